//! Rows in a row format, encoded batch by batch: while they are sent, or into a text.
//! Uses: `dataset::format`, `send`. Never: more than a batch in memory, an answer that ends early without an error.

use std::error::Error;
use std::io;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use axum::body::Body;
use axum::response::Response;
use futures::stream::{Stream, StreamExt, unfold};

use super::send::{Piece, in_format};
use crate::dataset::error::DatasetError;
use crate::dataset::format::{self, Format};
use crate::journal::error_chain;

/// Rows that are being encoded.
pub struct RowEncoder {
    format: Format,
    piece: Piece,
    stream: format::Stream<Piece>,
}

impl RowEncoder {
    /// Begins with rows of a schema.
    ///
    /// # Errors
    /// `DatasetError::Format` if the format cannot hold a column.
    pub fn new(format: Format, schema: &SchemaRef) -> Result<Self, DatasetError> {
        let piece = Piece::default();
        let stream = format::Stream::new(format, schema, piece.clone())?;
        Ok(Self { format, piece, stream })
    }

    /// Encodes a batch.
    ///
    /// # Errors
    /// `DatasetError::Format` if it cannot be encoded.
    pub fn push(&mut self, batch: &RecordBatch) -> Result<(), DatasetError> {
        Ok(self.stream.push(batch)?)
    }

    /// Removes and returns what was encoded since.
    pub fn take(&self) -> Vec<u8> {
        self.piece.take()
    }

    /// Returns what was encoded since, with the end of the format.
    ///
    /// # Errors
    /// `DatasetError::Format` if the end cannot be encoded.
    pub fn finish(self) -> Result<Vec<u8>, DatasetError> {
        Ok(self.stream.finish()?.take())
    }

    /// Returns a response with these batches, encoded as they arrive. After an error, which is logged with the words
    /// `incomplete`, it ends with this error.
    pub fn response<E: Error + 'static>(
        self,
        batches: impl Stream<Item = Result<RecordBatch, E>> + Send + 'static,
        incomplete: &'static str,
    ) -> Response {
        let format = self.format;
        let failed = move |error: &(dyn Error + 'static)| {
            tracing::warn!(error = error_chain(error), "{incomplete}");
            (Err(io::Error::other(error.to_string())), None)
        };
        let pieces = unfold(Some((self, Box::pin(batches))), move |state| async move {
            let (mut rows, mut batches) = state?;
            Some(match batches.next().await {
                Some(Ok(batch)) => match rows.push(&batch) {
                    Ok(()) => (Ok(rows.take()), Some((rows, batches))),
                    Err(error) => failed(&error),
                },
                Some(Err(error)) => failed(&error),
                None => match rows.finish() {
                    Ok(end) => (Ok(end), None),
                    Err(error) => failed(&error),
                },
            })
        });
        in_format(format, Body::from_stream(pieces))
    }
}
