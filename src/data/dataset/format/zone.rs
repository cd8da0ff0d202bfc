//! Names of the zone UTC: the readers and writers of text support offsets but no names of zones.
//! PURE. Uses: arrow. Never: other zones.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::TimestampMillisecondType;
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{ArrowError, DataType, Field, Schema, TimeUnit};

/// Name of UTC in tables.
pub(crate) const NAME: &str = "UTC";
/// Offset of UTC in texts.
pub(crate) const OFFSET: &str = "+00:00";

/// Replaces the zone `UTC` by `+00:00` in all columns; the instants do not change.
pub(super) fn as_offsets(batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    renamed(batch, NAME, OFFSET)
}

/// Replaces the zone `from` by `to` in all columns.
///
/// # Errors
/// `ArrowError` if the columns do not fit together.
pub(crate) fn renamed(
    batch: &RecordBatch,
    from: &str,
    to: &'static str,
) -> Result<RecordBatch, ArrowError> {
    let schema = batch.schema();
    let offset = Arc::<str>::from(to);
    let columns = schema.fields().iter().zip(batch.columns()).map(|(field, column)| {
        match field.data_type() {
            DataType::Timestamp(TimeUnit::Millisecond, Some(zone)) if zone.as_ref() == from => {
                let times = column.as_primitive::<TimestampMillisecondType>().clone();
                let times: ArrayRef = Arc::new(times.with_timezone(offset.clone()));
                let kind = times.data_type().clone();
                (Arc::new(Field::clone(field).with_data_type(kind)), times)
            }
            _ => (field.clone(), column.clone()),
        }
    });
    let (fields, columns): (Vec<_>, Vec<_>) = columns.unzip();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), columns)
}
