//! Width of rows, and the number of rows per batch that follows from it.
//! PURE. Uses: arrow. Never: values.

use arrow_schema::{DataType, Schema};

/// Largest number of rows per batch.
const WRITTEN_ROWS: usize = 1000;
/// Largest size of a batch of several rows, bytes.
const BYTES: usize = 16 << 20;
/// Assumed size of a text or a list of variable length, bytes.
const LOOSE_BYTES: usize = 64;

/// Returns the number of rows per batch, and so per Parquet row group: 1000, or fewer for wide rows
/// (force maps), so that a batch holds at most 16 MiB; at least 1.
pub fn rows_per_batch(schema: &Schema) -> usize {
    rows_within(schema, BYTES).min(WRITTEN_ROWS)
}

/// Returns the number of rows that take `most` bytes; at least 1.
pub fn rows_within(schema: &Schema, most: usize) -> usize {
    let row: usize = schema.fields().iter().map(|field| bytes(field.data_type())).sum();
    (most / row.max(1)).max(1)
}

fn bytes(kind: &DataType) -> usize {
    match kind {
        DataType::FixedSizeList(item, length) => {
            bytes(item.data_type()) * usize::try_from(*length).unwrap_or(0)
        }
        other => other.primitive_width().unwrap_or(LOOSE_BYTES),
    }
}
