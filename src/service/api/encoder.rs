//! Rows in a row format, encoded batch by batch: while they are sent, or into a text.
//! Uses: `dataset::format`, `send`. Never: more than a batch in memory, the whole text of one
//! that is sent, an answer that ends early without an error.

use std::error::Error;
use std::io;
use std::iter::from_fn;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use axum::body::Body;
use axum::response::Response;
use futures::stream::{Stream, StreamExt, iter, unfold};

use super::send::{Piece, in_format};
use crate::dataset::error::DatasetResult;
use crate::dataset::format::{self, Format, rows_within};
use crate::journal::error_chain;

/// Size of the rows whose text is sent as one piece, bytes; their text is several times as long.
const TEXT_PIECE_BYTES: usize = 256 << 10;

/// Rows that are being encoded.
pub struct RowEncoder {
    format: Format,
    /// Largest number of rows that are sent as one piece.
    piece_rows: usize,
    piece: Piece,
    stream: format::Stream<Piece>,
}

impl RowEncoder {
    /// Begins with rows of a schema.
    ///
    /// # Errors
    /// `DatasetError::Format` if the format cannot hold a column.
    pub fn new(format: Format, schema: &SchemaRef) -> DatasetResult<Self> {
        let piece = Piece::default();
        let stream = format::Stream::new(format, schema, piece.clone())?;
        let is_text = format.is_text();
        let piece_rows = if is_text { rows_within(schema, TEXT_PIECE_BYTES) } else { usize::MAX };
        Ok(Self { format, piece_rows, piece, stream })
    }

    /// Encodes the first piece of a batch; returns its other rows.
    ///
    /// # Errors
    /// `DatasetError::Format` if it cannot be encoded.
    pub fn begin(&mut self, batch: RecordBatch) -> DatasetResult<Option<RecordBatch>> {
        let (first, rest) = split(batch, self.piece_rows);
        self.push(&first)?;
        Ok(rest)
    }

    /// Encodes a batch.
    ///
    /// # Errors
    /// `DatasetError::Format` if it cannot be encoded.
    pub fn push(&mut self, batch: &RecordBatch) -> DatasetResult<()> {
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
    pub fn finish(self) -> DatasetResult<Vec<u8>> {
        Ok(self.stream.finish()?.take())
    }

    /// Returns a response with these batches, encoded as they arrive. After an error, which is logged with the words
    /// `incomplete`, it ends with this error.
    pub fn response<E: Error + Send + 'static>(
        self,
        batches: impl Stream<Item = Result<RecordBatch, E>> + Send + 'static,
        incomplete: &'static str,
    ) -> Response {
        let (format, piece_rows) = (self.format, self.piece_rows);
        let batches = batches.flat_map(move |batch| iter(pieces(batch, piece_rows)));
        let failed = move |error: &(dyn Error + 'static)| {
            tracing::warn!(error = error_chain(error), "{incomplete}");
            (Err(io::Error::other(error.to_string())), None)
        };
        let sent = unfold(Some((self, Box::pin(batches))), move |state| async move {
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
        in_format(format, Body::from_stream(sent))
    }
}

/// Splits a batch after `most` rows; returns the other rows, if there are some.
fn split(batch: RecordBatch, most: usize) -> (RecordBatch, Option<RecordBatch>) {
    match batch.num_rows().checked_sub(most) {
        None | Some(0) => (batch, None),
        Some(rest) => (batch.slice(0, most), Some(batch.slice(most, rest))),
    }
}

/// Pieces of a batch of at most `most` rows, in their order; an error as it is.
fn pieces<E>(
    batch: Result<RecordBatch, E>,
    most: usize,
) -> impl Iterator<Item = Result<RecordBatch, E>> {
    let mut rest = Some(batch);
    from_fn(move || {
        let piece = rest.take()?.map(|batch| split(batch, most));
        Some(piece.map(|(first, others)| {
            rest = others.map(Ok);
            first
        }))
    })
}

#[cfg(test)]
mod tests {
    use std::slice::from_ref;
    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float32Array};
    use arrow_schema::{ArrowError, DataType, Field, Schema};

    use super::super::send::encoded;
    use super::*;

    /// Rows of a batch: of several pieces.
    const ROWS: u16 = 10_000;
    /// Columns of a batch.
    const WIDE_COLUMNS: usize = 100;

    #[tokio::test]
    async fn the_text_of_a_batch_is_sent_in_pieces() {
        let field = |n: usize| Field::new(format!("v{n}"), DataType::Float32, false);
        let schema = Arc::new(Schema::new((0..WIDE_COLUMNS).map(field).collect::<Vec<_>>()));
        let values = (0..ROWS).map(f32::from);
        let column: ArrayRef = Arc::new(Float32Array::from_iter_values(values));
        let batch = RecordBatch::try_new(schema.clone(), vec![column; WIDE_COLUMNS]).unwrap();
        for format in [Format::Csv, Format::Ndjson] {
            let mut encoder = RowEncoder::new(format, &schema).unwrap();
            let rest = encoder.begin(batch.clone()).unwrap().unwrap();
            let batches = iter([Ok::<_, ArrowError>(rest)]);
            let mut body = encoder.response(batches, "incomplete").into_body().into_data_stream();
            let (mut text, mut longest) = (Vec::new(), 0);
            while let Some(piece) = body.next().await {
                let piece = piece.unwrap();
                longest = longest.max(piece.len());
                text.extend_from_slice(&piece);
            }
            let whole = encoded(format, &schema, from_ref(&batch)).unwrap();
            assert!(text == whole, "{format}");
            assert!(longest < text.len() / 5, "{format}: {longest} of {} bytes", text.len());
        }
    }
}
