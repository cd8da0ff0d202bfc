//! The runs that were started and wait: which of them begins when the rig is free and its time has come.
//! Uses: `conductor::turn` (the decision), `campaign` (its handle), `store`. Never: motion, HTTP.

use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tokio::time::Instant;

use super::{Conductor, ConductorError, startable, turn};
use crate::campaign::shown::command::Refusal;
use crate::campaign::shown::run_action::trip_for_person;
use crate::campaign::shown::status::Status;
use crate::campaign::spans::run_span;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::state::StoredState;
use crate::store::{RunRow, StoreError};

/// Pause before a run that the rig did not take up is offered again.
const BUSY_AGAIN: Duration = Duration::from_secs(5);
/// Why waiting runs do not begin after a run that was ended while it waited.
const ENDED_HALTED: &str =
    "the run before it was ended while it was halted, and a person may be at the rig";
/// Why waiting runs do not begin after a run that was aborted while it moved.
const ABORTED: &str = "the run before it was aborted, and a person may be at the rig";

impl Conductor {
    /// Follows the campaign: a run that was started while another was active, or before its time,
    /// begins when the rig is free and the run is due. Ends with the campaign's thread.
    pub async fn follow(self) {
        let mut status = self.inner.campaign.watch_status();
        // While the rig is free and no waiting run is due: when to decide again.
        let mut again: Option<Instant> = None;
        let mut attended: Option<&'static str> = None;
        loop {
            let until = again;
            let due = async move {
                match until {
                    Some(at) => tokio::time::sleep_until(at).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                changed = status.changed() => if changed.is_err() { return },
                () = self.inner.look.notified() => again = None,
                () = due => again = None,
            }
            let (free, why_not) = {
                let now = status.borrow_and_update();
                let is_free = now.run.is_none() && now.rig.is_ready();
                let tripped = trip_for_person(&now).map(|trip| format!("the rig tripped ({trip})"));
                let ended = attended.filter(|_| now.run.is_none()).map(str::to_owned);
                attended = may_be_attended(attended, &now);
                (is_free, tripped.or(ended))
            };
            // A person may be at the rig: it must not start by itself once it is free or homed again.
            if let Some(why) = why_not {
                self.drop_all_waiting(&why).await;
            }
            if !free {
                again = None;
            } else if again.is_none() {
                match self.begin_next(Timestamp::now()).await {
                    Ok(pause) => again = pause.map(|pause| Instant::now() + pause),
                    Err(error) => {
                        tracing::warn!(error = error_chain(&error), "the next run did not start");
                    }
                }
            }
        }
    }

    /// Begins the first waiting run that is due. A run that cannot begin must be started again; an
    /// event reports it. Returns when to decide again, if none began and some are early.
    async fn begin_next(&self, now: Timestamp) -> Result<Option<Duration>, ConductorError> {
        let waiting = self.still_waiting().await?;
        let lock = self.inner.store.lock().await?;
        let present = turn::Present { now, lock: lock.as_ref() };
        for run in waiting.iter().filter(|run| present.lets_begin(run)) {
            match self.begin(run, self.require_turn(run)).await {
                Ok(()) => return Ok(None),
                // Another run was started first: this one continues to wait.
                Err(_) if self.inner.campaign.status().run.is_some() => return Ok(None),
                // The rig is busy, for example with a jog or a homing.
                Err(ConductorError::Refused(Refusal::Busy(_) | Refusal::Gone)) => {
                    return Ok(Some(BUSY_AGAIN));
                }
                Err(error) => self.drop_waiting(run, &error.to_string()).await?,
            }
        }
        Ok(turn::decide_again(&waiting, present))
    }

    /// Refuses a run that has lost its turn while it was planned: it was dropped, or another person has taken the
    /// operator lock.
    async fn require_turn(&self, run: &RunRow) -> Result<(), ConductorError> {
        let lock = self.inner.store.lock().await?;
        let present = turn::Present { now: Timestamp::now(), lock: lock.as_ref() };
        if self.waiting().contains(&run.uid) && present.lets_begin(run) {
            return Ok(());
        }
        Err(Refusal::Busy("its turn is over: it is decided again".into()).into())
    }

    /// Runs that were started and wait, the next one first.
    pub(super) async fn still_waiting(&self) -> Result<Vec<RunRow>, StoreError> {
        if self.waiting().is_empty() {
            return Ok(Vec::new());
        }
        let mut runs = self.inner.store.waiting_runs().await?;
        let waiting = self.waiting();
        runs.retain(|run| waiting.contains(&run.uid));
        Ok(runs)
    }

    /// What the next run that was started waits for, as text; `None` if none waits. If those that waited do not begin
    /// by themselves any more: the first of them, with the reason.
    ///
    /// # Errors
    /// `StoreError` if the store fails.
    pub async fn waiting_for(&self) -> Result<Option<String>, StoreError> {
        let is_busy = self.inner.campaign.status().run.is_some();
        let lock = self.inner.store.lock().await?;
        let present = turn::Present { now: Timestamp::now(), lock: lock.as_ref() };
        match turn::waits_for(&self.still_waiting().await?, is_busy, present) {
            Some(words) => Ok(Some(words)),
            None => self.first_dropped().await,
        }
    }

    /// The first run that does not begin by itself any more although a person had started it, with the reason, as text.
    async fn first_dropped(&self) -> Result<Option<String>, StoreError> {
        let dropped = self.dropped().clone();
        for (uid, why) in dropped {
            let row = self.inner.store.run(uid).await?;
            let Some(run) = row.filter(|run| startable(run).is_ok()) else {
                self.dropped().remove(&uid);
                continue;
            };
            let (scan_id, experiment) = (run.scan_id, run.experiment);
            return Ok(Some(format!(
                "run {scan_id} ({experiment}) does not begin by itself: {why}"
            )));
        }
        Ok(None)
    }

    /// Why a run does not begin by itself any more although a person had started it, as text.
    pub fn why_dropped(&self, run: RunUid) -> Option<String> {
        self.dropped().get(&run).cloned()
    }

    /// Lets started runs wait for their turn.
    pub(super) fn let_wait(&self, runs: impl IntoIterator<Item = RunUid>) {
        self.waiting().extend(runs);
        self.inner.look.notify_one();
    }

    /// Removes all runs from those that wait, because a person may be at the rig.
    async fn drop_all_waiting(&self, why: &str) {
        // In memory first: none of them begins, whatever the store does.
        let dropped = std::mem::take(&mut *self.waiting());
        if dropped.is_empty() {
            return;
        }
        let why = format!("{why}: start it again");
        self.dropped().extend(dropped.iter().map(|run| (*run, why.clone())));
        let stored = match self.inner.store.waiting_runs().await {
            Ok(stored) => stored,
            Err(error) => {
                tracing::warn!(
                    error = error_chain(&error),
                    "waiting runs are dropped in memory only"
                );
                return;
            }
        };
        for run in stored.iter().filter(|run| dropped.contains(&run.uid)) {
            if let Err(error) = self.drop_waiting(run, &why).await {
                tracing::warn!(
                    error = error_chain(&error),
                    "a waiting run is dropped in memory only"
                );
            }
        }
    }

    /// Called at the end of the service while an e-stop is latched, which the next process would not know: it must
    /// drive no run by itself.
    pub async fn keep_stopped(&self) {
        let kept = async {
            self.inner.store.interrupt_open_runs(None).await?;
            for run in self.inner.store.waiting_runs().await? {
                let why = "the e-stop was latched when the service ended: start it again";
                self.drop_waiting(&run, why).await?;
            }
            Ok::<(), ConductorError>(())
        };
        if let Err(error) = kept.await {
            tracing::error!(error = error_chain(&error), "a stopped run may resume automatically");
        }
    }

    /// Removes a run from those that wait; an event reports it.
    pub(super) async fn drop_waiting(&self, run: &RunRow, why: &str) -> Result<(), ConductorError> {
        run_span(run.uid, run.scan_id)
            .in_scope(|| tracing::warn!(why, "a waiting run does not begin"));
        self.waiting().remove(&run.uid);
        self.dropped().insert(run.uid, why.into());
        self.inner.store.clear_waiting(run.uid).await?;
        self.say(run, "not_begun", json!({ "why": why })).await;
        Ok(())
    }
}

/// Why a person may be at the rig because of the active run: it was halted or is aborted, and has not moved again
/// since. `before`: the answer for the last status. Between two statuses others may have been missed.
fn may_be_attended(before: Option<&'static str>, status: &Status) -> Option<&'static str> {
    match status.run.as_ref().map(|run| run.state) {
        Some(StoredState::Paused | StoredState::Panicked) => Some(ENDED_HALTED),
        Some(StoredState::Aborting) => before.or(Some(ABORTED)),
        Some(StoredState::Running) | None => None,
        Some(_) => before,
    }
}
