//! The placement of a run that was stored last, with the verdict with which it was confirmed.
//! Uses: `core`. Never: the verdict itself (the service makes it, an event keeps it).

use crate::core::columns::Columns;
use crate::core::{Store, StoreResult};
use crate::ids::{RunUid, TrialId};

/// A stored placement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LastPlaced {
    /// Index of the placement in the plan.
    pub trial: u32,
    /// Id of the trial.
    pub trial_id: TrialId,
    /// Verdict of its confirmation, as stored; absent if no event states it.
    pub verdict: Option<String>,
}

impl Store {
    /// Returns the placement of a run that was stored last; `None` before the first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn last_placed(&self, run: RunUid) -> StoreResult<Option<LastPlaced>> {
        const OPERATION: &str = "reading the last placement";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT t.id, t.configuration,
                 (SELECT e.data ->> '$.verdict' FROM events e
                  WHERE e.run = t.run AND e.kind = 'placed'
                      AND e.data ->> '$.trial' = t.configuration
                  ORDER BY e.seq DESC LIMIT 1) AS verdict
             FROM trials t WHERE t.run = ?1 AND t.placed_by IS NOT NULL
             ORDER BY t.id DESC LIMIT 1",
        )
        .bind(scan_id);
        let read = |c: &Columns<'_>| {
            let (trial, verdict) = (c.whole("configuration")?, c.get("verdict")?);
            Ok(LastPlaced { trial, trial_id: TrialId(c.get("id")?), verdict })
        };
        self.row(OPERATION, query, read).await
    }
}
