//! The rows of a statement's result.
//! Uses: polars, `tables`, `statement`, `words`. Never: more rows than were ordered.

use std::io::{self, Write};

use palpate_words::query_lines::Table;
use polars::error::PolarsError;
use polars::frame::DataFrame;
use polars::prelude::{CompatLevel, Engine, IpcStreamWriter, SerWriter};
use polars::sql::SQLContext;

use crate::statement::Statement;
use crate::{polars_errors, tables};

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
    let limit = u32::try_from(rows_max.saturating_add(1)).unwrap_or(u32::MAX);
    let result = context.execute(&statement.sql)?.limit(limit);
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
pub fn write(rows: &mut DataFrame, out: impl Write) -> io::Result<()> {
    let mut writer = IpcStreamWriter::new(out).with_compat_level(CompatLevel::oldest());
    writer.finish(rows).map_err(io::Error::other)
}
