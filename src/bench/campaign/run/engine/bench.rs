//! Requests that concern only the rig: connect, home, jog, tare, reset, and the tips that a person
//! has mounted.
//! Uses: `campaign::{bench::stage, bench::travel, safe_end}`, `rig::registry`. Never: the plan.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use tokio::sync::OwnedMutexGuard;
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::{
    Answer, Connection, DECIDED_WITHIN, Engine, JUST_MOVED, NO_JOG_AFTER_ABORT, Owed, no_stage,
    no_wires, trip_of,
};
use crate::campaign::bench::estop::AxisStop;
use crate::campaign::bench::interlock::{self, Trip, TripKind};
use crate::campaign::bench::rig_state::RigEvent;
use crate::campaign::bench::stage::{AxisName, Height, Stage};
use crate::campaign::bench::tare;
use crate::campaign::bench::travel::Target;
use crate::campaign::diary::Note;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::safe_end::raise_as_planned;
use crate::campaign::shown::command::{Envelope, Refusal, Request};
use crate::campaign::shown::safe_end::Tips;
use crate::campaign::shown::show;
use crate::campaign::shown::status::Motion;
use crate::clock::Clock;
use crate::journal::Mounting;
use crate::record::ARMS;
use crate::rig::error::RigError;
use crate::rig::link::Line;
use crate::rig::registry;
use crate::rig::setup::RigSetup;
use crate::rig::traits::{Bench, SkinReader};

/// Why no waiting run begins after an abort of a motion that had just ended.
const ABORTED_LATE: &str =
    "an abort of a motion was requested when it had ended, and a person may be at the rig";
/// Samples of a tare on request.
const TARE_SAMPLES: u32 = 4;
/// Longest wait of a reset, and of closing the wires, for axes that an e-stop is about to stop.
const DECELERATION_WAIT: Duration = Duration::from_secs(3);
/// Period of that wait.
const DECELERATION_POLL: Duration = Duration::from_millis(10);

impl Engine {
    /// Accepts a request that concerns only the rig.
    pub(super) async fn rig_request(&mut self, envelope: Envelope) {
        let Envelope { request, answer, presses, decided_at, .. } = envelope;
        self.decided_at = decided_at;
        let refused = {
            let status = self.control.inbox.status.borrow();
            request.rig_action().and_then(|action| action.refused_by_rig(&status.rig))
        };
        if let Some(words) = refused {
            let _ = answer.send(Err(Refusal::State(words)));
            return;
        }
        // Opening the wires answers with its result; motions answer when accepted.
        let outcome = match request {
            Request::Connect => self.connect(presses).await,
            Request::Disconnect => self.disconnect().await,
            Request::Reset => self.reset(presses, Some(&answer)).await,
            Request::Home | Request::HomeForRun => {
                let ready = self.require_complete(&answer).await;
                match ready.and_then(|()| self.control.rig_event(RigEvent::Homing)) {
                    Ok(()) => {
                        let _ = answer.send(Ok(()));
                        self.home_axes(matches!(request, Request::Home)).await;
                        return;
                    }
                    Err(refusal) => Err(refusal),
                }
            }
            Request::Jog { axis, to_mm } => {
                let ready = self.require_complete(&answer).await;
                match ready.and_then(|()| self.jog_target(&axis, to_mm)) {
                    Ok(target) => {
                        let _ = answer.send(Ok(()));
                        self.jog(target).await;
                        return;
                    }
                    Err(refusal) => Err(refusal),
                }
            }
            Request::Tare => self.tare().await,
            Request::Mounted { tips, who } => self.mounted(tips, &who, &answer).await,
            Request::CameLate => {
                self.control.came_late();
                Ok(())
            }
            Request::AbortMotion => {
                if self.moved_at.is_some_and(|at| at.elapsed() <= JUST_MOVED) {
                    self.aborted_at = Some(Instant::now());
                    self.control.attended(ABORTED_LATE);
                }
                Err(Refusal::State("abort is not possible: nothing moves".into()))
            }
            // Of a run.
            Request::Start(_)
            | Request::PauseAtCheckpoint
            | Request::PauseNow
            | Request::Suspend(..)
            | Request::Resume
            | Request::Stop
            | Request::Abort
            | Request::Confirm { .. }
            | Request::Repeat { .. }
            | Request::Shutdown => {
                let halts = matches!(
                    request,
                    Request::PauseAtCheckpoint | Request::PauseNow | Request::Abort
                );
                if halts {
                    self.control.came_late();
                }
                let words = format!("{} is not possible: no run is active", request.name());
                Err(Refusal::State(words))
            }
        };
        let _ = answer.send(outcome);
    }

    /// Closes the wires, unless a stop or a raise is still pending.
    pub(super) async fn disconnect(&mut self) -> Result<(), Refusal> {
        if let Some(axis) = self.not_stopped().await {
            return Err(Refusal::State(format!("disconnect is not possible: {axis}")));
        }
        if self.owed != Owed::Nothing {
            let words = "disconnect is not possible: the last safe end is not complete";
            return Err(Refusal::State(words.into()));
        }
        self.connection = None;
        // What was measured before is not what is now.
        let closed = show::closed(&self.config).rig;
        self.control.show(|status| {
            (status.rig.pose, status.rig.not_clear) = (closed.pose, None);
            status.rig.forces_n = closed.forces_n;
            status.rig.live_cells = closed.live_cells;
            status.rig.stream = closed.stream;
            status.rig.wires = closed.wires;
            // A further press of a latched e-stop reaches no axis now.
            status.rig.estop_acknowledged_ms = None;
            status.rig.estop_stops.clear();
        });
        self.control.rig_event(RigEvent::Lost)
    }

    /// First axis that the latched e-stop has not stopped, with the reason. One without a fault gets the time to
    /// acknowledge it and to decelerate.
    async fn not_stopped(&self) -> Option<String> {
        let deadline = Instant::now() + DECELERATION_WAIT;
        loop {
            let stops = self.control.estop.pressed()?.stops();
            let failed = stops.iter().find(|stop| stop.error.is_some());
            let moving = failed.or_else(|| stops.iter().find(|stop| stop.stood_ms.is_none()));
            let words = match moving {
                None if stops.is_empty() && self.stage().is_some() => {
                    "the stop has just been pressed".into()
                }
                None => return None,
                Some(AxisStop { axis, acknowledged_ms: None, error, .. }) => {
                    let why = error.as_deref().unwrap_or("no answer yet");
                    format!("{axis} has not acknowledged its stop: {why}")
                }
                Some(AxisStop { axis, error, .. }) => {
                    let why = error.as_deref().unwrap_or("acknowledged, and may still move");
                    format!("{axis} is not stopped: {why}")
                }
            };
            if failed.is_some() || Instant::now() > deadline {
                return Some(words);
            }
            tokio::time::sleep(DECELERATION_POLL).await;
        }
    }

    /// Opens the wires and takes control of every device. A drive in alarm is connected too, and
    /// trips the rig: a reset clears it. A last trip that was not reset latches again.
    ///
    /// A press of the e-stop after the first `presses`, those when it was requested, reaches every axis at once and
    /// ends it: the wires stay open for the stops, and the rig is tripped. The reset takes control of the devices.
    ///
    /// # Errors
    /// A wire does not open, a device does not reply or is not the one in the rig file, the stop is pressed
    /// meanwhile, or the state does not allow it.
    pub(super) async fn connect(&mut self, presses: u64) -> Result<(), Refusal> {
        let wires = self.control.inbox.wires.take().ok_or_else(|| {
            Refusal::State("a check of the rig uses its wires: wait for its end".into())
        })?;
        let clock = Clock::new(self.config.clock_rate());
        let fail = |e: RigError| Refusal::State(e.to_string());
        let config = match &self.config {
            RigSetup::Bench(config) => config.as_ref().clone(),
            RigSetup::Skin(skin) => {
                let skin = registry::open_skin(skin, &clock).map_err(fail)?;
                let tasks = JoinSet::new();
                return self.connected(skin, BTreeMap::new(), None, clock, wires, tasks);
            }
        };
        let open = registry::open(&config, &clock, &self.control.estop.latch()).map_err(fail)?;
        let tasks = self.serve_stops(&open.bench);
        let estop = self.control.estop.clone();
        let alarms = tokio::select! {
            biased;
            () = estop.pressed_after(presses) => None,
            alarms = self.take_control(&open.bench) => Some(alarms.map_err(fail)?),
        };
        let mut stage = Stage::new(open.bench.clone(), config, clock.clone());
        stage.samples = self.control.inbox.samples.clone();
        self.connected(open.bench.skin, open.lines, Some(stage), clock, wires, tasks)?;
        if let Some(press) = estop.pressed() {
            self.control.latch(&Trip { kind: TripKind::Estop, detail: press.why });
        }
        let Some(alarms) = alarms else {
            let words = "the stop was pressed while the wires were opened: reset, then home";
            return Err(Refusal::State(words.into()));
        };
        if !alarms.is_empty() {
            let detail = format!("{}; clear the cause, reset, home", alarms.join("; "));
            self.control.latch(&Trip { kind: TripKind::Device, detail });
        }
        Ok(())
    }

    /// Starts the task that stops every axis of a bench at each press of the e-stop, and now if it is latched.
    pub(super) fn serve_stops(&self, bench: &Bench) -> JoinSet<()> {
        let mut tasks = JoinSet::new();
        tasks.spawn(self.control.estop.clone().serve(bench.clone()));
        tasks
    }

    /// Takes control of every device. Returns the alarms of the drives.
    async fn take_control(&self, bench: &Bench) -> Result<Vec<String>, RigError> {
        let mut alarms = Vec::new();
        for axis in bench.axes() {
            match axis.prepare().await {
                Ok(found) => {
                    self.control.say("device", json!({ "device": axis.name(), "found": found }));
                }
                Err(error @ RigError::NotReady { .. }) => alarms.push(error.to_string()),
                Err(error) => return Err(error),
            }
        }
        let found = bench.cells.prepare().await?;
        self.control.say("device", json!({ "device": "cells", "found": found }));
        Ok(alarms)
    }

    /// Keeps the open wires with the tasks that use them, and forwards the frames.
    pub(super) fn connected(
        &mut self,
        skin: Arc<dyn SkinReader>,
        lines: BTreeMap<String, Arc<Line>>,
        stage: Option<Stage>,
        clock: Clock,
        wires: OwnedMutexGuard<()>,
        mut tasks: JoinSet<()>,
    ) -> Result<(), Refusal> {
        tasks.spawn(show::forward_frames(skin.follow(), self.control.inbox.frames.clone()));
        let connection = Connection { lines, skin, clock, stage, _tasks: tasks, _wires: wires };
        self.connection = Some(connection);
        self.owed = Owed::Nothing;
        let last = self.control.inbox.status.borrow().rig.trip.clone();
        self.control.rig_event(RigEvent::Connected)?;
        if let Some(trip) = last {
            self.control.latch(&trip);
        }
        Ok(())
    }

    pub(super) fn stage(&self) -> Option<&Stage> {
        self.connection.as_ref()?.stage.as_ref()
    }

    pub(super) fn stage_mut(&mut self) -> Result<&mut Stage, Refusal> {
        let connection = self.connection.as_mut().ok_or_else(no_wires)?;
        connection.stage.as_mut().ok_or_else(no_stage)
    }

    /// Resets a trip: every axis must reply, alarms are cleared, drives are prepared again, and the
    /// stop is released last. `presses`: presses of the stop when the reset was requested or decided; a later
    /// one holds. `answer`: of the request; none for an automatic reset. After an e-stop the tips then stay where they
    /// are until the rig is homed.
    ///
    /// # Errors
    /// An axis is not stopped, a device does not follow, the stop was pressed again, or the caller was told
    /// meanwhile that the reset failed. The rig then stays tripped.
    pub(super) async fn reset(
        &mut self,
        presses: u64,
        answer: Option<&Answer>,
    ) -> Result<(), Refusal> {
        if let Some(axis) = self.not_stopped().await {
            return Err(Refusal::State(format!("not reset: {axis}")));
        }
        let connection = self.connection.as_ref().ok_or_else(no_wires)?;
        let bench = connection.stage.as_ref().map(|stage| stage.bench.clone());
        let fail = |e: RigError| Refusal::State(format!("not reset: {e}"));
        if let Some(bench) = bench {
            for axis in bench.axes() {
                axis.status().await.map_err(fail)?;
            }
            for axis in bench.axes() {
                axis.reset_alarm().await.map_err(fail)?;
                axis.prepare().await.map_err(fail)?;
            }
            bench.cells.prepare().await.map_err(fail)?;
        }
        if answer.is_some_and(Answer::is_closed) {
            return Err(Refusal::Gone);
        }
        let was_stopped = self.control.estop.pressed().is_some();
        if !self.control.estop.release(presses) {
            return Err(Refusal::State("not reset: the stop was pressed again".into()));
        }
        if was_stopped {
            self.owed = Owed::Nothing;
        }
        self.prepared_setting = None;
        self.control.show(|status| {
            status.rig.trip = None;
            status.rig.safe_end = None;
            status.rig.estop_acknowledged_ms = None;
            status.rig.estop_stops.clear();
        });
        self.control.rig_event(RigEvent::Reset)
    }

    /// No axis is moved that has not acknowledged its stop, or moves after it: a safe end that is not complete is
    /// repeated first. A lock that was taken meanwhile, or while the request waited for `DECIDED_WITHIN`, holds.
    async fn require_complete(&mut self, answer: &Answer) -> Result<(), Refusal> {
        let mut is_late = self.decided_at.1.elapsed() > DECIDED_WITHIN;
        if let Owed::Wires(_, height) = self.owed {
            is_late = true;
            self.repeat_safe_end(height).await;
            self.require_nothing_owed()?;
        }
        if is_late && let Some(awaited) = self.control.taken_lock(self.decided_at).await {
            return Err(Refusal::Busy(format!("nothing moves before {awaited}")));
        }
        if answer.is_closed() { Err(Refusal::Gone) } else { Ok(()) }
    }

    /// Homes for a run that resumes automatically.
    pub(super) async fn home(&mut self) -> bool {
        self.control.rig_event(RigEvent::Homing).is_ok() && self.home_axes(false).await
    }

    /// `by_person`: whether a person has requested it.
    async fn home_axes(&mut self, by_person: bool) -> bool {
        self.prepared_setting = None;
        let entered = self.entered_tips();
        let homed = self
            .guarded(Motion::Homing, by_person, async |stage, control| {
                stage.home(control, entered).await
            })
            .await;
        if homed {
            self.owed = Owed::Nothing;
            // Its warning is over: each axis is at rest at its zero, z was raised first.
            self.control.show(|status| {
                status.rig.safe_end.take_if(|end| end.tips != Tips::Raised || !end.is_stopped());
            });
        }
        homed && self.control.rig_event(RigEvent::Homed).is_ok()
    }

    async fn jog(&mut self, target: Target) {
        let entered = self.entered_tips();
        self.guarded(Motion::Jog, true, async |stage, control| {
            control.attending(stage.assume_tips(entered)).await??;
            if target.axis != AxisName::Z {
                // The clearance may have grown since: other tips, or an unknown surface.
                raise_as_planned(control, stage).await?;
            }
            stage.begin_watch();
            stage.checked_travel(control, target).await
        })
        .await;
    }

    /// Runs a motion outside a run, which the status shows until it ends. Every early end leads to the safe end, and
    /// latches unless it was requested. `by_person`: whether a person has requested the motion.
    async fn guarded(
        &mut self,
        motion: Motion,
        by_person: bool,
        drive: impl AsyncFnOnce(&mut Stage, &mut Control) -> Result<(), Halt>,
    ) -> bool {
        let Some(stage) = self.connection.as_mut().and_then(|c| c.stage.as_mut()) else {
            return false;
        };
        self.control.show(|status| status.rig.motion = Some(motion));
        let outcome = drive(stage, &mut self.control).await;
        self.control.show(|status| status.rig.motion = None);
        self.moved_at = Some(Instant::now());
        if by_person || matches!(outcome, Err(Halt::Asked)) {
            self.operated_at = Instant::now();
        }
        let Err(halt) = outcome else { return true };
        let requested = self.control.leaving() || matches!(halt, Halt::Asked);
        let trip = (!requested).then(|| trip_of(&halt));
        self.make_safe(trip.as_ref(), Height::Clear).await;
        self.aborted_at = requested.then(Instant::now);
        false
    }

    fn jog_target(&self, axis: &str, to_mm: f64) -> Result<Target, Refusal> {
        if self.aborted_at.is_some_and(|at| at.elapsed() <= NO_JOG_AFTER_ABORT) {
            let within_s = NO_JOG_AFTER_ABORT.as_secs();
            let words = format!("jog is not possible within {within_s} s of an abort");
            return Err(Refusal::Busy(words));
        }
        let stage = self.stage().ok_or_else(no_wires)?;
        let axes = &stage.config.axes;
        let slot = &stage.config.slot;
        let (name, target, [min, max]) = match axis {
            "x" => (AxisName::X, to_mm, axes.x.travel_mm),
            "y" => (AxisName::Y, to_mm, axes.y.travel_mm),
            // Jogging never moves into the skin: that is done by the touch-off.
            "z" => (AxisName::Z, to_mm, [axes.z.travel_mm[0], stage.clear_z_mm()]),
            "radius" => (AxisName::Radial, slot.angle_deg(to_mm), slot.radius_mm),
            other => {
                let words = format!("axis = {other}: must be x, y, z or radius");
                return Err(Refusal::Value(words));
            }
        };
        if !(min..=max).contains(&to_mm) {
            let words = format!("to_mm = {to_mm}: {axis} must be from {min} to {max}");
            return Err(Refusal::Value(words));
        }
        Ok(Target::of(name, target))
    }

    /// Tare on request. It is refused unless z is measured clear of the skin, and if a cell is outside its limits; a
    /// failing wire, and a suspension of the computer, lead to the safe end.
    async fn tare(&mut self) -> Result<(), Refusal> {
        let entered = self.entered_tips();
        let connection = self.connection.as_mut().ok_or_else(no_wires)?;
        let stage = connection.stage.as_mut().ok_or_else(no_stage)?;
        let control = &mut self.control;
        let tared = tare::tare_on_request(stage, control, entered, TARE_SAMPLES).await;
        let Err(halt) = tared else { return Ok(()) };
        let trip = trip_of(&halt);
        let ends_safe = matches!(trip.kind, TripKind::Wire | TripKind::Device | TripKind::Service);
        if ends_safe && matches!(halt, Halt::Trip(_)) {
            self.make_safe(Some(&trip), Height::Clear).await;
        }
        Err(Refusal::State(trip.detail))
    }

    /// Tips that a person has entered.
    fn entered_tips(&self) -> Option<u8> {
        self.mounting.as_ref().map(|(mounting, _)| mounting.tips)
    }

    /// Accepts the number of tips that a person has mounted, if the cells do not contradict it.
    ///
    /// # Errors
    /// `tips` is more than the number of arms, no wires are open, the cell of an attached arm is disconnected, or the
    /// caller was told meanwhile that the entry failed.
    pub(super) async fn mounted(
        &mut self,
        tips: u8,
        who: &str,
        answer: &Answer,
    ) -> Result<(), Refusal> {
        if usize::from(tips) > ARMS {
            return Err(Refusal::Value(format!("tips = {tips}: must be 0 to {ARMS}")));
        }
        let stage = self.stage_mut()?;
        let reading = stage.bench.cells.read().await;
        let reading = reading.map_err(|e| Refusal::State(e.to_string()))?;
        let live = interlock::live_cells(&stage.config.cells, &reading.volts, tips);
        let live_cells = live.map_err(Refusal::State)?;
        if answer.is_closed() {
            return Err(Refusal::Gone);
        }
        let mounting = Mounting { tips, live_cells, who: who.into() };
        self.control.diary.note(Note::Mounted(mounting.clone()));
        self.control.say("tips", json!({ "tips": tips, "live_cells": live_cells, "who": who }));
        self.control.show(|status| status.rig.tips = Some(tips));
        let stage = self.stage_mut()?;
        stage.tips = tips;
        // The result of the touch-off may no longer be valid, nor the clearance that follows from it.
        stage.surface = None;
        self.mounting = Some((mounting, true));
        self.prepared_setting = None;
        Ok(())
    }
}
