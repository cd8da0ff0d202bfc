//! Whether the disk has room for what is to be written: estimates from rows and columns.
//! PURE. Uses: arrow's types, the sizes of `record`. Never: the disk; an estimate of the compression.

use arrow_schema::{DataType, Schema};

use super::error::{DatasetError, Product};
use super::format::Format;
use crate::record::{TRIAL_BYTES, VOLTAGES_BYTES};

/// Free space that is reserved for runs, bytes.
pub const KEPT_FREE_BYTES: u64 = 2 << 30;
/// Size of a text, bytes: most are ids of 36 characters.
const TEXT_BYTES: u64 = 64;
/// Size of a list of variable length as text, bytes: six contacts.
const LIST_BYTES: u64 = 600;
/// Size of a stored contact, bytes: its row and the entry of the index.
const CONTACT_BYTES: u64 = 80;

/// Checks that `needed` bytes leave the space that is reserved for runs; `free`: free space, bytes.
///
/// # Errors
/// `DatasetError::DiskFull` if they do not.
pub fn check(product: Product, needed: u64, free: u64) -> Result<(), DatasetError> {
    let kept = KEPT_FREE_BYTES;
    if needed.checked_add(kept).is_some_and(|all| all <= free) {
        return Ok(());
    }
    Err(DatasetError::DiskFull { product, needed, free, kept })
}

/// Number of bytes that must become free for `needed` bytes; 0 if there is room. `free`: as in [`check`].
pub fn lacking(needed: u64, free: u64) -> u64 {
    needed.saturating_add(KEPT_FREE_BYTES).saturating_sub(free)
}

/// Upper estimate of the size of a row in a file, bytes.
pub fn row_bytes(schema: &Schema, format: Format) -> u64 {
    let as_text = format.is_text();
    let name = |name: &str| if as_text { name.len() as u64 + 4 } else { 0 };
    schema.fields().iter().map(|f| cell_bytes(f.data_type(), as_text) + name(f.name())).sum()
}

fn cell_bytes(kind: &DataType, as_text: bool) -> u64 {
    match kind {
        DataType::FixedSizeList(item, length) => {
            u64::try_from(*length).unwrap_or(0) * cell_bytes(item.data_type(), as_text)
        }
        DataType::List(_) => LIST_BYTES,
        DataType::Utf8 => TEXT_BYTES,
        // The longest numbers: -1.17549435e-38 and -2.2250738585072014e-308, and a comma.
        DataType::Float32 if as_text => 16,
        _ if as_text => 26,
        DataType::Float32 => 4,
        _ => 8,
    }
}

/// Size of an import in the database, bytes. `frames`: number of measured and simulated frames of all
/// trials, of `channels` voltages each; `contacts`: number of contacts of all trials.
pub fn imported_bytes(trials: u64, frames: u64, channels: u64, contacts: u64) -> u64 {
    let parts = [
        trials.saturating_mul(TRIAL_BYTES),
        frames.saturating_mul(VOLTAGES_BYTES + 4 * channels),
        contacts.saturating_mul(CONTACT_BYTES),
    ];
    parts.into_iter().fold(0, u64::saturating_add)
}

/// Size of an uploaded file and of its trials in the database, bytes. Measured on frames of noise: the
/// trials take 0.65 times the size of a file of f64 without compression, 1.54 times that of f32 with zstd.
pub fn upload_bytes(file: u64) -> u64 {
    file.saturating_add(file.saturating_mul(3) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::schema::{all, force_map};

    #[test]
    fn nothing_is_written_into_the_space_of_runs() {
        let free = KEPT_FREE_BYTES + 1000;
        check(Product::Import, 1000, free).unwrap();
        let refused = check(Product::Import, 1001, free).unwrap_err().to_string();
        assert!(refused.starts_with("an import of about 1001 bytes: 2147484648 bytes are free"));
        check(Product::Import, 0, KEPT_FREE_BYTES - 1).unwrap_err();
        check(Product::Export, u64::MAX, u64::MAX).unwrap_err();
        assert_eq!((lacking(1000, free), lacking(1001, free)), (0, 1));
    }

    #[test]
    fn frames_and_maps_determine_the_size_of_a_row() {
        let frames = all(784);
        let [binary, text] = [Format::Arrow, Format::Csv].map(|format| row_bytes(&frames, format));
        assert!((2 * 784 * 4..2 * 784 * 4 + 3000).contains(&binary), "{binary}");
        assert!((2 * 784 * 16..2 * 784 * 16 + 4000).contains(&text), "{text}");
        let map = Schema::new(vec![force_map(25_600)]);
        assert_eq!(row_bytes(&map, Format::Parquet), 4 * 25_600);
    }

    #[test]
    fn an_import_takes_the_space_that_was_measured() {
        // 20,000 trials of one contact: 3500 bytes each in SQLite, 6798 with a simulated frame.
        for (frames, measured) in [(1, 3500), (2, 6798)] {
            let bytes = imported_bytes(1, frames, 784, 1);
            assert!((measured..measured * 5 / 4).contains(&bytes), "{frames}: {bytes}");
        }
        assert_eq!(imported_bytes(u64::MAX, 1, 1, 1), u64::MAX);
    }
}
