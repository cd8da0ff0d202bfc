//! The runs that were started and wait: which of them begins when the rig is free and its time has come.
//! Uses: `conductor::turn` (the decision), `campaign` (its handle), `store`. Never: motion, HTTP.

use std::sync::atomic::Ordering;
use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tokio::time::Instant;

use super::{Conductor, ConductorError, ConductorResult, startable, turn};
use crate::campaign::shown::command::Refusal;
use crate::campaign::shown::run_action;
use crate::campaign::spans::run_span;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::state::StoredState;
use crate::store::{RunRow, StoreResult};

/// Pause before a run that the rig did not take up is offered again.
const BUSY_AGAIN: Duration = Duration::from_secs(5);
/// Starts of a run without an answer, one after the other, after which a person must start it again.
const UNANSWERED_STARTS: u32 = 8;
/// Pause before the store is told again of runs that were dropped while it failed.
const STORE_AGAIN: Duration = Duration::from_secs(10);

impl Conductor {
    /// Follows the campaign: a run that was started while another was active, or before its time,
    /// begins when the rig is free and the run is due. Ends with the campaign's thread.
    pub async fn follow(self) {
        let mut status = self.inner.campaign.watch_status();
        // While the rig is free and no waiting run is due: when to decide again.
        let mut again: Option<Instant> = None;
        // While a run that was dropped is stored as one that waits: when to store it.
        let mut store_at: Option<Instant> = None;
        let mut unanswered = None;
        loop {
            tokio::select! {
                changed = status.changed() => if changed.is_err() { return },
                () = self.inner.look.notified() => again = None,
                () = until(again) => again = None,
                () = until(store_at) => {}
            }
            let (free, tripped, attended) = {
                let now = status.borrow_and_update();
                let is_free = now.run.is_none() && now.rig.is_ready();
                (is_free, run_action::tripped(&now), now.attended.clone())
            };
            // A person may be at the rig: it must not start by itself once it is free or homed again. While the rig is
            // tripped, each look drops what was started in that moment.
            let is_followed = self.inner.signs.load(Ordering::SeqCst) == attended.signs;
            if let Some(why) = tripped.or((!is_followed).then_some(attended.why))
                && self.drop_all_waiting(&why)
            {
                store_at = Some(Instant::now());
            }
            self.inner.signs.store(attended.signs, Ordering::SeqCst);
            if store_at.is_some_and(|at| at <= Instant::now()) {
                store_at = self.store_dropped().await.err().map(|error| {
                    let error = error_chain(&error);
                    tracing::warn!(error, "waiting runs are dropped in memory only");
                    Instant::now() + STORE_AGAIN
                });
            }
            if !free {
                again = None;
            } else if again.is_none() {
                match self.begin_next(Timestamp::now(), &mut unanswered).await {
                    Ok(pause) => again = pause.map(|pause| Instant::now() + pause),
                    Err(error) => {
                        tracing::warn!(error = error_chain(&error), "the next run did not start");
                        // It may have been dropped in memory only.
                        store_at = store_at.or_else(|| Some(Instant::now() + STORE_AGAIN));
                    }
                }
            }
        }
    }

    /// Begins the first waiting run that is due. A run that cannot begin must be started again, unless the rig is busy or
    /// not ready any more, or the store fails; an event reports it. Returns when to decide again, if none began and
    /// some are early. `unanswered`: the run that was offered last, and its last starts, one after the other, that
    /// the campaign did not answer.
    async fn begin_next(
        &self,
        now: Timestamp,
        unanswered: &mut Option<(RunUid, u32)>,
    ) -> ConductorResult<Option<Duration>> {
        let waiting = self.still_waiting().await?;
        let lock = self.inner.store.lock().await?;
        let starters = self.starters();
        let present = turn::Present { now, lock: lock.as_ref(), starters: &starters };
        for run in waiting.iter().filter(|run| present.lets_begin(run)) {
            let begun = self.begin(run, false, self.require_turn(run)).await;
            let is_unanswered = matches!(begun, Err(ConductorError::Refused(Refusal::Gone)));
            let before = unanswered.filter(|(uid, _)| *uid == run.uid).map_or(0, |(_, n)| n);
            let count = if is_unanswered { before + 1 } else { 0 };
            *unanswered = Some((run.uid, count));
            match begun {
                Ok(()) => return Ok(None),
                // Another run was started first: this one continues to wait.
                Err(_) if self.inner.campaign.status().run.is_some() => return Ok(None),
                // The rig is busy, for example with a jog or a homing, or its thread does not answer.
                Err(ConductorError::Refused(Refusal::Busy(_) | Refusal::Gone))
                    if count < UNANSWERED_STARTS =>
                {
                    return Ok(Some(BUSY_AGAIN));
                }
                // The rig is not ready any more, for example without wires: no fault of this run.
                Err(ConductorError::Refused(_)) if !self.inner.campaign.status().rig.is_ready() => {
                    *unanswered = None;
                    return Ok(None);
                }
                // The store may answer again, and nothing was requested of the rig.
                Err(ConductorError::Store(error)) if !error.is_refusal() => {
                    tracing::warn!(error = error_chain(&error), "the next run did not start yet");
                    return Ok(Some(BUSY_AGAIN));
                }
                Err(error) => {
                    *unanswered = None;
                    self.drop_waiting(run, &error.to_string()).await?;
                }
            }
        }
        Ok(turn::decide_again(&waiting, present))
    }

    /// Refuses a run that has lost its turn while it was planned: it was dropped, there was a sign of a person, which
    /// drops it, or another person has taken the operator lock.
    async fn require_turn(&self, run: &RunRow) -> ConductorResult<()> {
        let lock = self.inner.store.lock().await?;
        let (now, starters) = (Timestamp::now(), self.starters());
        let present = turn::Present { now, lock: lock.as_ref(), starters: &starters };
        let signs = self.inner.campaign.status().attended.signs;
        let is_followed = self.inner.signs.load(Ordering::SeqCst) == signs;
        if is_followed && self.waiting().contains(&run.uid) && present.lets_begin(run) {
            return Ok(());
        }
        Err(Refusal::Busy("its turn is over: it is decided again".into()).into())
    }

    /// Runs that were started and wait, the next one first.
    pub(super) async fn still_waiting(&self) -> StoreResult<Vec<RunRow>> {
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
    pub async fn waiting_for(&self) -> StoreResult<Option<String>> {
        let obstacle = turn::Obstacle::of(&self.inner.campaign.status());
        let lock = self.inner.store.lock().await?;
        let (now, starters) = (Timestamp::now(), self.starters());
        let present = turn::Present { now, lock: lock.as_ref(), starters: &starters };
        match turn::waits_for(&self.still_waiting().await?, obstacle, present) {
            Some(words) => Ok(Some(words)),
            None => self.not_begun().await,
        }
    }

    /// The first run that does not begin by itself any more although a person had started it, with the reason, as text.
    ///
    /// # Errors
    /// `StoreError` if the store fails.
    pub async fn not_begun(&self) -> StoreResult<Option<String>> {
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

    /// Marks the run that the earlier process drove as interrupted: this one does not drive it. States why until a person
    /// starts or ends it. `why`: none if the rig was not reached.
    pub(super) async fn give_up(&self, run: &RunRow, why: Option<String>) -> ConductorResult<()> {
        let _one_at_a_time = self.inner.beginning.lock().await;
        let active = self.active();
        self.inner.store.interrupt_open_runs(active).await?;
        let is_left = self.present(run).await?.state == StoredState::Interrupted;
        // A person may have started it meanwhile.
        if is_left && active != Some(run.uid) && !self.waiting().contains(&run.uid) {
            let why = why.as_deref().unwrap_or("the rig was not reached");
            let why = format!("not driven again after the restart of the service: {why}");
            self.dropped().insert(run.uid, why);
        }
        Ok(())
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

    /// Removes all runs from those that wait, because a person may be at the rig: in memory, so that none of them
    /// begins, whatever the store does. Returns whether one waited, or one that the earlier process left may wait.
    pub(super) fn drop_all_waiting(&self, why: &str) -> bool {
        let dropped = std::mem::take(&mut *self.waiting());
        let why = format!("{why}: start it again");
        self.dropped().extend(dropped.iter().map(|run| (*run, why.clone())));
        self.note_sign(why) || !dropped.is_empty()
    }

    /// Stores which of the runs that wait were dropped, for the process after a crash.
    pub(super) async fn store_dropped(&self) -> ConductorResult<()> {
        // One that a person starts again meanwhile waits.
        let _one_at_a_time = self.inner.beginning.lock().await;
        for run in self.inner.store.waiting_runs().await? {
            if let Some(why) = self.why_not_next(run.uid) {
                self.drop_waiting(&run, &why).await?;
            }
        }
        Ok(())
    }

    /// Removes runs from those that wait, all first in memory: none of them begins, whatever the store does.
    pub(super) async fn drop_each(&self, runs: &[RunRow], why: &str) -> ConductorResult<()> {
        self.waiting().retain(|uid| runs.iter().all(|run| run.uid != *uid));
        self.dropped().extend(runs.iter().map(|run| (run.uid, why.to_owned())));
        for run in runs {
            self.drop_waiting(run, why).await?;
        }
        Ok(())
    }

    /// Removes a run from those that wait; an event reports it.
    pub(super) async fn drop_waiting(&self, run: &RunRow, why: &str) -> ConductorResult<()> {
        run_span(run.uid, run.scan_id)
            .in_scope(|| tracing::warn!(why, "a waiting run does not begin"));
        self.waiting().remove(&run.uid);
        self.dropped().insert(run.uid, why.into());
        self.inner.store.clear_waiting(run.uid).await?;
        self.say(run, "not_begun", json!({ "why": why })).await;
        Ok(())
    }
}

/// Waits until this time; for ever without one.
async fn until(at: Option<Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests {
    use super::super::stand_in::{asked, conductor, driven, granted, in_an_hour, queued_on, start};
    use super::super::{AutoResume, Started, Terms};
    use super::*;
    use crate::campaign::bench::interlock::{Trip, TripKind};
    use crate::campaign::bench::rig_state::RigState;
    use crate::campaign::shown::command::Request;

    /// Why a run is dropped.
    const BEFORE_ABORTED: &str = "the run before it was aborted";

    async fn queued(conductor: &Conductor, not_before: Option<Timestamp>) -> RunRow {
        queued_on(conductor, Terms { auto_resume: None, not_before }).await
    }

    #[tokio::test]
    async fn a_run_that_was_dropped_says_why_until_it_is_started_again() {
        let (conductor, _inbox, _folder) = conductor().await;
        let run = queued(&conductor, in_an_hour()).await;
        let words = async || conductor.waiting_for().await.unwrap().unwrap();
        start(&conductor, &run).await;
        assert!(words().await.contains("starts at"));
        assert!(conductor.drop_all_waiting(BEFORE_ABORTED));
        let why = format!("{BEFORE_ABORTED}: start it again");
        assert_eq!(words().await, format!("run 1 (small) does not begin by itself: {why}"));
        assert_eq!(conductor.why_dropped(run.uid), Some(why));
        assert_eq!(conductor.not_begun().await.unwrap(), Some(words().await));
        start(&conductor, &run).await;
        assert_eq!(conductor.not_begun().await.unwrap(), None);
        assert!(words().await.contains("starts at"));
        assert_eq!(conductor.why_dropped(run.uid), None);
    }

    #[tokio::test]
    async fn a_run_that_is_not_driven_again_after_a_restart_says_why_until_it_is_started() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: Some(true), not_before: None };
        let run = queued_on(&conductor, terms).await;
        driven(&conductor, &run).await;
        let trips = async {
            let answer = asked(&mut inbox, |request| matches!(request, Request::Connect)).await;
            let trip = Trip { kind: TripKind::Stale, detail: "x: no reply".into() };
            inbox.status.send_modify(|status| {
                (status.rig.state, status.rig.trip) = (RigState::Tripped, Some(trip));
            });
            let _ = answer.send(Ok(()));
        };
        let taken = conductor.resume_after_restart(AutoResume::Allowed);
        let (taken, ()) = tokio::join!(taken, trips);
        assert_eq!(taken.unwrap_err().to_string(), "the rig tripped: x: no reply");
        let run = conductor.present(&run).await.unwrap();
        assert_eq!(run.state, StoredState::Interrupted);
        let words = "run 1 (small) does not begin by itself: not driven again after the restart of the \
                     service: the rig tripped: x: no reply";
        assert_eq!(conductor.not_begun().await.unwrap().as_deref(), Some(words));
        let code = conductor.arm(&run).await.unwrap().code;
        let begins = granted(&mut inbox, |request| matches!(request, Request::Start(_)));
        let (started, ()) = tokio::join!(conductor.start(&run, &code, "ada".into()), begins);
        assert_eq!(started.unwrap(), Started::Running);
        assert_eq!(conductor.not_begun().await.unwrap(), None);
    }

    #[tokio::test]
    async fn what_was_dropped_while_the_store_failed_is_stored_later_unless_it_was_started_again() {
        let (conductor, _inbox, _folder) = conductor().await;
        let [stays, again] =
            [queued(&conductor, in_an_hour()).await, queued(&conductor, in_an_hour()).await];
        start(&conductor, &stays).await;
        start(&conductor, &again).await;
        assert!(conductor.drop_all_waiting(BEFORE_ABORTED));
        assert!(!conductor.drop_all_waiting(BEFORE_ABORTED), "once");
        start(&conductor, &again).await;
        conductor.store_dropped().await.unwrap();
        let stored = conductor.inner.store.waiting_runs().await.unwrap();
        assert_eq!(stored.iter().map(|run| run.uid).collect::<Vec<_>>(), [again.uid]);
        assert_eq!(conductor.still_waiting().await.unwrap().len(), 1);
    }

    #[tokio::test]
    async fn a_sign_of_a_person_drops_what_waits_although_the_status_has_changed_since() {
        let (conductor, inbox, _folder) = conductor().await;
        let run = queued(&conductor, in_an_hour()).await;
        start(&conductor, &run).await;
        // A run was aborted and is gone, before the queue looks.
        inbox.status.send_modify(|status| status.attended.note(BEFORE_ABORTED));
        inbox.status.send_modify(|status| status.version += 1);
        let following = tokio::spawn(conductor.clone().follow());
        let dropped = async {
            while !conductor.inner.store.waiting_runs().await.unwrap().is_empty() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), dropped).await.expect("it is dropped");
        assert_eq!(
            conductor.why_dropped(run.uid),
            Some(format!("{BEFORE_ABORTED}: start it again"))
        );
        // One sign counts once.
        start(&conductor, &run).await;
        inbox.status.send_modify(|status| status.version += 1);
        tokio::time::sleep(Duration::from_millis(100)).await;
        assert_eq!(conductor.why_dropped(run.uid), None);
        inbox.status.send_modify(|status| status.attended.note("a trip"));
        let dropped = async {
            while conductor.why_dropped(run.uid).is_none() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), dropped).await.expect("it is dropped again");
        following.abort();
        let _ = following.await;
    }

    #[tokio::test]
    async fn no_run_of_the_earlier_process_begins_after_an_abort_before_it_is_taken_over() {
        let (conductor, inbox, _folder) = conductor().await;
        let terms =
            |auto_resume| Terms { auto_resume: Some(auto_resume), not_before: in_an_hour() };
        let earlier = queued_on(&conductor, terms(true)).await;
        conductor.inner.store.set_waiting(earlier.uid).await.unwrap();
        inbox.status.send_modify(|status| status.attended.note(BEFORE_ABORTED));
        conductor.inner.signs.store(1, Ordering::SeqCst);
        let later = queued_on(&conductor, terms(false)).await;
        start(&conductor, &later).await;
        let taken = conductor.resume_after_restart(AutoResume::Allowed);
        tokio::time::timeout(Duration::from_secs(60), taken).await.expect("at once").unwrap();
        let why = format!("{BEFORE_ABORTED}: start it again");
        assert_eq!(conductor.why_dropped(earlier.uid), Some(why));
        assert_eq!(conductor.why_dropped(later.uid), None, "a person has started it since");
        let waiting = conductor.still_waiting().await.unwrap();
        assert_eq!(waiting.iter().map(|run| run.uid).collect::<Vec<_>>(), [later.uid]);
    }

    #[tokio::test]
    async fn a_run_whose_turn_is_lost_while_it_is_planned_does_not_begin() {
        let (conductor, inbox, _folder) = conductor().await;
        let [first, second] = [queued(&conductor, None).await, queued(&conductor, None).await];
        let store = &conductor.inner.store;
        for run in [&first, &second] {
            store.set_waiting(run.uid).await.unwrap();
            conductor.let_wait([run.uid]);
            let now = conductor.present(run).await.unwrap();
            conductor.require_turn(&now).await.unwrap();
        }
        let is_lost = async |run: &RunRow| {
            let now = conductor.present(run).await.unwrap();
            let refused = conductor.require_turn(&now).await;
            matches!(refused, Err(ConductorError::Refused(Refusal::Busy(_))))
        };
        conductor.drop_waiting(&first, BEFORE_ABORTED).await.unwrap();
        assert!(is_lost(&first).await && !is_lost(&second).await);
        // The queue follows it only after this attempt.
        inbox.status.send_modify(|status| status.attended.note(BEFORE_ABORTED));
        assert!(is_lost(&second).await);
        conductor.inner.signs.store(1, Ordering::SeqCst);
        assert!(!is_lost(&second).await);
        tokio::time::sleep(Duration::from_millis(20)).await;
        store.set_lock("bob", "hands in the rig").await.unwrap();
        assert!(is_lost(&second).await);
    }

    #[tokio::test]
    async fn a_run_does_not_lose_its_turn_because_the_store_fails() {
        let (conductor, _inbox, _folder) = conductor().await;
        let run = queued(&conductor, None).await;
        conductor.inner.store.set_waiting(run.uid).await.unwrap();
        conductor.let_wait([run.uid]);
        let one_at_a_time = conductor.inner.beginning.lock().await;
        let fails = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            conductor.inner.store.close().await;
            drop(one_at_a_time);
        };
        let mut unanswered = None;
        let begins = conductor.begin_next(Timestamp::now(), &mut unanswered);
        let (begun, ()) = tokio::join!(begins, fails);
        // On a slow machine it fails before it has read which runs wait.
        let is_later = match &begun {
            Ok(pause) => *pause == Some(BUSY_AGAIN),
            Err(error) => matches!(error, ConductorError::Store(_)),
        };
        assert!(is_later, "{begun:?}");
        assert!(conductor.waiting().contains(&run.uid));
        assert_eq!(conductor.why_dropped(run.uid), None);
    }

    #[tokio::test]
    async fn a_refusal_drops_a_waiting_run_only_if_the_rig_is_still_ready() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued(&conductor, None).await;
        conductor.inner.store.set_waiting(run.uid).await.unwrap();
        conductor.let_wait([run.uid]);
        let mut unanswered = None;
        for (state, waits) in [(RigState::Disconnected, true), (RigState::Homed, false)] {
            inbox.status.send_modify(|status| status.rig.state = state);
            let refuses = async {
                let is_this =
                    |request: &Request| matches!(request, Request::Start(job) if job.has_waited);
                let _ = asked(&mut inbox, is_this).await.send(Err(Refusal::State("no".into())));
            };
            let begins = conductor.begin_next(Timestamp::now(), &mut unanswered);
            let (begun, ()) = tokio::join!(begins, refuses);
            assert_eq!(begun.unwrap(), None);
            assert_eq!(conductor.waiting().contains(&run.uid), waits, "{state:?}");
        }
        assert_eq!(conductor.why_dropped(run.uid).as_deref(), Some("no"));
    }

    #[tokio::test]
    async fn a_start_that_is_not_answered_is_repeated_a_few_times_only() {
        let (conductor, inbox, _folder) = conductor().await;
        let run = queued(&conductor, None).await;
        conductor.inner.store.set_waiting(run.uid).await.unwrap();
        conductor.let_wait([run.uid]);
        // The campaign takes no request any more.
        drop(inbox.requests);
        // The rig is not ready any more after the last of them: later ones are counted from the first.
        let mut unanswered = Some((run.uid, UNANSWERED_STARTS - 1));
        let pause = conductor.begin_next(Timestamp::now(), &mut unanswered).await.unwrap();
        assert_eq!((pause, unanswered), (None, None));
        inbox.status.send_modify(|status| status.rig.state = RigState::Homed);
        // The starts of another run are not those of this one.
        unanswered = Some((RunUid::new(), UNANSWERED_STARTS - 1));
        for attempt in 1..=UNANSWERED_STARTS {
            let pause = conductor.begin_next(Timestamp::now(), &mut unanswered).await.unwrap();
            let is_repeated = attempt < UNANSWERED_STARTS;
            assert_eq!(pause, is_repeated.then_some(BUSY_AGAIN));
            assert_eq!(conductor.waiting().contains(&run.uid), is_repeated);
        }
        let why = conductor.why_dropped(run.uid);
        assert_eq!(why.as_deref(), Some("the rig's thread does not answer"));
    }
}
