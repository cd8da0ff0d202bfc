//! Writes batches one by one, for files and for pages of a response.
//! Uses: `dataset::format`, arrow. Never: NPZ, which holds columns.

use std::io::Write;

use arrow_array::RecordBatch;
use arrow_ipc::writer::StreamWriter;
use arrow_json::LineDelimitedWriter;
use arrow_schema::SchemaRef;

use super::{Format, FormatError, csv, parquet, zone};

/// Writes batches of one schema in a row format.
pub struct Stream<W: Write + Send>(Writer<W>);

enum Writer<W: Write + Send> {
    Parquet(Box<parquet::Writer<W>>),
    Arrow(StreamWriter<W>),
    Csv(Box<csv::Writer<W>>),
    Ndjson(LineDelimitedWriter<W>),
}

impl<W: Write + Send> Stream<W> {
    /// Starts an output and writes the header, if the format has one.
    ///
    /// # Errors
    /// `FormatError::NotAStream` for NPZ; another variant if the header cannot be written.
    pub fn new(format: Format, schema: &SchemaRef, out: W) -> Result<Self, FormatError> {
        Ok(Self(match format {
            Format::Parquet => Writer::Parquet(Box::new(parquet::Writer::new(schema, out)?)),
            Format::Arrow => Writer::Arrow(StreamWriter::try_new(out, schema)?),
            Format::Csv => Writer::Csv(Box::new(csv::Writer::new(schema, out)?)),
            Format::Ndjson => Writer::Ndjson(LineDelimitedWriter::new(out)),
            Format::Npz => return Err(FormatError::NotAStream),
        }))
    }

    /// Writes a batch; in Parquet, a row group.
    ///
    /// # Errors
    /// `FormatError` if the batch cannot be encoded or written.
    pub fn push(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        match &mut self.0 {
            Writer::Parquet(writer) => writer.push(batch),
            Writer::Arrow(writer) => Ok(writer.write(batch)?),
            Writer::Csv(writer) => writer.push(&zone::as_offsets(batch)?),
            Writer::Ndjson(writer) => Ok(writer.write(&zone::as_offsets(batch)?)?),
        }
    }

    /// Writes the end of the format and returns the output.
    ///
    /// # Errors
    /// `FormatError` if the output cannot be written.
    pub fn finish(self) -> Result<W, FormatError> {
        match self.0 {
            Writer::Parquet(writer) => writer.finish(),
            Writer::Arrow(writer) => Ok(writer.into_inner()?),
            Writer::Csv(writer) => writer.finish(),
            Writer::Ndjson(mut writer) => {
                writer.finish()?;
                Ok(writer.into_inner())
            }
        }
    }
}
