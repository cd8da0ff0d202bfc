//! The state machine of the rig, separate from that of the run: one enum, one diagram, one
//! function.
//! PURE. Uses: nothing. Never: motion, wires, time.
//!
//! ```text
//!   disconnected --connected--> disarmed --homed--> homed --arm--> armed
//!        ^                         ^  <--homing---  ^              |
//!        |                         |                  +---disarm-----+
//!        +-- lost (from any) ------|--- reset --- tripped <--trip-- (disarmed, homed, armed)
//! ```
//! A trip latches: only a reset by a person, or by a policy that a person armed, leaves it. The rig
//! must be homed again before it can be armed: nothing moves from an unknown position.

use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};
use utoipa::ToSchema;

/// State of the rig.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum RigState {
    /// No wire is open.
    Disconnected,
    /// Wires are open; only homing may move the axes.
    Disarmed,
    /// The position of every axis is known; jogging is allowed.
    Homed,
    /// A run may move.
    Armed,
    /// A limit or a fault latched.
    Tripped,
}

impl RigState {
    /// All states.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Name of the state, as in the API and the database.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// What the state is, and what follows, as sentences.
    pub fn about(self) -> &'static str {
        match self {
            Self::Disconnected => "The wires are closed.",
            Self::Disarmed => "Connected. Home the axes before anything moves.",
            Self::Homed => "Ready.",
            Self::Armed => "A run may move it.",
            Self::Tripped => "Stopped by a fault. Clear the cause, reset, then home.",
        }
    }
}

/// Events of the rig's state machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RigEvent {
    /// All devices replied and match the rig file.
    Connected,
    /// The wires were closed.
    Lost,
    /// Homing has started: until it ends, no position is known.
    Homing,
    /// Every axis has been homed.
    Homed,
    /// A run was armed.
    Arm,
    /// The run is over.
    Disarm,
    /// A limit, a fault or an e-stop latched.
    Trip,
    /// The trip was acknowledged and reset.
    Reset,
}

impl RigEvent {
    /// What cannot be done if the state does not allow the event.
    fn words(self) -> &'static str {
        match self {
            RigEvent::Connected => "be connected",
            RigEvent::Lost => "lose its wires",
            RigEvent::Homing | RigEvent::Homed => "be homed",
            RigEvent::Arm => "be armed",
            RigEvent::Disarm => "be disarmed",
            RigEvent::Trip => "trip",
            RigEvent::Reset => "be reset",
        }
    }
}

impl RigState {
    /// The next step from this state, for a person whose request it does not allow.
    pub(in crate::campaign) fn next(self) -> &'static str {
        match self {
            RigState::Disconnected => "connect it first (palpate rig connect)",
            RigState::Disarmed => "home it first (palpate rig home)",
            RigState::Homed => "it is ready to be armed",
            RigState::Armed => "a run has it",
            RigState::Tripped => "check and reset it first",
        }
    }
}

/// An event that the rig's state does not allow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the rig is {} and cannot {} now: {}", state.as_str(), event.words(), state.next())]
pub struct Illegal {
    /// State in which the event occurred.
    pub state: RigState,
    /// Event that was refused.
    pub event: RigEvent,
}

/// Returns the state after an event.
///
/// # Errors
/// `Illegal` if the state does not allow the event.
pub fn step(state: RigState, event: RigEvent) -> Result<RigState, Illegal> {
    use RigEvent as E;
    use RigState as S;
    match (state, event) {
        (_, E::Lost) => Ok(S::Disconnected),
        (S::Disconnected, E::Connected) => Ok(S::Disarmed),
        (S::Disarmed | S::Homed, E::Homing) => Ok(S::Disarmed),
        (S::Disarmed, E::Homed) => Ok(S::Homed),
        (S::Homed, E::Arm) => Ok(S::Armed),
        (S::Armed, E::Disarm) => Ok(S::Homed),
        (S::Disarmed | S::Homed | S::Armed | S::Tripped, E::Trip) => Ok(S::Tripped),
        (S::Tripped, E::Reset) => Ok(S::Disarmed),
        (
            S::Disconnected | S::Disarmed | S::Homed | S::Armed | S::Tripped,
            E::Connected | E::Homing | E::Homed | E::Arm | E::Disarm | E::Trip | E::Reset,
        ) => Err(Illegal { state, event }),
    }
}

/// Every state and event as in `docs/safety.md`; the test below derives it from `step`.
#[cfg(test)]
pub(in crate::campaign) const TABLE: &str = "\
disconnected disarmed disconnected - - - - - -
disarmed     - disconnected disarmed homed - - tripped -
homed        - disconnected disarmed - armed - tripped -
armed        - disconnected - - - homed tripped -
tripped      - disconnected - - - - tripped disarmed
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whole_table() {
        use RigEvent as E;
        use RigState as S;
        let mut table = String::new();
        for s in [S::Disconnected, S::Disarmed, S::Homed, S::Armed, S::Tripped] {
            let row: Vec<&str> =
                [E::Connected, E::Lost, E::Homing, E::Homed, E::Arm, E::Disarm, E::Trip, E::Reset]
                    .iter()
                    .map(|&e| step(s, e).map_or("-", RigState::as_str))
                    .collect();
            table += &format!("{:12} {}\n", s.as_str(), row.join(" "));
        }
        assert_eq!(table, TABLE);
    }
}
