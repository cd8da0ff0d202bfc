//! Rows of a dataset's file, chosen and cut: as often as they are asked for, in the same order.
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

/// The paper's skin, where a file says nothing else.
pub const SKIN: Skin = Skin { width_mm: 540.0, height_mm: 560.0 };

/// Chosen rows of a dataset.
pub struct DatasetRows {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
    selection: Selection,
    count: u64,
}

impl DatasetRows {
    /// Opens a dataset's file for what is wanted of it.
    pub fn open(path: &Path, wanted: &Wanted) -> Result<Self, DatasetError> {
        let file = File::open(path).map_err(DatasetError::file("opening", path))?;
        let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())?;
        let selection = Selection::new(wanted, metadata.schema(), Some(skin(&metadata)))
            .map_err(DatasetError::Problems)?;
        let mut rows = Self { path: path.to_owned(), metadata, selection, count: 0 };
        rows.count = rows.counted()?;
        Ok(rows)
    }

    /// True when the rows are those of the file, as they are.
    pub fn is_whole(&self) -> bool {
        self.selection.is_whole()
    }

    /// Rows of a batch that comes out.
    fn at_once(&self) -> usize {
        rows_per_batch(self.selection.schema())
    }

    /// Rows of the file.
    fn all(&self) -> u64 {
        self.metadata.metadata().file_metadata().num_rows().unsigned_abs()
    }

    fn counted(&self) -> Result<u64, DatasetError> {
        if self.selection.keeps_all_rows() {
            return Ok(self.all());
        }
        let mut count = 0;
        for batch in self.raw(&self.selection.needed(Some(&[])), 0, BATCH_ROWS)? {
            let batch = batch?;
            count += self.selection.mask(&batch).map_or(0, |mask| mask.true_count() as u64);
        }
        Ok(count)
    }

    /// A page: up to `limit` chosen rows from row `from` of the file on, and the row of the file
    /// where the next page starts, if there may be more.
    pub fn page(
        &self,
        from: u64,
        limit: usize,
    ) -> Result<(Vec<RecordBatch>, Option<u64>), DatasetError> {
        let (mut page, mut found, mut at) = (Vec::new(), 0, from);
        // Where every row stays, no more of them are decoded than are asked for.
        let all_stay = self.selection.keeps_all_rows();
        let at_once = if all_stay { self.at_once().min(limit.max(1)) } else { self.at_once() };
        for batch in self.raw(&self.selection.needed(None), from, at_once)? {
            let mut batch = batch?;
            let mask = self.selection.mask(&batch);
            let mut taken = batch.num_rows();
            if let Some(mask) = mask {
                let stays: Vec<usize> = (0..mask.len()).filter(|&row| mask.value(row)).collect();
                if let Some(&last) = stays.get(limit - found) {
                    taken = last;
                }
                let mask = arrow_array::BooleanArray::from_iter(
                    (0..mask.len()).map(|row| Some(row < taken && mask.value(row))),
                );
                batch = filter_record_batch(&batch, &mask)?;
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
        Ok((page, (at < self.all()).then_some(at)))
    }

    /// A page in the order of a column, from the row at `from` of that order on, and where the next
    /// one starts. The column is read as a whole, frames only of the page.
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
            let stays = |row: &usize| mask.as_ref().is_none_or(|mask| mask.value(*row));
            rows.extend((0..batch.num_rows()).filter(stays).map(|row| first + row as u64));
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

    /// These rows of the file, in this order.
    fn rows_in_order(&self, order: &[u64]) -> Result<Vec<RecordBatch>, DatasetError> {
        let mut places: Vec<usize> = (0..order.len()).collect();
        places.sort_by_key(|&at| order[at]);
        let ranges = places.iter().map(|&at| order[at] as usize..order[at] as usize + 1);
        let selection = RowSelection::from_consecutive_ranges(ranges, self.all() as usize);
        let file = File::open(&self.path).map_err(DatasetError::file("opening", &self.path))?;
        let builder =
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone());
        let needed = self.selection.needed(None);
        let mask = ProjectionMask::roots(builder.parquet_schema(), needed.iter().copied());
        let reader = builder
            .with_projection(mask)
            .with_row_selection(selection)
            .with_batch_size(self.at_once())
            .build()?;
        let schema = SchemaRef::new(self.metadata.schema().project(&needed)?);
        let batches = reader.collect::<Result<Vec<_>, _>>()?;
        let found = concat_batches(&schema, &batches)?;
        // Row n of what was found belongs to the nth of the places.
        let mut turned = vec![0_u32; places.len()];
        for (row, place) in places.into_iter().enumerate() {
            turned[place] = row as u32;
        }
        let page = take_record_batch(&found, &UInt32Array::from(turned))?;
        Ok(vec![self.selection.apply(&page, None)?])
    }

    /// Batches of some of the file's columns, from a row on.
    fn raw(
        &self,
        columns: &[usize],
        from: u64,
        at_once: usize,
    ) -> Result<parquet::arrow::arrow_reader::ParquetRecordBatchReader, DatasetError> {
        let file = File::open(&self.path).map_err(DatasetError::file("opening", &self.path))?;
        let builder =
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone());
        let mask = ProjectionMask::roots(builder.parquet_schema(), columns.iter().copied());
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
        Ok(builder
            .with_projection(mask)
            .with_row_groups((first..groups.len()).collect())
            .with_offset((from - skipped.min(from)) as usize)
            .with_batch_size(at_once)
            .build()?)
    }
}

/// The text of the sensor file behind a dataset's file; empty where it does not say.
pub fn sensor_text(path: &Path) -> Result<String, DatasetError> {
    let file = File::open(path).map_err(DatasetError::file("opening", path))?;
    let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new())?;
    Ok(sensor(&metadata).unwrap_or_default().to_owned())
}

fn sensor(metadata: &ArrowReaderMetadata) -> Option<&str> {
    let footer = metadata.metadata().file_metadata().key_value_metadata();
    footer?.iter().find(|kv| kv.key == schema::SENSOR)?.value.as_deref()
}

fn skin(metadata: &ArrowReaderMetadata) -> Skin {
    #[derive(serde::Deserialize)]
    struct Extent {
        width_mm: f64,
        height_mm: f64,
    }
    match sensor(metadata).and_then(|text| toml::from_str::<Extent>(text).ok()) {
        Some(Extent { width_mm, height_mm }) => Skin { width_mm, height_mm },
        None => SKIN,
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
        let raw = self.raw(&needed, 0, self.at_once()).map_err(RowsError::new)?;
        let columns: Option<Vec<usize>> = columns.map(<[usize]>::to_vec);
        if self.selection.keeps_all_rows() {
            return Ok(Box::new(raw.map(move |batch| {
                let batch = batch.map_err(RowsError::new)?;
                self.selection.apply(&batch, columns.as_deref()).map_err(RowsError::new)
            })));
        }
        // Rows that stay come in full batches again, so that row groups do not crumble.
        let names =
            SchemaRef::new(self.metadata.schema().project(&needed).map_err(RowsError::new)?);
        let coalescer = BatchCoalescer::new(names, self.at_once());
        Ok(Box::new(Chosen { rows: self, raw, columns, coalescer, ended: false }))
    }
}

/// Full batches of rows that stay.
struct Chosen<'a> {
    rows: &'a DatasetRows,
    raw: parquet::arrow::arrow_reader::ParquetRecordBatchReader,
    columns: Option<Vec<usize>>,
    coalescer: BatchCoalescer,
    ended: bool,
}

impl Chosen<'_> {
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

impl Iterator for Chosen<'_> {
    type Item = Result<RecordBatch, RowsError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.advance().map_err(RowsError::new).transpose()
    }
}
