//! The rows of a statement's result.
//! Uses: polars, `tables`, `statement`, `words`. Never: more rows than were ordered, all of them in one batch.

use std::io::{self, Write};

use palpate_words::query_lines::Table;
use polars::error::{PolarsError, PolarsResult};
use polars::frame::DataFrame;
use polars::prelude::{CompatLevel, Engine, SchemaExt};
use polars::sql::SQLContext;
use polars_arrow::io::ipc::write::{StreamWriter, WriteOptions};

use crate::statement::Statement;
use crate::{polars_errors, tables};

/// Size of a batch of a result: the service and the client read one while the next is written.
const BATCH_BYTES: usize = 8 << 20;
/// Fewest rows of a batch that is not the last: those of a row group of a dataset.
const BATCH_ROWS_MIN: usize = 1000;

/// Why a statement has no result.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// Polars refuses it, or a file cannot be read.
    #[error("sql: {0}")]
    Polars(#[from] PolarsError),
    /// The result is too long.
    #[error("sql: the result has more than {0} rows: add LIMIT, or aggregate")]
    Rows(u64),
}

impl EvaluateError {
    /// The error for a person: a short sentence that names what is wrong in the statement.
    pub fn words(&self, statement: &Statement, read: &[Table], memory_max_bytes: u64) -> String {
        let Self::Polars(error) = self else { return self.to_string() };
        let columns = read.iter().map(|table| {
            let schema = tables::rows(table).and_then(|mut rows| rows.collect_schema());
            let names = schema.map(|schema| schema.iter_names().map(ToString::to_string).collect());
            (table.name.clone(), names.unwrap_or_default())
        });
        polars_errors::of_error(
            error,
            &columns.collect::<Vec<_>>(),
            &statement.typed,
            memory_max_bytes,
        )
    }
}

/// Evaluates a statement over tables.
///
/// # Errors
/// `EvaluateError` if polars refuses it, or its result has more than `rows_max` rows.
pub fn rows(
    statement: &Statement,
    tables: &[Table],
    rows_max: u64,
) -> Result<DataFrame, EvaluateError> {
    let mut context = SQLContext::new();
    for table in tables {
        context.register(&table.name, tables::rows(table)?);
    }
    let mut result = context.execute(&statement.sql)?;
    // A sort with a limit holds its rows in a heap and copies them twice more.
    if !statement.sorts_all {
        result = result.limit(u32::try_from(rows_max.saturating_add(1)).unwrap_or(u32::MAX));
    }
    let rows = result.collect_with_engine(Engine::Streaming)?.unwrap_single();
    if rows.height() as u64 > rows_max {
        return Err(EvaluateError::Rows(rows_max));
    }
    Ok(rows)
}

/// Writes rows as an Arrow IPC stream, with the types of every Arrow reader.
///
/// # Errors
/// An error of `out`.
pub fn write(rows: &DataFrame, out: impl Write) -> io::Result<()> {
    batches(rows, out).map_err(io::Error::other)
}

/// Polars' own writer makes one batch of up to 262,144 rows: 1.6 GB of frames.
fn batches(rows: &DataFrame, out: impl Write) -> PolarsResult<()> {
    let level = CompatLevel::oldest();
    let mut writer = StreamWriter::new(out, WriteOptions::default());
    writer.start(&rows.schema().to_arrow(level), None)?;
    let row_bytes = (rows.estimated_size() / rows.height().max(1)).max(1);
    let length = (BATCH_BYTES / row_bytes).max(BATCH_ROWS_MIN);
    for first in (0..rows.height()).step_by(length) {
        let mut part = rows.slice(first as i64, length);
        part.rechunk_mut();
        for batch in part.iter_chunks(level, true) {
            writer.write(&batch, None)?;
        }
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use polars::df;
    use polars::prelude::{IpcStreamReader, SerReader};

    use super::*;

    #[test]
    fn a_large_result_is_several_batches_and_an_empty_one_has_its_columns() {
        let ids: Vec<i64> = (0..2500).collect();
        let texts: Vec<String> = ids.iter().map(|id| format!("{id:010000}")).collect();
        let rows = df!("id" => ids, "text" => texts).unwrap();
        for (rows, batches) in [(rows.clone(), 3), (rows.slice(0, 999), 1), (rows.slice(0, 0), 0)] {
            let mut bytes = Vec::new();
            write(&rows, &mut bytes).unwrap();
            let reader = IpcStreamReader::new(Cursor::new(bytes)).set_rechunk(false);
            let read = reader.finish().unwrap();
            assert!(batches == 0 || read.first_col_n_chunks() == batches, "{batches}");
            assert_eq!(read.schema(), rows.schema());
            assert!(read.equals(&rows));
        }
    }
}
