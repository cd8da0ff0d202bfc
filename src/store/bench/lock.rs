//! The operator lock, which prevents starting and editing but never stopping.
//! Uses: `core`. Never: the rig lock, the file with which one process holds the rig.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteConnection;
use utoipa::ToSchema;

use crate::core::columns::{Columns, row};
use crate::core::keys::{KEYLESS, KEYLESS_SUFFIX};
use crate::core::{During, Store, StoreError, StoreResult};
use crate::plain::violated;

/// Longest name of a holder, with the mark of one without a key.
const HOLDER_MAX_CHARS: usize = 120;
/// Longest note of the operator lock, characters.
const NOTE_MAX_CHARS: usize = 500;

/// The operator lock while a person holds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LockRow {
    /// Name of the holder.
    pub holder: String,
    /// Note of the holder.
    pub note: String,
    /// Wall time at which it was taken; not before what it holds up, if the clock was set back.
    pub since: Timestamp,
}

/// What a lock must hold up is not later than it, although the wall clock was set back: starts that wait, and the
/// beginnings and last trials of open runs.
const NEWEST_HELD_UP: &str = "SELECT max(at) FROM (
    SELECT waiting_since AS at FROM runs
    UNION ALL SELECT started_at FROM runs WHERE state NOT IN ('queued', 'ended', 'removed')
    UNION ALL SELECT (SELECT measured_at FROM trials INDEXED BY trials_in_order
            WHERE run = runs.scan_id ORDER BY id DESC LIMIT 1)
        FROM runs WHERE state NOT IN ('queued', 'ended', 'removed'))";

/// The lock; no row if it is free.
const HELD: &str = "SELECT * FROM operator_lock";

impl LockRow {
    /// Whether the lock was taken without a key.
    pub fn is_keyless(&self) -> bool {
        self.holder == KEYLESS || self.holder.ends_with(KEYLESS_SUFFIX)
    }

    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        Ok(row!(c, Self {}, get: holder, note; time: since))
    }
}

impl Store {
    /// Takes the lock, or changes the note if `holder` already holds it.
    ///
    /// # Errors
    /// `Refused` if holder or note is too long or has control characters; `LockHeld` if another person
    /// holds it; `Sql`, `Late` or `Closed` if the write fails.
    pub async fn set_lock(&self, holder: &str, note: &str) -> StoreResult<LockRow> {
        const OPERATION: &str = "taking the operator lock";
        for (text, max_chars) in [(holder, HOLDER_MAX_CHARS), (note, NOTE_MAX_CHARS)] {
            if violated(text, max_chars).is_some() {
                let limit = "must be short (a name 120, a note 500 characters) and without control characters";
                let field = "holder or note";
                return Err(StoreError::Refused { operation: OPERATION, field, limit });
            }
        }
        let (holder, note, now) = (holder.to_owned(), note.to_owned(), self.now_text());
        self.write(OPERATION, async move |connection| {
            if let Some(held) = held(connection, OPERATION).await?
                && held.holder != holder
            {
                return Err(StoreError::LockHeld { holder: held.holder, note: held.note });
            }
            let newest: Option<String> = sqlx::query_scalar(NEWEST_HELD_UP)
                .fetch_one(&mut *connection)
                .await
                .during(OPERATION)?;
            let since = newest.filter(|newest| *newest > now).unwrap_or(now);
            let row = sqlx::query(
                "INSERT INTO operator_lock (id, holder, note, since) VALUES (1, ?1, ?2, ?3)
                 ON CONFLICT (id) DO UPDATE SET note = ?2, since = ?3
                 RETURNING *",
            )
            .bind(holder)
            .bind(note)
            .bind(since)
            .fetch_one(connection)
            .await
            .during(OPERATION)?;
            LockRow::read(&Columns::of(&row, OPERATION))
        })
        .await
    }

    /// Removes the lock of any holder (the caller checks the rights). Returns the removed lock.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn clear_lock(&self) -> StoreResult<Option<LockRow>> {
        const OPERATION: &str = "releasing the operator lock";
        self.write(OPERATION, async move |connection| {
            let was = held(connection, OPERATION).await?;
            sqlx::query("DELETE FROM operator_lock").execute(connection).await.during(OPERATION)?;
            Ok(was)
        })
        .await
    }

    /// Returns the lock; `None` if it is free.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn lock(&self) -> StoreResult<Option<LockRow>> {
        self.row("reading the operator lock", sqlx::query(HELD), LockRow::read).await
    }

    /// Returns who took the lock after a time, with the note; `None` if it was not taken.
    pub(crate) async fn taken_since(&self, at: Timestamp) -> StoreResult<Option<String>> {
        let lock = self.lock().await?.filter(|lock| lock.since > at);
        Ok(lock.map(|lock| format!("{}: {}", lock.holder, lock.note)))
    }
}

/// Returns the lock; `None` if it is free.
async fn held(
    connection: &mut SqliteConnection,
    operation: &'static str,
) -> StoreResult<Option<LockRow>> {
    let row = sqlx::query(HELD).fetch_optional(connection).await.during(operation)?;
    row.map(|row| LockRow::read(&Columns::of(&row, operation))).transpose()
}
