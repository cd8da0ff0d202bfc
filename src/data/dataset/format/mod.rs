//! Rows of a dataset in the formats that people load: Parquet, Arrow, CSV, NDJSON, NPZ.
//! Uses: arrow, parquet, csv, zip. Never: what the rows mean, where they come from, files.
//!
//! The same rows give the same bytes. Memory is bounded by a batch: formats that hold rows are
//! written as batches come ([`Stream`]); NPZ holds columns, and reads the rows again for each.
//! The metadata of the rows' schema goes along where a format has a place for it: footer
//! key-values in Parquet, schema metadata in Arrow.

#[cfg(test)]
mod tests;

mod columns;
mod csv;
mod npy;
mod npz;
mod parquet;
mod stream;
mod zone;

use std::fmt;
use std::io::{self, Write};
use std::str::FromStr;

use ::parquet::errors::ParquetError;
use arrow_array::RecordBatch;
use arrow_schema::{ArrowError, DataType, SchemaRef};
use serde::{Deserialize, Serialize};
use zip::result::ZipError;

pub use columns::rows_per_batch;
pub use stream::Stream;

/// A format of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Apache Parquet: a row group for each batch, zstd.
    Parquet,
    /// Arrow IPC stream, not compressed.
    Arrow,
    /// RFC 4180, with a header line. Lists of one length have a column for each item
    /// (`voltages_v_0`, `voltages_v_1` ...); other lists are a cell of JSON. A missing value is an
    /// empty cell.
    Csv,
    /// A JSON object on each line, without the values that are missing.
    Ndjson,
    /// NumPy arrays, one for each column, that `numpy.load` reads without pickle; the head of
    /// `npz.rs` says what each type of column becomes.
    Npz,
}

impl Format {
    /// Every format, in the order in which choices are listed.
    pub const ALL: [Self; 5] = [Self::Parquet, Self::Arrow, Self::Csv, Self::Ndjson, Self::Npz];

    /// The name in queries, commands and definitions.
    pub fn name(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Arrow => "arrow",
            Self::Csv => "csv",
            Self::Ndjson => "ndjson",
            Self::Npz => "npz",
        }
    }

    /// How a file's name ends, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Arrow => "arrows",
            Self::Parquet | Self::Csv | Self::Ndjson | Self::Npz => self.name(),
        }
    }

    /// The media type in HTTP.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Parquet => "application/vnd.apache.parquet",
            Self::Arrow => "application/vnd.apache.arrow.stream",
            Self::Csv => "text/csv; charset=utf-8; header=present",
            Self::Ndjson => "application/x-ndjson",
            Self::Npz => "application/zip",
        }
    }

    /// Whether rows can be written as they come, in one pass: all but NPZ.
    pub fn streams(self) -> bool {
        self != Self::Npz
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that no format has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no format is named `{name}`: choose from {}", Format::ALL.map(Format::name).join(", "))]
pub struct UnknownFormat {
    /// What was given.
    pub name: String,
}

impl FromStr for Format {
    type Err = UnknownFormat;

    fn from_str(name: &str) -> Result<Self, UnknownFormat> {
        let found = Self::ALL.into_iter().find(|format| format.name() == name);
        found.ok_or_else(|| UnknownFormat { name: name.to_owned() })
    }
}

/// Batches as they are read.
pub type Batches<'a> = Box<dyn Iterator<Item = Result<RecordBatch, RowsError>> + 'a>;

/// Rows that can be read more than once, always in the same order and the same batches.
pub trait Rows {
    /// Columns, with the metadata that goes along with them.
    fn schema(&self) -> SchemaRef;

    /// Number of rows.
    fn count(&self) -> u64;

    /// The rows in batches; of all columns, or of those with these indices in the schema, in the
    /// order of the indices. A batch becomes a row group of Parquet: [`rows_per_batch`] says how
    /// long one should be.
    fn batches(&self, columns: Option<&[usize]>) -> Result<Batches<'_>, RowsError>;
}

/// Rows could not be read.
#[derive(Debug, thiserror::Error)]
#[error("cannot read the rows")]
pub struct RowsError(#[source] Box<dyn std::error::Error + Send + Sync>);

impl RowsError {
    /// The reason, as the source of rows states it.
    pub fn new(reason: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self(reason.into())
    }
}

/// Rows could not be written.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// They could not be read.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// A column's type has no place in the format.
    #[error("column {column} of type {kind} cannot be written as {format}")]
    Column {
        /// Name of the column.
        column: String,
        /// Its type.
        kind: DataType,
        /// The format asked for.
        format: Format,
    },
    /// Rows were lost or added between passes.
    #[error("{found} rows were read where {expected} were counted")]
    Count {
        /// What the rows' source said.
        expected: u64,
        /// What it gave.
        found: u64,
    },
    /// NPZ asked for where rows come one by one.
    #[error("npz holds columns, so it cannot be written row by row")]
    NotAStream,
    /// Parquet encoding or its output.
    #[error("cannot write Parquet")]
    Parquet(#[from] ParquetError),
    /// Arrow or JSON encoding or their output.
    #[error("cannot write Arrow columns")]
    Arrow(#[from] ArrowError),
    /// CSV encoding or its output.
    #[error("cannot write CSV")]
    Csv(#[from] ::csv::Error),
    /// The container of an NPZ.
    #[error("cannot write the NPZ container")]
    Zip(#[from] ZipError),
    /// The output.
    #[error("cannot write the output")]
    Io(#[from] io::Error),
}

/// Writes all rows. `progress` is told after each batch how many of [`Rows::count`] are done; where
/// the rows are read more than once it is the part of the bytes that is written, in rows.
pub fn write(
    format: Format,
    rows: &dyn Rows,
    out: &mut (impl Write + Send),
    progress: &mut dyn FnMut(u64),
) -> Result<(), FormatError> {
    if format == Format::Npz {
        return npz::write(rows, out, progress);
    }
    let mut stream = Stream::new(format, &rows.schema(), out)?;
    let mut done = 0;
    for batch in rows.batches(None)? {
        let batch = batch?;
        stream.push(&batch)?;
        done += batch.num_rows() as u64;
        progress(done);
    }
    stream.finish()?;
    counted(rows, done)
}

/// That as many rows were read as there are.
fn counted(rows: &dyn Rows, found: u64) -> Result<(), FormatError> {
    let expected = rows.count();
    if found == expected { Ok(()) } else { Err(FormatError::Count { expected, found }) }
}
