//! A file of trials in any format that imports read, as batches of the columns of `rows`.
//! Uses: parquet, `columns`, `pages`, `foreign`. Never: a check of a value, which is the task of `rows`.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::{FieldRef, SchemaRef};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;

use super::columns::{Columns, is_read};
use super::extent::Extent;
use super::foreign::arrays::{Arrays, Container};
use super::foreign::csv::Csv;
use super::{pages, whole};
use crate::dataset::error::{DatasetError, DatasetResult};

/// Number of bytes by which a format is recognised.
const START_BYTES: u64 = 4096;

/// Pages of rows.
pub type Batches = Box<dyn Iterator<Item = DatasetResult<RecordBatch>>>;

/// A file whose headers have been read.
pub struct Source {
    file: String,
    schema: SchemaRef,
    extent: Extent,
    content: Content,
}

enum Content {
    Parquet(Box<ParquetRecordBatchReaderBuilder<File>>),
    Csv(Csv),
    Arrays(Arrays),
}

/// Format of a file, by its first bytes.
enum Found {
    Parquet,
    Csv,
    Arrays(Container),
    Refused(&'static str),
}

fn format(start: &[u8]) -> Found {
    match start {
        [b'P', b'A', b'R', b'1', ..] => Found::Parquet,
        [b'P', b'K', 3 | 5, 4 | 6, ..] => Found::Arrays(Container::Npz),
        _ if start.starts_with(b"MATLAB 5.0") => Found::Arrays(Container::Mat),
        _ if start.starts_with(b"MATLAB 7.3") || start.starts_with(b"\x89HDF") => Found::Refused(
            "must not be HDF5, as MATLAB writes it with -v7.3: save it with save(FILE, .., '-v7'), or as a \
             table with parquetwrite",
        ),
        _ if start.starts_with(b"\x93NUMPY") => Found::Refused(
            "must not be a single array: save voltages and contacts with numpy.savez(FILE, voltages_v=.., \
             contacts_xy_mm=.., force_n=..)",
        ),
        _ if start.starts_with(b"ARROW1") => {
            Found::Refused("must not be an Arrow or Feather file: save it as Parquet")
        }
        _ => {
            let line = start.split(|byte| *byte == b'\n').next().unwrap_or_default();
            let is_text = !start.contains(&0);
            match is_text && line.iter().any(|byte| b",;\t".contains(byte)) {
                true => Found::Csv,
                false => Found::Refused(
                    "must be a Parquet file with the columns of the trials table, CSV with a line of their \
                     names, an NPZ file or a MAT file of version 5 to 7",
                ),
            }
        }
    }
}

impl Source {
    /// Opens a file; the format follows from its content. `file` is its name in messages.
    ///
    /// # Errors
    /// `DatasetError::File` if it cannot be read, `Problems` if its format or its headers are invalid.
    pub fn open(path: &Path, file: &str) -> DatasetResult<Self> {
        let opened = File::open(path).map_err(DatasetError::file("opening", path))?;
        let mut start = Vec::new();
        let read = (&opened).take(START_BYTES).read_to_end(&mut start);
        read.map_err(DatasetError::file("reading", path))?;
        let (schema, extent, content) = match format(&start) {
            Found::Parquet => {
                let headers = opened.try_clone().map_err(DatasetError::file("opening", path))?;
                let parquet = ParquetRecordBatchReaderBuilder::try_new(opened)
                    .map_err(|error| unreadable(file, &error))?;
                // A column of another type is refused before it is read.
                let empty = RecordBatch::new_empty(parquet.schema().clone());
                Columns::of(file, &empty)
                    .map_err(|problem| DatasetError::Problems(vec![problem]))?;
                pages::check(&Arc::new(headers), parquet.metadata())
                    .map_err(|error| unreadable(file, &error))?;
                let extent = Extent::of(parquet.metadata());
                (parquet.schema().clone(), extent, Content::Parquet(Box::new(parquet)))
            }
            Found::Csv => {
                let csv = Csv::open(path, file)?;
                (Arc::new(csv.schema()), csv.extent(), Content::Csv(csv))
            }
            Found::Arrays(container) => {
                let arrays = Arrays::open(container, path, file)?;
                (Arc::new(arrays.schema()), arrays.extent(), Content::Arrays(arrays))
            }
            Found::Refused(limit) => return Err(whole(file, limit)),
        };
        Ok(Self { file: file.into(), schema, extent, content })
    }

    /// Columns of the file. Those of other formats than Parquet have names only.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// Numbers of rows and values, as the file states them.
    pub fn extent(&self) -> &Extent {
        &self.extent
    }

    /// Reads the columns that an import uses, page by page.
    ///
    /// # Errors
    /// `DatasetError::File` or `Problems` if the file cannot be read.
    pub fn batches(self) -> DatasetResult<Batches> {
        Ok(match self.content {
            Content::Parquet(parquet) => {
                let used = |(at, field): (usize, &FieldRef)| is_read(field.name()).then_some(at);
                let fields = self.schema.fields().iter().enumerate();
                let used: Vec<usize> = fields.filter_map(used).collect();
                let mask = ProjectionMask::roots(parquet.parquet_schema(), used);
                let rows = self.extent.rows_at_once();
                let built = parquet.with_projection(mask).with_batch_size(rows).build();
                let batches = built.map_err(|error| unreadable(&self.file, &error))?;
                Box::new(batches.map(|batch| batch.map_err(DatasetError::from)))
            }
            Content::Csv(csv) => Box::new(csv.batches()?),
            Content::Arrays(arrays) => Box::new(arrays.batches()?),
        })
    }
}

fn unreadable(file: &str, error: &ParquetError) -> DatasetError {
    let limit = format!("must be a Parquet file with the columns of the trials table: {error}");
    whole(file, limit)
}
