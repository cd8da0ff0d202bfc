//! Filters, `COLUMN__gt=VALUE`: one language for stored trials and runs, where a condition becomes
//! SQL, and for the rows of datasets, where it becomes a mask. A NULL meets no condition.
//! Uses: `column`, `near` of words. Never: text of a request inside a statement.

use jiff::Timestamp;

use super::column::{self, Column, Kind, TABLE};
use crate::core::bulk::Statement;
use crate::core::columns::time_text;
use crate::near::did_you_mean;

/// Operator of a condition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Comparison {
    /// Equal: `eq`; `in` for several values.
    Equal,
    /// Greater: `gt`.
    Greater,
    /// Greater or equal: `gte`.
    GreaterOrEqual,
    /// Less: `lt`.
    Less,
    /// Less or equal: `lte`.
    LessOrEqual,
}

/// Value with which a column is compared; its type is the kind of the column.
#[derive(Debug, Clone, PartialEq)]
pub enum Operand {
    /// A finite number in the unit of the column.
    Number(f64),
    /// A time (UTC).
    Time(Timestamp),
    /// A word, compared exactly.
    Word(String),
}

/// A condition on a row: one or several comparisons, of which one must hold.
#[derive(Debug, Clone)]
pub struct Condition(Vec<Part>);

/// A comparison of one column with one or several values.
#[derive(Debug, Clone)]
pub struct Part {
    column: &'static Column,
    comparison: Comparison,
    /// At least one; the comparison holds if it holds for one of them.
    operands: Vec<Operand>,
}

impl Condition {
    /// Parses a condition on stored trials or rows of datasets: `COLUMN`, `COLUMN__eq|gt|gte|lt|lte` with a value,
    /// or `COLUMN__in` with several, separated by commas; or several of these separated by `|`, of which one must hold.
    ///
    /// # Errors
    /// A message that names the invalid part and the choices: no `=`, an unknown column or comparison, a value
    /// of another type, an order of words, or a column of lists.
    pub fn parse(text: &str) -> Result<Self, String> {
        Self::parse_of(&TABLE, text)
    }

    /// Parses a condition on the columns of a table.
    ///
    /// # Errors
    /// As [`Condition::parse`].
    pub fn parse_of(table: &'static [Column], text: &str) -> Result<Self, String> {
        let several: Vec<&str> = text.split('|').collect();
        // A word may hold the separator.
        let texts =
            if several.iter().all(|part| part.contains('=')) { several } else { vec![text] };
        let part = |text: &str| {
            let (key, value) =
                text.split_once('=').ok_or("must be COLUMN__gt=VALUE, or another comparison")?;
            Part::from_pair(table, key.trim(), value.trim())
        };
        texts.into_iter().map(part).collect::<Result<_, _>>().map(Self)
    }

    /// Returns the condition if stored trials have its columns.
    ///
    /// # Errors
    /// A message with the columns of stored trials if only datasets have one of them.
    pub fn of_stored(self) -> Result<Self, String> {
        let Some(other) = self.columns().find(|column| !column.is_of_stored()) else {
            return Ok(self);
        };
        let stored = column::names(|column| column.is_of_stored() && column.kind() != Kind::List);
        Err(format!("only datasets have {}; stored trials have {stored}", other.name))
    }

    /// The comparisons, of which one must hold.
    pub fn parts(&self) -> &[Part] {
        &self.0
    }

    /// The columns that are compared.
    pub fn columns(&self) -> impl Iterator<Item = &'static Column> {
        self.0.iter().map(|part| part.column)
    }

    /// Returns the condition as SQL of the query engine, in which a time is a text without a zone.
    pub fn to_sql(&self) -> String {
        let parts: Vec<String> = self.0.iter().map(Part::to_sql).collect();
        if parts.len() > 1 { format!("({})", parts.join(" OR ")) } else { parts.concat() }
    }

    /// Appends ` AND` and the condition. It selects nothing if stored trials do not have its column.
    pub(crate) fn push_onto(&self, query: &mut Statement) {
        let several = self.0.len() > 1;
        query.push(if several { " AND (" } else { " AND " });
        query.each(&self.0, " OR ", |query, part| part.push_onto(query, several));
        query.push(if several { ")" } else { "" });
    }

    /// Whether it states the ids of the trials.
    pub(crate) fn lists_ids(&self) -> bool {
        let of_id = |part: &Part| part.comparison == Comparison::Equal && part.is_of_id();
        self.0.len() == 1 && self.0.iter().all(of_id)
    }

    /// Whether the bounds of a block can exclude it; those of ids alone are the block.
    pub(crate) fn is_bounded(&self) -> bool {
        self.0.iter().all(|part| part.column.is_bounded()) && !self.0.iter().all(Part::is_of_id)
    }

    /// Appends ` AND` and what a block meets if it may hold a trial that meets the condition; nothing if
    /// the bounds of a block cannot exclude it.
    pub(crate) fn push_onto_blocks(&self, query: &mut Statement) {
        if !self.0.iter().all(|part| part.column.is_bounded()) {
            return;
        }
        query.push(" AND (");
        query.each(&self.0, " OR ", |query, part| part.push_onto_blocks(query));
        query.push(")");
    }
}

impl Operand {
    /// Appends the value.
    fn push_onto(&self, query: &mut Statement) {
        match self {
            Self::Number(number) => query.bind(*number),
            Self::Time(time) => query.bind(time_text(*time)),
            Self::Word(word) => query.bind(word.clone()),
        };
    }
}

impl Part {
    fn from_pair(table: &'static [Column], key: &str, value: &str) -> Result<Self, String> {
        let (name, suffix) = key.rsplit_once("__").unwrap_or((key, "eq"));
        let comparable = || column::names_of(table, |column| column.kind() != Kind::List);
        let column = table.iter().find(|column| column.name == name).ok_or_else(|| {
            let all = comparable();
            format!(
                "there is no column {name}; there are {all}{}",
                did_you_mean(name, all.split(", "))
            )
        })?;
        let comparison = match suffix {
            "eq" | "in" => Comparison::Equal,
            "gt" => Comparison::Greater,
            "gte" => Comparison::GreaterOrEqual,
            "lt" => Comparison::Less,
            "lte" => Comparison::LessOrEqual,
            _ => return Err(format!("{suffix}: must be eq, gt, gte, lt, lte or in")),
        };
        let operand = |text: &str| match column.kind() {
            Kind::Number => match text.parse::<f64>() {
                Ok(number) if number.is_finite() => Ok(Operand::Number(number)),
                _ => Err(format!("{text}: {name} holds numbers")),
            },
            Kind::Time => match text.parse() {
                Ok(time) => Ok(Operand::Time(time)),
                Err(_) => Err(format!("{text}: {name} holds RFC 3339 times")),
            },
            Kind::Word if comparison == Comparison::Equal => Ok(Operand::Word(text.into())),
            Kind::Word => Err(format!("{name} holds words: use eq or in")),
            Kind::List => Err(format!(
                "{name} holds a list for each row and cannot be compared; filter by {}",
                comparable()
            )),
        };
        let texts: Vec<&str> =
            if suffix == "in" { value.split(',').collect() } else { vec![value] };
        let operands = texts.into_iter().map(operand).collect::<Result<_, _>>()?;
        Ok(Self { column, comparison, operands })
    }

    /// Returns the column that is compared.
    pub fn column(&self) -> &'static Column {
        self.column
    }

    /// Whether a value meets the comparison. `order` returns the order of the value relative to an
    /// operand; `None` if they cannot be compared.
    pub fn is_met(&self, order: impl FnMut(&Operand) -> Option<std::cmp::Ordering>) -> bool {
        self.operands.iter().filter_map(order).any(|order| match self.comparison {
            Comparison::Equal => order.is_eq(),
            Comparison::Greater => order.is_gt(),
            Comparison::GreaterOrEqual => order.is_ge(),
            Comparison::Less => order.is_lt(),
            Comparison::LessOrEqual => order.is_le(),
        })
    }

    fn operator(&self) -> &'static str {
        match self.comparison {
            Comparison::Equal => " = ",
            Comparison::Greater => " > ",
            Comparison::GreaterOrEqual => " >= ",
            Comparison::Less => " < ",
            Comparison::LessOrEqual => " <= ",
        }
    }

    fn to_sql(&self) -> String {
        let value = |operand: &Operand| match operand {
            Operand::Number(number) => number.to_string(),
            Operand::Time(time) => format!("'{}'", time.strftime("%Y-%m-%dT%H:%M:%S%.3f")),
            Operand::Word(word) => format!("'{}'", word.replace('\'', "''")),
        };
        let values: Vec<String> = self.operands.iter().map(value).collect();
        match values.as_slice() {
            [one] => format!("{}{}{one}", self.column.name, self.operator()),
            several => format!("{} IN ({})", self.column.name, several.join(", ")),
        }
    }

    /// Appends the comparison; `alternative`: it is one of several, of which one must hold.
    fn push_onto(&self, query: &mut Statement, alternative: bool) {
        let column = if self.column.sql.is_empty() { "NULL" } else { self.column.sql };
        let several = self.operands.len() > 1;
        // `+` prevents an index: for several values SQLite would use it and sort the result, and a page
        // of 200,000 trials takes 44 ms instead of 0.3 ms. For ids the index is faster.
        let unindexed = alternative || several && self.column.name != "trial_id";
        query.push(if unindexed { "+" } else { "" }).push(column);
        // Several values are compared for equality only.
        query.push(if several { " IN (" } else { self.operator() });
        query.each(&self.operands, ", ", |query, operand| operand.push_onto(query));
        query.push(if several { ")" } else { "" });
    }

    fn is_of_id(&self) -> bool {
        self.column.name == "trial_id"
    }

    /// Appends what a block meets if one of its trials may meet the comparison.
    fn push_onto_blocks(&self, query: &mut Statement) {
        if self.column.sql.starts_with("r.") {
            query.push(
                "EXISTS (SELECT 1 FROM runs r
                 WHERE r.scan_id BETWEEN b.scan_id_least AND b.scan_id_most AND ",
            );
            self.push_onto(query, false);
            query.push(")");
            return;
        }
        let name = self.column.name;
        let (least, most) = if self.is_of_id() {
            ("b.block << 10".to_owned(), "(b.block << 10) + 1023".to_owned())
        } else {
            (format!("b.{name}_least"), format!("b.{name}_most"))
        };
        let bound = match (self.comparison, self.operands.as_slice()) {
            (Comparison::Equal, [operand]) => {
                query.push(&least).push(" <= ");
                operand.push_onto(query);
                query.push(" AND ").push(&most).push(" >= ");
                operand.push_onto(query);
                return;
            }
            // A list may have more values than an expression may have levels.
            (Comparison::Equal, operands) => {
                query.push("EXISTS (SELECT 1 FROM (VALUES (");
                query.each(operands, "), (", |query, operand| operand.push_onto(query));
                query.push(")) WHERE column1 BETWEEN ");
                query.push(&least).push(" AND ").push(&most).push(")");
                return;
            }
            (Comparison::Greater | Comparison::GreaterOrEqual, _) => most,
            (Comparison::Less | Comparison::LessOrEqual, _) => least,
        };
        query.each(&self.operands, " OR ", |query, operand| {
            query.push(&bound).push(self.operator());
            operand.push_onto(query);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_names_the_column_and_the_choices() {
        let wrong = |text: &str| Condition::parse(text).unwrap_err();
        assert!(wrong("colour=red").contains("contact_count"));
        assert!(wrong("deph__gt=3").ends_with("; did you mean `depth_mm`?"));
        assert!(wrong("voltages_v__gt=1").contains("cannot be compared; filter by trial_id"));
        assert!(wrong("tips__near=3").contains("gte"));
        assert!(wrong("tips__gt=many").contains("tips holds numbers"));
        assert!(wrong("started_at__gt=5").contains("RFC 3339"));
        assert!(wrong("run__gt=a").contains("eq or in"));
        assert!(wrong("tips__in=1,,2").contains("tips holds numbers"));
        assert!(wrong("tips=3|colour=red").contains("contact_count"));
        let split = Condition::parse("split=train").unwrap().of_stored().unwrap_err();
        assert!(split.contains("only datasets have split"), "{split}");
        let either = Condition::parse("tips=3|split=train").unwrap();
        assert!(either.of_stored().unwrap_err().contains("only datasets have split"));
    }

    #[test]
    fn a_condition_is_sql_of_the_engine() {
        let sql = |text: &str| Condition::parse(text).unwrap().to_sql();
        assert_eq!(sql("max_force_n__gte=0.5"), "max_force_n >= 0.5");
        assert_eq!(sql("tips__in=4,6"), "tips IN (4, 6)");
        assert_eq!(sql("experiment=O'Hara"), "experiment = 'O''Hara'");
        assert_eq!(sql("experiment=a|b"), "experiment = 'a|b'");
        assert_eq!(sql("tips=4|fvu__lt=1e-3"), "(tips = 4 OR fvu < 0.001)");
        assert_eq!(
            sql("measured_at__gt=2026-11-23T20:18:00.5+01:00"),
            "measured_at > '2026-11-23T19:18:00.500'"
        );
    }

    #[test]
    fn every_column_that_stored_trials_can_be_compared_by_has_its_sql() {
        for column in &column::TABLE {
            let comparable = column.is_of_stored() && column.kind() != Kind::List;
            assert_eq!(!column.sql.is_empty(), comparable, "{}", column.name);
            assert!(!column.about.is_empty() && column.name.ends_with(&column.unit.to_lowercase()));
        }
    }
}
