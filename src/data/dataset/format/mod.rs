//! Writers of rows in common formats: Parquet, Arrow, CSV, NDJSON, NPZ.
//! Uses: arrow, parquet, csv, zip. Never: the meaning or origin of rows, files.
//!
//! The same rows produce the same bytes. Memory is bounded by a batch: row formats are written as
//! batches arrive ([`Stream`]); NPZ holds columns, and the rows are read again for each column.
//! The metadata of the schema is written where the format has a place for it: footer key-values in
//! Parquet, schema metadata in Arrow.

#[cfg(test)]
mod tests;

mod columns;
mod csv;
pub(crate) mod npy;
mod npz;
mod parquet;
pub(crate) mod zone;

use std::fmt;
use std::io::{self, Write};
use std::str::FromStr;

use ::parquet::errors::ParquetError;
use arrow_array::RecordBatch;
use arrow_ipc::writer::{FileWriter, StreamWriter};
use arrow_json::LineDelimitedWriter;
use arrow_schema::{ArrowError, DataType, SchemaRef};
use serde::{Deserialize, Serialize};
use zip::result::ZipError;

pub(super) use self::parquet::Writer as ParquetWriter;
pub use columns::{rows_per_batch, rows_within};

/// File format of rows. A new format is a variant with its row in the list, and its writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Apache Parquet: a row group for each batch, compressed with zstd.
    Parquet,
    /// Arrow IPC stream, uncompressed.
    Arrow,
    /// Arrow IPC file (Feather 2), uncompressed: readers may map it and skip to a batch.
    Feather,
    /// CSV (RFC 4180) with a header line. Lists of fixed length have a column for each item
    /// (`voltages_v_0`, `voltages_v_1` ...); other lists are a cell of JSON. A missing value is an
    /// empty cell.
    Csv,
    /// A JSON object per line, without missing values.
    Ndjson,
    /// NumPy arrays, one per column, readable by `numpy.load` without pickle; `npz.rs` lists the
    /// array type of each column type.
    Npz,
}

/// A row of the list of formats.
struct Row {
    name: &'static str,
    title: &'static str,
    extension: &'static str,
    media_type: &'static str,
    about: &'static str,
}

impl Format {
    /// All formats, in the order in which messages list them.
    pub const ALL: [Self; 6] =
        [Self::Parquet, Self::Arrow, Self::Feather, Self::Csv, Self::Ndjson, Self::Npz];

    /// The list of formats. Messages, commands, HTTP and `openapi.yaml` follow from it.
    fn row(self) -> Row {
        match self {
            Self::Parquet => Row {
                name: "parquet",
                title: "Parquet",
                extension: "parquet",
                media_type: "application/vnd.apache.parquet",
                about: "Apache Parquet, compressed with zstd",
            },
            Self::Arrow => Row {
                name: "arrow",
                title: "Arrow stream",
                extension: "arrows",
                media_type: "application/vnd.apache.arrow.stream",
                about: "Arrow IPC stream, uncompressed",
            },
            Self::Feather => Row {
                name: "feather",
                title: "Arrow file (Feather)",
                extension: "arrow",
                media_type: "application/vnd.apache.arrow.file",
                about: "Arrow IPC file (Feather 2), uncompressed",
            },
            Self::Csv => Row {
                name: "csv",
                title: "CSV",
                extension: "csv",
                media_type: "text/csv; charset=utf-8; header=present",
                about: "CSV (RFC 4180) with a header line",
            },
            Self::Ndjson => Row {
                name: "ndjson",
                title: "NDJSON",
                extension: "ndjson",
                media_type: "application/x-ndjson",
                about: "a JSON object per line, without missing values",
            },
            Self::Npz => Row {
                name: "npz",
                title: "NumPy (npz)",
                extension: "npz",
                media_type: "application/zip",
                about: "NumPy arrays, one per column",
            },
        }
    }

    /// Splits the name of a file at the dot before its ending: the extension of a format or, if it is of
    /// none, the name of one; `None` for another ending.
    pub fn of_file(name: &str) -> Option<(&str, Self)> {
        let by = |ending: fn(Self) -> &'static str| {
            Self::ALL.into_iter().find_map(|format| {
                Some((name.strip_suffix(ending(format))?.strip_suffix('.')?, format))
            })
        };
        by(Self::extension).or_else(|| by(Self::name))
    }

    /// Name in queries and commands.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Name for people.
    pub fn title(self) -> &'static str {
        self.row().title
    }

    /// Extension of file names, without the dot.
    pub fn extension(self) -> &'static str {
        self.row().extension
    }

    /// Media type in HTTP.
    pub fn media_type(self) -> &'static str {
        self.row().media_type
    }

    /// Description in one line.
    pub fn about(self) -> &'static str {
        self.row().about
    }

    /// True if rows can be written in one pass: all formats except NPZ.
    pub fn streams(self) -> bool {
        self != Self::Npz
    }

    /// True if numbers are written as text: a file is longer, and a person can read it.
    pub fn is_text(self) -> bool {
        matches!(self, Self::Csv | Self::Ndjson)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The name is not that of a format.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("format `{name}`: choose from {}", Format::ALL.map(Format::name).join(", "))]
pub struct UnknownFormat {
    /// The unknown name.
    pub name: String,
}

impl FromStr for Format {
    type Err = UnknownFormat;

    fn from_str(name: &str) -> Result<Self, UnknownFormat> {
        let found = Self::ALL.into_iter().find(|format| format.name() == name);
        found.ok_or_else(|| UnknownFormat { name: name.to_owned() })
    }
}

/// Iterator over batches.
pub type Batches<'a> = Box<dyn Iterator<Item = Result<RecordBatch, RowsError>> + 'a>;

/// Rows that can be read several times, each time in the same order and batches.
pub trait Rows {
    /// Columns and metadata.
    fn schema(&self) -> SchemaRef;

    /// Number of rows.
    fn count(&self) -> u64;

    /// Returns the rows in batches: all columns, or those with the given indices of the schema, in
    /// this order. A batch becomes a row group of Parquet; [`rows_per_batch`] is its recommended
    /// length.
    ///
    /// # Errors
    /// `RowsError` if the rows cannot be read.
    fn batches(&self, columns: Option<&[usize]>) -> Result<Batches<'_>, RowsError>;
}

/// The rows could not be read.
#[derive(Debug, thiserror::Error)]
#[error("cannot read the rows")]
pub struct RowsError(#[source] Box<dyn std::error::Error + Send + Sync>);

impl RowsError {
    /// Wraps the error of the source of the rows.
    pub fn new(reason: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self(reason.into())
    }
}

/// Why rows could not be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum FormatError {
    #[error(transparent)]
    Rows(#[from] RowsError),
    #[error("column {column} of type {kind} cannot be written as {format}")]
    Column { column: String, kind: DataType, format: Format },
    #[error("{found} rows were read, {expected} were counted")]
    Count { expected: u64, found: u64 },
    #[error("npz holds columns and cannot be written row by row: choose another format")]
    NotAStream,
    #[error("cannot write Parquet")]
    Parquet(#[from] ParquetError),
    #[error("cannot write Arrow columns")]
    Arrow(#[from] ArrowError),
    #[error("cannot write CSV")]
    Csv(#[from] ::csv::Error),
    #[error("cannot write the NPZ container")]
    Zip(#[from] ZipError),
    #[error("cannot write the output")]
    Io(#[from] io::Error),
}

/// Writes batches of one schema in a row format.
pub struct Stream<W: Write + Send>(RowWriter<W>);

/// Writer of a row format, after its header.
#[allow(clippy::large_enum_variant, reason = "an output has one")]
enum RowWriter<W: Write + Send> {
    Parquet(parquet::Writer<W>),
    Arrow(StreamWriter<W>),
    Feather(FileWriter<W>),
    Csv(csv::Writer<W>),
    Ndjson(LineDelimitedWriter<W>),
}

impl<W: Write + Send> Stream<W> {
    /// Starts an output and writes the header, if the format has one.
    ///
    /// # Errors
    /// `FormatError::NotAStream` for NPZ; another variant if the header cannot be written.
    pub fn new(format: Format, schema: &SchemaRef, out: W) -> Result<Self, FormatError> {
        Ok(Self(match format {
            Format::Parquet => RowWriter::Parquet(parquet::Writer::new(schema, out)?),
            Format::Arrow => RowWriter::Arrow(StreamWriter::try_new(out, schema)?),
            Format::Feather => RowWriter::Feather(FileWriter::try_new(out, schema)?),
            Format::Csv => RowWriter::Csv(csv::Writer::new(schema, out)?),
            Format::Ndjson => RowWriter::Ndjson(LineDelimitedWriter::new(out)),
            Format::Npz => return Err(FormatError::NotAStream),
        }))
    }

    /// Writes a batch; in Parquet, a row group.
    ///
    /// # Errors
    /// `FormatError` if the batch cannot be encoded or written.
    pub fn push(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        match &mut self.0 {
            RowWriter::Parquet(file) => file.push(batch),
            RowWriter::Arrow(stream) => Ok(stream.write(batch)?),
            RowWriter::Feather(file) => Ok(file.write(batch)?),
            RowWriter::Csv(lines) => lines.push(&zone::as_offsets(batch)?),
            RowWriter::Ndjson(lines) => Ok(lines.write(&zone::as_offsets(batch)?)?),
        }
    }

    /// Writes the end of the format and returns the output.
    ///
    /// # Errors
    /// `FormatError` if the output cannot be written.
    pub fn finish(self) -> Result<W, FormatError> {
        match self.0 {
            RowWriter::Parquet(file) => file.finish(),
            RowWriter::Arrow(stream) => Ok(stream.into_inner()?),
            RowWriter::Feather(file) => Ok(file.into_inner()?),
            RowWriter::Csv(lines) => lines.finish(),
            RowWriter::Ndjson(mut lines) => {
                lines.finish()?;
                Ok(lines.into_inner())
            }
        }
    }
}

/// Writes all rows. `progress` is called after each batch with the number of written rows; for NPZ,
/// which reads the rows several times, with the written share of the bytes, in rows.
///
/// # Errors
/// `FormatError::Rows` if the rows cannot be read, `Column` if the format cannot hold a column,
/// `Count` if their number changes; the other variants if encoding or writing fails.
pub fn write(
    format: Format,
    rows: &dyn Rows,
    out: &mut (impl Write + Send),
    progress: &mut dyn FnMut(u64),
) -> Result<(), FormatError> {
    if !format.streams() {
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
    check_count(rows, done)
}

/// Checks that the number of read rows is the number that was counted.
fn check_count(rows: &dyn Rows, found: u64) -> Result<(), FormatError> {
    let expected = rows.count();
    if found == expected { Ok(()) } else { Err(FormatError::Count { expected, found }) }
}
