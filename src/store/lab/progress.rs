//! Progress of a run by configuration: trials, forces, failed attempts, skips, and fits of the twins.
//! Uses: `core`. Never: the plan (the caller knows its order); a row for each trial.

use crate::core::{During, Store, StoreResult};
use crate::ids::RunUid;

/// The stored trials of one configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConfigurationTrials {
    /// Index of the configuration in the plan.
    pub configuration: u32,
    /// Number of stored trials.
    pub stored: u32,
    /// Largest raw force of its trials, N; absent if none was measured.
    pub largest_force_n: Option<f64>,
}

/// What is stored of a run, by the index of the configuration in its plan. Configurations without an
/// entry have no such record.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StoredProgress {
    /// Configurations with trials.
    pub trials: Vec<ConfigurationTrials>,
    /// Number of failed attempts of each configuration; discarded trials are not counted.
    pub attempts_failed: Vec<(u32, u32)>,
    /// Configurations that were given up.
    pub skipped: Vec<u32>,
    /// Median FVU of the trials of each configuration, by the newest model of each trial.
    pub median_fvu: Vec<(u32, f64)>,
}

impl Store {
    /// Returns the progress of a run by configuration.
    ///
    /// 198,000 trials with twins take about 0.3 s, nearly all of it for the medians.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn progress_by_configuration(&self, run: RunUid) -> StoreResult<StoredProgress> {
        const OPERATION: &str = "reading a run's progress by configuration";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let trials: Vec<(u32, u32, Option<f64>)> = sqlx::query_as(
            "SELECT configuration, count(*), max(max_force_n) FROM trials
             WHERE run = ?1 GROUP BY configuration",
        )
        .bind(scan_id)
        .fetch_all(&mut *view)
        .await
        .during(OPERATION)?;
        let attempts_failed = sqlx::query_as(
            "SELECT configuration, count(*) FROM attempts
             WHERE run = ?1 AND trial IS NULL GROUP BY configuration",
        )
        .bind(scan_id)
        .fetch_all(&mut *view)
        .await
        .during(OPERATION)?;
        let skipped =
            sqlx::query_scalar("SELECT configuration FROM skips WHERE run = ?1 ORDER BY 1")
                .bind(scan_id)
                .fetch_all(&mut *view)
                .await
                .during(OPERATION)?;
        // The median is the mean of the middle two values, which are one for an odd number.
        let median_fvu = sqlx::query_as(
            "SELECT configuration, avg(fvu) FROM (
                 SELECT t.configuration, w.fvu,
                     row_number() OVER (PARTITION BY t.configuration ORDER BY w.fvu) AS place,
                     count(*) OVER (PARTITION BY t.configuration) AS n
                 FROM trials t
                 JOIN twins w ON w.trial = t.id
                     AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
                 WHERE t.run = ?1 AND w.fvu IS NOT NULL)
             WHERE place IN ((n + 1) / 2, (n + 2) / 2) GROUP BY configuration",
        )
        .bind(scan_id)
        .fetch_all(&mut *view)
        .await
        .during(OPERATION)?;
        let of = |(configuration, stored, largest_force_n)| ConfigurationTrials {
            configuration,
            stored,
            largest_force_n,
        };
        let trials = trials.into_iter().map(of).collect();
        Ok(StoredProgress { trials, attempts_failed, skipped, median_fvu })
    }
}
