//! Progress of a run: stored keys, and counts of trials by contacts and by setting.
//! Uses: `core`, `journal`. Never: the plan (the caller knows which trials are missing).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::columns::{Columns, row};
use crate::core::{During, Store, StoreResult};
use crate::ids::{RunUid, TrialKey};
use crate::journal::Progress;

/// Stored trials of a run with one number of tips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SettingCount {
    /// Number of attached tips or placed contacts.
    pub tips: u8,
    /// Number of stored trials.
    pub stored: u64,
}

impl Store {
    /// Returns the stored and skipped parts of the plan of a run.
    pub(crate) async fn read_progress(&self, run: RunUid) -> StoreResult<Progress> {
        const OPERATION: &str = "reading a run's progress";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let stored: Vec<(u32, u32)> =
            sqlx::query_as("SELECT configuration, depth_index FROM trials WHERE run = ?1")
                .bind(scan_id)
                .fetch_all(&mut *view)
                .await
                .during(OPERATION)?;
        let skipped: Vec<u32> =
            sqlx::query_scalar("SELECT configuration FROM skips WHERE run = ?1")
                .bind(scan_id)
                .fetch_all(&mut *view)
                .await
                .during(OPERATION)?;
        let retries: i64 = sqlx::query_scalar("SELECT count(*) FROM attempts WHERE run = ?1")
            .bind(scan_id)
            .fetch_one(&mut *view)
            .await
            .during(OPERATION)?;
        let key = |(configuration, depth_index)| TrialKey { configuration, depth_index };
        Ok(Progress {
            stored: stored.into_iter().map(key).collect(),
            skipped: skipped.into_iter().collect(),
            retries: retries.unsigned_abs(),
        })
    }

    /// Returns the number of stored trials of a run with 0 to 6 contacts, by the deadband of the run.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn contact_counts(&self, run: RunUid) -> StoreResult<[u64; 7]> {
        const OPERATION: &str = "counting contacts";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT contact_count, count(*) AS trials FROM trials INDEXED BY trials_in_order
             WHERE run = ?1 GROUP BY contact_count",
        )
        .bind(scan_id);
        let row = |c: &Columns<'_>| Ok((c.whole("contact_count")?, c.whole("trials")?));
        let rows: Vec<(usize, u64)> = self.rows(OPERATION, query, row).await?;
        let mut counts = [0; 7];
        for (contacts, trials) in rows {
            if let Some(count) = counts.get_mut(contacts) {
                *count = trials;
            }
        }
        Ok(counts)
    }

    /// Returns the number of stored trials of a run by setting, in ascending order of tips.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn stored_per_setting(&self, run: RunUid) -> StoreResult<Vec<SettingCount>> {
        const OPERATION: &str = "counting trials by setting";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT tips, count(*) AS stored FROM trials INDEXED BY trials_in_order
             WHERE run = ?1 GROUP BY tips ORDER BY tips",
        )
        .bind(scan_id);
        let count = |c: &Columns<'_>| Ok(row!(c, SettingCount {}, whole: tips, stored));
        self.rows(OPERATION, query, count).await
    }
}
