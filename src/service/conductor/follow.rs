//! The runs that were started and wait: which of them begins when the rig is free and its time has come.
//! Uses: `conductor::turn` (the decision), `campaign` (its handle), `store`. Never: motion, HTTP.

use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tokio::time::Instant;

use super::{Conductor, ConductorError, turn};
use crate::campaign::shown::status::Status;
use crate::campaign::spans::run_span;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::store::{RunRow, StoreError};

impl Conductor {
    /// Follows the campaign: a run that was started while another was active, or before its time,
    /// begins when the rig is free and the run is due. Ends with the campaign's thread.
    pub async fn follow(self) {
        let mut status = self.inner.campaign.watch_status();
        // While the rig is free and no waiting run is due: when to decide again.
        let mut again: Option<Instant> = None;
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
            let (free, tripped) = {
                let now = status.borrow_and_update();
                (now.run.is_none() && now.rig.is_ready(), needs_person(&now).map(ToOwned::to_owned))
            };
            // A person comes to the rig: it must not start by itself once it is homed again.
            if let Some(why) = tripped {
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
            match self.begin(run).await {
                Ok(()) => return Ok(None),
                // Another run was started first: this one continues to wait.
                Err(_) if self.inner.campaign.status().run.is_some() => return Ok(None),
                Err(error) => self.drop_waiting(run, &error.to_string()).await?,
            }
        }
        Ok(turn::decide_again(&waiting, present))
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

    /// What the next run that was started waits for, as text; `None` if none waits.
    ///
    /// # Errors
    /// `StoreError` if the store fails.
    pub async fn waiting_for(&self) -> Result<Option<String>, StoreError> {
        let is_busy = self.inner.campaign.status().run.is_some();
        let lock = self.inner.store.lock().await?;
        let present = turn::Present { now: Timestamp::now(), lock: lock.as_ref() };
        Ok(turn::waits_for(&self.still_waiting().await?, is_busy, present))
    }

    /// Lets started runs wait for their turn.
    pub(super) fn let_wait(&self, runs: impl IntoIterator<Item = RunUid>) {
        self.waiting().extend(runs);
        self.inner.look.notify_one();
    }

    /// Removes all runs from those that wait, because of a trip that needs a person.
    async fn drop_all_waiting(&self, trip: &str) {
        // In memory first: none of them begins, whatever the store does.
        let dropped = std::mem::take(&mut *self.waiting());
        if dropped.is_empty() {
            return;
        }
        let why = format!("the rig tripped ({trip}): start it again");
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

    /// Removes a run from those that wait; an event reports it.
    pub(super) async fn drop_waiting(&self, run: &RunRow, why: &str) -> Result<(), ConductorError> {
        run_span(run.uid, run.scan_id)
            .in_scope(|| tracing::warn!(why, "a waiting run does not begin"));
        self.waiting().remove(&run.uid);
        self.inner.store.clear_waiting(run.uid).await?;
        self.say(run, "not_begun", json!({ "why": why })).await;
        Ok(())
    }
}

/// The trip that brings a person to the rig, if there is one: without a run any, during a run one that does not pass
/// without a person.
pub(super) fn needs_person(status: &Status) -> Option<&str> {
    let trip = status.rig.trip.as_ref()?;
    (status.run.is_none() || !trip.kind.may_pass()).then_some(trip.detail.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::interlock::{Trip, TripKind};
    use crate::campaign::shown::show;
    use crate::rig::setup::RigSetup;

    #[test]
    fn a_trip_without_a_run_brings_a_person_to_the_rig() {
        let rig = include_str!("../../../experiments/rigs/virtual.toml");
        let mut status = show::closed(&RigSetup::from_toml("virtual.toml", rig).unwrap());
        assert_eq!(needs_person(&status), None);
        for kind in [TripKind::Wire, TripKind::Estop] {
            status.rig.trip = Some(Trip { kind, detail: "why".into() });
            assert_eq!(needs_person(&status), Some("why"), "{kind:?}");
        }
    }
}
