//! Selected rows of a dataset's file; each reading returns the same rows in the same order.
//! Uses: parquet, `dataset::select`. Never: all rows at once.

use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::{RecordBatch, UInt32Array, UInt64Array};
use arrow_schema::SchemaRef;
use arrow_select::coalesce::BatchCoalescer;
use arrow_select::concat::{concat, concat_batches};
use arrow_select::filter::filter_record_batch;
use arrow_select::take::take_record_batch;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder, RowSelection,
};

use super::error::DatasetError;
use super::format::{Batches, Rows, RowsError, rows_per_batch};
use super::schema::{self, BATCH_ROWS};
use super::select::{Selection, Skin, Wanted};
use super::sort::Sort;

/// Extent of the paper's skin, used if a file has no sensor file in its metadata.
pub const PAPER_SKIN: Skin = Skin { width_mm: 540.0, height_mm: 560.0 };

/// Selected rows of a dataset.
pub struct DatasetRows {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
    selection: Selection,
    count: u64,
}

impl DatasetRows {
    /// Opens a dataset's file and counts the requested rows.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the request does not fit the columns, `File` or `Parquet` if the
    /// file cannot be read.
    pub fn open(path: &Path, wanted: &Wanted) -> Result<Self, DatasetError> {
        let file = File::open(path).map_err(DatasetError::file("opening", path))?;
        let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())?;
        let selection = Selection::new(wanted, metadata.schema(), Some(skin(&metadata)))
            .map_err(DatasetError::Problems)?;
        let mut rows = Self { path: path.to_owned(), metadata, selection, count: 0 };
        rows.count = rows.count_selected()?;
        Ok(rows)
    }

    /// True if the rows are those of the file, unchanged.
    pub fn is_whole(&self) -> bool {
        self.selection.is_whole()
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
    fn count_selected(&self) -> Result<u64, DatasetError> {
        if self.selection.keeps_all_rows() {
            return Ok(self.file_rows());
        }
        let mut count = 0;
        for batch in self.raw(&self.selection.needed(Some(&[])), 0, BATCH_ROWS)? {
            let batch = batch?;
            count += self.selection.mask(&batch).map_or(0, |mask| mask.true_count() as u64);
        }
        Ok(count)
    }

    /// Returns a page: up to `limit` selected rows from row `from` of the file, and the row of the
    /// file at which the next page starts; `None` at the end of the file.
    ///
    /// # Errors
    /// `DatasetError::File`, `Parquet` or `Arrow` if the rows cannot be read.
    pub fn page(
        &self,
        from: u64,
        limit: usize,
    ) -> Result<(Vec<RecordBatch>, Option<u64>), DatasetError> {
        let (mut page, mut found, mut at) = (Vec::new(), 0, from);
        // Without conditions only the requested number of rows is decoded.
        let mut batch_rows = self.batch_rows();
        if self.selection.keeps_all_rows() {
            batch_rows = batch_rows.min(limit.max(1));
        }
        for batch in self.raw(&self.selection.needed(None), from, batch_rows)? {
            let mut batch = batch?;
            let mask = self.selection.mask(&batch);
            let mut taken = batch.num_rows();
            if let Some(mask) = mask {
                taken = mask.values().set_indices().nth(limit - found).unwrap_or(taken);
                batch = filter_record_batch(&batch.slice(0, taken), &mask.slice(0, taken))?;
            } else {
                taken = taken.min(limit - found);
                batch = batch.slice(0, taken);
            }
            at += taken as u64;
            found += batch.num_rows();
            page.push(self.selection.apply(&batch, None)?);
            if found == limit {
                break;
            }
        }
        Ok((page, (at < self.file_rows()).then_some(at)))
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
    ) -> Result<(Vec<RecordBatch>, Option<u64>), DatasetError> {
        let key = sort
            .find(self.metadata.schema())
            .map_err(|limit| DatasetError::value("sort", &sort.column, &limit))?;
        let mut needed = self.selection.needed(Some(&[]));
        needed.push(key);
        needed.sort_unstable();
        needed.dedup();
        let (mut keys, mut rows, mut first) = (Vec::new(), Vec::new(), 0);
        for batch in self.raw(&needed, 0, BATCH_ROWS)? {
            let batch = batch?;
            let mask = self.selection.mask(&batch);
            let selected = |row: &usize| mask.as_ref().is_none_or(|mask| mask.value(*row));
            rows.extend((0..batch.num_rows()).filter(selected).map(|row| first + row as u64));
            first += batch.num_rows() as u64;
            let batch = match &mask {
                Some(mask) => filter_record_batch(&batch, mask)?,
                None => batch,
            };
            keys.extend(batch.column_by_name(&sort.column).cloned());
        }
        if keys.is_empty() {
            return Ok((Vec::new(), None));
        }
        let keys = concat(&keys.iter().map(AsRef::as_ref).collect::<Vec<_>>())?;
        let rows = UInt64Array::from(rows);
        let order = sort.order(keys, &rows, from as usize, limit)?;
        let next = from + order.len() as u64;
        Ok((self.rows_in_order(&order)?, (next < rows.len() as u64).then_some(next)))
    }

    /// Reads the given rows of the file, in the given order.
    fn rows_in_order(&self, order: &[u64]) -> Result<Vec<RecordBatch>, DatasetError> {
        let mut places: Vec<usize> = (0..order.len()).collect();
        places.sort_by_key(|&at| order[at]);
        let ranges = places.iter().map(|&at| order[at] as usize..order[at] as usize + 1);
        let selection = RowSelection::from_consecutive_ranges(ranges, self.file_rows() as usize);
        let needed = self.selection.needed(None);
        let reader =
            self.reader(&needed, self.batch_rows())?.with_row_selection(selection).build()?;
        let schema = SchemaRef::new(self.metadata.schema().project(&needed)?);
        let batches = reader.collect::<Result<Vec<_>, _>>()?;
        let found = concat_batches(&schema, &batches)?;
        // The rows were read in the order of the file: `places` maps them to the requested order.
        let mut row_at = vec![0_u32; places.len()];
        for (row, place) in places.into_iter().enumerate() {
            row_at[place] = row as u32;
        }
        let page = take_record_batch(&found, &UInt32Array::from(row_at))?;
        Ok(vec![self.selection.apply(&page, None)?])
    }

    /// A reader of some of the file's columns.
    fn reader(
        &self,
        columns: &[usize],
        batch_rows: usize,
    ) -> Result<ParquetRecordBatchReaderBuilder<File>, DatasetError> {
        let file = File::open(&self.path).map_err(DatasetError::file("opening", &self.path))?;
        let builder =
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone());
        let mask = ProjectionMask::roots(builder.parquet_schema(), columns.iter().copied());
        Ok(builder.with_projection(mask).with_batch_size(batch_rows))
    }

    /// Batches of some of the file's columns from row `from`, without conditions.
    fn raw(
        &self,
        columns: &[usize],
        from: u64,
        batch_rows: usize,
    ) -> Result<parquet::arrow::arrow_reader::ParquetRecordBatchReader, DatasetError> {
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
            .reader(columns, batch_rows)?
            .with_row_groups((first..groups.len()).collect())
            .with_offset((from - skipped.min(from)) as usize)
            .build()?)
    }
}

/// Returns the text of the sensor file in the metadata of a dataset's file; empty if there is none.
///
/// # Errors
/// `DatasetError::File` or `Parquet` if the file cannot be read.
pub fn sensor_text(path: &Path) -> Result<String, DatasetError> {
    let file = File::open(path).map_err(DatasetError::file("opening", path))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())?;
    Ok(sensor(&metadata).unwrap_or_default().to_owned())
}

fn sensor(metadata: &ArrowReaderMetadata) -> Option<&str> {
    let footer = metadata.metadata().file_metadata().key_value_metadata();
    footer?.iter().find(|kv| kv.key == schema::SENSOR_KEY)?.value.as_deref()
}

fn skin(metadata: &ArrowReaderMetadata) -> Skin {
    #[derive(serde::Deserialize)]
    struct Extent {
        width_mm: f64,
        height_mm: f64,
    }
    match sensor(metadata).and_then(|text| toml::from_str::<Extent>(text).ok()) {
        Some(Extent { width_mm, height_mm }) => Skin { width_mm, height_mm },
        None => PAPER_SKIN,
    }
}

impl Rows for DatasetRows {
    fn schema(&self) -> SchemaRef {
        self.selection.schema().clone()
    }

    fn count(&self) -> u64 {
        self.count
    }

    fn batches(&self, columns: Option<&[usize]>) -> Result<Batches<'_>, RowsError> {
        let needed = self.selection.needed(columns);
        let raw = self.raw(&needed, 0, self.batch_rows()).map_err(RowsError::new)?;
        let columns: Option<Vec<usize>> = columns.map(<[usize]>::to_vec);
        if self.selection.keeps_all_rows() {
            return Ok(Box::new(raw.map(move |batch| {
                let batch = batch.map_err(RowsError::new)?;
                self.selection.apply(&batch, columns.as_deref()).map_err(RowsError::new)
            })));
        }
        // Selected rows are combined to full batches, so that row groups do not become small.
        let names =
            SchemaRef::new(self.metadata.schema().project(&needed).map_err(RowsError::new)?);
        let coalescer = BatchCoalescer::new(names, self.batch_rows());
        Ok(Box::new(SelectedBatches { rows: self, raw, columns, coalescer, ended: false }))
    }
}

/// Full batches of the selected rows.
struct SelectedBatches<'a> {
    rows: &'a DatasetRows,
    raw: parquet::arrow::arrow_reader::ParquetRecordBatchReader,
    columns: Option<Vec<usize>>,
    coalescer: BatchCoalescer,
    ended: bool,
}

impl SelectedBatches<'_> {
    fn advance(&mut self) -> Result<Option<RecordBatch>, DatasetError> {
        loop {
            if let Some(batch) = self.coalescer.next_completed_batch() {
                return Ok(Some(self.rows.selection.apply(&batch, self.columns.as_deref())?));
            }
            if self.ended {
                return Ok(None);
            }
            match self.raw.next() {
                Some(batch) => {
                    let batch = batch?;
                    match self.rows.selection.mask(&batch) {
                        Some(mask) => self.coalescer.push_batch_with_filter(batch, &mask)?,
                        None => self.coalescer.push_batch(batch)?,
                    }
                }
                None => {
                    self.ended = true;
                    self.coalescer.finish_buffered_batch()?;
                }
            }
        }
    }
}

impl Iterator for SelectedBatches<'_> {
    type Item = Result<RecordBatch, RowsError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.advance().map_err(RowsError::new).transpose()
    }
}
