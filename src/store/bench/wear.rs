//! The wear of skin and axes by a run, and the stored trials in which the skin was untouched.
//! Uses: `core`, `table`. Never: which runs wore the same skin (the caller knows).

use jiff::Timestamp;

use crate::core::columns::Columns;
use crate::core::{During, Store, StoreResult};
use crate::ids::{RunUid, TrialId};
use crate::table::pages::id;

/// Wear by the stored trials of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StoredWear {
    /// Time of the first trial; absent without one.
    pub since: Option<Timestamp>,
    /// Number of stored trials.
    pub trials: u64,
    /// Positions of tips or weights, skin coordinates, mm, with the number of configurations in which
    /// one pressed there: a configuration presses once, deeper with each trial.
    pub points: Vec<PressedPoint>,
    /// Travel of x, y, z, mm, and of the radius of the arms, mm: the sum of the distances between the
    /// poses of trials that were stored one after the other. What an axis travelled in between is
    /// unknown.
    pub travel_mm: [f64; 4],
}

/// A position with the number of presses there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PressedPoint {
    /// x, skin coordinates, mm.
    pub x_mm: f64,
    /// y, skin coordinates, mm.
    pub y_mm: f64,
    /// Number of presses.
    pub presses: u64,
}

impl Store {
    /// Returns the wear by a run.
    ///
    /// 198,000 trials take about 0.4 s, nearly all of it for the travel.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn wear(&self, run: RunUid) -> StoreResult<StoredWear> {
        const OPERATION: &str = "reading the wear by a run";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let trials: i64 = sqlx::query_scalar("SELECT count(*) FROM trials WHERE run = ?1")
            .bind(scan_id)
            .fetch_one(&mut *view)
            .await
            .during(OPERATION)?;
        let first = sqlx::query(
            "SELECT measured_at FROM trials INDEXED BY trials_in_order
             WHERE run = ?1 ORDER BY id LIMIT 1",
        )
        .bind(scan_id)
        .fetch_optional(&mut *view)
        .await
        .during(OPERATION)?;
        // All trials of a configuration have the same positions: one of them is enough.
        let points: Vec<(f64, f64, i64)> = sqlx::query_as(
            "WITH pressed AS (
                 SELECT min(id) AS trial FROM trials WHERE run = ?1 GROUP BY configuration)
             SELECT x_mm, y_mm, count(*) FROM (
                 SELECT t.x_mm, t.y_mm FROM pressed p JOIN trial_tips t ON t.trial = p.trial
                 UNION ALL
                 SELECT c.x_mm, c.y_mm FROM pressed p JOIN placed_contacts c ON c.trial = p.trial
                 WHERE c.x_mm IS NOT NULL AND c.y_mm IS NOT NULL)
             GROUP BY x_mm, y_mm",
        )
        .bind(scan_id)
        .fetch_all(&mut *view)
        .await
        .during(OPERATION)?;
        let (x, y, z, radius): (f64, f64, f64, f64) = sqlx::query_as(
            "SELECT total(abs(x)), total(abs(y)), total(abs(z)), total(abs(radius)) FROM (
                 SELECT reached_x_mm - lag(reached_x_mm) OVER before AS x,
                     reached_y_mm - lag(reached_y_mm) OVER before AS y,
                     reached_z_mm - lag(reached_z_mm) OVER before AS z,
                     reached_radius_mm - lag(reached_radius_mm) OVER before AS radius
                 FROM trials WHERE run = ?1 AND reached_x_mm IS NOT NULL
                 WINDOW before AS (ORDER BY id))",
        )
        .bind(scan_id)
        .fetch_one(&mut *view)
        .await
        .during(OPERATION)?;
        let since = first
            .map_or(Ok(None), |row| Columns::of(&row, OPERATION).time_or_none("measured_at"))?;
        let point = |(x_mm, y_mm, presses): (f64, f64, i64)| PressedPoint {
            x_mm,
            y_mm,
            presses: presses.unsigned_abs(),
        };
        Ok(StoredWear {
            since,
            trials: trials.unsigned_abs(),
            points: points.into_iter().map(point).collect(),
            travel_mm: [x, y, z, radius],
        })
    }

    /// Returns the newest trials of a run without a contact and without a force above `below_n`, N, at
    /// most `limit`, newest first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn untouched_trials(
        &self,
        run: RunUid,
        below_n: f64,
        limit: u32,
    ) -> StoreResult<Vec<TrialId>> {
        const OPERATION: &str = "reading untouched trials";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT id FROM trials WHERE run = ?1 AND contact_count = 0 AND max_force_n <= ?2
             ORDER BY id DESC LIMIT ?3",
        )
        .bind(scan_id)
        .bind(below_n)
        .bind(limit);
        self.rows(OPERATION, query, id).await
    }
}
