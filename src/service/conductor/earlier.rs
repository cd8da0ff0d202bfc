//! The runs that the earlier process left open or waiting: read from the store, and decided by `restart`.
//! Uses: `conductor::restart`, `store`. Never: motion, HTTP.

use std::time::Duration;

use jiff::Timestamp;

use super::restart::{AutoResume, TakenOver};
use super::{Conductor, ConductorResult};
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::store::StoreResult;

/// Number of attempts to read what the earlier process left, and to reach the rig, and the pause before the second;
/// it doubles.
pub(super) const RESTART_TRIES: u32 = 8;
pub(super) const RESTART_PAUSE: Duration = Duration::from_secs(1);

impl Conductor {
    /// Decides on the runs of the earlier process, and marks its other open runs as interrupted. A read that fails is
    /// repeated: without it no run is driven again. Returns the decision, and the last time at which the run to be driven
    /// did something.
    ///
    /// # Errors
    /// `ConductorError::Store` if each attempt to read fails, or what is read is damaged, or the runs cannot be marked.
    pub(super) async fn left_by_earlier(
        &self,
        resume: AutoResume,
    ) -> ConductorResult<(TakenOver, Option<Timestamp>)> {
        let (mut attempt, mut pause) = (1, RESTART_PAUSE);
        loop {
            // No run begins between the look at the active one and the mark of the others.
            let one_at_a_time = self.inner.beginning.lock().await;
            let active = self.active();
            let error = match self.read_left(resume, active).await {
                Ok((taken, since)) => {
                    let stays = taken.driven.as_ref().map(|run| run.uid).or(active);
                    self.inner.store.interrupt_open_runs(stays).await?;
                    return Ok((taken, since));
                }
                Err(error) if attempt == RESTART_TRIES || error.is_refusal() => {
                    return Err(error.into());
                }
                Err(error) => error,
            };
            drop(one_at_a_time);
            let error = error_chain(&error);
            tracing::warn!(attempt, error, "the runs of the earlier process are not known yet");
            tokio::time::sleep(pause).await;
            (attempt, pause) = (attempt + 1, 2 * pause);
        }
    }

    /// `active`: the run that this process drives.
    async fn read_left(
        &self,
        resume: AutoResume,
        active: Option<RunUid>,
    ) -> StoreResult<(TakenOver, Option<Timestamp>)> {
        let store = &self.inner.store;
        let (mut open, mut waiting) = (store.open_runs().await?, store.waiting_runs().await?);
        // What a person has started in this process waits as it is.
        waiting.retain(|run| !self.waiting().contains(&run.uid));
        open.retain(|run| Some(run.uid) != active);
        let TakenOver { driven, waiting, dropped } = TakenOver::of(open, waiting, resume);
        // A person may have started a run in this process already: no earlier one is driven again.
        let driven = driven.filter(|_| active.is_none());
        let since = match &driven {
            Some(run) => store.last_trial_at(run.uid).await?.or(run.started_at),
            None => None,
        };
        Ok((TakenOver { driven, waiting, dropped }, since))
    }
}

#[cfg(test)]
mod tests {
    use super::super::stand_in::conductor;
    use super::*;

    #[tokio::test]
    async fn what_the_earlier_process_left_is_read_again_while_the_store_fails() {
        let (conductor, _inbox, _folder) = conductor().await;
        conductor.inner.store.close().await;
        let left = conductor.left_by_earlier(AutoResume::Allowed);
        let left = tokio::time::timeout(RESTART_PAUSE / 2, left).await;
        assert!(left.is_err(), "{left:?}");
    }
}
