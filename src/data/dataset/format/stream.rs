//! Writes batches one by one, for files and for pages of a response.
//! Uses: `dataset::format`, arrow. Never: NPZ, which holds columns.

use std::io::Write;

use arrow_array::RecordBatch;
use arrow_ipc::writer::{FileWriter, StreamWriter};
use arrow_json::LineDelimitedWriter;
use arrow_schema::SchemaRef;

use super::{Format, FormatError, csv, parquet, zone};

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
