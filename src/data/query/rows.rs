//! The rows of a result, batch by batch as the engine sends them, in the types of every format.
//! Uses: arrow, `dataset::background`. Never: all rows at once; a turn that is kept because a client reads
//! slowly; an end before the last row without an error.

use std::io::Read;
use std::sync::Arc;
use std::time::Duration;

use arrow_array::cast::AsArray;
use arrow_array::types::TimestampMillisecondType;
use arrow_array::{ArrayRef, RecordBatch};
use arrow_cast::cast;
use arrow_ipc::reader::StreamReader;
use arrow_schema::{ArrowError, DataType, Field, Fields, Schema, SchemaRef, TimeUnit};
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};
use tokio::time::sleep;
use tracing::Instrument;

use super::TAKEN_WITHIN;
use super::engine::Engine;
use super::error::QueryError;
use crate::dataset::background::background;
use crate::dataset::error::DatasetError;
use crate::dataset::format::zone;

/// Number of batches that wait for the reader.
const RESULTS_AHEAD: usize = 2;

/// Rows of a result. The engine ends when they have been read from it, when they are dropped, or `TAKEN_WITHIN`
/// after it has begun to send them; then the turn of the query is free.
pub struct ResultRows {
    /// Names and types of the columns.
    pub schema: SchemaRef,
    /// Number of rows.
    pub count: u64,
    batches: mpsc::Receiver<Result<RecordBatch, ArrowError>>,
}

impl ResultRows {
    /// Reads the output of an engine that has `count` rows.
    pub(super) async fn read(
        engine: Engine,
        count: u64,
        turn: OwnedSemaphorePermit,
    ) -> Result<Self, QueryError> {
        let (output, alive) = engine.into_output()?;
        Self::of(output, count, (alive, turn), TAKEN_WITHIN).await
    }

    /// Reads an output with `count` rows, and drops `held` when it has been read, when these rows are dropped, or
    /// after `within`.
    async fn of(
        output: impl Read + Send + 'static,
        count: u64,
        held: impl Send + 'static,
        within: Duration,
    ) -> Result<Self, QueryError> {
        let (sender, batches) = mpsc::channel(RESULTS_AHEAD);
        let (columns, schema) = oneshot::channel();
        let taken = sender.clone();
        let reading = tokio::spawn(background(move || {
            let reader = match StreamReader::try_new(output, None) {
                Ok(reader) => reader,
                Err(error) => return drop(columns.send(Err(error))),
            };
            let schema = plain_schema(&reader.schema());
            if columns.send(Ok(schema.clone())).is_err() {
                return;
            }
            // Rows without columns are in no batch.
            let count = if schema.fields().is_empty() { 0 } else { count };
            for batch in whole(reader, count) {
                let batch = batch.and_then(|batch| plain(&schema, &batch));
                if sender.blocking_send(batch).is_err() {
                    return;
                }
            }
        }));
        let schema = schema.await.map_err(|_| DatasetError::Worker)??;
        let waiting = async move {
            tokio::select! {
                _ = reading => {}
                () = taken.closed() => {}
                () = sleep(within) => {
                    let within_s = within.as_secs();
                    tracing::warn!(within_s, "a query was ended: its client reads its rows too slowly");
                }
            }
            drop(held);
        };
        tokio::spawn(waiting.in_current_span());
        Ok(Self { schema, count, batches })
    }

    /// Returns the next batch; `None` at the end.
    ///
    /// # Errors
    /// `ArrowError` if the engine has failed meanwhile.
    pub async fn next(&mut self) -> Option<Result<RecordBatch, ArrowError>> {
        self.batches.recv().await
    }
}

/// The batches, and an error after the last one if they have fewer than `count` rows: of a stream that ends between two
/// batches its reader reports none.
fn whole(
    batches: impl Iterator<Item = Result<RecordBatch, ArrowError>>,
    count: u64,
) -> impl Iterator<Item = Result<RecordBatch, ArrowError>> {
    let mut read = 0;
    batches.map(Some).chain([None]).filter_map(move |batch| match batch {
        Some(batch) => {
            read += batch.as_ref().map_or(0, |batch| batch.num_rows() as u64);
            Some(batch)
        }
        None if read >= count => None,
        None => {
            let words = format!("the query engine ended after {read} of {count} rows");
            Some(Err(ArrowError::IpcError(words)))
        }
    })
}

fn plain_schema(schema: &Schema) -> SchemaRef {
    let fields = schema.fields().iter().map(|field| plain_field(field));
    Arc::new(Schema::new(fields.collect::<Fields>()))
}

fn plain_field(field: &Field) -> Field {
    Field::new(field.name(), plain_type(field.data_type()), field.is_nullable())
}

/// The type among those of datasets that holds the values of a type of polars.
fn plain_type(kind: &DataType) -> DataType {
    match kind {
        DataType::LargeUtf8 | DataType::Utf8View | DataType::Null => DataType::Utf8,
        DataType::Date32 | DataType::Date64 | DataType::Time64(_) => DataType::Utf8,
        DataType::Decimal128(..) => DataType::Float64,
        DataType::Dictionary(_, values) => plain_type(values),
        // The engine knows no zones: all its times are UTC.
        DataType::Timestamp(..) => {
            DataType::Timestamp(TimeUnit::Millisecond, Some(zone::NAME.into()))
        }
        DataType::Duration(_) => DataType::Int64,
        DataType::LargeList(item) | DataType::List(item) => {
            DataType::List(Arc::new(plain_field(item)))
        }
        DataType::FixedSizeList(item, length) => {
            DataType::FixedSizeList(Arc::new(plain_field(item)), *length)
        }
        DataType::Struct(fields) => {
            DataType::Struct(fields.iter().map(|field| plain_field(field)).collect())
        }
        other => other.clone(),
    }
}

fn plain(schema: &SchemaRef, batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    let columns = schema.fields().iter().zip(batch.columns());
    let columns = columns.map(|(field, column)| match column.data_type() {
        DataType::Timestamp(..) => {
            let bare = cast(column, &DataType::Timestamp(TimeUnit::Millisecond, None))?;
            let times = bare.as_primitive::<TimestampMillisecondType>().clone();
            let is_time = |at: i64| jiff::Timestamp::from_millisecond(at).is_ok();
            if let Some(at) = times.iter().flatten().find(|&at| !is_time(at)) {
                return Err(ArrowError::InvalidArgumentError(format!(
                    "column {} holds {at} ms, which is no time",
                    field.name()
                )));
            }
            Ok(Arc::new(times.with_timezone(zone::NAME)) as ArrayRef)
        }
        // Durations are counted in milliseconds.
        DataType::Duration(_) => {
            cast(&cast(column, &DataType::Duration(TimeUnit::Millisecond))?, field.data_type())
        }
        _ => cast(column, field.data_type()),
    });
    RecordBatch::try_new(schema.clone(), columns.collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use arrow_array::Int64Array;
    use arrow_ipc::writer::StreamWriter;
    use tokio::time::timeout;

    use super::*;

    /// Batches of a whole stream: more than wait for a reader.
    const BATCHES: u64 = 6;
    const ROWS_EACH: u64 = 10;
    /// Far more than a test takes.
    const PATIENCE: Duration = Duration::from_secs(60);

    /// A stream of the first `batches` batches, without its end if it has more.
    fn stream(batches: u64) -> Cursor<Vec<u8>> {
        let fields = vec![Field::new("n", DataType::Int64, false)];
        let schema: SchemaRef = Arc::new(Schema::new(fields));
        let mut writer = StreamWriter::try_new(Vec::new(), &schema).unwrap();
        for _ in 0..batches {
            let numbers: ArrayRef = Arc::new(Int64Array::from_iter_values(0..ROWS_EACH as i64));
            writer.write(&RecordBatch::try_new(schema.clone(), vec![numbers]).unwrap()).unwrap();
        }
        let unfinished = writer.get_ref().clone();
        Cursor::new(if batches < BATCHES { unfinished } else { writer.into_inner().unwrap() })
    }

    /// Rows of a stream, and a receiver that ends when their turn is free.
    async fn rows(batches: u64, within: Duration) -> (ResultRows, oneshot::Receiver<()>) {
        let (turn, freed) = oneshot::channel();
        let rows = ResultRows::of(stream(batches), BATCHES * ROWS_EACH, turn, within).await;
        (rows.unwrap(), freed)
    }

    /// Waits until the turn is dropped.
    async fn is_free(freed: oneshot::Receiver<()>) -> bool {
        matches!(timeout(PATIENCE, freed).await, Ok(Err(_)))
    }

    #[tokio::test]
    async fn a_client_that_does_not_read_keeps_no_turn() {
        let (_rows, freed) = rows(BATCHES, Duration::ZERO).await;
        assert!(is_free(freed).await);
    }

    #[tokio::test]
    async fn a_turn_is_kept_until_the_rows_are_read_or_dropped() {
        let (mut read, mut freed) = rows(BATCHES, PATIENCE * 2).await;
        assert!(read.next().await.unwrap().is_ok());
        assert_eq!(freed.try_recv(), Err(oneshot::error::TryRecvError::Empty));
        let mut count = 1;
        while let Some(batch) = read.next().await {
            assert_eq!(batch.unwrap().num_rows() as u64, ROWS_EACH);
            count += 1;
        }
        assert!(count == BATCHES && is_free(freed).await);
        let (dropped, freed) = rows(BATCHES, PATIENCE * 2).await;
        drop(dropped);
        assert!(is_free(freed).await);
    }

    #[tokio::test]
    async fn rows_that_are_missing_are_an_error() {
        let (mut read, _freed) = rows(3, PATIENCE).await;
        for _ in 0..3 {
            assert!(read.next().await.unwrap().is_ok());
        }
        let error = read.next().await.unwrap().unwrap_err().to_string();
        assert!(error.contains("ended after 30 of 60 rows"), "{error}");
        assert!(read.next().await.is_none());
    }
}
