//! Depth and largest force of each trial of a run.
//! Uses: `core`. Never: a statistic of them.

use crate::core::columns::{Columns, row};
use crate::core::{Store, StoreResult};
use crate::ids::RunUid;

/// Depth and largest force of a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthForce {
    /// Number of tips.
    pub tips: u8,
    /// Planned depth, mm.
    pub depth_mm: f64,
    /// Largest force, N.
    pub force_n: f64,
}

impl Store {
    /// Returns depth and largest force of each trial of a run that has both.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn forces_over_depth(&self, run: RunUid) -> StoreResult<Vec<DepthForce>> {
        const OPERATION: &str = "reading the forces of a run";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT tips, depth_mm, max_force_n FROM trials
             WHERE run = ?1 AND depth_mm IS NOT NULL AND max_force_n IS NOT NULL",
        )
        .bind(scan_id);
        let force = |c: &Columns<'_>| {
            let force_n = c.get("max_force_n")?;
            Ok(row!(c, DepthForce { force_n }, whole: tips; get: depth_mm))
        };
        self.rows(OPERATION, query, force).await
    }
}
