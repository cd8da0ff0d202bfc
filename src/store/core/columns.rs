//! Encoding of values in columns (times, ids, words, arrays of numbers), and their decoding.
//! Uses: `core::error`. Never: statements.

use std::cell::Cell;

use jiff::Timestamp;
use rusqlite::types::{FromSql, FromSqlError, ValueRef};
use serde::de::IntoDeserializer;
use serde::de::value::StrDeserializer;
use sqlx::Row;
use sqlx::sqlite::{Sqlite, SqliteRow};

use super::error::{During, StoreError, StoreResult};

/// Returns a time as it is stored: RFC 3339, UTC, truncated to milliseconds.
pub(crate) fn time_text(at: Timestamp) -> String {
    format!("{at:.3}")
}

/// Returns the counts of a frame as they are stored: little-endian i16.
pub(crate) fn counts_blob(counts: &[i16]) -> Vec<u8> {
    counts.iter().flat_map(|c| c.to_le_bytes()).collect()
}

/// Returns voltages as they are stored: V, little-endian f32.
pub(crate) fn volts_blob(volts: &[f32]) -> Vec<u8> {
    volts.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A row with the operation that reads it. Every method returns `StoreError::Sql` or `Read` if the column
/// is missing or has another type, and `StoreError::Unreadable` if its value cannot be decoded.
pub(crate) struct Columns<'r> {
    row: Source<'r>,
    operation: &'static str,
}

/// A row of either reader.
enum Source<'r> {
    /// A copy of the row.
    Copied(&'r SqliteRow),
    /// A row inside SQLite, until its statement steps to the next.
    Lent(&'r rusqlite::Row<'r>, &'r Names),
}

/// The names of the columns of a statement. Each row is read in the same order, so that the column that is
/// read after another is found where it was found before, mostly without comparing letters.
pub(crate) struct Names {
    names: Vec<String>,
    /// For each column the one that was read after it: its name as the reader states it, and its place.
    followers: Vec<Cell<(&'static str, usize)>>,
    /// Place of the column that was read last.
    last: Cell<usize>,
}

impl Names {
    /// The names of the columns of this statement.
    pub(crate) fn of(statement: &rusqlite::Statement<'_>) -> Self {
        let names: Vec<String> = statement.column_names().into_iter().map(str::to_owned).collect();
        let followers = (1..=names.len()).map(|place| Cell::new(("", place))).collect();
        Self { names, followers, last: Cell::new(0) }
    }

    fn position(&self, column: &'static str) -> Option<usize> {
        let last = self.last.get();
        let follower = self.followers.get(last)?;
        let (name, place) = follower.get();
        if std::ptr::eq(name, column) {
            self.last.set(place);
            return Some(place);
        }
        let is_there = |place: &usize| self.names.get(*place).is_some_and(|name| name == column);
        let found = [place, last].into_iter().find(is_there);
        let found = found.or_else(|| self.names.iter().position(|name| name == column))?;
        if found != last {
            follower.set((column, found));
        }
        self.last.set(found);
        Some(found)
    }
}

/// A type that a column may have.
pub(crate) trait Value<'r>: sqlx::Decode<'r, Sqlite> + sqlx::Type<Sqlite> {
    /// Returns the value.
    fn of(value: ValueRef<'r>) -> Result<Self, FromSqlError>;
}

macro_rules! owned {
    ($($kind:ty),*) => {$(
        impl Value<'_> for $kind {
            fn of(value: ValueRef<'_>) -> Result<Self, FromSqlError> {
                FromSql::column_result(value)
            }
        }
    )*};
}

owned!(bool, u16, i64, f32, f64, String, Vec<u8>);

impl<'r> Value<'r> for &'r str {
    fn of(value: ValueRef<'r>) -> Result<Self, FromSqlError> {
        value.as_str()
    }
}

impl<'r> Value<'r> for &'r [u8] {
    fn of(value: ValueRef<'r>) -> Result<Self, FromSqlError> {
        value.as_blob()
    }
}

impl<'r, T: Value<'r>> Value<'r> for Option<T> {
    fn of(value: ValueRef<'r>) -> Result<Self, FromSqlError> {
        if value == ValueRef::Null { Ok(None) } else { T::of(value).map(Some) }
    }
}

impl<'r> Columns<'r> {
    /// Wraps `row`; errors name `operation`.
    pub(crate) fn of(row: &'r SqliteRow, operation: &'static str) -> Self {
        Self { row: Source::Copied(row), operation }
    }

    /// Wraps a row of a statement with these columns; errors name `operation`.
    pub(crate) fn lent(
        row: &'r rusqlite::Row<'r>,
        names: &'r Names,
        operation: &'static str,
    ) -> Self {
        Self { row: Source::Lent(row, names), operation }
    }

    /// Whether the query selected this column.
    pub(crate) fn has(&self, column: &'static str) -> bool {
        match self.row {
            Source::Copied(row) => row.try_column(column).is_ok(),
            Source::Lent(_, names) => names.position(column).is_some(),
        }
    }

    pub(crate) fn get<T: Value<'r>>(&self, column: &'static str) -> StoreResult<T> {
        match self.row {
            Source::Copied(row) => row.try_get(column).during(self.operation),
            Source::Lent(row, names) => {
                let place = names.position(column);
                let place = place.ok_or_else(|| rusqlite::Error::InvalidColumnName(column.into()));
                let read = place.and_then(|place| row.get_ref(place)).and_then(|value| {
                    T::of(value).map_err(|_| {
                        rusqlite::Error::InvalidColumnType(0, column.into(), value.data_type())
                    })
                });
                read.during(self.operation)
            }
        }
    }

    /// Returns an integer that was stored from a narrower or unsigned type.
    pub(crate) fn whole<T: TryFrom<i64>>(&self, column: &'static str) -> StoreResult<T> {
        let value: i64 = self.get(column)?;
        T::try_from(value).map_err(|_| self.unreadable(column, value))
    }

    /// Returns such an integer; `None` for NULL.
    pub(crate) fn whole_or_none<T: TryFrom<i64>>(
        &self,
        column: &'static str,
    ) -> StoreResult<Option<T>> {
        let Some(value) = self.get::<Option<i64>>(column)? else { return Ok(None) };
        T::try_from(value).map(Some).map_err(|_| self.unreadable(column, value))
    }

    pub(crate) fn time(&self, column: &'static str) -> StoreResult<Timestamp> {
        let text: &str = self.get(column)?;
        text.parse().map_err(|_| self.unreadable(column, text))
    }

    /// Returns a time; `None` for NULL.
    pub(crate) fn time_or_none(&self, column: &'static str) -> StoreResult<Option<Timestamp>> {
        Ok(self.time_and_text(column)?.map(|(time, _)| time))
    }

    /// Returns a time and its text as it is stored; `None` for NULL.
    pub(crate) fn time_and_text(
        &self,
        column: &'static str,
    ) -> StoreResult<Option<(Timestamp, &'r str)>> {
        let Some(text) = self.get::<Option<&'r str>>(column)? else { return Ok(None) };
        let time: Timestamp = text.parse().map_err(|_| self.unreadable(column, text))?;
        Ok(Some((time, text)))
    }

    /// Returns a value that is stored as JSON.
    pub(crate) fn json<T: serde::de::DeserializeOwned>(
        &self,
        column: &'static str,
    ) -> StoreResult<T> {
        let text: &str = self.get(column)?;
        serde_json::from_str(text).map_err(|_| self.unreadable(column, text))
    }

    /// Returns a value of an enum that is stored as its serde name, or an id that is stored as its text.
    pub(crate) fn word<T: serde::de::DeserializeOwned>(
        &self,
        column: &'static str,
    ) -> StoreResult<T> {
        let text: &str = self.get(column)?;
        word(text).ok_or_else(|| self.unreadable(column, text))
    }

    /// Like `word`; `None` for NULL.
    pub(crate) fn word_or_none<T: serde::de::DeserializeOwned>(
        &self,
        column: &'static str,
    ) -> StoreResult<Option<T>> {
        self.get::<Option<&str>>(column)?.map(|_| self.word(column)).transpose()
    }

    /// Returns the counts of a frame, injection-major.
    pub(crate) fn counts(&self, column: &'static str) -> StoreResult<Vec<i16>> {
        self.numbers(column, self.get(column)?, i16::from_le_bytes)
    }

    /// Returns the voltages, V, injection-major, that a column holds as `bytes`.
    pub(crate) fn volts(&self, column: &'static str, bytes: &[u8]) -> StoreResult<Vec<f32>> {
        self.numbers(column, bytes, f32::from_le_bytes)
    }

    /// Returns the numbers that a column holds as `bytes`, `N` of each.
    fn numbers<T, const N: usize>(
        &self,
        column: &'static str,
        bytes: &[u8],
        number: impl Fn([u8; N]) -> T,
    ) -> StoreResult<Vec<T>> {
        match bytes.as_chunks() {
            (values, []) => Ok(values.iter().map(|bytes| number(*bytes)).collect()),
            _ => Err(self.unreadable(column, format!("{} bytes", bytes.len()))),
        }
    }

    /// Returns the error for a value that cannot be decoded.
    fn unreadable(&self, column: &'static str, value: impl std::fmt::Display) -> StoreError {
        StoreError::Unreadable { operation: self.operation, column, value: value.to_string() }
    }
}

/// Returns a struct whose fields are the columns of their names: `row!(c, Name { stated }, method: fields; ..)`. The
/// method of [`Columns`] before a colon reads the fields after it; all others are stated in the braces.
macro_rules! row {
    ($c:ident, $row:ident { $($stated:tt)* }, $($read:ident: $($field:ident),+);+) => {
        $row { $($($field: $c.$read(stringify!($field))?,)+)+ $($stated)* }
    };
}
pub(crate) use row;

/// Returns the value of an enum from its serde name; `None` for another word.
pub(crate) fn word<T: serde::de::DeserializeOwned>(text: &str) -> Option<T> {
    let word: StrDeserializer<'_, serde::de::value::Error> = text.into_deserializer();
    T::deserialize(word).ok()
}
