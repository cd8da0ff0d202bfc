//! Selected rows of a dataset's file; each reading returns the same rows in the same order.
//! Uses: parquet, `dataset::select`. Never: all rows at once, frames of rows that are not selected.

use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::{BooleanArray, RecordBatch, UInt32Array, UInt64Array};
use arrow_schema::SchemaRef;
use arrow_select::concat::{concat, concat_batches};
use arrow_select::filter::filter;
use arrow_select::take::take_record_batch;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowPredicateFn, ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder,
    RowFilter, RowSelection, RowSelectionPolicy,
};

use super::error::{DatasetError, DatasetResult};
use super::filter::all;
use super::format::{Batches, Rows, RowsError, rows_per_batch};
use super::schema::{self, BATCH_ROWS};
use super::select::{Selection, Skin, Wanted};
use super::sort::Sort;

/// Extent of the paper's skin, used if a file has no sensor file in its metadata.
pub const PAPER_SKIN: Skin = Skin { width_mm: 540.0, height_mm: 560.0 };

/// Pages of selected rows of a dataset.
pub struct DatasetPages {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
    selection: Selection,
}

/// All selected rows of a dataset, counted.
pub struct DatasetRows {
    pages: DatasetPages,
    count: u64,
}

impl DatasetRows {
    /// Opens a dataset's file and counts the requested rows.
    ///
    /// # Errors
    /// As [`DatasetPages::open`].
    pub fn open(path: &Path, wanted: &Wanted) -> DatasetResult<Self> {
        let pages = DatasetPages::open(path, wanted)?;
        let count = pages.count()?;
        Ok(Self { pages, count })
    }

    /// True if the rows are those of the file, unchanged.
    pub fn is_whole(&self) -> bool {
        self.pages.selection.is_whole()
    }
}

impl DatasetPages {
    /// Opens a dataset's file.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the request does not fit the columns, `File` or `Parquet` if the
    /// file cannot be read.
    pub fn open(path: &Path, wanted: &Wanted) -> DatasetResult<Self> {
        let file = File::open(path).map_err(DatasetError::file("opening", path))?;
        let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())?;
        let selection = Selection::new(wanted, metadata.schema(), Some(skin(&metadata)))
            .map_err(DatasetError::Problems)?;
        Ok(Self { path: path.to_owned(), metadata, selection })
    }

    /// Columns and metadata.
    pub fn schema(&self) -> &SchemaRef {
        self.selection.schema()
    }

    /// Number of rows per batch of the result.
    fn batch_rows(&self) -> usize {
        rows_per_batch(self.selection.schema())
    }

    /// Number of rows of the file.
    fn file_rows(&self) -> u64 {
        self.metadata.metadata().file_metadata().num_rows().unsigned_abs()
    }

    /// Number of selected rows.
    fn count(&self) -> DatasetResult<u64> {
        let filters = self.selection.filters();
        if filters.is_empty() {
            return Ok(self.file_rows());
        }
        let mut count = 0;
        for batch in self.raw(&self.selection.needed(Some(&[])), 0)? {
            count += all(filters, &batch?).count_set_bits() as u64;
        }
        Ok(count)
    }

    /// Returns a page: up to `limit` selected rows from row `from` of the file, and the row of the
    /// file at which the next page starts; `None` at the end of the file.
    ///
    /// # Errors
    /// `DatasetError::File`, `Parquet` or `Arrow` if the rows cannot be read.
    pub fn page(&self, from: u64, limit: usize) -> DatasetResult<(Vec<RecordBatch>, Option<u64>)> {
        let filters = self.selection.filters();
        let (mut rows, mut at) = (Vec::new(), from);
        if filters.is_empty() {
            at = from.saturating_add(limit as u64).min(self.file_rows());
            rows.extend(from..at);
        } else {
            for batch in self.raw(&self.selection.needed(Some(&[])), from)? {
                let batch = batch?;
                let selected = all(filters, &batch);
                let lacking = limit - rows.len();
                rows.extend(selected.set_indices().take(lacking).map(|row| at + row as u64));
                // The next page starts with the row that this one does not take.
                at += selected.set_indices().nth(lacking).unwrap_or(batch.num_rows()) as u64;
                if rows.len() == limit {
                    break;
                }
            }
        }
        Ok((self.rows_at(&rows)?, (at < self.file_rows()).then_some(at)))
    }

    /// Returns a page in the order of a column, from position `from` of that order, and the
    /// position at which the next page starts; `None` at the end. The whole column is read, frames
    /// only of the page.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the rows cannot be sorted by the column; `File`, `Parquet` or
    /// `Arrow` if they cannot be read.
    pub fn sorted_page(
        &self,
        sort: &Sort,
        from: u64,
        limit: usize,
    ) -> DatasetResult<(Vec<RecordBatch>, Option<u64>)> {
        let key = sort
            .find(self.metadata.schema())
            .map_err(|limit| DatasetError::value("sort", &sort.column, &limit))?;
        let mut needed = self.selection.needed(Some(&[]));
        needed.push(key);
        needed.sort_unstable();
        needed.dedup();
        let (mut keys, mut rows, mut first) = (Vec::new(), Vec::new(), 0);
        for batch in self.raw(&needed, 0)? {
            let batch = batch?;
            let selected = all(self.selection.filters(), &batch);
            rows.extend(selected.set_indices().map(|row| first + row as u64));
            first += batch.num_rows() as u64;
            if let Some(key) = batch.column_by_name(&sort.column) {
                keys.push(filter(key, &BooleanArray::from(selected))?);
            }
        }
        if keys.is_empty() {
            return Ok((Vec::new(), None));
        }
        let keys = concat(&keys.iter().map(AsRef::as_ref).collect::<Vec<_>>())?;
        let rows = UInt64Array::from(rows);
        let order = sort.order(keys, &rows, from as usize, limit)?;
        let next = from + order.len() as u64;
        Ok((vec![self.rows_in_order(&order)?], (next < rows.len() as u64).then_some(next)))
    }

    /// Reads the given rows of the file, in the given order.
    fn rows_in_order(&self, order: &[u64]) -> DatasetResult<RecordBatch> {
        let mut rows = order.to_vec();
        rows.sort_unstable();
        let found = concat_batches(self.selection.schema(), &self.rows_at(&rows)?)?;
        let places = order.iter().map(|row| rows.partition_point(|other| other < row) as u32);
        Ok(take_record_batch(&found, &UInt32Array::from_iter_values(places))?)
    }

    /// Reads the given rows of the file, in its order. Only the row groups that hold one are opened.
    fn rows_at(&self, rows: &[u64]) -> DatasetResult<Vec<RecordBatch>> {
        let (mut groups, mut ranges) = (Vec::new(), Vec::new());
        let (mut rest, mut first, mut opened) = (rows, 0, 0);
        for (at, group) in self.metadata.metadata().row_groups().iter().enumerate() {
            let end = first + group.num_rows().unsigned_abs();
            let (inside, after) = rest.split_at(rest.partition_point(|&row| row < end));
            if !inside.is_empty() {
                groups.push(at);
                // Positions count the rows of the opened groups.
                let position = |row: &u64| opened + (row - first) as usize;
                ranges.extend(inside.iter().map(position).map(|row| row..row + 1));
                opened += (end - first) as usize;
            }
            (rest, first) = (after, end);
        }
        let selection = RowSelection::from_consecutive_ranges(ranges.into_iter(), opened);
        let reader = self.reader(&self.selection.needed(None), self.batch_rows())?;
        let batches = reader.with_row_groups(groups).with_row_selection(selection).build()?;
        batches.map(|batch| Ok(self.selection.apply(&batch?, None)?)).collect()
    }

    /// A reader of some of the file's columns.
    fn reader(
        &self,
        columns: &[usize],
        batch_rows: usize,
    ) -> DatasetResult<ParquetRecordBatchReaderBuilder<File>> {
        let file = File::open(&self.path).map_err(DatasetError::file("opening", &self.path))?;
        let builder =
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone());
        let mask = ProjectionMask::roots(builder.parquet_schema(), columns.iter().copied());
        // A mask would decode all rows between those that are selected.
        let policy = RowSelectionPolicy::Selectors;
        let builder = builder.with_projection(mask).with_row_selection_policy(policy);
        Ok(builder.with_batch_size(batch_rows))
    }

    /// Batches of some of the file's columns from row `from`, of all rows.
    fn raw(
        &self,
        columns: &[usize],
        from: u64,
    ) -> DatasetResult<parquet::arrow::arrow_reader::ParquetRecordBatchReader> {
        let mut skipped = 0;
        let groups = self.metadata.metadata().row_groups();
        let first = groups
            .iter()
            .position(|group| {
                let rows = group.num_rows().unsigned_abs();
                let inside = skipped + rows > from;
                skipped += if inside { 0 } else { rows };
                inside
            })
            .unwrap_or(groups.len());
        Ok(self
            .reader(columns, BATCH_ROWS)?
            .with_row_groups((first..groups.len()).collect())
            .with_offset((from - skipped.min(from)) as usize)
            .build()?)
    }
}

/// Returns the text of the sensor file in the metadata of a dataset's file; empty if there is none.
///
/// # Errors
/// `DatasetError::File` or `Parquet` if the file cannot be read.
pub fn sensor_text(path: &Path) -> DatasetResult<String> {
    let file = File::open(path).map_err(DatasetError::file("opening", path))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())?;
    Ok(sensor(&metadata).unwrap_or_default().to_owned())
}

fn sensor(metadata: &ArrowReaderMetadata) -> Option<&str> {
    let footer = metadata.metadata().file_metadata().key_value_metadata();
    footer?.iter().find(|kv| kv.key == schema::SENSOR_KEY)?.value.as_deref()
}

fn skin(metadata: &ArrowReaderMetadata) -> Skin {
    sensor(metadata).and_then(|text| toml::from_str(text).ok()).unwrap_or(PAPER_SKIN)
}

impl Rows for DatasetRows {
    fn schema(&self) -> SchemaRef {
        self.pages.schema().clone()
    }

    fn count(&self) -> u64 {
        self.count
    }

    fn batches(&self, columns: Option<&[usize]>) -> Result<Batches<'_>, RowsError> {
        let DatasetPages { selection, .. } = &self.pages;
        let reader = self.pages.reader(&selection.needed(columns), self.pages.batch_rows());
        let mut reader = reader.map_err(RowsError::new)?;
        if !selection.filters().is_empty() {
            let filters = selection.filters().to_vec();
            let needed = selection.needed(Some(&[]));
            let mask = ProjectionMask::roots(reader.parquet_schema(), needed);
            let predicate = ArrowPredicateFn::new(mask, move |batch: RecordBatch| {
                Ok(BooleanArray::from(all(&filters, &batch)))
            });
            reader = reader.with_row_filter(RowFilter::new(vec![Box::new(predicate)]));
        }
        let columns: Option<Vec<usize>> = columns.map(<[usize]>::to_vec);
        let batches = reader.build().map_err(RowsError::new)?;
        Ok(Box::new(batches.map(move |batch| {
            let batch = batch.map_err(RowsError::new)?;
            selection.apply(&batch, columns.as_deref()).map_err(RowsError::new)
        })))
    }
}

#[cfg(test)]
mod tests {
    use arrow_array::Int64Array;
    use arrow_array::cast::AsArray;
    use arrow_array::types::Int64Type;
    use arrow_cast::cast;
    use parquet::arrow::ArrowWriter;

    use super::*;

    /// Value of a trial by its number.
    type Value = fn(i64) -> Option<i64>;
    /// Which trials meet a condition.
    type Fits = fn(i64) -> bool;

    /// Trials 1 to 30 in three row groups: tips from 0 to 3, and a force that falls, each third of them unknown.
    fn write(path: &Path) {
        let numbers: [(&str, Value); 3] = [
            ("trial_id", Some),
            ("tips", |n| Some(n % 4)),
            ("max_force_n", |n| (n % 3 != 0).then_some(31 - n)),
        ];
        let all = schema::all(schema::PAPER_CHANNELS);
        let columns = numbers.map(|(name, _)| all.index_of(name).unwrap());
        let table = SchemaRef::new(all.project(&columns).unwrap());
        let mut writer =
            ArrowWriter::try_new(File::create(path).unwrap(), table.clone(), None).unwrap();
        for first in [1, 11, 21] {
            let columns = numbers.iter().zip(table.fields()).map(|((_, number), field)| {
                let values: Int64Array = (first..first + 10).map(number).collect();
                cast(&values, field.data_type()).unwrap()
            });
            writer.write(&RecordBatch::try_new(table.clone(), columns.collect()).unwrap()).unwrap();
            writer.flush().unwrap();
        }
        writer.close().unwrap();
    }

    fn ids(batches: &[RecordBatch]) -> Vec<i64> {
        let of =
            |batch: &RecordBatch| batch["trial_id"].as_primitive::<Int64Type>().values().to_vec();
        batches.iter().flat_map(of).collect()
    }

    /// The trials of all pages; each but the last is full.
    fn of_pages(limit: usize, page: impl Fn(u64) -> (Vec<RecordBatch>, Option<u64>)) -> Vec<i64> {
        let (mut all, mut from) = (Vec::new(), Some(0));
        while let Some(at) = from {
            let (batches, next) = page(at);
            let found = ids(&batches);
            assert!(found.len() == limit || next.is_none(), "{found:?} of {limit}");
            all.extend(found);
            from = next;
        }
        all
    }

    #[test]
    fn pages_have_each_selected_row_once_across_row_groups() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pages.parquet");
        write(&path);
        let sort = Sort::parse("-max_force_n");
        let cases: [(Option<&str>, Fits); 3] =
            [(None, |_| true), (Some("tips=2"), |n| n % 4 == 2), (Some("tips=7"), |_| false)];
        for (condition, fits) in cases {
            let conditions = condition.map(str::to_owned).into_iter().collect();
            let wanted = Wanted { conditions, ..Wanted::default() };
            let expected: Vec<i64> = (1..=30).filter(|n| fits(*n)).collect();
            let mut by_force = expected.clone();
            by_force.sort_by_key(|n| n % 3 == 0);
            let pages = DatasetPages::open(&path, &wanted).unwrap();
            for limit in [1, 4, 7, 40] {
                assert_eq!(of_pages(limit, |at| pages.page(at, limit).unwrap()), expected);
                let sorted = |at| pages.sorted_page(&sort, at, limit).unwrap();
                assert_eq!(of_pages(limit, sorted), by_force);
            }
            let (beyond, next) = pages.page(40, 5).unwrap();
            assert_eq!((ids(&beyond), next), (Vec::new(), None));
            let rows = DatasetRows::open(&path, &wanted).unwrap();
            let whole: Vec<RecordBatch> = rows.batches(None).unwrap().map(Result::unwrap).collect();
            assert_eq!((ids(&whole), rows.count()), (expected.clone(), expected.len() as u64));
        }
    }
}
