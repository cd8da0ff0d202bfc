//! Evaluates conditions on the rows of a batch.
//! PURE. Uses: `store`'s conditions, arrow. Never: the syntax of conditions.

use std::cmp::Ordering;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, TimestampMillisecondType};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_buffer::BooleanBuffer;
use arrow_cast::cast;
use arrow_schema::{DataType, Schema};

use super::schema::comparable;
use crate::store::{Condition, Operand, Part};

/// Checks that a table has the column of a condition.
///
/// # Errors
/// The limit as text, with the comparable columns of the table.
pub fn fits(condition: &Condition, schema: &Schema) -> Result<(), String> {
    let missing = condition.columns().find(|column| schema.field_with_name(column.name).is_err());
    match missing {
        None => Ok(()),
        Some(column) => {
            let (name, names) = (column.name, comparable(schema).join(", "));
            Err(format!("must name a column of these rows, which have no {name}: {names}"))
        }
    }
}

/// Returns which rows meet all conditions.
pub fn all(conditions: &[Condition], batch: &RecordBatch) -> BooleanBuffer {
    let every = BooleanBuffer::new_set(batch.num_rows());
    conditions.iter().fold(every, |rows, condition| &rows & &mask(condition, batch))
}

/// Returns which rows meet a condition; a comparison with a column that the batch lacks does not hold.
pub fn mask(condition: &Condition, batch: &RecordBatch) -> BooleanBuffer {
    let values = |part: &Part| -> Option<ArrayRef> {
        let column = batch.column_by_name(part.column().name)?;
        match column.data_type().is_integer() {
            true => cast(column, &DataType::Float64).ok(),
            false => Some(column.clone()),
        }
    };
    let parts = condition.parts().iter().filter_map(|part| Some((part, values(part)?)));
    let parts: Vec<(&Part, ArrayRef)> = parts.collect();
    let meets = |row: usize, (part, column): &(&Part, ArrayRef)| {
        !column.is_null(row) && part.is_met(|operand| order(column, row, operand))
    };
    BooleanBuffer::collect_bool(batch.num_rows(), |row| parts.iter().any(|part| meets(row, part)))
}

/// Compares a value with an operand; `None` if their types differ or a number is NaN.
fn order(column: &dyn Array, row: usize, operand: &Operand) -> Option<Ordering> {
    match operand {
        // A value stored as f32 is compared as f32: a stored 5.1 equals 5.1.
        Operand::Number(wanted) => match column.as_primitive_opt::<Float32Type>() {
            Some(singles) => singles.value(row).partial_cmp(&(*wanted as f32)),
            None => column.as_primitive_opt::<Float64Type>()?.value(row).partial_cmp(wanted),
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
