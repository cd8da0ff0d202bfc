//! A run over time: trials, forces, failed attempts and fits in bins of equal length.
//! Uses: `core`, `bench`. Never: what a bin means; a row for each trial.

use jiff::Timestamp;

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

/// Counts and extremes of the trials that were stored within a bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BinTrials {
    /// Index of the bin.
    pub bin: u32,
    /// Number of stored trials.
    pub trials: u32,
    /// Largest raw force, N; absent if none was measured.
    pub largest_force_n: Option<f64>,
}

/// What is stored of a run, by bin. Bins without an entry have no such record.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StoredHistory {
    /// Bins with trials, by the time of measurement.
    pub trials: Vec<BinTrials>,
    /// Number of failed attempts of each bin; discarded trials are not counted.
    pub attempts_failed: Vec<(u32, u32)>,
    /// Median FVU of the trials of each bin, by the newest model of each trial.
    pub median_fvu: Vec<(u32, f64)>,
}

/// Index of the bin of the time `$at`: ?2 is the start, ?3 the length, s, ?4 the last index.
macro_rules! bin_of {
    ($at:literal) => {
        concat!(
            "max(0, min(?4, CAST((julianday(",
            $at,
            ") - julianday(?2)) * 86400.0 / ?3 AS INTEGER)))"
        )
    };
}

const TRIALS: &str = concat!(
    "SELECT ",
    bin_of!("measured_at"),
    " AS bin, count(*), max(max_force_n) FROM trials
     WHERE run = ?1 AND measured_at IS NOT NULL GROUP BY bin ORDER BY bin"
);
const ATTEMPTS: &str = concat!(
    "SELECT ",
    bin_of!("at"),
    " AS bin, count(*) FROM attempts WHERE run = ?1 AND trial IS NULL GROUP BY bin ORDER BY bin"
);
// The median is the mean of the middle two values, which are one for an odd number.
const FITS: &str = concat!(
    "SELECT bin, avg(fvu) FROM (
         SELECT bin, fvu, row_number() OVER (PARTITION BY bin ORDER BY fvu) AS place,
             count(*) OVER (PARTITION BY bin) AS n
         FROM (SELECT ",
    bin_of!("t.measured_at"),
    " AS bin, w.fvu AS fvu
             FROM trials t
             JOIN twins w ON w.trial = t.id
                 AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
             WHERE t.run = ?1 AND t.measured_at IS NOT NULL AND w.fvu IS NOT NULL))
     WHERE place IN ((n + 1) / 2, (n + 2) / 2) GROUP BY bin ORDER BY bin"
);

impl Store {
    /// Returns the history of a run in bins.
    ///
    /// 198,000 trials with twins take about 0.5 s.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn history(&self, run: RunUid, bins: Bins) -> StoreResult<StoredHistory> {
        const OPERATION: &str = "reading a run's history";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let (from, last) = (time_text(bins.from), bins.count.saturating_sub(1));
        let trials: Vec<(u32, u32, Option<f64>)> = sqlx::query_as(TRIALS)
            .bind(scan_id)
            .bind(&from)
            .bind(bins.bin_s)
            .bind(last)
            .fetch_all(&mut *view)
            .await
            .during(OPERATION)?;
        let attempts_failed = sqlx::query_as(ATTEMPTS)
            .bind(scan_id)
            .bind(&from)
            .bind(bins.bin_s)
            .bind(last)
            .fetch_all(&mut *view)
            .await
            .during(OPERATION)?;
        let median_fvu = sqlx::query_as(FITS)
            .bind(scan_id)
            .bind(&from)
            .bind(bins.bin_s)
            .bind(last)
            .fetch_all(&mut *view)
            .await
            .during(OPERATION)?;
        let of = |(bin, trials, largest_force_n)| BinTrials { bin, trials, largest_force_n };
        let trials = trials.into_iter().map(of).collect();
        Ok(StoredHistory { trials, attempts_failed, median_fvu })
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
