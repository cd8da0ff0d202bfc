//! What a campaign shows of itself: rig, run, forces, stream, estimate.
//! PURE. Uses: `campaign::{run::run_state, bench::rig_state, kept::record}`. Never: HTTP.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::campaign::bench::estop::AxisStop;
use crate::campaign::bench::interlock::Trip;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stopping::StoppingDistance;
use crate::campaign::kept::record::{PlacedContact, Pose, TouchOffRecord};
use crate::campaign::run::run_state::PausedWhy;
use crate::campaign::safe_end::SafeEnd;
use crate::ids::{RunUid, TrialKey};

/// The whole status.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Status {
    /// The rig.
    pub rig: RigStatus,
    /// The run under way, if any.
    pub run: Option<RunStatus>,
    /// Grows with every change.
    pub version: u64,
}

/// The rig's part.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RigStatus {
    /// Name from the rig file.
    pub name: String,
    /// `measured` or `virtual`: label of everything that it gives.
    pub label: String,
    /// State reached.
    pub state: RigState,
    /// What latched it.
    pub trip: Option<Trip>,
    /// Process seconds in one wall second.
    pub clock_rate: f64,
    /// Where it stands.
    pub pose: Option<Pose>,
    /// Forces over the tare of attached arms, N; absent for arms without a tip.
    pub forces_n: Vec<Option<f64>>,
    /// Limit on one cell, N.
    pub force_limit_n: f64,
    /// Tips that a person says are mounted, on arms 1 to n.
    pub tips: Option<u8>,
    /// Cells on their cables, as the cells show: at least one for each tip.
    pub live_cells: Option<u8>,
    /// The surface as it was last found.
    pub surface: Option<TouchOffRecord>,
    /// The voltage stream.
    pub stream: StreamStatus,
    /// The wires.
    pub wires: Vec<WireStatus>,
    /// From an e-stop's press until every axis had acknowledged its stop, ms.
    pub estop_acknowledged_ms: Option<f64>,
    /// While an e-stop is latched, each axis's stop: one that is not acknowledged is sent again
    /// until it is.
    pub estop_stops: Vec<AxisStop>,
    /// How the last safe end went; null before the first one and while one is under way.
    pub safe_end: Option<SafeEnd>,
    /// What the force may grow by between a sample and its stop: computed, and measured beside.
    pub stopping: Option<StoppingDistance>,
}

/// The voltage stream's counters.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StreamStatus {
    /// Frames accepted.
    pub frames: u64,
    /// Frames that the sequence numbers say are missing.
    pub missed: u64,
    /// Packets refused.
    pub garbled: u64,
    /// Times the wire was opened again.
    pub reconnects: u64,
    /// Age of the newest frame, wall ms.
    pub age_ms: Option<u64>,
}

/// One wire's counters.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WireStatus {
    /// Name from the rig file.
    pub name: String,
    /// Requests answered soundly.
    pub requests: u64,
    /// Requests sent again.
    pub retries: u64,
    /// Replies that did not come in time.
    pub timeouts: u64,
    /// Replies that made no sense.
    pub garbled: u64,
    /// Times it was opened again.
    pub reconnects: u64,
    /// Last round trip, microseconds.
    pub last_round_trip_us: u64,
}

/// The run's part.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RunStatus {
    /// Id.
    pub uid: RunUid,
    /// Number for people.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// State reached.
    pub state: String,
    /// State asked for, while it has not been reached.
    pub requested_state: Option<String>,
    /// Why it waits or is about to.
    pub paused_why: Option<PausedWhy>,
    /// What it waits for, in words.
    pub waiting_for: Option<String>,
    /// What a person must do.
    pub wanted: Option<Wanted>,
    /// What it is doing.
    pub phase: Phase,
    /// The trial under way.
    pub trial: Option<TrialKey>,
    /// Trials in the plan.
    pub trials_planned: u64,
    /// Trials stored.
    pub trials_stored: u64,
    /// Trials of configurations that were given up.
    pub trials_skipped: u64,
    /// Failed attempts.
    pub retries: u64,
    /// When it will be done.
    pub eta: Option<Eta>,
}

/// What a person must do before a run goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum Wanted {
    /// Mount this many tips on arms 1 to n.
    Tips {
        /// The count.
        tips: u8,
    },
    /// Place these weights.
    Placement {
        /// Position in the plan.
        trial: u32,
        /// The contacts.
        contacts: Vec<PlacedContact>,
    },
}

/// What a run is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Looking at the next step.
    Next,
    /// Finding the surface.
    TouchOff,
    /// Moving in the air.
    Travel,
    /// Reading the zeros.
    Tare,
    /// Pressing.
    Press,
    /// Waiting for the forces.
    Settle,
    /// Taking frames.
    Measure,
    /// Making the trial durable.
    Commit,
    /// Raising the tips.
    Raise,
    /// Waiting for a person or a policy.
    Wait,
}

/// Time to go, wall seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Eta {
    /// Most likely.
    pub remaining_s: f64,
    /// Band: 90 % of runs at this pace end within it.
    pub low_s: f64,
    /// Band.
    pub high_s: f64,
}
