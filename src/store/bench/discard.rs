//! Discarding a stored trial: it is moved to the attempts, with its raw frames.
//! Uses: `core::{writer, bulk}`, `table::assemble`. Never: a decision to discard one (`campaign` makes it).

use rusqlite::Connection;
use sqlx::sqlite::SqliteConnection;

use super::trials::id_of_key;
use crate::core::bulk::Statement;
use crate::core::{During, Store, StoreError, StoreResult};
use crate::ids::{RunUid, TrialKey};
use crate::table::assemble::rows_of_ids;
use crate::table::pages::id;
use crate::table::query::SELECT_WITH_VOLTAGES;
use crate::table::trial_row::TrialRow;

const DISCARDING: &str = "discarding a trial";

impl Store {
    /// Moves a trial to the attempts: its row as JSON, its raw frames unchanged. A twin that is stored
    /// between reading and moving is not in the record; it can be computed again.
    ///
    /// # Errors
    /// `NoSuchTrial` if the run has no trial with this key; `NoSuchRun` if the run is not stored;
    /// `Damaged` if the trial differs from its checksum; `NotStored` if the commit failed and the trial
    /// is still stored; `Sql`, `Read`, `Unreadable` or `Closed` if the
    /// database fails.
    pub(crate) async fn discard_trial(
        &self,
        run: RunUid,
        key: TrialKey,
        reason: &str,
    ) -> StoreResult<()> {
        let scan_id = self.facts_to_write(run, DISCARDING).await?.scan_id;
        let (reason, now) = (reason.to_owned(), self.now_text());
        let read = move |c: &Connection| {
            let mut of_key = Statement::new("SELECT id FROM trials WHERE run = ");
            of_key.bind(scan_id).push(" AND configuration = ").bind(key.configuration);
            of_key.push(" AND depth_index = ").bind(key.depth_index);
            let ids = of_key.rows(c, DISCARDING, id)?;
            Ok(rows_of_ids(c, SELECT_WITH_VOLTAGES, &ids, DISCARDING)?.pop())
        };
        let row = self.inner.bulk.read_apart(DISCARDING, read).await?;
        let row = row.ok_or(StoreError::NoSuchTrial { run, key })?;
        let record = serde_json::to_string(&row).map_err(|e| {
            let value = e.to_string();
            StoreError::Unreadable { operation: DISCARDING, column: "record", value }
        })?;
        self.inner
            .writer
            .patient()
            .run_and_settle(
                DISCARDING,
                async move |connection| {
                    // Another caller may have discarded it since it was read.
                    let stored = id_of_key(connection, scan_id, key, DISCARDING).await?;
                    if stored != Some(row.trial_id) {
                        return Err(StoreError::NoSuchTrial { run, key });
                    }
                    move_to_attempts(connection, scan_id, &row, record, reason, now).await
                },
                async move |connection| {
                    let stored = id_of_key(connection, scan_id, key, DISCARDING).await?;
                    Ok(stored.is_none().then_some(()))
                },
            )
            .await?;
        self.count_change(scan_id);
        Ok(())
    }
}

/// Inserts the attempt, copies the frames, and deletes the trial.
async fn move_to_attempts(
    connection: &mut SqliteConnection,
    scan_id: i64,
    row: &TrialRow,
    record: String,
    reason: String,
    now: String,
) -> StoreResult<()> {
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
    .during(DISCARDING)?;
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
    .during(DISCARDING)?;
    sqlx::query("DELETE FROM trials WHERE id = ?1")
        .bind(row.trial_id.0)
        .execute(&mut *connection)
        .await
        .during(DISCARDING)?;
    Ok(())
}
