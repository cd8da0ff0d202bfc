//! The rows of a result, batch by batch as the engine sends them, in the types of every format.
//! Uses: arrow, `dataset::background`. Never: all rows at once.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::TimestampMillisecondType;
use arrow_array::{ArrayRef, RecordBatch};
use arrow_cast::cast;
use arrow_ipc::reader::StreamReader;
use arrow_schema::{ArrowError, DataType, Field, Fields, Schema, SchemaRef, TimeUnit};
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};

use super::engine::Engine;
use super::error::QueryError;
use crate::dataset::background::background;
use crate::dataset::error::DatasetError;
use crate::dataset::format::zone;

/// Number of batches that wait for the reader.
const RESULTS_AHEAD: usize = 2;

/// Rows of a result. The engine ends when they are dropped.
pub struct ResultRows {
    /// Names and types of the columns.
    pub schema: SchemaRef,
    /// Number of rows.
    pub count: u64,
    batches: mpsc::Receiver<Result<RecordBatch, ArrowError>>,
    _alive: Box<dyn Send>,
    _turn: OwnedSemaphorePermit,
}

impl ResultRows {
    /// Reads the output of an engine that has `count` rows.
    pub(super) async fn read(
        engine: Engine,
        count: u64,
        turn: OwnedSemaphorePermit,
    ) -> Result<Self, QueryError> {
        let (output, alive) = engine.into_output()?;
        let (sender, batches) = mpsc::channel(RESULTS_AHEAD);
        let (columns, schema) = oneshot::channel();
        tokio::spawn(background(move || {
            let reader = match StreamReader::try_new(output, None) {
                Ok(reader) => reader,
                Err(error) => return drop(columns.send(Err(error))),
            };
            let schema = plain_schema(&reader.schema());
            if columns.send(Ok(schema.clone())).is_err() {
                return;
            }
            for batch in reader {
                let batch = batch.and_then(|batch| plain(&schema, &batch));
                if sender.blocking_send(batch).is_err() {
                    return;
                }
            }
        }));
        let schema = schema.await.map_err(|_| DatasetError::Worker)??;
        Ok(Self { schema, count, batches, _alive: Box::new(alive), _turn: turn })
    }

    /// Returns the next batch; `None` at the end.
    ///
    /// # Errors
    /// `ArrowError` if the engine has failed meanwhile.
    pub async fn next(&mut self) -> Option<Result<RecordBatch, ArrowError>> {
        self.batches.recv().await
    }
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
