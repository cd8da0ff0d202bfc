//! Requests that concern the rig alone: connect, home, jog, tare, reset.
//! Uses: `campaign::stage`, `rig::registry`. Never: the plan.

use serde_json::json;

use super::{Connection, Engine, no_wires, trip_of};
use crate::campaign::command::{Envelope, Refusal, Request};
use crate::campaign::control::{Control, name};
use crate::campaign::halt::Halt;
use crate::campaign::interlock;
use crate::campaign::rig_state::{RigEvent, RigState};
use crate::campaign::show;
use crate::campaign::stage::{AxisName, Stage};
use crate::campaign::tare;
use crate::clock::Clock;
use crate::rig::registry;

impl Engine {
    /// Takes up a request that concerns the rig alone.
    pub(super) async fn rig_request(&mut self, envelope: Envelope) {
        let Envelope { request, answer } = envelope;
        if let Err(refusal) = self.allowed(&request) {
            let _ = answer.send(Err(refusal));
            return;
        }
        match request {
            // Opening the wires answers with what went wrong; motions answer when taken up.
            Request::Connect => {
                let _ = answer.send(self.connect().await);
            }
            Request::Disconnect => {
                self.connection = None;
                let _ = answer.send(self.control.rig_event(RigEvent::Lost).await);
            }
            Request::Reset => {
                let _ = answer.send(self.reset().await);
            }
            Request::Home => {
                let _ = answer.send(Ok(()));
                self.home().await;
            }
            Request::Jog { axis, to_mm } => match self.jog_target(&axis, to_mm) {
                Ok(target) => {
                    let _ = answer.send(Ok(()));
                    self.guarded(|stage, control| {
                        Box::pin(async move { stage.travel(control, &[target], true).await })
                    })
                    .await;
                }
                Err(refusal) => {
                    let _ = answer.send(Err(refusal));
                }
            },
            Request::Tare => {
                let _ = answer.send(self.tare().await);
            }
            Request::Start(_)
            | Request::PauseAtCheckpoint
            | Request::PauseNow
            | Request::Suspend(_)
            | Request::Resume
            | Request::Stop
            | Request::Abort
            | Request::Confirm { .. }
            | Request::Repeat { .. }
            | Request::Shutdown => {
                let words = format!("{} is not possible: no run is under way", name(&request));
                let _ = answer.send(Err(Refusal::State(words)));
            }
        }
    }

    pub(super) fn allowed(&self, request: &Request) -> Result<(), Refusal> {
        let rig = self.control.rig();
        let ok = match request {
            Request::Connect => rig == RigState::Disconnected,
            Request::Home => matches!(rig, RigState::Disarmed | RigState::Homed),
            Request::Jog { .. } => rig == RigState::Homed,
            Request::Tare => rig != RigState::Disconnected,
            Request::Reset => rig == RigState::Tripped,
            Request::Disconnect => rig != RigState::Armed,
            Request::Start(_)
            | Request::PauseAtCheckpoint
            | Request::PauseNow
            | Request::Suspend(_)
            | Request::Resume
            | Request::Stop
            | Request::Abort
            | Request::Confirm { .. }
            | Request::Repeat { .. }
            | Request::Shutdown => true,
        };
        let words =
            || format!("{} is not possible while the rig is {}", name(request), rig.as_str());
        if ok { Ok(()) } else { Err(Refusal::State(words())) }
    }

    pub(super) async fn connect(&mut self) -> Result<(), Refusal> {
        let clock = Clock::new(self.config.clock_rate);
        let fail = |e: crate::rig::error::RigError| Refusal::State(e.to_string());
        let open =
            registry::open(&self.config, &clock, &self.control.estop.latch()).map_err(fail)?;
        for axis in open.bench.axes() {
            let found = axis.prepare().await.map_err(fail)?;
            self.control.say("device", json!({ "device": axis.name(), "found": found })).await;
        }
        let found = open.bench.cells.prepare().await.map_err(fail)?;
        self.control.say("device", json!({ "device": "cells", "found": found })).await;
        let stage = Stage::new(open.bench.clone(), self.config.clone(), clock);
        let estop = tokio::spawn(self.control.estop.clone().serve(open.bench.clone()));
        let frames = tokio::spawn(show::forward_frames(
            open.bench.skin.follow(),
            self.control.inbox.frames.clone(),
        ));
        self.connection = Some(Connection { open, stage, estop, frames });
        self.control.rig_event(RigEvent::Connected).await
    }

    pub(super) async fn reset(&mut self) -> Result<(), Refusal> {
        let connection = self.connection.as_mut().ok_or_else(no_wires)?;
        self.control.estop.release();
        for axis in connection.open.bench.axes() {
            axis.reset_alarm().await.map_err(|e| Refusal::State(e.to_string()))?;
        }
        self.control.show(|status| {
            status.rig.trip = None;
            status.rig.estop_acknowledged_ms = None;
        });
        self.control.rig_event(RigEvent::Reset).await
    }

    pub(super) async fn home(&mut self) -> bool {
        self.prepared_setting = None;
        let homed =
            self.guarded(|stage, control| Box::pin(async move { stage.home(control).await })).await;
        homed && self.control.rig_event(RigEvent::Homed).await.is_ok()
    }

    /// Runs a motion outside a run: a halt trips the rig and raises the tips.
    pub(super) async fn guarded<F>(&mut self, motion: F) -> bool
    where
        F: for<'a> FnOnce(
            &'a mut Stage,
            &'a mut Control,
        ) -> std::pin::Pin<
            Box<dyn std::future::Future<Output = Result<(), Halt>> + 'a>,
        >,
    {
        let Some(connection) = self.connection.as_mut() else { return false };
        match motion(&mut connection.stage, &mut self.control).await {
            Ok(()) => true,
            Err(halt) => {
                let trip = trip_of(halt);
                for axis in connection.open.bench.axes() {
                    if let Err(error) = axis.stop().await {
                        tracing::error!(axis = axis.name(), %error, "not stopped");
                    }
                }
                self.control.trip(&trip).await;
                false
            }
        }
    }

    pub(super) fn jog_target(&self, axis: &str, to_mm: f64) -> Result<(AxisName, f64), Refusal> {
        let connection = self.connection.as_ref().ok_or_else(no_wires)?;
        let axes = &self.config.axes;
        let slot = &self.config.slot;
        let (name, target, [min, max]) = match axis {
            "x" => (AxisName::X, to_mm, axes.x.travel_mm),
            "y" => (AxisName::Y, to_mm, axes.y.travel_mm),
            // By hand never into the skin: that is what a touch-off is for.
            "z" => (AxisName::Z, to_mm, [axes.z.travel_mm[0], connection.stage.clear_z_mm()]),
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
        Ok((name, target))
    }

    pub(super) async fn tare(&mut self) -> Result<(), Refusal> {
        let connection = self.connection.as_mut().ok_or_else(no_wires)?;
        let stage = &mut connection.stage;
        let reading = stage.bench.cells.read().await;
        let reading = reading.map_err(|e| Refusal::State(e.to_string()))?;
        stage.tips =
            interlock::live_tips(&self.config.cells, &reading.volts).map_err(Refusal::State)?;
        let tared = tare::tare(stage, &mut self.control, 4, true).await;
        tared.map(|_| ()).map_err(|halt| Refusal::State(trip_of(halt).detail))
    }
}
