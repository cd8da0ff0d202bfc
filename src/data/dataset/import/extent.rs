//! How much a foreign file holds: a Parquet file by its footer alone, the others by their headers and lines.
//! PURE. Uses: parquet's metadata, `dataset::space`. Never: a value of the file.

use std::collections::BTreeMap;

use parquet::file::metadata::ParquetMetaData;

use super::rows::is_read;
use super::sensor::ImportedSensor;
use crate::dataset::schema::VOLTAGES_V;
use crate::dataset::space::ImportCounts;
use crate::problem::{Checks, Problem};
use crate::simulate::schema::{CONTACTS, SIM_VOLTAGES_V};
use crate::store::IMPORTED_CONTACTS_MAX;

/// Largest number of trials of an import: their keys are kept in memory.
pub const IMPORTED_TRIALS_MAX: u64 = 10_000_000;

/// Numbers of rows and values of a file.
#[derive(Debug, Default)]
pub struct Extent {
    rows: u64,
    /// Largest number of values of a leaf, by the column that is read.
    values: BTreeMap<String, u64>,
}

impl Extent {
    /// Of a file with this number of rows, and of values by column.
    pub fn new(rows: u64, values: BTreeMap<String, u64>) -> Self {
        Self { rows, values }
    }

    /// Extent of a Parquet file, by its footer.
    pub fn of(footer: &ParquetMetaData) -> Self {
        let count = |n: i64| u64::try_from(n).unwrap_or(u64::MAX);
        let mut leaves: BTreeMap<String, u64> = BTreeMap::new();
        let mut rows: u64 = 0;
        for group in footer.row_groups() {
            rows = rows.saturating_add(count(group.num_rows()));
            for leaf in group.columns() {
                let values = leaves.entry(leaf.column_path().string()).or_default();
                *values = values.saturating_add(count(leaf.num_values()));
            }
        }
        let mut values = BTreeMap::new();
        for (path, number) in leaves {
            let column = path.split('.').next().unwrap_or_default();
            if is_read(column) {
                let most: &mut u64 = values.entry(column.to_owned()).or_default();
                *most = number.max(*most);
            }
        }
        Self { rows, values }
    }

    /// Number of rows.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Returns the size of the trials in the database, bytes. `file` is the name of the file in
    /// messages.
    ///
    /// # Errors
    /// A problem if there are too many rows, and for each column with more values than trials of the
    /// sensor can have.
    pub fn needed(&self, file: &str, sensor: &ImportedSensor) -> Result<u64, Vec<Problem>> {
        let mut checks = Checks::of(file);
        let limit = format!("must be at most {IMPORTED_TRIALS_MAX}: split the file");
        checks.require(self.rows <= IMPORTED_TRIALS_MAX, "rows", self.rows, &limit);
        let channels = sensor.channels as u64;
        for (column, number) in &self.values {
            let most = match column.as_str() {
                VOLTAGES_V | SIM_VOLTAGES_V => channels,
                _ => IMPORTED_CONTACTS_MAX as u64,
            };
            let limit = format!("must have at most {most} values per row");
            let fits = *number <= self.rows.saturating_mul(most);
            checks.require(fits, column, format!("{number} values"), &limit);
        }
        checks.done()?;
        // Each row has a whole frame, which the reader checks, whatever the footer states.
        let frames = [VOLTAGES_V, SIM_VOLTAGES_V].iter().filter(|f| self.values.contains_key(**f));
        let frames = self.rows.saturating_mul(frames.count() as u64);
        let contacts = self.values.get(CONTACTS).copied().unwrap_or(0);
        Ok(ImportCounts { trials: self.rows, frames, channels, contacts }.bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pad() -> ImportedSensor {
        let text = "name = \"pad\"\nchannels = 4\nwidth_mm = 100\nheight_mm = 80\n";
        ImportedSensor::from_toml("pad.toml", text).unwrap()
    }

    fn extent(rows: u64, values: [(&str, u64); 2]) -> Extent {
        Extent { rows, values: values.map(|(name, n)| (name.to_owned(), n)).into() }
    }

    #[test]
    fn a_file_of_few_bytes_and_many_values_is_refused() {
        let of = |rows, voltages, contacts| {
            let extent = extent(rows, [(VOLTAGES_V, voltages), (CONTACTS, contacts)]);
            extent.needed("f", &pad()).map_err(|all| all[0].to_string())
        };
        let counts = ImportCounts { trials: 10, frames: 10, channels: 4, contacts: 12 };
        assert_eq!(of(10, 40, 12).unwrap(), counts.bytes());
        let refused = "f: voltages_v = 41 values: must have at most 4 values per row";
        assert_eq!(of(10, 41, 12).unwrap_err(), refused);
        let refused = "f: contacts = 641 values: must have at most 64 values per row";
        assert_eq!(of(10, 40, 641).unwrap_err(), refused);
        let refused = of(IMPORTED_TRIALS_MAX + 1, 0, 0).unwrap_err();
        assert!(refused.starts_with("f: rows = 10000001: must be at most 10000000"), "{refused}");
    }
}
