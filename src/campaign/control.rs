//! Requests meet the state machines here: what is allowed, what it leads to, what is shown.
//! Uses: `campaign::{command, run_state, rig_state, status}`. Never: motion, wires.

use std::sync::Arc;

use jiff::Timestamp;
use serde_json::json;

use super::command::{Envelope, Inbox, Refusal, Request};
use super::estop::StopSwitch;
use super::halt::Halt;
use super::interlock::{Trip, TripKind};
use super::journal::Journal;
use super::rig_state::{self, RigEvent, RigState};
use super::run_state::{self, PausedWhy, RunAction, RunEvent, RunState};
use super::status::{Phase, RunStatus, Status};
use crate::ids::RunUid;

/// The states of rig and run, the requests, and the status that is shown.
pub struct Control {
    /// Requests and the places where status and frames go.
    pub inbox: Inbox,
    /// The stop button.
    pub estop: StopSwitch,
    /// Where events go.
    pub journal: Arc<dyn Journal>,
    rig: RigState,
    run: RunState,
    current: Option<RunUid>,
    suspended_for: Option<String>,
    leaving: bool,
}

impl Control {
    /// A control with no wires open and no run.
    pub fn new(inbox: Inbox, estop: StopSwitch, journal: Arc<dyn Journal>) -> Self {
        Self {
            inbox,
            estop,
            journal,
            rig: RigState::Disconnected,
            run: RunState::Idle,
            current: None,
            suspended_for: None,
            leaving: false,
        }
    }

    /// The rig's state.
    pub fn rig(&self) -> RigState {
        self.rig
    }

    /// The run's state.
    pub fn run(&self) -> RunState {
        self.run
    }

    /// Changes what is shown.
    pub fn show(&self, change: impl FnOnce(&mut Status)) {
        self.inbox.status.send_modify(|status| {
            change(status);
            status.version += 1;
        });
    }

    /// Changes what is shown of the run.
    pub fn show_run(&self, change: impl FnOnce(&mut RunStatus)) {
        self.show(|status| {
            if let Some(run) = status.run.as_mut() {
                change(run);
            }
        });
    }

    /// Shows what the run is doing.
    pub fn phase(&self, phase: Phase) {
        self.show_run(|run| run.phase = phase);
    }

    /// Moves the rig's state.
    pub async fn rig_event(&mut self, event: RigEvent) -> Result<(), Refusal> {
        let next = rig_state::step(self.rig, event).map_err(|e| Refusal::State(e.to_string()))?;
        let changed = next != self.rig;
        self.rig = next;
        self.show(|status| status.rig.state = next);
        if changed {
            self.say("rig", json!({ "state": next })).await;
        }
        Ok(())
    }

    /// Latches a trip, and says so.
    pub async fn trip(&mut self, trip: &Trip) {
        let shown = trip.clone();
        self.show(|status| status.rig.trip = Some(shown));
        // A trip is allowed from every state with open wires; without any there is nothing to latch.
        let _ = self.rig_event(RigEvent::Trip).await;
        self.say("trip", json!(trip)).await;
    }

    /// Begins a run's states.
    pub async fn begin(&mut self, run: RunUid) -> Result<(), Refusal> {
        self.current = Some(run);
        self.run_event(RunEvent::Start).await.map(|_| ())
    }

    /// Moves the run's state, stores it, shows it.
    pub async fn run_event(&mut self, event: RunEvent) -> Result<RunAction, Refusal> {
        let (next, action) =
            run_state::step(self.run, event).map_err(|e| Refusal::State(e.to_string()))?;
        let changed = next != self.run;
        self.run = next;
        if changed {
            self.publish_run_state(next).await;
        }
        Ok(action)
    }

    async fn publish_run_state(&mut self, state: RunState) {
        let requested = match state {
            RunState::Pausing(_) | RunState::Suspending(_) => Some("paused"),
            RunState::Stopping | RunState::Aborting => Some("idle"),
            RunState::Idle | RunState::Running | RunState::Paused(_) | RunState::Panicked => None,
        };
        self.show_run(|run| {
            run.state = state.as_str().into();
            run.requested_state = requested.map(Into::into);
            run.paused_why = state.why();
            if state == RunState::Running {
                run.waiting_for = None;
                run.wanted = None;
            }
        });
        // An end is stored by `end_run`, with its status.
        if let Some(run) = self.current.filter(|_| state != RunState::Idle) {
            let why = state.why().map(PausedWhy::as_str);
            let now = Timestamp::now();
            let stored = self.journal.run_state(run, state.as_str(), requested, why, now).await;
            if let Err(error) = stored {
                tracing::error!(%error, "the run's state was not stored");
            }
            let data = json!({ "state": state.as_str(), "requested": requested, "why": why });
            self.say("state", data).await;
        }
    }

    /// Events belong to no run from now on.
    pub fn forget_run(&mut self) {
        self.current = None;
        self.run = RunState::Idle;
    }

    /// Whether the thread has been asked to end: the run is left open, to go on after a restart.
    pub fn leaving(&self) -> bool {
        self.leaving
    }

    /// Asks the thread to end.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// Stores an event for people. A store that cannot take it does not stop the rig here: the next
    /// trial's commit will.
    pub async fn say(&self, kind: &str, data: serde_json::Value) {
        if let Err(error) = self.journal.event(self.current, kind, data, Timestamp::now()).await {
            tracing::error!(%error, kind, "an event was not stored");
        }
    }

    /// Takes up what was asked for meanwhile. Called at every poll of motion, settling and waiting
    /// for frames; an error means that the tips must be raised now.
    pub async fn attend(&mut self) -> Result<(), Halt> {
        if let Some(press) = self.estop.pressed() {
            return Err(Halt::trip(TripKind::Estop, press.why));
        }
        while let Ok(envelope) = self.inbox.requests.try_recv() {
            let action = self.take_up_while_running(envelope).await;
            if action == Some(RunAction::Raise) {
                return Err(Halt::Asked);
            }
        }
        Ok(())
    }

    /// After a commit: leaves the configuration if a pause or a stop was asked for.
    pub async fn checkpoint(&mut self) -> Result<(), Halt> {
        self.attend().await?;
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

    async fn take_up_while_running(&mut self, envelope: Envelope) -> Option<RunAction> {
        let answer = match self.run_request(&envelope.request) {
            Some(event) => self.run_event(event).await,
            None => Err(Refusal::State(format!(
                "{} is not possible while a run is {}",
                name(&envelope.request),
                self.run.as_str()
            ))),
        };
        let action = answer.as_ref().ok().copied();
        // The asker may have gone; what was asked for still holds.
        let _ = envelope.answer.send(answer.map(|_| ()));
        action
    }

    /// The event that a request means for a run, if it means one.
    pub fn run_request(&mut self, request: &Request) -> Option<RunEvent> {
        match request {
            Request::PauseAtCheckpoint => Some(RunEvent::PauseAtCheckpoint),
            Request::PauseNow => Some(RunEvent::PauseNow),
            Request::Suspend(why) => {
                self.suspended_for = Some(why.clone());
                Some(RunEvent::Suspend(PausedWhy::Suspender))
            }
            Request::Resume => Some(RunEvent::Resume),
            Request::Stop => Some(RunEvent::Stop),
            Request::Abort => Some(RunEvent::Abort),
            Request::Shutdown => {
                self.leaving = true;
                Some(RunEvent::Suspend(PausedWhy::Restart))
            }
            Request::Connect
            | Request::Disconnect
            | Request::Home
            | Request::Jog { .. }
            | Request::Tare
            | Request::Reset
            | Request::Start(_)
            | Request::Confirm { .. }
            | Request::Repeat { .. } => None,
        }
    }

    /// Why a suspender asked for a halt, once.
    pub fn take_suspended_for(&mut self) -> Option<String> {
        self.suspended_for.take()
    }
}

/// The request's name, for a refusal.
pub fn name(request: &Request) -> &'static str {
    match request {
        Request::Connect => "connect",
        Request::Disconnect => "disconnect",
        Request::Home => "home",
        Request::Jog { .. } => "jog",
        Request::Tare => "tare",
        Request::Reset => "reset",
        Request::Start(_) => "start",
        Request::PauseAtCheckpoint | Request::PauseNow => "pause",
        Request::Suspend(_) => "suspend",
        Request::Resume => "resume",
        Request::Stop => "stop",
        Request::Abort => "abort",
        Request::Confirm { .. } => "confirm",
        Request::Repeat { .. } => "repeat",
        Request::Shutdown => "shutdown",
    }
}
