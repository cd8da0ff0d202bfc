//! Reasons for which a step was left, for the decision of the engine.
//! PURE. Uses: `campaign::{bench::interlock, journal}`, `rig::error`. Never: motion.

use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::shown::status::Wanted;
use crate::journal::JournalError;
use crate::rig::error::{RigError, Severity};

/// Reason for which a step of the plan ended early. In every case the safe end comes next.
#[derive(Debug)]
pub enum Halt {
    /// A request that needs the tips up immediately: pause now, abort, suspend.
    Asked,
    /// A checkpoint was reached while pausing or stopping.
    Checkpoint,
    /// The plan needs a person, for this.
    Needs(Wanted),
    /// The attempt failed; it may be repeated.
    Failed(String),
    /// A limit or a fault, latched.
    Trip(Trip),
    /// A record could not be made durable.
    Store(JournalError),
}

impl Halt {
    /// Trip of this halt, if it is one.
    pub fn as_trip(&self) -> Option<&Trip> {
        match self {
            Halt::Trip(trip) => Some(trip),
            Halt::Asked | Halt::Checkpoint | Halt::Needs(_) | Halt::Failed(_) | Halt::Store(_) => {
                None
            }
        }
    }

    /// Creates a trip of this kind.
    pub fn trip(kind: TripKind, detail: impl Into<String>) -> Self {
        Halt::Trip(Trip { kind, detail: detail.into() })
    }
}

impl From<RigError> for Halt {
    /// The drivers have already retried up to their limit: any remaining error trips the rig,
    /// except missing frames, which fail the attempt.
    fn from(error: RigError) -> Self {
        let detail = error.to_string();
        match (&error, error.severity()) {
            (RigError::NoFrames { .. }, _) => Halt::Failed(detail),
            (RigError::Latched { .. }, _) => Halt::trip(TripKind::Estop, detail),
            (_, Severity::Transient) => Halt::trip(TripKind::Wire, detail),
            (_, Severity::Setup | Severity::Device) => Halt::trip(TripKind::Device, detail),
        }
    }
}

impl From<Trip> for Halt {
    fn from(trip: Trip) -> Self {
        Halt::Trip(trip)
    }
}

impl From<JournalError> for Halt {
    fn from(error: JournalError) -> Self {
        Halt::Store(error)
    }
}
