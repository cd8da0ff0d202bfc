//! What is stored of a run, by configuration or in bins of time: trials, forces, failed attempts and fits of the twins;
//! and the times of its last records.
//! Uses: `core`. Never: the plan (the caller knows its order), what a bin means; a row for each trial.

use jiff::Timestamp;
use sqlx::sqlite::{Sqlite, SqliteConnection, SqliteRow};
use sqlx::{AssertSqlSafe, FromRow};

use crate::core::columns::time_text;
use crate::core::{During, Store, StoreResult};
use crate::ids::RunUid;

/// Bins of equal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bins {
    /// Start of the first bin.
    pub from: Timestamp,
    /// Length of a bin, s, above 0.
    pub bin_s: f64,
    /// Number of bins, at least 1. What was stored before the first or after the last bin counts in it.
    pub count: u32,
}

/// The stored trials of one configuration, or of one bin by the time of measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartTrials {
    /// Index of the configuration in the plan, or of the bin.
    pub part: u32,
    /// Number of stored trials.
    pub stored: u32,
    /// Largest raw force of its trials, N; absent if none was measured.
    pub largest_force_n: Option<f64>,
}

/// What is stored of a run, by configuration or bin. Parts without an entry have no such record.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StoredParts {
    /// Parts with trials.
    pub trials: Vec<PartTrials>,
    /// Number of failed attempts of each part; discarded trials are not counted.
    pub attempts_failed: Vec<(u32, u32)>,
    /// Configurations that were given up; empty for bins.
    pub skipped: Vec<u32>,
    /// Median FVU of the trials of each part, by the newest model of each trial.
    pub median_fvu: Vec<(u32, f64)>,
}

/// The statements on the parts of a run.
struct Parts {
    scan_id: i64,
    /// Bins of time; absent for configurations.
    bins: Option<Bins>,
    operation: &'static str,
}

impl Parts {
    /// The part of a record as SQL: its configuration, or the bin of its time `at`. ?2 is the start of the first bin,
    /// ?3 the length of a bin, s, ?4 the index of the last.
    fn of(&self, configuration: &str, at: &str) -> String {
        match self.bins {
            None => configuration.to_owned(),
            Some(_) => format!(
                "max(0, min(?4, CAST((julianday({at}) - julianday(?2)) * 86400.0 / ?3 AS INTEGER)))"
            ),
        }
    }

    async fn rows<T>(&self, view: &mut SqliteConnection, sql: String) -> StoreResult<Vec<T>>
    where
        T: for<'r> FromRow<'r, SqliteRow> + Send + Unpin,
    {
        let bins = self.bins;
        sqlx::query_as::<Sqlite, T>(AssertSqlSafe(sql))
            .bind(self.scan_id)
            .bind(bins.map(|bins| time_text(bins.from)))
            .bind(bins.map(|bins| bins.bin_s))
            .bind(bins.map(|bins| bins.count.saturating_sub(1)))
            .fetch_all(view)
            .await
            .during(self.operation)
    }

    async fn read(&self, view: &mut SqliteConnection) -> StoreResult<StoredParts> {
        let of_trial = self.of("t.configuration", "t.measured_at");
        let timed = if self.bins.is_some() { "AND t.measured_at IS NOT NULL" } else { "" };
        let sql = format!(
            "SELECT {of_trial} AS part, count(*), max(t.max_force_n) FROM trials t
             WHERE t.run = ?1 {timed} GROUP BY part ORDER BY part"
        );
        let trials: Vec<(u32, u32, Option<f64>)> = self.rows(view, sql).await?;
        let of_attempt = self.of("configuration", "at");
        let sql = format!(
            "SELECT {of_attempt} AS part, count(*) FROM attempts
             WHERE run = ?1 AND trial IS NULL GROUP BY part ORDER BY part"
        );
        let attempts_failed = self.rows(view, sql).await?;
        // The median is the mean of the middle two values, which are one for an odd number.
        let sql = format!(
            "SELECT part, avg(fvu) FROM (
                 SELECT part, fvu, row_number() OVER (PARTITION BY part ORDER BY fvu) AS place,
                     count(*) OVER (PARTITION BY part) AS n
                 FROM (SELECT {of_trial} AS part, w.fvu AS fvu
                     FROM trials t
                     JOIN twins w ON w.trial = t.id
                         AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
                     WHERE t.run = ?1 {timed} AND w.fvu IS NOT NULL))
             WHERE place IN ((n + 1) / 2, (n + 2) / 2) GROUP BY part ORDER BY part"
        );
        let median_fvu = self.rows(view, sql).await?;
        let of = |(part, stored, largest_force_n)| PartTrials { part, stored, largest_force_n };
        let trials = trials.into_iter().map(of).collect();
        Ok(StoredParts { trials, attempts_failed, skipped: Vec::new(), median_fvu })
    }
}

impl Store {
    /// Returns the progress of a run by configuration.
    ///
    /// 198,000 trials with twins take about 0.3 s, nearly all of it for the medians.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn progress_by_configuration(&self, run: RunUid) -> StoreResult<StoredParts> {
        const OPERATION: &str = "reading a run's progress by configuration";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let parts = Parts { scan_id, bins: None, operation: OPERATION };
        let read = parts.read(&mut view).await?;
        let skipped =
            sqlx::query_scalar("SELECT configuration FROM skips WHERE run = ?1 ORDER BY 1")
                .bind(scan_id)
                .fetch_all(&mut *view)
                .await
                .during(OPERATION)?;
        Ok(StoredParts { skipped, ..read })
    }

    /// Returns the history of a run in bins.
    ///
    /// 198,000 trials with twins take about 0.5 s.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn history(&self, run: RunUid, bins: Bins) -> StoreResult<StoredParts> {
        const OPERATION: &str = "reading a run's history";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let parts = Parts { scan_id, bins: Some(bins), operation: OPERATION };
        parts.read(&mut *self.read(OPERATION).await?).await
    }

    /// Returns the time of measurement of the newest durable trial of a run; `None` without trials.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn last_trial_at(&self, run: RunUid) -> StoreResult<Option<Timestamp>> {
        const OPERATION: &str = "reading the time of the last trial";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT measured_at FROM trials INDEXED BY trials_in_order
             WHERE run = ?1 ORDER BY id DESC LIMIT 1",
        )
        .bind(scan_id);
        Ok(self.row(OPERATION, query, |c| c.time_or_none("measured_at")).await?.flatten())
    }

    /// Returns the time of the last record of a run, a trial or an event, before a time; `None` without
    /// one.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn last_record_before(
        &self,
        run: RunUid,
        before: Timestamp,
    ) -> StoreResult<Option<Timestamp>> {
        const OPERATION: &str = "reading the time of the last record of a run";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT max(at) AS at FROM (
                 SELECT max(measured_at) AS at FROM trials WHERE run = ?1 AND measured_at < ?2
                 UNION ALL SELECT max(at) FROM events WHERE run = ?1 AND at < ?2)",
        )
        .bind(scan_id)
        .bind(time_text(before));
        Ok(self.row(OPERATION, query, |c| c.time_or_none("at")).await?.flatten())
    }
}
