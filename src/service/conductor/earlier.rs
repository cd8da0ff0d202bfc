//! The runs that the earlier process left open or waiting: read from the store, and decided by `restart`.
//! Uses: `conductor::restart`, `store`. Never: motion, HTTP.

use std::time::Duration;

use jiff::Timestamp;

use super::restart::{AutoResume, TakenOver};
use super::{Conductor, ConductorResult};
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::store::StoreResult;

/// Number of attempts to take over what the earlier process left, and to reach the rig, and the pause before the second;
/// it doubles.
pub(super) const RESTART_TRIES: u32 = 8;
pub(super) const RESTART_PAUSE: Duration = Duration::from_secs(1);

/// The decision on the runs that were left, and the last time at which the run to be driven did something.
type Left = (TakenOver, Option<Timestamp>);

impl Conductor {
    /// Decides on the runs of the earlier process, and marks its other open runs as interrupted. A read or a mark that
    /// fails is repeated: without it no run is driven again, and none can be started. Returns the decision, and the last
    /// time at which the run to be driven did something.
    ///
    /// # Errors
    /// `ConductorError::Store` if each attempt fails, or what is read is damaged.
    pub(super) async fn left_by_earlier(&self, resume: AutoResume) -> ConductorResult<Left> {
        let (mut attempt, mut pause, mut left) = (1, RESTART_PAUSE, None);
        loop {
            // No run begins between the look at the active one and the mark of the others.
            let one_at_a_time = self.inner.beginning.lock().await;
            let active = self.active();
            let read = match left.take() {
                Some(read) => Ok(read),
                None => self.read_left(resume, active).await,
            };
            let error = match read.map(|read| self.still_left(read, active)) {
                Ok((taken, since)) => {
                    let stays = taken.driven.as_ref().map(|run| run.uid).or(active);
                    match self.mark(&taken, stays).await {
                        Ok(()) => return Ok((taken, since)),
                        Err(error) => {
                            // They may be marked nevertheless: what they were before decides.
                            left = Some((taken, since));
                            error
                        }
                    }
                }
                Err(error) => error,
            };
            drop(one_at_a_time);
            if attempt == RESTART_TRIES || error.is_refusal() {
                return Err(error.into());
            }
            let (error, words) = (error_chain(&error), "the earlier runs are not taken over yet");
            tracing::warn!(attempt, error, "{words}");
            tokio::time::sleep(pause).await;
            (attempt, pause) = (attempt + 1, 2 * pause);
        }
    }

    /// Stores what follows for the next process. First which runs wait no more: the open runs may be the reason, and stay
    /// open until this is stored, since the next process would otherwise begin what waits behind them.
    async fn mark(&self, taken: &TakenOver, stays: Option<RunUid>) -> StoreResult<()> {
        for (run, _) in &taken.dropped {
            self.inner.store.clear_waiting(run.uid).await?;
        }
        self.inner.store.interrupt_open_runs(stays).await
    }

    /// What was left, without what a person has started in this process: that waits as it is, and no earlier run is
    /// driven again.
    fn still_left(&self, (mut taken, since): Left, active: Option<RunUid>) -> Left {
        let begun = self.inner.begun.lock().clone();
        let started = |run: RunUid| self.waiting().contains(&run) || begun.contains(&run);
        taken.waiting.retain(|run| !started(run.uid));
        taken.dropped.retain(|(run, _)| !started(run.uid));
        let driven = taken.driven.filter(|_| active.is_none());
        let since = since.filter(|_| driven.is_some());
        (TakenOver { driven, ..taken }, since)
    }

    /// `active`: the run that this process drives.
    async fn read_left(&self, resume: AutoResume, active: Option<RunUid>) -> StoreResult<Left> {
        let store = &self.inner.store;
        let (mut open, waiting) = (store.open_runs().await?, store.waiting_runs().await?);
        open.retain(|run| Some(run.uid) != active);
        let taken = TakenOver::of(open, waiting, resume);
        let since = match &taken.driven {
            Some(run) => store.last_trial_at(run.uid).await?.or(run.started_at),
            None => None,
        };
        Ok((taken, since))
    }
}

#[cfg(test)]
mod tests {
    use super::super::stand_in::{conductor, earlier};
    use super::*;

    #[tokio::test]
    async fn what_the_earlier_process_left_is_read_again_while_the_store_fails() {
        let (conductor, _inbox, _folder) = conductor().await;
        conductor.inner.store.close().await;
        let left = conductor.left_by_earlier(AutoResume::Allowed);
        let left = tokio::time::timeout(RESTART_PAUSE / 2, left).await;
        assert!(left.is_err(), "{left:?}");
    }

    #[tokio::test]
    async fn a_process_that_ends_as_it_takes_over_leaves_no_run_that_begins_by_itself() {
        let (conductor, _inbox, _folder) = conductor().await;
        earlier(&conductor).await;
        conductor.left_by_earlier(AutoResume::Off).await.unwrap();
        let store = &conductor.inner.store;
        assert!(store.open_runs().await.unwrap().is_empty());
        assert!(store.waiting_runs().await.unwrap().is_empty());
    }
}
