//! The one safe end. Every path that moves ends here when it does not end as planned: trip, pause
//! now, abort, suspension, lost device, failed homing, jog or weighing, shutdown, a panic, a store
//! that fails.
//! Uses: `campaign::{run::control, bench::stage, bench::estop, bench::interlock}`. Never: the store, a disk, a client. What
//! happened is noted in the diary, which waits for nobody here.
//!
//! ```text
//! latch (memory) -> stop x, y, radial  |  stop z -> raise z      each axis by itself
//!                          \           /
//!                        show and note how it ended
//! ```
//! After an e-stop nothing moves until a person releases it, and the tips stay where they are.

use std::time::Duration;

use futures::future::join_all;
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::time::Instant;
use utoipa::ToSchema;

use crate::campaign::bench::estop::AxisStop;
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::stage::Stage;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::status::Phase;
use crate::rig::traits::Axis;

/// Tries at raising the tips before a person must look.
const RAISE_TRIES: u32 = 3;
/// Pause between two tries.
const RAISE_AGAIN: Duration = Duration::from_millis(200);

/// How far up the tips go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Height {
    /// Clear of the skin, as for travelling.
    Clear,
    /// The top of the travel: room for a person's hands.
    Top,
}

/// Where the tips are after a safe end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", tag = "tips", content = "why")]
pub enum Tips {
    /// Measured clear of the skin, at rest.
    Raised,
    /// An e-stop is latched: nothing moves, they stay where they are.
    HeldByEstop,
    /// z does not know where it is: nothing was raised. Homing moves it up first.
    NotHomed,
    /// They could not be raised: a person must look.
    NotRaised(String),
}

/// How a safe end went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SafeEnd {
    /// Each axis's stop.
    pub stops: Vec<AxisStop>,
    /// Where the tips are.
    #[serde(flatten)]
    pub tips: Tips,
    /// From the last sample before it to z's acknowledged stop, wall ms; absent where nothing was
    /// weighed or z did not acknowledge.
    pub sample_to_stop_ms: Option<f64>,
    /// From its begin to its end, wall ms.
    pub took_ms: f64,
}

impl SafeEnd {
    /// Whether nothing more can be done for the tips: they are up, held where they are by an e-stop,
    /// or z must be homed first.
    pub fn is_safe(&self) -> bool {
        match self.tips {
            Tips::Raised | Tips::HeldByEstop | Tips::NotHomed => true,
            Tips::NotRaised(_) => false,
        }
    }

    /// Whether each axis acknowledged its stop.
    pub fn is_acknowledged(&self) -> bool {
        self.stops.iter().all(|s| s.acknowledged_ms.is_some())
    }
}

/// Makes the rig safe, then says how it ended. `trip` latches the rig; without one (pause now,
/// abort, shutdown) the rig stays as it was, unless the tips cannot be raised: that latches too.
pub async fn make_safe(
    control: &mut Control,
    stage: &mut Stage,
    trip: Option<&Trip>,
    height: Height,
) -> SafeEnd {
    // An earlier end says nothing about this one.
    control.show(|status| status.rig.safe_end = None);
    if let Some(trip) = trip {
        control.latch(trip);
    }
    control.phase(Phase::Raise);
    let began = Instant::now();
    let sampled = stage.take_last_sample();
    let bench = stage.bench.clone();
    let lateral = [&bench.x, &bench.y, &bench.radial];
    let (mut stops, (z_stop, tips)) = futures::join!(
        join_all(lateral.map(|axis| stop(axis.as_ref(), began))),
        stop_and_raise(control, stage, began, height)
    );
    let stopped = z_stop.acknowledged_ms.map(|ms| began + Duration::from_secs_f64(ms / 1e3));
    let sample_to_stop = sampled.zip(stopped).map(|(from, to)| to.saturating_duration_since(from));
    stops.push(z_stop);
    let end = SafeEnd {
        stops,
        tips,
        sample_to_stop_ms: sample_to_stop.map(|t| t.as_secs_f64() * 1e3),
        took_ms: began.elapsed().as_secs_f64() * 1e3,
    };
    if trip.is_some() {
        stage.stopping.note_stop(sample_to_stop);
    }
    if let Tips::NotRaised(why) = &end.tips
        && trip.is_none()
    {
        let detail = format!("the tips were not raised: {why}");
        control.latch(&Trip { kind: TripKind::Position, detail });
    }
    let shown = end.clone();
    control.show(|status| status.rig.safe_end = Some(shown));
    control.say("safe_end", json!(end));
    end
}

/// Raises z, trying a few times: the planned way up after a configuration.
pub async fn raise(control: &Control, stage: &Stage, height: Height) -> Tips {
    let mut last = String::new();
    for attempt in 0..RAISE_TRIES {
        if attempt > 0 {
            tokio::time::sleep(RAISE_AGAIN).await;
        }
        if control.estop.pressed().is_some() {
            return Tips::HeldByEstop;
        }
        match stage.raise_once(height, &control.estop).await {
            Ok(true) => return Tips::Raised,
            Ok(false) => return Tips::NotHomed,
            Err(error) => last = error,
        }
    }
    if control.estop.pressed().is_some() { Tips::HeldByEstop } else { Tips::NotRaised(last) }
}

/// As `raise`, where the plan has it: anything but raised tips is a trip.
pub async fn raise_as_planned(control: &Control, stage: &mut Stage) -> Result<(), Halt> {
    stage.begin_watch();
    match raise(control, stage, Height::Clear).await {
        Tips::Raised => Ok(()),
        Tips::HeldByEstop => Err(Halt::trip(TripKind::Estop, "the emergency stop is latched")),
        Tips::NotHomed => Err(Halt::trip(TripKind::Position, "z has lost its zero: home")),
        Tips::NotRaised(why) => Err(Halt::trip(TripKind::Position, format!("not raised: {why}"))),
    }
}

async fn stop_and_raise(
    control: &Control,
    stage: &Stage,
    began: Instant,
    height: Height,
) -> (AxisStop, Tips) {
    let stopped = stop(stage.bench.z.as_ref(), began).await;
    (stopped, raise(control, stage, height).await)
}

async fn stop(axis: &dyn Axis, began: Instant) -> AxisStop {
    let outcome = axis.stop().await;
    AxisStop {
        axis: axis.name().into(),
        acknowledged_ms: outcome.is_ok().then(|| began.elapsed().as_secs_f64() * 1e3),
        error: outcome.err().map(|e| e.to_string()),
    }
}
