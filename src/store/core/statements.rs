//! One statement alone: what it reads or returns, row by row, or the number of rows that it changes.
//! Uses: `core::{store, writer, columns}`, sqlx. Never: SQL written here.

use sqlx::Sqlite;
use sqlx::sqlite::SqliteArguments;

use super::columns::Columns;
use super::error::{During, StoreResult};
use super::store::Store;
use super::writer::Writer;

/// A statement with its values.
pub(crate) type Query = sqlx::query::Query<'static, Sqlite, SqliteArguments>;

impl Store {
    /// Returns what `read` makes of each row.
    ///
    /// # Errors
    /// `Sql` if the read fails; an error of `read`.
    pub(crate) async fn rows<T>(
        &self,
        operation: &'static str,
        query: Query,
        read: impl Fn(&Columns<'_>) -> StoreResult<T>,
    ) -> StoreResult<Vec<T>> {
        let rows = query.fetch_all(&self.inner.readers).await.during(operation)?;
        rows.iter().map(|row| read(&Columns::of(row, operation))).collect()
    }

    /// Returns what `read` makes of the first row; `None` without rows.
    pub(crate) async fn row<T>(
        &self,
        operation: &'static str,
        query: Query,
        read: impl Fn(&Columns<'_>) -> StoreResult<T>,
    ) -> StoreResult<Option<T>> {
        let row = query.fetch_optional(&self.inner.readers).await.during(operation)?;
        row.map(|row| read(&Columns::of(&row, operation))).transpose()
    }

    /// Returns what `read` makes of the row of a statement that always has one.
    pub(crate) async fn one<T>(
        &self,
        operation: &'static str,
        query: Query,
        read: impl Fn(&Columns<'_>) -> StoreResult<T>,
    ) -> StoreResult<T> {
        let row = query.fetch_one(&self.inner.readers).await.during(operation)?;
        read(&Columns::of(&row, operation))
    }
}

impl Writer {
    /// Carries out a statement in a transaction; returns the number of rows that it changed.
    pub(crate) async fn execute(&self, operation: &'static str, query: Query) -> StoreResult<u64> {
        self.run(operation, async move |connection| {
            Ok(query.execute(connection).await.during(operation)?.rows_affected())
        })
        .await
    }

    /// Carries out a statement that returns a row in a transaction; returns what `read` makes of it.
    pub(crate) async fn returned<T: Send + 'static>(
        &self,
        operation: &'static str,
        query: Query,
        read: fn(&Columns<'_>) -> StoreResult<T>,
    ) -> StoreResult<T> {
        self.run(operation, async move |connection| {
            let row = query.fetch_one(connection).await.during(operation)?;
            read(&Columns::of(&row, operation))
        })
        .await
    }
}
