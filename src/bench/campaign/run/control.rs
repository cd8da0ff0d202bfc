//! Where requests meet the state machines: what is allowed, the next state, the published status.
//! All of it happens in memory; the diary stores it afterwards.
//! Uses: `campaign::{shown::command, run::{job, run_state, unattended}, bench::rig_state, shown::status, diary}`.
//! Never: motion, wires, a wait for the store except while the tips are up (`flush`, `at_rest`,
//! `taken_lock`).

use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tokio::time::Instant;

use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::rig_state::{self, RigEvent, RigState};
use crate::campaign::diary::{Diary, Note};
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::Beginning;
use crate::campaign::run::run_state::{self, PausedWhy, RunAction, RunEvent, RunState};
use crate::campaign::run::unattended::{self, Unattended};
use crate::campaign::shown::command::{Envelope, Inbox, Moment, Refusal, Request};
use crate::campaign::shown::run_action::doing;
use crate::campaign::shown::status::{Phase, RunStatus, Status};
use crate::ids::RunUid;
use crate::journal::{Journal, JournalError};
use crate::record::Untouched;
use crate::state::StateChange;
use crate::suspension::Suspensions;

/// Longest wait for the store, for a trial or for earlier notes to be durable.
pub const STORE_LIMIT: Duration = Duration::from_secs(30);
/// Why no waiting run begins after an abort of a motion outside a run.
const MOTION_ABORTED: &str = "a motion of the rig was aborted, and a person may be at it";
/// Why no waiting run begins after a pause or an abort that came too late for the run before it.
const CAME_LATE: &str =
    "a pause or an abort of a run that did not move was requested, and a person may be at the rig";
/// Why no waiting run begins after a run that ended before a pause that was requested of it.
pub const ENDED_PAUSING: &str =
    "a pause of the run before it was requested as it ended, and a person may be at the rig";
/// Period at which requests are checked while waiting for the store or for a reply, wall time.
const REQUESTS_POLL: Duration = Duration::from_millis(20);

/// States of rig and run, pending requests, and the published status.
pub struct Control {
    /// Incoming requests, and the channels for status and frames.
    pub inbox: Inbox,
    /// Stop button of the rig.
    pub estop: StopSwitch,
    /// Records everything that happens.
    pub diary: Diary,
    /// Reads what is stored.
    pub journal: Arc<dyn Journal>,
    /// Notices that the computer was suspended.
    pub suspensions: Suspensions,
    /// The motion that no person has requested, if there is one: who operates the rig ends it, too.
    pub unattended: Option<Unattended>,
    rig: RigState,
    run: RunState,
    current: Option<RunUid>,
    suspended_for: Option<String>,
    leaving: bool,
    estop_noted: bool,
    /// When a person operated the rig last, as it moved or before its run, and started or resumed no run since.
    operated: Option<Instant>,
}

impl Control {
    /// Creates a control without open wires and without a run.
    pub fn new(inbox: Inbox, estop: StopSwitch, diary: Diary, journal: Arc<dyn Journal>) -> Self {
        Self {
            inbox,
            estop,
            diary,
            journal,
            suspensions: Suspensions::watch(),
            unattended: None,
            rig: RigState::Disconnected,
            run: RunState::Idle,
            current: None,
            suspended_for: None,
            leaving: false,
            estop_noted: false,
            operated: None,
        }
    }

    /// Returns the state of the rig.
    pub fn rig(&self) -> RigState {
        self.rig
    }

    /// Returns the state of the run.
    pub fn run(&self) -> RunState {
        self.run
    }

    /// Changes the published status.
    pub fn show(&self, change: impl FnOnce(&mut Status)) {
        self.inbox.status.send_modify(|status| status.change(Timestamp::now(), change));
    }

    /// Changes the published status of the run, if there is one.
    pub fn show_run(&self, change: impl FnOnce(&mut RunStatus)) {
        self.show(|status| {
            if let Some(run) = status.run.as_mut() {
                change(run);
            }
        });
    }

    /// Publishes the phase of the run.
    pub fn phase(&self, phase: Phase) {
        self.show_run(|run| run.phase = phase);
    }

    /// Publishes a sign that a person may be at the rig, with the reason: no waiting run begins by itself.
    pub fn attended(&self, why: &str) {
        self.show(|status| status.attended.note(why));
    }

    /// Publishes that a pause or an abort came too late for its run: a sign of a person.
    pub fn came_late(&self) {
        self.attended(CAME_LATE);
    }

    /// Why a person may have come to the rig after the first `signs`, as text; none if there was no further sign.
    pub fn attended_since(&self, signs: u64) -> Option<String> {
        let status = self.inbox.status.borrow();
        (status.attended.signs != signs).then(|| status.attended.why.clone())
    }

    /// Applies an event to the state of the rig and publishes the new state.
    ///
    /// # Errors
    /// `Refusal::State` if the state does not allow the event.
    pub fn rig_event(&mut self, event: RigEvent) -> Result<(), Refusal> {
        let next = rig_state::step(self.rig, event).map_err(|e| Refusal::State(e.to_string()))?;
        self.estop_noted &= next == RigState::Tripped;
        let changed = next != self.rig;
        self.rig = next;
        self.show(|status| status.rig.state = next);
        if changed {
            self.say("rig", json!({ "state": next }));
        }
        Ok(())
    }

    /// Latches a trip in memory, then records it. The first cause is shown until the reset, except
    /// that an e-stop replaces it: that requires a person in any case.
    pub fn latch(&mut self, trip: &Trip) {
        let stop = trip.kind == TripKind::Estop;
        if stop && std::mem::replace(&mut self.estop_noted, true) {
            return;
        }
        let first = stop || self.rig != RigState::Tripped;
        // A trip is allowed in every state with open wires; without wires there is nothing to
        // latch.
        let _ = self.rig_event(RigEvent::Trip);
        self.show(|status| {
            if first {
                status.rig.trip = Some(trip.clone());
            }
            if status.run.is_none() || !trip.kind.may_pass() {
                status.attended.note(format!("the rig tripped ({})", trip.detail));
            }
        });
        self.say("trip", json!(trip));
    }

    /// Starts the state machine of a run.
    ///
    /// # Errors
    /// `Refusal::State` if another run is active.
    pub fn begin(&mut self, run: RunUid, beginning: Beginning) -> Result<(), Refusal> {
        self.current = Some(run);
        let before = self.operated;
        self.run_event(RunEvent::Start)?;
        self.operated = beginning.operated(before);
        Ok(())
    }

    /// Applies an event to the state of the run, publishes and records the new state. Returns what
    /// the engine must do.
    ///
    /// # Errors
    /// `Refusal::State` if the state does not allow the event.
    pub fn run_event(&mut self, event: RunEvent) -> Result<RunAction, Refusal> {
        let (next, action) =
            run_state::step(self.run, event).map_err(|e| Refusal::State(e.to_string()))?;
        let changed = next != self.run;
        self.run = next;
        if changed {
            self.publish_run_state(next);
        }
        Ok(action)
    }

    fn publish_run_state(&mut self, state: RunState) {
        let change = state.change();
        if state == RunState::Running {
            // They belong to an earlier halt.
            (self.suspended_for, self.operated) = (None, None);
        }
        self.show_run(|run| {
            run.state = change.state;
            run.requested_state = change.requested;
            run.paused_why = change.why;
            if state == RunState::Running {
                run.waiting_for = None;
                run.wanted = None;
            }
        });
        // The end of a run is recorded by `EndRun`, with its status.
        if let Some(run) = self.current.filter(|_| state != RunState::Idle) {
            let StateChange { state, requested, why } = change;
            self.diary.note(Note::RunState(run, change));
            self.say("state", json!({ "state": state, "requested": requested, "why": why }));
        }
    }

    /// Id of the active run.
    pub fn run_uid(&self) -> Option<RunUid> {
        self.current
    }

    /// Publishes a frame of the untouched skin, and records it if a run is active.
    pub fn untouched(&self, skin: Untouched) {
        let skin = Arc::new(skin);
        if let Some(run) = skin.run {
            self.diary.note(Note::Untouched(run, skin.clone()));
        }
        self.inbox.untouched.send_replace(Some(skin));
    }

    /// Ends the run: later events belong to no run.
    pub fn forget_run(&mut self) {
        self.current = None;
        self.run = RunState::Idle;
        self.unattended = None;
    }

    /// Whether the thread was asked to end. The run stays open and resumes after a restart.
    pub fn leaving(&self) -> bool {
        self.leaving
    }

    /// Asks the thread to end.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// Records an event for people.
    pub fn say(&self, kind: &str, data: serde_json::Value) {
        self.diary.note(Note::Event { run: self.current, kind: kind.into(), data });
    }

    /// Waits for the store while nothing moves and the tips are up, and meanwhile accepts requests.
    ///
    /// # Errors
    /// A stop, a request that halts the run, or a store that fails or does not answer.
    pub async fn at_rest<T>(
        &mut self,
        work: impl Future<Output = Result<T, JournalError>>,
    ) -> Result<T, Halt> {
        match self.attending(tokio::time::timeout(STORE_LIMIT, work)).await? {
            Ok(outcome) => Ok(outcome?),
            Err(_late) => Err(Halt::Store(silent())),
        }
    }

    /// Waits for the store or for the reply of a device, and meanwhile accepts requests: a silent wire delays none.
    ///
    /// # Errors
    /// As `attend`; the work is dropped.
    pub async fn attending<T>(&mut self, work: impl Future<Output = T>) -> Result<T, Halt> {
        let mut work = std::pin::pin!(work);
        loop {
            tokio::select! {
                biased;
                done = &mut work => return Ok(done),
                () = tokio::time::sleep(REQUESTS_POLL) => self.attend()?,
            }
        }
    }

    /// As `attending`, for a raise, which no request ends; `is_asked` is set once there was one. Returns its result, and
    /// that of `attend` meanwhile.
    ///
    /// # Errors
    /// The newest trip of `attend`, which states a suspension only once, otherwise its first request, next to the
    /// result.
    pub async fn attending_to_the_end<T>(
        &mut self,
        raise: impl Future<Output = T>,
        is_asked: &Cell<bool>,
    ) -> (T, Result<(), Halt>) {
        let mut raise = std::pin::pin!(raise);
        let mut asked = Ok(());
        loop {
            tokio::select! {
                biased;
                done = &mut raise => return (done, asked),
                () = tokio::time::sleep(REQUESTS_POLL) => {
                    let now = self.attend();
                    if asked.is_ok() || now.as_ref().is_err_and(|halt| halt.as_trip().is_some()) {
                        asked = now;
                    }
                    is_asked.set(asked.is_err());
                }
            }
        }
    }

    /// Waits until all notes are durable. For use at rest.
    ///
    /// # Errors
    /// The store fails or does not answer; the notes are kept.
    pub async fn flush(&self) -> Result<(), JournalError> {
        tokio::time::timeout(STORE_LIMIT, self.diary.flush()).await.unwrap_or(Err(silent()))
    }

    /// What must come before anything moves, as text: a person has taken the operator lock after this, for example with
    /// hands in the rig, or the store does not answer.
    pub async fn taken_lock(&self, since: Moment) -> Option<String> {
        let taken = unattended::taken_lock(self.journal.as_ref(), since);
        taken.await.unwrap_or_else(Some)
    }

    /// Whether the computer was suspended since this was last asked, as text. Drives then have moved to their targets
    /// unwatched, and a person may have come to the rig.
    pub fn was_suspended(&mut self) -> Option<String> {
        let time = self.suspensions.newest()?;
        Some(format!("the computer was suspended for {} s", time.as_secs()))
    }

    /// Accepts pending requests. Called before every motion, and at every poll of motion, settling and waiting.
    ///
    /// # Errors
    /// `Halt::Trip` for an e-stop and after a suspension of the computer, `Halt::Asked` for a request that needs the
    /// tips up, once the thread was asked to end, and once a person ends an unattended motion: the rig must be made safe
    /// immediately.
    pub fn attend(&mut self) -> Result<(), Halt> {
        if let Some(press) = self.estop.pressed() {
            return Err(Halt::trip(TripKind::Estop, press.why));
        }
        if let Some(words) = self.was_suspended() {
            return Err(Halt::trip(TripKind::Service, words));
        }
        if self.leaving {
            return Err(Halt::Asked);
        }
        while let Some(envelope) = self.inbox.pending() {
            let action = self.take_up_while_moving(envelope);
            if action == Some(RunAction::Raise) || self.leaving {
                return Err(Halt::Asked);
            }
        }
        let motion = self.unattended.as_ref();
        let is_ended = motion.is_some_and(|motion| self.operated.is_some() || motion.is_locked());
        if is_ended { Err(Halt::Asked) } else { Ok(()) }
    }

    /// Called after a commit, and before the tips go down: leaves the configuration if a pause or a stop was requested.
    ///
    /// # Errors
    /// As `attend`; `Halt::Checkpoint` while pausing or stopping.
    pub fn checkpoint(&mut self) -> Result<(), Halt> {
        self.attend()?;
        match self.run {
            RunState::Pausing(_) | RunState::Stopping => Err(Halt::Checkpoint),
            RunState::Idle
            | RunState::Running
            | RunState::Paused(_)
            | RunState::Aborting
            | RunState::Suspending(_)
            | RunState::Panicked => Ok(()),
        }
    }

    fn take_up_while_moving(&mut self, envelope: Envelope) -> Option<RunAction> {
        let Envelope { request, answer, .. } = envelope;
        if matches!(request, Request::CameLate) {
            self.came_late();
            let _ = answer.send(Ok(()));
            return None;
        }
        if request.rig_action().is_some() {
            self.operated = Some(Instant::now());
        }
        let is_pause = matches!(request, Request::PauseAtCheckpoint | Request::PauseNow);
        if is_pause && self.run == RunState::Stopping {
            // It is refused, and the run ends before it.
            self.attended(ENDED_PAUSING);
        }
        let outcome = match self.run {
            RunState::Idle => self.asked_without_run(&request),
            _ => self.asked_of_run(&request),
        };
        let action = outcome.as_ref().ok().copied();
        // The client may have disconnected; its request still holds.
        let _ = answer.send(outcome.map(|_| ()));
        action
    }

    /// Homing or jogging outside a run ends when the service ends, or by an abort.
    fn asked_without_run(&mut self, request: &Request) -> Result<RunAction, Refusal> {
        match self.run_request(request) {
            Some(event) if self.leaving || event == RunEvent::Abort => {
                if event == RunEvent::Abort {
                    self.attended(MOTION_ABORTED);
                }
                Ok(RunAction::Raise)
            }
            Some(event) => self.run_event(event),
            None => {
                let what = request.name();
                Err(Refusal::Busy(format!("{what} is not possible while the rig moves")))
            }
        }
    }

    fn asked_of_run(&mut self, request: &Request) -> Result<RunAction, Refusal> {
        let refused = request.refused_by_run(&self.inbox.status.borrow());
        if let Some(words) = refused {
            return Err(Refusal::State(words));
        }
        let what = request.name();
        match self.run_request(request) {
            // A paused run whose rig homes: it resumes once the rig is ready, not before.
            Some(RunEvent::Resume) if matches!(self.run, RunState::Paused(_)) => {
                Err(Refusal::State(format!("{what} is not possible while the rig moves")))
            }
            Some(event) => self.run_event(event),
            None => {
                let status = self.inbox.status.borrow();
                let doing = status.run.as_ref().map_or_else(|| "the rig moves".into(), doing);
                let next = self.run.allowed();
                Err(Refusal::State(format!("{what} is not possible while {doing}: {next}")))
            }
        }
    }

    /// Whether a person tried to operate the rig while it moved, since this was last taken.
    pub fn take_operated(&mut self) -> bool {
        self.operated.take().is_some()
    }

    /// Whether a person has requested something of the rig within this time, also during a run before, and started or
    /// resumed none since.
    pub fn is_operated_within(&self, time: Duration) -> bool {
        self.operated.is_some_and(|at| at.elapsed() <= time)
    }

    /// Event of the run that a request means; none for requests to the rig.
    pub fn run_request(&mut self, request: &Request) -> Option<RunEvent> {
        match request {
            Request::PauseAtCheckpoint => Some(RunEvent::PauseAtCheckpoint),
            Request::PauseNow => Some(RunEvent::PauseNow),
            Request::Suspend(_, why) => {
                let event = RunEvent::Suspend(PausedWhy::Suspender);
                let is_accepted = run_state::step(self.run, event).is_ok();
                self.suspended_for = is_accepted.then(|| why.clone());
                Some(event)
            }
            Request::Resume => Some(RunEvent::Resume),
            Request::Stop => Some(RunEvent::Stop),
            Request::Abort | Request::AbortMotion => Some(RunEvent::Abort),
            Request::Shutdown => {
                self.leaving = true;
                Some(RunEvent::Suspend(PausedWhy::Restart))
            }
            Request::Connect
            | Request::Disconnect
            | Request::Home
            | Request::HomeForRun
            | Request::Jog { .. }
            | Request::Tare
            | Request::Reset
            | Request::Mounted { .. }
            | Request::Start(_)
            | Request::Confirm { .. }
            | Request::Repeat { .. }
            | Request::CameLate => None,
        }
    }

    /// Takes the reason for which a suspender requested a halt, if there is one.
    pub fn take_suspended_for(&mut self) -> Option<String> {
        self.suspended_for.take()
    }
}

fn silent() -> JournalError {
    JournalError::of("a record", &format!("no answer within {} s", STORE_LIMIT.as_secs()))
}
