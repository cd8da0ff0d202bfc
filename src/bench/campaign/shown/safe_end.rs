//! Result of a safe end, as the status, the diary and the clients show it.
//! Uses: `campaign::bench::estop` (its record of a stop). Never: a motion.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::campaign::bench::estop::AxisStop;

/// Position of the tips after a safe end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", tag = "tips", content = "why")]
pub enum Tips {
    /// Measured clear of the skin and at rest.
    Raised,
    /// An e-stop is latched: nothing moves, the tips stay where they are.
    HeldByEstop,
    /// z has lost its zero: nothing was raised. Homing moves it up first.
    NotHomed,
    /// They could not be raised, for this reason: a person must inspect the rig.
    NotRaised(String),
}

/// Result of a safe end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SafeEnd {
    /// Stop of each axis.
    pub stops: Vec<AxisStop>,
    /// Position of the tips.
    #[serde(flatten)]
    pub tips: Tips,
    /// Time from the last sample before the safe end to the acknowledged stop of z, wall ms; absent
    /// if no cell was read or z did not acknowledge.
    pub sample_to_stop_ms: Option<f64>,
    /// Travel of z from that sample to its deepest position after the stop, mm; absent unless z was
    /// moving and was raised.
    #[serde(default)]
    pub travelled_mm: Option<f64>,
    /// Duration of the safe end, wall ms.
    pub took_ms: f64,
}

impl SafeEnd {
    /// Whether nothing more can be done for the tips: they are up, they are held by an e-stop, or z
    /// must be homed first.
    pub fn is_safe(&self) -> bool {
        match self.tips {
            Tips::Raised | Tips::HeldByEstop | Tips::NotHomed => true,
            Tips::NotRaised(_) => false,
        }
    }

    /// Whether each axis acknowledged its stop, and none was found moving after it.
    pub fn is_stopped(&self) -> bool {
        self.stops.iter().all(AxisStop::is_done)
    }

    /// Whether both ended alike: the tips, and which axes are stopped, with their faults. The times may differ.
    pub(in crate::campaign) fn has_result_of(&self, other: &Self) -> bool {
        let result = |stop: &AxisStop| {
            let (acknowledged, stood) = (stop.acknowledged_ms.is_some(), stop.stood_ms.is_some());
            (stop.axis.clone(), acknowledged, stood, stop.error.clone())
        };
        self.tips == other.tips && self.stops.iter().map(result).eq(other.stops.iter().map(result))
    }
}
