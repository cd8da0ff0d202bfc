//! How wide rows are, and what a list is made of.
//! PURE. Uses: arrow. Never: values.

use arrow_schema::{DataType, Schema};

/// Rows of a batch where nothing asks for fewer.
const ROWS: usize = 1000;
/// Bytes that a batch should stay under.
const BYTES: usize = 16 << 20;
/// What a text, or a list of any length, is reckoned to hold, bytes.
const LOOSE_BYTES: usize = 64;

/// Rows of a batch, and so of a Parquet row group: 1000, or fewer where rows are so wide (force
/// maps) that these would hold more than 16 MiB; never none.
pub fn rows_per_batch(schema: &Schema) -> usize {
    let row: usize = schema.fields().iter().map(|field| bytes(field.data_type())).sum();
    (BYTES / row.max(1)).clamp(1, ROWS)
}

fn bytes(kind: &DataType) -> usize {
    match kind {
        DataType::FixedSizeList(item, length) => {
            bytes(item.data_type()) * usize::try_from(*length).unwrap_or(0)
        }
        other => other.primitive_width().unwrap_or(LOOSE_BYTES),
    }
}
