//! Writes batches one by one, for files and for pages of a response.
//! Uses: `dataset::format`, arrow. Never: NPZ, which holds columns.

use std::io::Write;

use arrow_array::RecordBatch;
use arrow_ipc::writer::{FileWriter, StreamWriter};
use arrow_json::LineDelimitedWriter;
use arrow_schema::SchemaRef;

use super::{Format, FormatError, csv, parquet, zone};

/// Writes batches of one schema in a row format.
pub struct Stream<'w, W: Write + Send>(Box<dyn RowWriter<W> + 'w>);

impl<'w, W: Write + Send + 'w> Stream<'w, W> {
    /// Starts an output and writes the header, if the format has one.
    ///
    /// # Errors
    /// `FormatError::NotAStream` for NPZ; another variant if the header cannot be written.
    pub fn new(format: Format, schema: &SchemaRef, out: W) -> Result<Self, FormatError> {
        Ok(Self(format.writer(schema, out)?))
    }

    /// Writes a batch; in Parquet, a row group.
    ///
    /// # Errors
    /// `FormatError` if the batch cannot be encoded or written.
    pub fn push(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        self.0.push_batch(batch)
    }

    /// Writes the end of the format and returns the output.
    ///
    /// # Errors
    /// `FormatError` if the output cannot be written.
    pub fn finish(self) -> Result<W, FormatError> {
        self.0.end()
    }
}

/// Writer of a row format, after its header.
pub(super) trait RowWriter<W>: Send {
    /// Writes a batch.
    fn push_batch(&mut self, batch: &RecordBatch) -> Result<(), FormatError>;

    /// Writes the end of the format and returns the output.
    fn end(self: Box<Self>) -> Result<W, FormatError>;
}

impl<W: Write + Send> RowWriter<W> for parquet::Writer<W> {
    fn push_batch(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        self.push(batch)
    }

    fn end(self: Box<Self>) -> Result<W, FormatError> {
        self.finish()
    }
}

impl<W: Write + Send> RowWriter<W> for StreamWriter<W> {
    fn push_batch(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        Ok(self.write(batch)?)
    }

    fn end(self: Box<Self>) -> Result<W, FormatError> {
        Ok(self.into_inner()?)
    }
}

impl<W: Write + Send> RowWriter<W> for FileWriter<W> {
    fn push_batch(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        Ok(self.write(batch)?)
    }

    fn end(self: Box<Self>) -> Result<W, FormatError> {
        Ok(self.into_inner()?)
    }
}

impl<W: Write + Send> RowWriter<W> for csv::Writer<W> {
    fn push_batch(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        self.push(&zone::as_offsets(batch)?)
    }

    fn end(self: Box<Self>) -> Result<W, FormatError> {
        self.finish()
    }
}

impl<W: Write + Send> RowWriter<W> for LineDelimitedWriter<W> {
    fn push_batch(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        Ok(self.write(&zone::as_offsets(batch)?)?)
    }

    fn end(mut self: Box<Self>) -> Result<W, FormatError> {
        self.finish()?;
        Ok(self.into_inner())
    }
}
