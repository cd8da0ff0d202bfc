//! A trial that is taken back: moved to the attempts, with its raw frames.
//! Uses: `core`, `table`. Never: a reason of its own (`campaign` gives it).

use sqlx::sqlite::SqliteConnection;

use super::trials::id_of_key;
use crate::core::{During, Store, StoreError};
use crate::ids::{RunUid, TrialKey};
use crate::table::assemble::row_of_key;
use crate::table::trial_row::TrialRow;

const TAKING_BACK: &str = "taking a trial back";

impl Store {
    /// Moves a trial to the attempts: its row as JSON, its raw frames as they are.
    pub(crate) async fn take_back(
        &self,
        run: RunUid,
        key: TrialKey,
        reason: &str,
    ) -> Result<(), StoreError> {
        let scan_id = self.facts_to_write(run, TAKING_BACK).await?.scan_id;
        let (reason, now) = (reason.to_owned(), self.now_text());
        self.inner
            .writer
            .patient()
            .run_and_settle(
                TAKING_BACK,
                async move |connection| {
                    let row = row_of_key(connection, scan_id, key, TAKING_BACK).await?;
                    let row = row.ok_or(StoreError::NoSuchTrial { run, key })?;
                    let record = serde_json::to_string(&row).map_err(|e| {
                        let value = e.to_string();
                        StoreError::Unreadable { operation: TAKING_BACK, column: "record", value }
                    })?;
                    move_to_attempts(connection, scan_id, &row, record, reason, now).await
                },
                async move |connection| {
                    let stored = id_of_key(connection, scan_id, key, TAKING_BACK).await?;
                    Ok(stored.is_none().then_some(()))
                },
            )
            .await
    }
}

async fn move_to_attempts(
    connection: &mut SqliteConnection,
    scan_id: i64,
    row: &TrialRow,
    record: String,
    reason: String,
    now: String,
) -> Result<(), StoreError> {
    let attempt: i64 = sqlx::query_scalar(
        "INSERT INTO attempts (run, configuration, depth_index, attempt, reason, at, trial, record)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8) RETURNING id",
    )
    .bind(scan_id)
    .bind(row.configuration)
    .bind(row.depth_index)
    .bind(row.attempt)
    .bind(reason)
    .bind(now)
    .bind(row.trial_id.0)
    .bind(record)
    .fetch_one(&mut *connection)
    .await
    .during(TAKING_BACK)?;
    sqlx::query(
        "INSERT INTO attempt_frames
             (attempt, n, sequence, device_time_us, volts_per_count, counts, crc32)
         SELECT ?1, n, sequence, device_time_us, volts_per_count, counts, crc32
         FROM frames WHERE trial = ?2",
    )
    .bind(attempt)
    .bind(row.trial_id.0)
    .execute(&mut *connection)
    .await
    .during(TAKING_BACK)?;
    sqlx::query("DELETE FROM trials WHERE id = ?1")
        .bind(row.trial_id.0)
        .execute(&mut *connection)
        .await
        .during(TAKING_BACK)?;
    Ok(())
}
