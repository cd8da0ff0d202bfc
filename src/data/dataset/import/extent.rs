//! How much a foreign file holds: a Parquet file by its footer alone, the others by their headers and lines.
//! PURE. Uses: parquet's metadata, `dataset::space`. Never: a value of the file.

use std::collections::BTreeMap;

use parquet::basic::Type;
use parquet::file::metadata::ParquetMetaData;

use super::BATCH_TRIALS;
use super::columns::{FRAMES_V, is_read};
use super::sensor::ImportedSensor;
use crate::dataset::schema::VOLTAGES_V;
use crate::dataset::space::ImportCounts;
use crate::problem::{Checks, Problem};
use crate::simulate::schema::{CONTACTS, SIM_VOLTAGES_V};
use crate::store::{IMPORTED_CONTACTS_MAX, IMPORTED_FRAMES_MAX};

/// Largest number of trials of an import: their keys are kept in memory.
pub const IMPORTED_TRIALS_MAX: u64 = 10_000_000;

/// Number of values of a column that are read at a time.
const VALUES_AT_ONCE: u64 = 4 << 20;
/// Largest size of the texts of a row group, and of those that are read at a time, bytes: a text that a group holds once
/// may be that of each of its rows.
const TEXT_BYTES_AT_ONCE: u64 = 256 << 20;

/// Largest number of values of a column in a row group of a Parquet file, 1 GiB of voltages: one row may have all of
/// them, whatever their mean is, and a row is read as a whole.
const GROUP_VALUES_MAX: u64 = 256 << 20;

/// Numbers of rows and values of a file.
#[derive(Debug, Default)]
pub struct Extent {
    rows: u64,
    /// Largest number of values of a leaf, by the column that is read.
    values: BTreeMap<String, u64>,
    /// Largest size of the texts of a row group that are read, without compression, bytes.
    text_bytes: u64,
    /// Largest number of values of a leaf in a row group.
    group_values: u64,
}

impl Extent {
    /// Of a file with this number of rows, and of values by column.
    pub fn new(rows: u64, values: BTreeMap<String, u64>) -> Self {
        Self { rows, values, text_bytes: 0, group_values: 0 }
    }

    /// Extent of a Parquet file, by its footer.
    pub fn of(footer: &ParquetMetaData) -> Self {
        let count = |n: i64| u64::try_from(n).unwrap_or(u64::MAX);
        let mut leaves: BTreeMap<String, u64> = BTreeMap::new();
        let mut extent = Self::default();
        for group in footer.row_groups() {
            extent.rows = extent.rows.saturating_add(count(group.num_rows()));
            let mut text_bytes: u64 = 0;
            for leaf in group.columns() {
                let path = leaf.column_path().string();
                if !is_read(column_of(&path)) {
                    continue;
                }
                if leaf.column_type() == Type::BYTE_ARRAY {
                    text_bytes = text_bytes.saturating_add(count(leaf.uncompressed_size()));
                }
                let in_group = count(leaf.num_values());
                extent.group_values = extent.group_values.max(in_group);
                let values = leaves.entry(path).or_default();
                *values = values.saturating_add(in_group);
            }
            extent.text_bytes = extent.text_bytes.max(text_bytes);
        }
        for (path, number) in leaves {
            let most: &mut u64 = extent.values.entry(column_of(&path).to_owned()).or_default();
            *most = number.max(*most);
        }
        extent
    }

    /// Number of rows.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Number of rows that are read at a time: fewer of rows with many values, or with long texts.
    pub fn rows_at_once(&self) -> usize {
        let most = self.values.values().copied().max().unwrap_or_default();
        let each = most.div_ceil(self.rows.max(1)).max(1);
        let of_texts = TEXT_BYTES_AT_ONCE / self.text_bytes.max(1);
        (VALUES_AT_ONCE / each).min(of_texts).clamp(1, BATCH_TRIALS as u64) as usize
    }

    /// Returns the size of the trials in the database, bytes. `file` is the name of the file in
    /// messages.
    ///
    /// # Errors
    /// A problem if there are too many rows, if the texts are too long, if a row group has too many values, and for each
    /// column with more values than trials of the sensor can have.
    pub fn needed(&self, file: &str, sensor: &ImportedSensor) -> Result<u64, Vec<Problem>> {
        let mut checks = Checks::of(file);
        let limit = format!("must be at most {IMPORTED_TRIALS_MAX}: split the file");
        checks.require(self.rows <= IMPORTED_TRIALS_MAX, "rows", self.rows, &limit);
        let texts = format!("{} bytes in a row group", self.text_bytes);
        let limit = format!("must be at most {TEXT_BYTES_AT_ONCE} bytes: write smaller row groups");
        checks.require(self.text_bytes <= TEXT_BYTES_AT_ONCE, "texts", texts, &limit);
        let values = format!("{} of a column in a row group", self.group_values);
        let limit = format!("must be at most {GROUP_VALUES_MAX}: write smaller row groups");
        checks.require(self.group_values <= GROUP_VALUES_MAX, "values", values, &limit);
        let channels = sensor.channels as u64;
        for (column, number) in &self.values {
            let most = match column.as_str() {
                VOLTAGES_V | SIM_VOLTAGES_V => channels,
                FRAMES_V => channels.saturating_mul(IMPORTED_FRAMES_MAX as u64),
                _ => IMPORTED_CONTACTS_MAX as u64,
            };
            let limit = format!("must have at most {most} values per row");
            let fits = *number <= self.rows.saturating_mul(most);
            checks.require(fits, column, format!("{number} values"), &limit);
        }
        checks.done()?;
        // Each row has a whole frame, which the reader checks, whatever the footer states.
        let simulated = u64::from(self.values.contains_key(SIM_VOLTAGES_V));
        let frames = self.rows.saturating_mul(1 + simulated);
        let contacts = self.values.get(CONTACTS).copied().unwrap_or(0);
        let raw_frames = self.values.get(FRAMES_V).copied().unwrap_or(0).div_ceil(channels.max(1));
        Ok(ImportCounts { trials: self.rows, frames, raw_frames, channels, contacts }.bytes())
    }
}

/// The column of a leaf.
pub(super) fn column_of(path: &str) -> &str {
    path.split('.').next().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pad() -> ImportedSensor {
        let text = "name = \"pad\"\nchannels = 4\nwidth_mm = 100\nheight_mm = 80\n";
        ImportedSensor::from_toml("pad.toml", text).unwrap()
    }

    fn extent(rows: u64, values: [(&str, u64); 2]) -> Extent {
        Extent::new(rows, values.map(|(name, n)| (name.to_owned(), n)).into())
    }

    #[test]
    fn a_file_of_few_bytes_and_many_values_is_refused() {
        let of = |rows, voltages, contacts| {
            let extent = extent(rows, [(VOLTAGES_V, voltages), (CONTACTS, contacts)]);
            extent.needed("f", &pad()).map_err(|all| all[0].to_string())
        };
        let counts =
            ImportCounts { trials: 10, frames: 10, raw_frames: 0, channels: 4, contacts: 12 };
        assert_eq!(of(10, 40, 12).unwrap(), counts.bytes());
        let refused = "f: voltages_v = 41 values: must have at most 4 values per row";
        assert_eq!(of(10, 41, 12).unwrap_err(), refused);
        let refused = "f: contacts = 641 values: must have at most 64 values per row";
        assert_eq!(of(10, 40, 641).unwrap_err(), refused);
        let refused = of(IMPORTED_TRIALS_MAX + 1, 0, 0).unwrap_err();
        assert!(refused.starts_with("f: rows = 10000001: must be at most 10000000"), "{refused}");
    }

    #[test]
    fn raw_frames_are_counted_and_read_in_smaller_pieces() {
        let of = |number| extent(10, [(FRAMES_V, number), (CONTACTS, 0)]);
        let counts =
            ImportCounts { trials: 10, frames: 10, raw_frames: 30, channels: 4, contacts: 0 };
        assert_eq!(of(120).needed("f", &pad()).unwrap(), counts.bytes());
        assert_eq!(of(120).rows_at_once(), BATCH_TRIALS);
        let most = 10 * 4 * IMPORTED_FRAMES_MAX as u64;
        let refused = of(most + 1).needed("f", &pad()).unwrap_err()[0].to_string();
        let words = format!("must have at most {} values per row", most / 10);
        assert!(refused.starts_with("f: frames_v = ") && refused.ends_with(&words), "{refused}");
        assert_eq!(of(10 * VALUES_AT_ONCE / 3).rows_at_once(), 2);
        assert_eq!(of(u64::MAX).rows_at_once(), 1);
    }

    #[test]
    fn rows_with_long_texts_are_read_in_smaller_pieces() {
        let of =
            |text_bytes| Extent { text_bytes, ..extent(1000, [(VOLTAGES_V, 0), (CONTACTS, 0)]) };
        assert_eq!(of(100_000).rows_at_once(), BATCH_TRIALS);
        assert_eq!(of(TEXT_BYTES_AT_ONCE / 3).rows_at_once(), 3);
        assert!(of(TEXT_BYTES_AT_ONCE).needed("f", &pad()).is_ok());
        let refused = of(TEXT_BYTES_AT_ONCE + 1).needed("f", &pad()).unwrap_err()[0].to_string();
        assert!(refused.starts_with("f: texts = 268435457 bytes in a row group"), "{refused}");
    }

    #[test]
    fn a_row_group_with_values_for_one_long_row_is_refused() {
        let of = |group_values| {
            let few = extent(1000, [(VOLTAGES_V, 4000), (CONTACTS, 0)]);
            Extent { group_values, ..few }.needed("f", &pad())
        };
        assert!(of(GROUP_VALUES_MAX).is_ok());
        let refused = of(GROUP_VALUES_MAX + 1).unwrap_err()[0].to_string();
        let words = "f: values = 268435457 of a column in a row group";
        assert!(refused.starts_with(words), "{refused}");
    }
}
