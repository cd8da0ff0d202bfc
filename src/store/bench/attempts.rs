//! Failed attempts and skipped configurations of a run.
//! Uses: `record`, `core::writer`. Never: trials (an attempt that is not accepted must never count as
//! one).

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::columns::{Columns, row, time_text};
use crate::core::{Store, StoreResult};
use crate::ids::{RunUid, TrialKey};
use crate::record::AttemptRecord;

/// A configuration that was given up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SkipRow {
    /// Position of the configuration in the plan.
    pub configuration: u32,
    /// Reason of the skip.
    pub reason: String,
    /// Wall time of the skip.
    pub at: Timestamp,
}

impl Store {
    /// Stores a failed attempt. A repetition after a failure does not store it twice.
    pub(crate) async fn insert_attempt(
        &self,
        run: RunUid,
        attempt: &AttemptRecord,
    ) -> StoreResult<()> {
        const OPERATION: &str = "storing an attempt";
        let scan_id = self.facts_to_write(run, OPERATION).await?.scan_id;
        let insert = sqlx::query(
            "INSERT INTO attempts (run, configuration, depth_index, attempt, reason, at)
             SELECT ?1, ?2, ?3, ?4, ?5, ?6 WHERE NOT EXISTS (
               SELECT 1 FROM attempts
               WHERE id > (SELECT max(id) - 1000 FROM attempts) AND run = ?1
                 AND configuration = ?2 AND depth_index = ?3 AND attempt = ?4
                 AND reason = ?5 AND at = ?6 AND trial IS NULL)",
        )
        .bind(scan_id)
        .bind(attempt.key.configuration)
        .bind(attempt.key.depth_index)
        .bind(attempt.attempt)
        .bind(&attempt.reason)
        .bind(time_text(attempt.at));
        self.inner.writer.patient().execute(OPERATION, insert).await.map(drop)
    }

    /// Stores that a configuration was given up. A stored skip is not changed.
    pub(crate) async fn insert_skip(
        &self,
        run: RunUid,
        configuration: u32,
        reason: &str,
        at: Timestamp,
    ) -> StoreResult<()> {
        const OPERATION: &str = "storing a skip";
        let scan_id = self.facts_to_write(run, OPERATION).await?.scan_id;
        // A repetition keeps the first reason.
        let insert = sqlx::query(
            "INSERT INTO skips (run, configuration, reason, at) VALUES (?1, ?2, ?3, ?4)
             ON CONFLICT (run, configuration) DO NOTHING",
        )
        .bind(scan_id)
        .bind(configuration)
        .bind(reason)
        .bind(time_text(at));
        self.inner.writer.patient().execute(OPERATION, insert).await.map(drop)
    }

    /// Returns the skips of a run, in the order of its plan.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn skips(&self, run: RunUid) -> StoreResult<Vec<SkipRow>> {
        const OPERATION: &str = "reading skips";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query("SELECT * FROM skips WHERE run = ?1 ORDER BY configuration");
        let read =
            |c: &Columns<'_>| Ok(row!(c, SkipRow {}, whole: configuration; get: reason; time: at));
        self.rows(OPERATION, query.bind(scan_id), read).await
    }

    /// Returns at most `limit` failed attempts and discarded trials of a run, newest first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn attempts(&self, run: RunUid, limit: u32) -> StoreResult<Vec<AttemptRecord>> {
        const OPERATION: &str = "reading attempts";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT configuration, depth_index, attempt, reason, at FROM attempts
             WHERE run = ?1 ORDER BY id DESC LIMIT ?2",
        );
        let read = |c: &Columns<'_>| {
            let key = row!(c, TrialKey {}, whole: configuration, depth_index);
            Ok(row!(c, AttemptRecord { key }, whole: attempt; get: reason; time: at))
        };
        self.rows(OPERATION, query.bind(scan_id).bind(limit), read).await
    }
}
