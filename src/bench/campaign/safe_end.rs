//! The one safe end. Every motion that does not end as planned ends here: trip, pause now, abort,
//! suspension, lost device, failed homing, jog or reading of the cells, shutdown, a panic, a store
//! that fails.
//! Uses: `campaign::{run::control, bench::stage, bench::estop, bench::interlock}`. Never: the
//! store, a disk, a client. What happened is recorded in the diary, which does not block here.
//!
//! ```text
//! latch (memory) -> stop x, y, radial  |  stop z -> raise z      each axis independently
//!                          \           /
//!                     read each until it stands
//!                        publish and record the result
//! ```
//! After an e-stop nothing moves until a person releases it, and the tips stay where they are.

use std::cell::Cell;
use std::time::Duration;

use futures::future::join_all;
use serde_json::json;
use tokio::time::Instant;

use crate::campaign::bench::estop::{AxisStop, StopSwitch, stands};
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::stage::{Height, Raised, Stage};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::safe_end::{SafeEnd, Tips};
use crate::campaign::shown::status::Phase;
use crate::rig::traits::Axis;

/// Attempts to raise the tips before a person must inspect the rig.
const RAISE_TRIES: u32 = 3;
/// Pause between two attempts.
const RAISE_AGAIN: Duration = Duration::from_millis(200);

/// Makes the rig safe, then publishes the result. `trip` latches the rig. Without one (pause now,
/// abort, shutdown) the state of the rig does not change, unless the tips cannot be raised: that
/// latches too. `before`: result of the attempt that this one repeats; its event is stored only if the result differs.
pub async fn make_safe(
    control: &mut Control,
    stage: &mut Stage,
    trip: Option<&Trip>,
    height: Height,
    before: Option<&SafeEnd>,
) -> SafeEnd {
    // A good result of an earlier safe end no longer applies. The warning of a bad one stays until a
    // better result replaces it.
    control.show(|status| {
        status.rig.safe_end.take_if(|end| end.is_safe() && end.is_stopped());
    });
    if let Some(trip) = trip {
        control.latch(trip);
    }
    control.phase(Phase::Raise);
    let began = Instant::now();
    let sampled = stage.take_last_sample();
    let bench = stage.bench.clone();
    let lateral = [&bench.x, &bench.y, &bench.radial];
    // z first: on a shared wire each stop waits for those before it.
    let ((z_stop, (tips, deepest_mm)), mut stops) = futures::join!(
        stop_and_raise(&control.estop, stage, began, height),
        join_all(lateral.map(|axis| stop(axis.as_ref(), began)))
    );
    let stopped = z_stop.acknowledged_ms.map(|ms| began + Duration::from_secs_f64(ms / 1e3));
    let sample_to_stop = sampled.zip(stopped).map(|(s, to)| to.saturating_duration_since(s.at));
    let travelled_mm =
        sampled.and_then(|s| s.z_mm).zip(deepest_mm).map(|(from, to)| (to - from).max(0.0));
    stops.push(z_stop);
    // An e-stop reads the axes by itself, and stops them again.
    if control.estop.pressed().is_none() {
        let axes = [&bench.x, &bench.y, &bench.radial, &bench.z];
        let reads = axes.into_iter().zip(&mut stops);
        join_all(reads.map(|(axis, stop)| read_until_it_stands(axis.as_ref(), stop, began))).await;
    }
    let end = SafeEnd {
        stops,
        tips,
        sample_to_stop_ms: sample_to_stop.map(|t| t.as_secs_f64() * 1e3),
        travelled_mm,
        took_ms: began.elapsed().as_secs_f64() * 1e3,
    };
    // Only these trips are caused by a sample of a moving z: the delay of the others
    // follows from their cause.
    let by_sample = trip.is_some_and(|t| matches!(t.kind, TripKind::Force | TripKind::Cell));
    if by_sample && sampled.is_some_and(|s| s.z_mm.is_some()) {
        stage.stopping.note_stop(sample_to_stop);
        stage.stopping.note_travel(travelled_mm);
    }
    if let Tips::NotRaised(why) = &end.tips
        && trip.is_none()
    {
        let detail = format!("the tips were not raised: {why}");
        control.latch(&Trip { kind: TripKind::Position, detail });
    }
    let shown = end.clone();
    control.show(|status| {
        status.rig.safe_end = Some(shown);
        if let Some(stopping) = &mut status.rig.stopping {
            stage.stopping.show_measured(stopping);
        }
    });
    if !before.is_some_and(|before| before.has_result_of(&end)) {
        control.say("safe_end", json!(end));
    }
    end
}

/// Raises z, with a few attempts; after a request (`is_asked`) none is repeated. Returns the deepest position of z on the
/// way as well, machine mm.
async fn raise(
    estop: &StopSwitch,
    stage: &Stage,
    height: Height,
    is_asked: &Cell<bool>,
) -> (Tips, Option<f64>) {
    let mut last = String::new();
    for attempt in 0..RAISE_TRIES {
        if attempt > 0 {
            tokio::time::sleep(RAISE_AGAIN).await;
            if is_asked.get() {
                break;
            }
        }
        if estop.pressed().is_some() {
            return (Tips::HeldByEstop, None);
        }
        match stage.raise_once(height, estop).await {
            // After a failed attempt the deepest position may have passed unread.
            Ok(Raised::Up { deepest_mm }) => {
                return (Tips::Raised, (attempt == 0).then_some(deepest_mm));
            }
            Ok(Raised::NotHomed) => return (Tips::NotHomed, None),
            Err(error) => last = error,
        }
    }
    let held = estop.pressed().is_some();
    (if held { Tips::HeldByEstop } else { Tips::NotRaised(last) }, None)
}

/// Raises z as planned, after a configuration. Requests are accepted meanwhile, and end it once z is up, or an attempt has
/// failed: a stop would leave the tips down.
///
/// # Errors
/// As `attend` after a request; otherwise trips unless the tips are raised.
pub async fn raise_as_planned(control: &mut Control, stage: &mut Stage) -> Result<(), Halt> {
    stage.begin_watch();
    let (estop, is_asked) = (control.estop.clone(), Cell::default());
    let raised = raise(&estop, stage, Height::Clear, &is_asked);
    let ((tips, _), asked) = control.attending_to_the_end(raised, &is_asked).await;
    match tips {
        Tips::Raised => asked,
        Tips::HeldByEstop => Err(Halt::trip(TripKind::Estop, "the emergency stop is latched")),
        Tips::NotHomed => Err(Halt::trip(TripKind::Position, "z has lost its zero: home")),
        // The safe end of a request raises them again, and trips if it fails.
        Tips::NotRaised(why) => {
            asked.and(Err(Halt::trip(TripKind::Position, format!("not raised: {why}"))))
        }
    }
}

async fn stop_and_raise(
    estop: &StopSwitch,
    stage: &Stage,
    began: Instant,
    height: Height,
) -> (AxisStop, (Tips, Option<f64>)) {
    let stopped = stop(stage.bench.z.as_ref(), began).await;
    (stopped, raise(estop, stage, height, &Cell::default()).await)
}

async fn stop(axis: &dyn Axis, began: Instant) -> AxisStop {
    let outcome = axis.stop().await;
    AxisStop {
        acknowledged_ms: outcome.is_ok().then(|| began.elapsed().as_secs_f64() * 1e3),
        error: outcome.err().map(|e| e.to_string()),
        ..AxisStop::of(axis.name())
    }
}

/// Reads an axis that has acknowledged its stop: one that moves after it is not stopped.
async fn read_until_it_stands(axis: &dyn Axis, stop: &mut AxisStop, began: Instant) {
    if stop.acknowledged_ms.is_none() {
        return;
    }
    match stands(axis).await {
        Ok(()) => stop.stood(began.elapsed().as_secs_f64() * 1e3),
        Err(words) => stop.error = Some(words),
    }
}
