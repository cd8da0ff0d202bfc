//! Whether the disk has room for what is to be written: estimates from rows and columns.
//! PURE. Uses: arrow's types, the sizes of `record`. Never: the disk; an estimate of the compression.

use arrow_schema::{DataType, Schema};

use super::error::{DatasetError, DatasetResult, Product};
use super::format::Format;
use crate::record::{RAW_FRAME_BYTES, TRIAL_BYTES, VOLTAGES_BYTES};

/// Free space that is reserved for runs, bytes.
pub const KEPT_FREE_BYTES: u64 = 2 << 30;
/// Size of a text, bytes: most are ids of 36 characters.
const TEXT_BYTES: u64 = 64;
/// Size of a list of variable length as text, bytes: six contacts.
const LIST_BYTES: u64 = 600;
/// Size of a stored contact, bytes: its row and the entry of the index.
const CONTACT_BYTES: u64 = 80;

/// Space on the disk, bytes.
#[derive(Debug, Clone, Copy)]
pub struct Space {
    /// What is to be written.
    pub needed: u64,
    /// Free space.
    pub free: u64,
}

impl Space {
    /// Checks that what is needed leaves the space that is reserved for runs.
    ///
    /// # Errors
    /// `DatasetError::DiskFull` if it does not.
    pub fn check(self, product: Product) -> DatasetResult<()> {
        let (Self { needed, free }, kept) = (self, KEPT_FREE_BYTES);
        if needed.checked_add(kept).is_some_and(|all| all <= free) {
            return Ok(());
        }
        Err(DatasetError::DiskFull { product, needed, free, kept })
    }

    /// Number of bytes that must become free; 0 if there is room.
    pub fn lacking(self) -> u64 {
        self.needed.saturating_add(KEPT_FREE_BYTES).saturating_sub(self.free)
    }
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

/// What an import consists of.
#[derive(Debug, Clone, Copy)]
pub struct ImportCounts {
    /// Number of trials.
    pub trials: u64,
    /// Number of measured and simulated frames of all trials.
    pub frames: u64,
    /// Number of raw frames of all trials.
    pub raw_frames: u64,
    /// Number of voltages of a frame.
    pub channels: u64,
    /// Number of contacts of all trials.
    pub contacts: u64,
}

impl ImportCounts {
    /// Size in the database, bytes.
    pub fn bytes(self) -> u64 {
        let parts = [
            self.trials.saturating_mul(TRIAL_BYTES),
            self.frames.saturating_mul(VOLTAGES_BYTES + 4 * self.channels),
            self.raw_frames.saturating_mul(RAW_FRAME_BYTES + 2 * self.channels),
            self.contacts.saturating_mul(CONTACT_BYTES),
        ];
        parts.into_iter().fold(0, u64::saturating_add)
    }
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
        let fits = Space { needed: 1000, free };
        fits.check(Product::Import).unwrap();
        let large = Space { needed: 1001, free };
        let refused = large.check(Product::Import).unwrap_err().to_string();
        assert!(refused.starts_with("an import of about 1001 bytes: 2147484648 bytes are free"));
        let full = Space { needed: 0, free: KEPT_FREE_BYTES - 1 };
        full.check(Product::Import).unwrap_err();
        Space { needed: u64::MAX, free: u64::MAX }.check(Product::Export).unwrap_err();
        assert_eq!((fits.lacking(), large.lacking()), (0, 1));
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
            let counts =
                ImportCounts { trials: 1, frames, raw_frames: 0, channels: 784, contacts: 1 };
            let bytes = counts.bytes();
            assert!((measured..measured * 5 / 4).contains(&bytes), "{frames}: {bytes}");
        }
        let most =
            ImportCounts { trials: u64::MAX, frames: 1, raw_frames: 1, channels: 1, contacts: 1 };
        assert_eq!(most.bytes(), u64::MAX);
        // A raw frame takes about half the space of a mean.
        let raw = ImportCounts { trials: 0, frames: 0, raw_frames: 1, channels: 784, contacts: 0 };
        assert_eq!(raw.bytes(), 250 + 2 * 784);
    }
}
