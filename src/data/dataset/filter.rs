//! Which rows of a table meet a condition.
//! PURE. Uses: `store`'s conditions, arrow. Never: a syntax of conditions.

use std::cmp::Ordering;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float32Type, Float64Type, Int64Type, TimestampMillisecondType, UInt8Type, UInt32Type,
    UInt64Type,
};
use arrow_array::{Array, BooleanArray, RecordBatch};
use arrow_schema::{DataType, Schema};

use super::schema::comparable;
use crate::store::{Condition, Operand};

/// That a table has the column of a condition.
///
/// # Errors
/// The columns that the table can be compared by.
pub fn fits(condition: &Condition, schema: &Schema) -> Result<(), String> {
    let name = condition.column().name;
    match schema.field_with_name(name) {
        Ok(_) => Ok(()),
        Err(_) => {
            let names = comparable(schema).join(", ");
            Err(format!("these rows have no column {name}; there are {names}"))
        }
    }
}

/// Which rows meet it; a table without its column has none.
pub fn mask(condition: &Condition, batch: &RecordBatch) -> BooleanArray {
    let Some(column) = batch.column_by_name(condition.column().name) else {
        return vec![false; batch.num_rows()].into();
    };
    let meets = |row| condition.is_met(|operand| order(column.as_ref(), row, operand));
    (0..batch.num_rows()).map(|row| Some(!column.is_null(row) && meets(row))).collect()
}

/// The order of a value against an operand.
fn order(column: &dyn Array, row: usize, operand: &Operand) -> Option<Ordering> {
    match operand {
        // A force that is kept as f32 is compared as one: 5.1 in it equals 5.1.
        Operand::Number(wanted) => match column.as_primitive_opt::<Float32Type>() {
            Some(singles) => singles.value(row).partial_cmp(&(*wanted as f32)),
            None => number(column, row)?.partial_cmp(wanted),
        },
        Operand::Time(wanted) => {
            let times = column.as_primitive_opt::<TimestampMillisecondType>()?;
            Some(times.value(row).cmp(&wanted.as_millisecond()))
        }
        Operand::Word(wanted) => {
            Some(column.as_string_opt::<i32>()?.value(row).cmp(wanted.as_str()))
        }
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
