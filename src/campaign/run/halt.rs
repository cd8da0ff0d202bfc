//! Why pressing was left: what the engine must now decide about.
//! PURE. Uses: `campaign::{bench::interlock, kept::journal}`, `rig::error`. Never: motion.

use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::kept::journal::JournalError;
use crate::campaign::shown::status::Wanted;
use crate::rig::error::{RigError, Severity};

/// Why a step of the plan was left before its end. In every case the safe end comes next.
#[derive(Debug)]
pub enum Halt {
    /// A request that wants the tips up now: pause now, abort, suspend.
    Asked,
    /// A checkpoint was reached while pausing or stopping.
    Checkpoint,
    /// The plan needs a person.
    Needs(Wanted),
    /// This try failed; it may be tried again.
    Failed(String),
    /// A limit or a fault: latched.
    Trip(Trip),
    /// A record could not be made durable.
    Store(JournalError),
}

impl Halt {
    /// What latches the rig, if this halt does.
    pub fn as_trip(&self) -> Option<&Trip> {
        match self {
            Halt::Trip(trip) => Some(trip),
            Halt::Asked | Halt::Checkpoint | Halt::Needs(_) | Halt::Failed(_) | Halt::Store(_) => {
                None
            }
        }
    }

    /// A trip of this kind.
    pub fn trip(kind: TripKind, detail: impl Into<String>) -> Self {
        Halt::Trip(Trip { kind, detail: detail.into() })
    }
}

impl From<RigError> for Halt {
    /// The drivers have retried already, within a count: what still fails trips, except frames that
    /// did not come, which fail the try.
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
