//! Changes of a run's state, and its end.
//! Uses: `core`, `journal`. Never: what a state means (`campaign` does).

use jiff::Timestamp;

use crate::core::columns::time_text;
use crate::core::statements::Query;
use crate::core::{Store, StoreError, StoreResult};
use crate::ids::RunUid;
use crate::journal::ExitStatus;
use crate::state::{PausedWhy, StateChange, StoredState};

impl Store {
    /// Marks the runs that an earlier process did not end as `interrupted`, except for `but`: nothing drives them any more
    /// without a person. Also those that [`Store::leave_open_runs`] leaves, since a stop by a person holds in the next
    /// process.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn interrupt_open_runs(&self, but: Option<RunUid>) -> StoreResult<()> {
        let query = sqlx::query(
            "UPDATE runs
             SET state = 'interrupted', requested_state = NULL, paused_why = 'restart'
             WHERE state NOT IN ('queued', 'interrupted', 'ended', 'removed')
                 AND uid IS NOT ?1",
        )
        .bind(but.map(|run| run.to_string()));
        self.inner.writer.execute("marking interrupted runs", query).await.map(drop)
    }

    /// Stores the state of a run, with the requested state and the cause of a pause. A run that ended
    /// short of its plan may be driven again: then it is open as before.
    ///
    /// # Errors
    /// `Refused` if the store itself sets this state; `NoSuchRun` or `RunEnded` if the run cannot
    /// change; `Sql` or `Closed` if the write fails.
    pub(crate) async fn set_run_state(
        &self,
        run: RunUid,
        change: StateChange,
        at: Timestamp,
    ) -> StoreResult<()> {
        const OPERATION: &str = "storing a run's state";
        if matches!(change.state, StoredState::Queued | StoredState::Ended | StoredState::Removed) {
            let limit =
                "must be a state of the engine (only the store sets queued, ended and removed)";
            return Err(StoreError::Refused { operation: OPERATION, field: "state", limit });
        }
        let query = sqlx::query(
            "UPDATE runs SET state = ?2, requested_state = ?3, paused_why = ?4,
                 queue_position = NULL, waiting_since = NULL,
                 started_at = coalesce(started_at, ?5),
                 exit_status = NULL, reason = NULL, ended_at = NULL
             WHERE uid = ?1 AND state <> 'removed' AND (state <> 'ended'
                 OR (?2 = 'running' AND kind <> 'imported' AND exit_status <> 'success'))",
        )
        .bind(run.to_string())
        .bind(change.state.as_str())
        .bind(change.requested.map(StoredState::as_str))
        .bind(change.why.map(PausedWhy::as_str))
        .bind(time_text(at));
        self.change_run(run, OPERATION, query).await
    }

    /// Stores the exit status of a run. A repetition with the same status changes nothing.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `RunEnded` if it was removed or has another status; `Sql`
    /// or `Closed` if the write fails.
    pub(crate) async fn finish_run(
        &self,
        run: RunUid,
        status: ExitStatus,
        reason: &str,
        at: Timestamp,
    ) -> StoreResult<()> {
        // The caller repeats the request if it does not know the outcome of the first.
        let query = sqlx::query(
            "UPDATE runs SET state = 'ended', requested_state = NULL, paused_why = NULL,
                 queue_position = NULL, waiting_since = NULL, exit_status = ?2,
                 reason = CASE WHEN state = 'ended' THEN reason ELSE ?3 END,
                 ended_at = coalesce(ended_at, ?4)
             WHERE uid = ?1 AND state <> 'removed'
               AND (exit_status IS NULL OR exit_status = ?2)",
        )
        .bind(run.to_string())
        .bind(status.as_str())
        .bind(reason.to_owned())
        .bind(time_text(at));
        self.change_run(run, "ending a run", query).await
    }

    async fn change_run(
        &self,
        run: RunUid,
        operation: &'static str,
        query: Query,
    ) -> StoreResult<()> {
        let writer = self.inner.writer.patient();
        if writer.execute(operation, query).await? > 0 {
            return Ok(());
        }
        // `NoSuchRun` if it is not stored.
        self.facts_by(&writer, run, operation).await?;
        Err(StoreError::RunEnded(run))
    }
}
