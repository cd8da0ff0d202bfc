//! How far a run has come: stored keys, trials by contacts and by setting.
//! Uses: `store`, `journal`. Never: the plan (who asks knows what is missing).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::facts::RunKind;
use crate::core::{During, Store, StoreError};
use crate::ids::{RunUid, TrialKey};
use crate::journal::Progress;

/// Stored trials of one setting (tip count) of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SettingCount {
    /// Attached tips, or placed contacts.
    pub tips: u8,
    /// Stored trials.
    pub stored: u64,
}

impl Store {
    pub(crate) async fn read_progress(&self, run: RunUid) -> Result<Progress, StoreError> {
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

    /// Stored trials of a run by their number of contacts, 0 to 6, as labelled with its deadband.
    pub async fn contact_counts(&self, run: RunUid) -> Result<[u64; 7], StoreError> {
        const OPERATION: &str = "counting contacts";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let rows = sqlx::query_as(
            "SELECT contact_count, count(*) FROM trials INDEXED BY trials_in_order
             WHERE run = ?1 GROUP BY contact_count",
        )
        .bind(scan_id)
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        Ok(by_count(rows))
    }

    /// The same as another deadband would label them, from the raw forces.
    pub async fn contact_counts_at(
        &self,
        run: RunUid,
        deadband_n: f64,
    ) -> Result<[u64; 7], StoreError> {
        const OPERATION: &str = "counting contacts";
        let facts = self.facts(run, OPERATION).await?;
        if facts.kind == RunKind::RealRandom {
            // Nominal contacts have no deadband.
            return self.contact_counts(run).await;
        }
        let rows = sqlx::query_as(
            "SELECT contacts, count(*) FROM (
                 SELECT count(CASE WHEN p.force_n >= ?2 THEN 1 END) AS contacts
                 FROM trials t LEFT JOIN trial_tips p ON p.trial = t.id
                 WHERE t.run = ?1 GROUP BY t.id)
             GROUP BY contacts",
        )
        .bind(facts.scan_id)
        .bind(deadband_n)
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        Ok(by_count(rows))
    }

    /// Stored trials of a run by setting, fewest tips first.
    pub async fn stored_per_setting(&self, run: RunUid) -> Result<Vec<SettingCount>, StoreError> {
        const OPERATION: &str = "counting trials by setting";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let rows: Vec<(u8, i64)> = sqlx::query_as(
            "SELECT tips, count(*) FROM trials INDEXED BY trials_in_order
             WHERE run = ?1 GROUP BY tips ORDER BY tips",
        )
        .bind(scan_id)
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        let row = |(tips, stored): (u8, i64)| SettingCount { tips, stored: stored.unsigned_abs() };
        Ok(rows.into_iter().map(row).collect())
    }
}

fn by_count(rows: Vec<(i64, i64)>) -> [u64; 7] {
    let mut counts = [0; 7];
    for (contacts, trials) in rows {
        if let Some(count) = usize::try_from(contacts).ok().and_then(|n| counts.get_mut(n)) {
            *count += trials.unsigned_abs();
        }
    }
    counts
}
