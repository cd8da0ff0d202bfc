//! Conditions on rows: `COLUMN__gt=VALUE`, checked against the columns that there are.
//! PURE. Uses: `dataset::schema`, arrow. Never: SQL.

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int64Type, TimestampMillisecondType, UInt8Type, UInt32Type,
    UInt64Type,
};
use arrow_array::{Array, BooleanArray, RecordBatch};
use arrow_schema::{DataType, Schema};
use jiff::Timestamp;

use super::schema::{COLUMNS, Kind, kind};

/// How a value is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Comparison {
    Equal,
    Greater,
    GreaterOrEqual,
    Less,
    LessOrEqual,
}

/// What it is compared with.
#[derive(Debug, Clone, PartialEq)]
enum Operand {
    Number(f64),
    Millisecond(i64),
    Word(String),
}

/// One condition; an absent value meets none.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    column: String,
    comparison: Comparison,
    /// One, or those of which one must be met.
    operands: Vec<Operand>,
}

/// The columns that rows can be filtered by.
pub fn filterable() -> String {
    let names = COLUMNS.iter().filter(|(_, kind)| *kind != Kind::List);
    names.map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ")
}

impl Filter {
    /// Reads `COLUMN__gt=VALUE`; what is wrong with it otherwise.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or("must be COLUMN__gt=VALUE or the like")?;
        Self::from_pair(key.trim(), value.trim())
    }

    /// Reads a pair of a query string; what is wrong with it otherwise.
    pub fn from_pair(key: &str, value: &str) -> Result<Self, String> {
        let (name, suffix) = key.rsplit_once("__").unwrap_or((key, "eq"));
        let Some((column, kind)) = COLUMNS.iter().find(|(column, _)| column == name) else {
            return Err(format!("there is no column {name}; there are {}", filterable()));
        };
        let comparison = match suffix {
            "eq" | "in" => Comparison::Equal,
            "gt" => Comparison::Greater,
            "gte" => Comparison::GreaterOrEqual,
            "lt" => Comparison::Less,
            "lte" => Comparison::LessOrEqual,
            _ => return Err(format!("{suffix}: must be eq, gt, gte, lt, lte or in")),
        };
        let texts: Vec<&str> =
            if suffix == "in" { value.split(',').collect() } else { vec![value] };
        let operands = texts.into_iter().map(|text| operand(column, *kind, comparison, text));
        Ok(Self {
            column: column.clone(),
            comparison,
            operands: operands.collect::<Result<_, _>>()?,
        })
    }

    /// The column that it looks at.
    pub fn column(&self) -> &str {
        &self.column
    }

    /// That a table has its column; what is wrong otherwise.
    pub fn fits(&self, schema: &Schema) -> Result<(), String> {
        match schema.field_with_name(&self.column) {
            Ok(_) => Ok(()),
            Err(_) => {
                let fields = schema.fields().iter();
                let names = fields.filter(|f| kind(f.data_type()) != Kind::List).map(|f| f.name());
                let names: Vec<&str> = names.map(String::as_str).collect();
                Err(format!(
                    "these rows have no column {}; there are {}",
                    self.column,
                    names.join(", ")
                ))
            }
        }
    }

    /// Which rows meet it; a table without its column has none.
    pub fn mask(&self, batch: &RecordBatch) -> BooleanArray {
        let Some(column) = batch.column_by_name(&self.column) else {
            return vec![false; batch.num_rows()].into();
        };
        (0..batch.num_rows())
            .map(|row| Some(!column.is_null(row) && self.meets(column.as_ref(), row)))
            .collect()
    }

    fn meets(&self, column: &dyn Array, row: usize) -> bool {
        self.operands.iter().any(|operand| {
            let order = match operand {
                Operand::Number(wanted) => {
                    number(column, row).and_then(|value| value.partial_cmp(wanted))
                }
                Operand::Millisecond(wanted) => column
                    .as_primitive_opt::<TimestampMillisecondType>()
                    .map(|times| times.value(row).cmp(wanted)),
                Operand::Word(wanted) => {
                    column.as_string_opt::<i32>().map(|words| words.value(row).cmp(wanted))
                }
            };
            order.is_some_and(|order| match self.comparison {
                Comparison::Equal => order.is_eq(),
                Comparison::Greater => order.is_gt(),
                Comparison::GreaterOrEqual => order.is_ge(),
                Comparison::Less => order.is_lt(),
                Comparison::LessOrEqual => order.is_le(),
            })
        })
    }
}

fn operand(
    column: &str,
    kind: Kind,
    comparison: Comparison,
    text: &str,
) -> Result<Operand, String> {
    match kind {
        Kind::Number => match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Operand::Number(number)),
            _ => Err(format!("{text}: {column} holds numbers")),
        },
        Kind::Time => match text.parse::<Timestamp>() {
            Ok(time) => Ok(Operand::Millisecond(time.as_millisecond())),
            Err(_) => Err(format!("{text}: {column} holds RFC 3339 times")),
        },
        Kind::Word if comparison == Comparison::Equal => Ok(Operand::Word(text.into())),
        Kind::Word => Err(format!("{column} holds words: use eq or in")),
        Kind::List => Err(format!(
            "{column} holds a list for each row and cannot be compared; filter by {}",
            filterable()
        )),
    }
}

/// A number of a column of numbers.
pub(super) fn number(column: &dyn Array, row: usize) -> Option<f64> {
    Some(match column.data_type() {
        DataType::Float64 => column.as_primitive_opt::<Float64Type>()?.value(row),
        DataType::Float32 => f64::from(column.as_primitive_opt::<Float32Type>()?.value(row)),
        DataType::Int64 => column.as_primitive_opt::<Int64Type>()?.value(row) as f64,
        DataType::UInt64 => column.as_primitive_opt::<UInt64Type>()?.value(row) as f64,
        DataType::UInt32 => f64::from(column.as_primitive_opt::<UInt32Type>()?.value(row)),
        DataType::UInt8 => f64::from(column.as_primitive_opt::<UInt8Type>()?.value(row)),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_names_the_column_and_the_choices() {
        let wrong = |text: &str| Filter::parse(text).unwrap_err();
        assert!(wrong("colour=red").contains("contact_count"));
        assert!(wrong("voltages_v__gt=1").contains("cannot be compared; filter by trial_id"));
        assert!(wrong("tips__near=3").contains("gte"));
        assert!(wrong("tips__gt=many").contains("tips holds numbers"));
        assert!(wrong("started_at__gt=5").contains("RFC 3339"));
        assert!(wrong("run__gt=a").contains("eq or in"));
        assert!(wrong("tips__in=1,,2").contains("tips holds numbers"));
    }
}
