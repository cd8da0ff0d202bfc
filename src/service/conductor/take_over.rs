//! After a start of the service: drives what the earlier process drove, as `restart` decides.
//! Uses: `conductor::{restart, earlier}`, `campaign` (its handle), `store`. Never: motion, HTTP.

use std::collections::BTreeSet;
use std::sync::atomic::Ordering;
use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tracing::Instrument;

use super::earlier::{RESTART_PAUSE, RESTART_TRIES};
use super::restart::{AutoResume, TakenOver};
use super::{Conductor, ConductorError, ConductorResult, locked, turn};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::command::Request;
use crate::campaign::spans::run_span;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::store::{RunRow, StoreError};

/// Pause before the runs that wait are read again.
const READ_AGAIN: Duration = Duration::from_secs(10);

/// Why a run that waited does not begin after one that is not driven again.
pub(super) const NOT_DRIVEN: &str =
    "the run before it is not driven again, and a person may be at the rig: start it again";

/// What must not have changed since a run was taken over: then a person may be at the rig.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unattended {
    /// The last time at which the run did something; none if it was not driven.
    pub since: Option<Timestamp>,
    /// Signs of a person before it.
    pub(super) signs: u64,
}

impl Conductor {
    /// Called after a start of the service: resumes the run that was driven when the process ended,
    /// and then the runs that were started behind it, if their arming and `resume` allow it. Marks
    /// other open runs as interrupted; a waiting run that is dropped must be started again. Reports
    /// in events what it does and what it cannot do.
    ///
    /// Until the run is driven again it keeps its state: if this process ends early, the next one
    /// finds the same case. With `AutoResume::Later` nothing is changed at all.
    ///
    /// # Errors
    /// `ConductorError` if the store fails, or the run cannot resume.
    pub async fn resume_after_restart(&self, resume: AutoResume) -> ConductorResult<()> {
        if resume == AutoResume::Later {
            return Ok(());
        }
        let (TakenOver { driven, waiting, dropped }, since) = self.left_by_earlier(resume).await?;
        // In memory all of them, whatever the store does.
        self.dropped().extend(dropped.iter().map(|(run, why)| (run.uid, (*why).to_owned())));
        for (run, why) in &dropped {
            // Stored already by `left_by_earlier`; this adds the event.
            if let Err(error) = self.drop_waiting(run, why).await {
                let error = error_chain(&error);
                tracing::warn!(error, "a waiting run is dropped in memory only");
            }
        }
        let was_driven = driven.is_some();
        let (first, signs) = match driven {
            // A sign of a person since the start of the service counts, also one that was followed.
            Some(run) => (run, 0),
            None => match self.first_due(waiting).await? {
                Some(due) => due,
                None => return Ok(()),
            },
        };
        let before = Unattended { since, signs };
        let outcome =
            self.drive_again(&first, before).instrument(run_span(first.uid, first.scan_id)).await;
        let begun = matches!(outcome, Ok(true));
        if was_driven && !begun {
            let why = outcome.as_ref().err().map(ToString::to_string);
            self.give_up(&first, why).await?;
        }
        let mut waiting = self.inner.store.waiting_runs().await?;
        // What was dropped meanwhile stays dropped, even if the store does not know it yet.
        waiting
            .retain(|run| !(begun && run.uid == first.uid) && self.why_dropped(run.uid).is_none());
        let tripped = self.inner.campaign.status().rig.state == RigState::Tripped;
        let why_not = match &outcome {
            _ if tripped => Some("the rig tripped during the start: start it again"),
            Err(ConductorError::Forbidden(_)) if was_driven => Some(NOT_DRIVEN),
            Ok(_) | Err(_) => None,
        };
        if why_not.is_none() {
            self.let_wait(waiting.iter().map(|run| run.uid));
        }
        // Read after it: a sign of a person that came before was followed without them.
        let attended = self.inner.campaign.status().attended;
        let sign = (attended.signs != signs).then(|| format!("{}: start it again", attended.why));
        if let Some(why) = why_not.or(sign.as_deref()) {
            self.drop_each(&waiting, why).await?;
        }
        outcome.map(|_| ())
    }

    /// Waits until one of these runs, which waited for the earlier process, is due, so that the rig must be brought up.
    /// Then none of them waits, and the signs of a person that were followed before are returned with it.
    /// `None` if none of them waits any more, such as after a sign of a person, or if one has brought the rig up: then
    /// the run begins as any other.
    async fn first_due(&self, waiting: Vec<RunRow>) -> ConductorResult<Option<(RunRow, u64)>> {
        let taken_over: BTreeSet<RunUid> = waiting.iter().map(|run| run.uid).collect();
        self.let_wait(taken_over.iter().copied());
        // Read after it: a sign of a person that came before was followed without them.
        let attended = self.inner.campaign.status().attended;
        if attended.signs > 0 {
            self.drop_each(&waiting, &format!("{}: start it again", attended.why)).await?;
            return Ok(None);
        }
        loop {
            let read = async {
                Ok::<_, StoreError>((self.still_waiting().await?, self.inner.store.lock().await?))
            };
            let (waiting, lock) = match read.await {
                Ok(read) => read,
                Err(error) if error.is_refusal() => return Err(error.into()),
                Err(error) => {
                    tracing::warn!(error = error_chain(&error), "no waiting run is due yet");
                    tokio::time::sleep(READ_AGAIN).await;
                    continue;
                }
            };
            let (now, starters) = (Timestamp::now(), self.starters());
            let present = turn::Present { now, lock: lock.as_ref(), starters: &starters };
            // For a run that was started in this process the rig is not brought up: a person homes it.
            let first: Vec<&RunRow> =
                waiting.iter().filter(|run| taken_over.contains(&run.uid)).collect();
            if first.is_empty() {
                return Ok(None);
            }
            if let Some(due) = first.into_iter().find(|run| present.lets_begin(run)) {
                let status = self.inner.campaign.status();
                if status.run.is_some() || status.rig.is_ready() {
                    return Ok(None);
                }
                let signs = self.inner.signs.load(Ordering::SeqCst);
                // None of them begins by itself as soon as the rig is up.
                if self.take_from_waiting(due.uid, &waiting) {
                    return Ok(Some((due.clone(), signs)));
                }
                continue;
            }
            match turn::decide_again(&waiting, present) {
                Some(pause) => tokio::time::sleep(pause).await,
                None => return Ok(None),
            }
        }
    }

    /// Takes runs from those that wait, unless the first of them was dropped meanwhile.
    fn take_from_waiting(&self, first: RunUid, runs: &[RunRow]) -> bool {
        let mut waiting = self.waiting();
        let waits = waiting.contains(&first);
        if waits {
            waiting.retain(|uid| runs.iter().all(|run| run.uid != *uid));
        }
        waits
    }

    /// Drives a run again; returns `false` if the rig could not be reached. Nothing moves if a person may have come to
    /// the rig since `before`.
    async fn drive_again(&self, run: &RunRow, before: Unattended) -> ConductorResult<bool> {
        self.require_sound_store()?;
        let mut pause = RESTART_PAUSE;
        for attempt in 1..=RESTART_TRIES {
            let driving = async {
                // Before the wires are opened: nothing moves for a run that is refused.
                self.prepare_stored(run).await?;
                self.try_to_drive(run, before).await
            };
            let Err(error) = driving.await else {
                tracing::info!(attempt, "the run is driven again");
                self.say(run, "resumed", json!({ "attempt": attempt })).await;
                return Ok(true);
            };
            let why = error.to_string();
            self.say(run, "not_resumed", json!({ "attempt": attempt, "why": why })).await;
            let tripped = self.inner.campaign.status().rig.state == RigState::Tripped;
            let for_good = match &error {
                ConductorError::Problems { .. }
                | ConductorError::PlanDiffers { .. }
                | ConductorError::Forbidden(_) => true,
                ConductorError::Store(error) => error.is_refusal(),
                _ => false,
            };
            if tripped || for_good {
                return Err(error);
            }
            tracing::warn!(attempt, error = error_chain(&error), "the run is not driven again yet");
            tokio::time::sleep(pause).await;
            pause *= 2;
        }
        Ok(false)
    }

    /// Brings the rig up and begins a run, unless the run was ended, a lock was taken or a person has operated the
    /// rig, also while it homed.
    async fn try_to_drive(&self, run: &RunRow, before: Unattended) -> ConductorResult<()> {
        *self.inner.brought_up.lock() = Some(run.uid);
        // First: the cause, if an operation has also interrupted it.
        self.require_not_operated(run.uid)?;
        self.unended(run).await?;
        self.require_left_alone(before.since).await?;
        self.require_unattended(run, before).await?;
        self.bring_up(run, before).await?;
        self.begin(run, false, self.require_unattended(run, before)).await
    }

    /// Holds a run that is about to be driven again: a person has requested to pause or stop it. It must be started
    /// again, also in the next process; if the rig homes for it, the homing ends. One that has begun meanwhile gets the
    /// request. Returns whether it has.
    ///
    /// # Errors
    /// `ConductorError::Refused` if the campaign refuses; `Store` if the store fails: then only this process holds it.
    pub async fn hold_undriven(&self, run: RunUid, request: Request) -> ConductorResult<bool> {
        // Before the wait: an attempt in progress does not begin it.
        self.note_operation();
        self.end_bringing_up(run);
        let _one_at_a_time = self.inner.beginning.lock().await;
        if self.active() == Some(run) {
            self.halt(request).await?;
            return Ok(true);
        }
        // At once: this process may end before it has given the run up.
        let stored = self.inner.store.interrupt_open_runs(self.active()).await;
        // For the runs that wait behind it. If the campaign is busy, it is noted later.
        let _ = self.halt(Request::CameLate).await;
        stored?;
        Ok(false)
    }

    /// The run that this process drives.
    pub(super) fn active(&self) -> Option<RunUid> {
        self.inner.campaign.status().run.map(|run| run.uid)
    }

    /// Refuses a run if a person may be at the rig: one has operated it since the start of the service and has not
    /// started the run again, the computer was suspended since, there was a sign of a person, such as an abort of another
    /// run, or one has taken the operator lock.
    pub(super) async fn require_unattended(
        &self,
        run: &RunRow,
        Unattended { since, signs }: Unattended,
    ) -> ConductorResult<()> {
        self.require_not_operated(run.uid)?;
        self.require_no_sign(signs)?;
        self.require_no_lock(run, since).await
    }

    pub(super) fn require_not_operated(&self, run: RunUid) -> ConductorResult<()> {
        if !self.is_operated_since_start(run) {
            return Ok(());
        }
        let words = "a person has operated the rig since the start of the service, or its computer was suspended: \
                     start the run";
        Err(ConductorError::Forbidden(words.into()))
    }

    /// Refuses a run if a person has taken the operator lock. `since`: as in `Unattended`.
    pub(super) async fn require_no_lock(
        &self,
        run: &RunRow,
        since: Option<Timestamp>,
    ) -> ConductorResult<()> {
        let lock = self.inner.store.lock().await?;
        let (now, starters) = (Timestamp::now(), self.starters());
        let present = turn::Present { now, lock: lock.as_ref(), starters: &starters };
        let refusing = match (&lock, since) {
            (Some(lock), Some(since)) => Some(lock).filter(|lock| lock.since >= since),
            (lock, _) => lock.as_ref().filter(|_| !present.lets_begin(run)),
        };
        refusing.map_or(Ok(()), |lock| Err(locked(lock)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Terms;
    use super::super::stand_in::{asked, conductor, driven, earlier, granted, queued_on, unasked};
    use super::*;
    use crate::campaign::shown::command::Inbox;
    use crate::campaign::shown::show;
    use crate::state::StoredState;

    /// Why a run is dropped.
    const RUN_ABORTED: &str = "a run was aborted";

    /// A person aborts a run, and the campaign is told.
    async fn abort(conductor: &Conductor, run: &RunRow, inbox: &mut Inbox) {
        let told = async {
            let answer = asked(inbox, |request| matches!(request, Request::CameLate)).await;
            inbox.status.send_modify(|status| status.attended.note(RUN_ABORTED));
            let _ = answer.send(Ok(()));
        };
        let (aborted, ()) = tokio::join!(conductor.abort_undriven(run), told);
        assert!(aborted.unwrap());
    }

    #[tokio::test]
    async fn after_an_abort_of_a_run_before_it_is_taken_over_none_behind_it_begins() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, next] = earlier(&conductor).await;
        // The database is still examined.
        abort(&conductor, &driven, &mut inbox).await;
        let taken = conductor.resume_after_restart(AutoResume::Allowed);
        unasked(&mut inbox, taken).await.unwrap();
        assert_eq!(conductor.why_dropped(next.uid), Some(format!("{RUN_ABORTED}: start it again")));
        assert!(conductor.inner.store.waiting_runs().await.unwrap().is_empty());
    }

    #[tokio::test]
    async fn after_an_abort_of_a_run_not_driven_yet_the_next_process_begins_none_behind_it() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, next] = earlier(&conductor).await;
        let following = tokio::spawn(conductor.clone().follow());
        // The rig is not reached yet, and this process ends before it is.
        abort(&conductor, &driven, &mut inbox).await;
        let dropped = async {
            while !conductor.inner.store.waiting_runs().await.unwrap().is_empty() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), dropped).await.expect("it is dropped");
        assert_eq!(conductor.why_dropped(next.uid), Some(format!("{RUN_ABORTED}: start it again")));
        following.abort();
        let _ = following.await;
    }

    #[tokio::test]
    async fn a_service_that_drives_no_rig_leaves_the_runs_to_the_next_one() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, next] = earlier(&conductor).await;
        let taken = conductor.resume_after_restart(AutoResume::Later);
        unasked(&mut inbox, taken).await.unwrap();
        conductor.keep_stopped().await;
        assert_eq!(conductor.present(&driven).await.unwrap().state, StoredState::Running);
        let waiting = conductor.inner.store.waiting_runs().await.unwrap();
        assert_eq!(waiting.iter().map(|run| run.uid).collect::<Vec<_>>(), [next.uid]);
        assert_eq!(conductor.why_dropped(next.uid), None);
    }

    #[tokio::test]
    async fn after_an_abort_of_a_run_as_it_is_taken_over_none_behind_it_begins() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, next] = earlier(&conductor).await;
        let aborts = async {
            let answer = asked(&mut inbox, |request| matches!(request, Request::Connect)).await;
            abort(&conductor, &driven, &mut inbox).await;
            let _ = answer.send(Ok(()));
            inbox.next().await
        };
        let taken = tokio::select! {
            taken = conductor.resume_after_restart(AutoResume::Allowed) => taken,
            // Nothing is homed for it.
            asked = aborts => panic!("{asked:?}"),
        };
        assert!(matches!(taken, Err(ConductorError::Forbidden(_))), "{taken:?}");
        assert_eq!(conductor.why_dropped(next.uid).as_deref(), Some(NOT_DRIVEN));
        let words = conductor.not_begun().await.unwrap();
        assert!(words.is_some_and(|words| words.ends_with(NOT_DRIVEN)));
        assert!(conductor.still_waiting().await.unwrap().is_empty());
    }

    #[tokio::test]
    async fn a_run_that_is_held_as_it_is_taken_over_is_not_driven() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, next] = earlier(&conductor).await;
        let holds = async {
            let answer = asked(&mut inbox, |request| matches!(request, Request::Connect)).await;
            let noted = granted(&mut inbox, |request| matches!(request, Request::CameLate));
            let held = conductor.hold_undriven(driven.uid, Request::PauseNow);
            let (held, ()) = tokio::join!(held, noted);
            assert!(!held.unwrap(), "it has not begun");
            // The next process does not drive it either.
            assert!(!conductor.present(&driven).await.unwrap().is_driven());
            let _ = answer.send(Ok(()));
            inbox.next().await
        };
        let taken = tokio::select! {
            taken = conductor.resume_after_restart(AutoResume::Allowed) => taken,
            // Nothing is homed for it.
            asked = holds => panic!("{asked:?}"),
        };
        assert!(matches!(taken, Err(ConductorError::Forbidden(_))), "{taken:?}");
        let state = conductor.present(&driven).await.unwrap().state;
        assert_eq!(state, StoredState::Interrupted);
        assert!(conductor.why_dropped(next.uid).is_some());
    }

    #[tokio::test]
    async fn a_run_is_not_given_up_because_the_store_fails_once() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, next] = earlier(&conductor).await;
        conductor.inner.store.close().await;
        let before = Unattended { since: None, signs: 0 };
        let waits = async {
            tokio::select! {
                driven = conductor.drive_again(&driven, before) => panic!("{driven:?}"),
                due = conductor.first_due(vec![next]) => panic!("{due:?}"),
                () = tokio::time::sleep(RESTART_PAUSE / 2) => {}
            }
        };
        unasked(&mut inbox, waits).await;
    }

    #[tokio::test]
    async fn a_pause_of_a_run_that_has_just_begun_reaches_it() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [driven, _next] = earlier(&conductor).await;
        let job = conductor.prepare_stored(&driven).await.unwrap().job(&driven);
        inbox.status.send_modify(|status| status.run = Some(show::started(&job)));
        let paused = granted(&mut inbox, |request| matches!(request, Request::PauseNow));
        let held = conductor.hold_undriven(driven.uid, Request::PauseNow);
        let (held, ()) = tokio::join!(held, paused);
        assert!(held.unwrap());
    }

    #[tokio::test]
    async fn none_of_several_runs_begins_after_a_sign_although_the_store_fails() {
        let (conductor, _inbox, _folder) = conductor().await;
        let runs = earlier(&conductor).await;
        conductor.let_wait(runs.iter().map(|run| run.uid));
        conductor.inner.store.close().await;
        conductor.drop_each(&runs, RUN_ABORTED).await.unwrap_err();
        assert!(conductor.waiting().is_empty());
        for run in &runs {
            assert_eq!(conductor.why_dropped(run.uid).as_deref(), Some(RUN_ABORTED));
        }
    }

    #[tokio::test]
    async fn nothing_homes_for_a_run_after_a_lock_was_taken_while_the_wires_were_opened() {
        let (conductor, mut inbox, _folder) = conductor().await;
        earlier(&conductor).await;
        let homing = async {
            let answer = asked(&mut inbox, |request| matches!(request, Request::Connect)).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
            conductor.inner.store.set_lock("bob", "hands in the rig").await.unwrap();
            inbox.status.send_modify(|status| status.rig.state = RigState::Disarmed);
            let _ = answer.send(Ok(()));
            tokio::time::timeout(2 * RESTART_PAUSE, inbox.next()).await
        };
        let asked = tokio::select! {
            taken = conductor.resume_after_restart(AutoResume::Allowed) => panic!("{taken:?}"),
            asked = homing => asked,
        };
        assert!(asked.is_err(), "{asked:?}");
    }

    #[tokio::test]
    async fn a_run_that_a_person_has_started_is_not_taken_over() {
        let (conductor, inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let job = conductor.prepare_stored(&run).await.unwrap().job(&run);
        driven(&conductor, &run).await;
        let one_at_a_time = conductor.inner.beginning.lock().await;
        let taken = conductor.resume_after_restart(AutoResume::Allowed);
        let begins = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            inbox.status.send_modify(|status| status.run = Some(show::started(&job)));
            drop(one_at_a_time);
        };
        let both = async { tokio::join!(taken, begins).0 };
        tokio::time::timeout(Duration::from_secs(60), both).await.expect("at once").unwrap();
        assert_eq!(conductor.present(&run).await.unwrap().state, StoredState::Running);
    }
}
