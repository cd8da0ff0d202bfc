//! Published status of a campaign: rig, run, forces, stream, remaining time.
//! PURE. Uses: `campaign::{run::run_state, bench::rig_state, bench::not_clear, record}`. Never: HTTP.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use crate::campaign::bench::estop::AxisStop;
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::not_clear::NotClear;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stopping::StoppingDistance;
use crate::campaign::run::run_state::PausedWhy;
use crate::campaign::shown::safe_end::SafeEnd;
use crate::ids::{RunUid, TrialKey};
use crate::record::{Label, PlacedContact, Pose, TouchOffRecord};
use crate::schedule::visits::StepOfTour;
use crate::state::StoredState;

// The command line reads its parts, also from an older service: a field that is added needs a default.
/// Status of rig and run.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Status {
    /// Status of the rig.
    pub rig: RigStatus,
    /// The active run; null without one.
    pub run: Option<RunStatus>,
    /// Number that increases with every change.
    pub version: u64,
    /// Signs that a person may have come to the rig; for the queue, not for clients.
    #[serde(skip)]
    pub attended: Attended,
}

/// Signs that a person may have come to the rig: a trip that waits for a person, an abort, the end of a halted run.
/// After each no waiting run begins by itself. They are counted, so that a reader who misses a status misses no sign.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Attended {
    /// Number of signs since the start of the service.
    pub signs: u64,
    /// The last one, as text.
    pub why: String,
}

impl Attended {
    /// Adds a sign.
    pub fn note(&mut self, why: impl Into<String>) {
        self.signs += 1;
        self.why = why.into();
    }
}

impl Status {
    /// Applies a change, and keeps when the rig tripped and since when the run waits.
    pub fn change(&mut self, now: Timestamp, change: impl FnOnce(&mut Self)) {
        let (had_trip, waited) = (self.rig.trip.is_some(), self.waits());
        change(self);
        self.version += 1;
        let rig = &mut self.rig;
        match (&rig.trip, rig.state) {
            (Some(_), _) if !had_trip => rig.tripped_at = Some(now),
            (None, RigState::Disconnected | RigState::Homed | RigState::Armed) => {
                rig.tripped_at = None;
            }
            (None, RigState::Disarmed | RigState::Tripped) | (Some(_), _) => {}
        }
        let waits = self.waits();
        if let Some(run) = self.run.as_mut().filter(|_| waits != waited) {
            run.waits_since = waits.map(|_| now);
        }
    }

    /// The run that waits, or is about to, and why.
    fn waits(&self) -> Option<(RunUid, PausedWhy)> {
        let run = self.run.as_ref()?;
        Some((run.uid, run.paused_why?))
    }
}

/// Status of the rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RigStatus {
    /// Name from the rig file.
    pub name: String,
    /// Label of all data of this rig: `measured` or `virtual`.
    pub label: Label,
    /// Whether the rig has a stage and load cells; false for a skin and its board alone: nothing is
    /// homed, and weights are placed by a person.
    pub has_stage: bool,
    /// State of the rig.
    pub state: RigState,
    /// Homing or jog in progress, without the safe end that follows its early end; null if none. Unless a run is
    /// active, `POST /api/v1/rig/abort` ends it.
    pub motion: Option<Motion>,
    /// Cause of the latched trip; null if the rig is not tripped.
    pub trip: Option<Trip>,
    /// Time of the latched or last trip; null once the axes were homed after it, or the wires closed.
    pub tripped_at: Option<Timestamp>,
    /// Process seconds per wall second.
    pub clock_rate: f64,
    /// Measured pose; null while the wires are closed.
    pub pose: Option<Pose>,
    /// Why z does not permit a tare that a person requests, from the last reading between runs; none if it does, and
    /// while it is unknown. For `RigAction`, not for clients.
    #[serde(skip)]
    pub not_clear: Option<NotClear>,
    /// Forces of arms 1 to 6 after subtraction of the tare, N; null for arms whose cell is
    /// disconnected. Empty while unknown.
    pub forces_n: Vec<Option<f64>>,
    /// Limit of the force on one cell, N; null without cells.
    pub force_limit_n: Option<f64>,
    /// Number of tips that a person has entered as mounted, on arms 1 to n; null if none was
    /// entered.
    pub tips: Option<u8>,
    /// Number of connected cells, from their outputs: at least one for each tip; null while
    /// unknown.
    pub live_cells: Option<u8>,
    /// Result of the last touch-off; null before the first one.
    pub surface: Option<TouchOffRecord>,
    /// Counters of the voltage stream.
    pub stream: StreamStatus,
    /// Counters of each wire.
    pub wires: Vec<WireStatus>,
    /// Time from the press of an e-stop to the acknowledgement of the last axis, ms; null while one
    /// is missing.
    pub estop_acknowledged_ms: Option<f64>,
    /// Stop of each axis while an e-stop is latched. The stop is sent again until the axis has acknowledged it
    /// and stands.
    pub estop_stops: Vec<AxisStop>,
    /// Result of the last safe end; null before the first one, and while one follows a good result.
    pub safe_end: Option<SafeEnd>,
    /// Bound of the force increase between a sample and the resulting stop: computed, and measured.
    pub stopping: Option<StoppingDistance>,
}

impl RigStatus {
    /// Whether a run may begin: every axis is homed; a skin alone only needs its stream.
    pub fn is_ready(&self) -> bool {
        match self.state {
            RigState::Homed => true,
            RigState::Disarmed => !self.has_stage,
            RigState::Disconnected | RigState::Armed | RigState::Tripped => false,
        }
    }

    /// State of the rig, with the homing or jog in progress, as text.
    pub fn state_words(&self) -> String {
        let motion = self.motion.map(|motion| format!(", {}", motion.as_str()));
        format!("{}{}", self.state.as_str(), motion.unwrap_or_default())
    }

    /// The largest force on a tip, N.
    pub fn max_force_n(&self) -> Option<f64> {
        self.forces_n.iter().copied().flatten().reduce(f64::max)
    }

    /// Axes whose last stop is not acknowledged, or that move after it, each with its cause: of the latched e-stop,
    /// otherwise of the last safe end.
    pub fn not_stopped(&self) -> Vec<String> {
        let safe_end = self.safe_end.iter().filter(|_| self.estop_stops.is_empty());
        let of_safe_end = safe_end.flat_map(|end| &end.stops);
        let moving = self.estop_stops.iter().chain(of_safe_end).filter(|stop| !stop.is_done());
        let words = |stop: &AxisStop| {
            format!("{} ({})", stop.axis, stop.error.as_deref().unwrap_or("no answer yet"))
        };
        moving.map(words).collect()
    }

    /// Whether every axis was read at rest after the latched e-stop.
    pub fn stands(&self) -> bool {
        !self.estop_stops.is_empty() && self.estop_stops.iter().all(|s| s.stood_ms.is_some())
    }

    /// Cause of the trip, as text.
    pub fn trip_words(&self) -> String {
        let words = |trip: &Trip| match (trip.kind, trip.detail.as_str()) {
            (TripKind::Estop, "") => "e-stop".into(),
            (TripKind::Estop, why) => format!("e-stop: {why}"),
            (_, detail) => detail.to_owned(),
        };
        self.trip.as_ref().map_or_else(|| "for no stated reason".into(), words)
    }
}

/// Motion on request, or for a run that resumes: not one of the steps of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Motion {
    /// The zero of each axis is determined.
    Homing,
    /// One axis moves to a position.
    Jog,
}

impl Motion {
    /// Name of the motion on every wire.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Counters of the voltage stream since the wires were opened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StreamStatus {
    /// Number of valid frames.
    pub frames: u64,
    /// Number of frames missing according to the sequence numbers.
    pub missed: u64,
    /// Number of rejected packets.
    pub garbled: u64,
    /// Number of times the wire was reopened.
    pub reconnects: u64,
    /// Age of the newest frame, wall ms; null before the first one.
    pub age_ms: Option<u64>,
}

/// Counters of one wire since it was opened.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WireStatus {
    /// Name of the wire in the rig file.
    pub name: String,
    /// Number of requests with a valid reply.
    pub requests: u64,
    /// Number of repeated requests.
    pub retries: u64,
    /// Number of replies that did not arrive in time.
    pub timeouts: u64,
    /// Number of invalid replies.
    pub garbled: u64,
    /// Number of times the wire was reopened.
    pub reconnects: u64,
    /// Duration of the last round trip, us.
    pub last_round_trip_us: u64,
}

/// Status of the active run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunStatus {
    /// Id of the run (UUIDv7).
    pub uid: RunUid,
    /// Number of the run, for people.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Whether a person places its weights; the run then moves nothing.
    pub is_manual: bool,
    /// State that the run has reached.
    pub state: StoredState,
    /// State that was requested; null once it is reached.
    pub requested_state: Option<StoredState>,
    /// Reason why the run waits or is about to wait; null otherwise.
    pub paused_why: Option<PausedWhy>,
    /// Time since which it waits, or is about to, for this reason; null if it does not.
    pub waits_since: Option<Timestamp>,
    /// What the run waits for, as text; null if it does not wait.
    pub waiting_for: Option<String>,
    /// What a person must do; null if nothing.
    pub wanted: Option<Wanted>,
    /// Present activity of the run.
    pub phase: Phase,
    /// Current or most recent configuration or placement in the tour of the run; null before the
    /// first.
    pub current_step: Option<StepOfTour>,
    /// Key of the current or most recent trial; null without one and in reference presses.
    pub trial: Option<TrialKey>,
    /// Number of trials in the plan.
    pub trials_planned: u64,
    /// Number of trials stored.
    pub trials_stored: u64,
    /// Number of trials in skipped configurations.
    pub trials_skipped: u64,
    /// Number of failed attempts.
    pub retries: u64,
    /// Remaining time; null while it is unknown.
    pub eta: Option<Eta>,
    /// Disk space that the remaining trials need, bytes.
    pub needed_bytes: u64,
}

/// What a person must do before a run resumes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum Wanted {
    /// Mount tips on arms 1 to `tips`.
    Tips {
        /// Number of tips.
        tips: u8,
    },
    /// Place weights on the skin.
    Placement {
        /// Index of the placement in the plan.
        trial: u32,
        /// Positions and weights of the contacts.
        contacts: Vec<PlacedContact>,
    },
}

/// What a person says to have done. A confirmation that is sent twice must not confirm what the run waits
/// for next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Done {
    /// Index of the placement; `None` if not stated.
    pub trial: Option<u32>,
    /// Number of mounted tips; `None` if not stated.
    pub tips: Option<u8>,
}

impl Done {
    /// Whether it is what the run waits for, as far as it is stated.
    pub fn fits(self, wanted: &Wanted) -> bool {
        let (trial, tips) = match wanted {
            Wanted::Tips { tips } => (None, Some(*tips)),
            Wanted::Placement { trial, .. } => (Some(*trial), None),
        };
        (self.trial.is_none() || self.trial == trial) && (self.tips.is_none() || self.tips == tips)
    }
}

/// Activity of a run.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Phase {
    /// Selecting the next step.
    Next,
    /// Searching for the surface.
    TouchOff,
    /// Moving in the air.
    Travel,
    /// Measuring the zeros of the cells.
    Tare,
    /// Pressing to a depth.
    Press,
    /// Waiting until the forces settle.
    Settle,
    /// Frames of the settled load are read.
    Measure,
    /// Waiting until the trial is durable.
    Commit,
    /// Raising the tips.
    Raise,
    /// Waiting for a person or a policy.
    Wait,
}

impl Phase {
    /// All activities.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Name of the activity on every wire.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// What the run is doing, in words.
    pub fn about(self) -> &'static str {
        match self {
            Self::Next => "selecting the next step",
            Self::TouchOff => "searching for the surface",
            Self::Travel => "travelling",
            Self::Tare => "measuring the zeros",
            Self::Press => "pressing",
            Self::Settle => "waiting until the forces settle",
            Self::Measure => "taking frames",
            Self::Commit => "storing",
            Self::Raise => "raising the tips",
            Self::Wait => "waiting",
        }
    }
}

/// Remaining time, wall s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Eta {
    /// Expected remaining time, wall s.
    pub remaining_s: f64,
    /// Lower end of the band that contains the end of 90 % of the runs at this pace.
    pub low_s: f64,
    /// Upper end of the band.
    pub high_s: f64,
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn a_homing_is_shown_with_the_state_and_an_older_service_names_none() {
        let mut rig = json!({ "name": "lab", "label": "virtual", "has_stage": true,
            "state": "disarmed", "trip": null, "clock_rate": 1.0, "pose": null, "forces_n": [],
            "stream": StreamStatus::default(), "wires": [], "estop_stops": [] });
        let words = |rig: &Value| RigStatus::deserialize(rig).unwrap().state_words();
        assert_eq!(words(&rig), "disarmed");
        rig["motion"] = "homing".into();
        assert_eq!(words(&rig), "disarmed, homing");
    }

    #[test]
    fn a_confirmation_fits_only_what_it_states() {
        let placement = Wanted::Placement { trial: 7, contacts: Vec::new() };
        let tips = Wanted::Tips { tips: 4 };
        let done = |trial, tips| Done { trial, tips };
        assert!(Done::default().fits(&placement) && Done::default().fits(&tips));
        assert!(done(Some(7), None).fits(&placement) && done(None, Some(4)).fits(&tips));
        for (done, wanted) in [
            (done(Some(6), None), &placement),
            (done(None, Some(4)), &placement),
            (done(Some(7), Some(4)), &placement),
            (done(None, Some(3)), &tips),
            (done(Some(7), None), &tips),
        ] {
            assert!(!done.fits(wanted), "{done:?} {wanted:?}");
        }
    }
}
