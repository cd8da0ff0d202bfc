//! States of a run as they are stored and shown, with their only texts.
//! PURE. Uses: no other module. Never: which state follows which (`campaign::run::run_state`).

use serde::{Deserialize, Serialize};
use strum::{Display, IntoStaticStr, VariantArray};
use utoipa::ToSchema;

/// State of a run, from submission to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(Display, IntoStaticStr, VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum StoredState {
    /// It waits in the queue.
    Queued,
    /// It was taken from the queue and has not started.
    Idle,
    /// Moving and measuring.
    Running,
    /// Pauses after the current trial.
    Pausing,
    /// Paused with the tips raised.
    Paused,
    /// Ends after the current trial.
    Stopping,
    /// Raises the tips now, then ends.
    Aborting,
    /// Raises the tips now, then waits.
    Suspending,
    /// The tips could not be raised: a person must inspect the rig.
    Panicked,
    /// The process that drove it ended; it can resume.
    Interrupted,
    /// It has an exit status.
    Ended,
    /// It was removed from the queue before it started.
    Removed,
}

impl StoredState {
    /// All states.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Text of the state, in the database and on every wire.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Reason why a run waits.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum PausedWhy {
    /// A person requested it.
    Operator,
    /// Tips must be mounted or removed.
    TipChange,
    /// Weights must be placed by a person.
    ManualTrial,
    /// A suspender suspended it.
    Suspender,
    /// A limit or a fault tripped the rig.
    Trip,
    /// The service was restarted during the run.
    Restart,
}

impl PausedWhy {
    /// All reasons.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Text of the reason, in the database and on every wire.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// Why the run waits, as a clause.
    pub fn about(self) -> &'static str {
        match self {
            Self::Operator => "a person paused it",
            Self::TipChange => "tips must be changed",
            Self::ManualTrial => "weights must be placed",
            Self::Suspender => "something that watches the run suspended it",
            Self::Trip => "the rig tripped",
            Self::Restart => "the service was started again",
        }
    }
}

/// A state that a run has reached, as it is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateChange {
    /// State that the run has reached.
    pub state: StoredState,
    /// Requested state that is not reached yet.
    pub requested: Option<StoredState>,
    /// Reason why the run waits or is about to wait.
    pub why: Option<PausedWhy>,
}

impl StateChange {
    /// A state without a request or a reason.
    pub fn to(state: StoredState) -> Self {
        Self { state, requested: None, why: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_those_of_serde() {
        for state in StoredState::ALL {
            assert_eq!(serde_json::to_value(state).unwrap(), state.as_str());
        }
        for why in PausedWhy::ALL {
            assert_eq!(serde_json::to_value(why).unwrap(), why.as_str());
        }
    }
}
