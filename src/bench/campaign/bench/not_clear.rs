//! Why z does not permit a tare that a person requests, and what this person must do first: for the refusal, and for
//! the status, which states it beforehand.
//! PURE. Uses: `campaign::bench::rig_state`. Never: motion, wires, time.

use crate::campaign::bench::rig_state::RigState;

/// Why a reading of z does not show z clear of the skin and at rest.
#[derive(Debug, Clone, PartialEq)]
pub enum NotClear {
    /// z has no zero, or has lost it.
    NotHomed,
    /// z is in alarm, has its motor off or is outside its travel, as text.
    Faulty(String),
    /// z moves.
    Moving {
        /// Position of z, machine mm.
        at_mm: f64,
    },
    /// z is too low.
    Low {
        /// Position of z, machine mm.
        at_mm: f64,
        /// Lowest position that is clear of the skin, machine mm.
        limit_mm: f64,
    },
}

impl NotClear {
    /// Refusal of a tare while the rig is in this state, with what a person must do first, as text.
    pub fn refuses_tare(&self, rig: RigState) -> String {
        let why = match self {
            Self::NotHomed => "z is not homed, and its position is not known".to_owned(),
            Self::Faulty(words) => words.clone(),
            Self::Moving { at_mm } => format!("z still moves, at {at_mm:.3} mm"),
            Self::Low { at_mm, limit_mm } => {
                format!("z at {at_mm:.3} mm, limit {limit_mm:.3} mm to be clear of the skin")
            }
        };
        let (state, next) = (rig.as_str(), self.next(rig));
        format!("tare is not possible: {why}; the rig is {state}: {next}")
    }

    fn next(&self, rig: RigState) -> &'static str {
        match (rig, self) {
            (RigState::Disconnected, _) => rig.next(),
            (_, Self::Moving { .. }) => "wait until z is at rest",
            (RigState::Tripped, _) => {
                "clear the cause, reset, then home it (palpate rig reset, palpate rig home)"
            }
            (RigState::Armed, _) => "end the run, then home it (palpate abort, palpate rig home)",
            (RigState::Disarmed | RigState::Homed, Self::Faulty(_)) => {
                "clear the cause, then home it (palpate rig home); if it trips, reset and home again"
            }
            (RigState::Disarmed, Self::NotHomed | Self::Low { .. }) => rig.next(),
            (RigState::Homed, Self::NotHomed) => {
                "z has lost its zero since: home it again (palpate rig home)"
            }
            (RigState::Homed, Self::Low { .. }) => {
                "raise z first: home it (palpate rig home), or jog z up"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_tare_states_what_the_state_of_the_rig_and_of_z_allow_next() {
        let faulty = NotClear::Faulty("z reports alarm 0x1".into());
        let low = NotClear::Low { at_mm: 60.0, limit_mm: 50.0 };
        for (why, rig, wanted) in [
            (&NotClear::NotHomed, RigState::Disarmed, "home it first (palpate rig home)"),
            (&NotClear::NotHomed, RigState::Homed, "home it again (palpate rig home)"),
            (&low, RigState::Homed, "raise z first: home it (palpate rig home), or jog z up"),
            (&low, RigState::Disarmed, "home it first (palpate rig home)"),
            (&low, RigState::Tripped, "then home it (palpate rig reset, palpate rig home)"),
            (&faulty, RigState::Homed, "; if it trips, reset and home again"),
            (
                &faulty,
                RigState::Armed,
                "end the run, then home it (palpate abort, palpate rig home)",
            ),
            (&NotClear::Moving { at_mm: 4.0 }, RigState::Tripped, "wait until z is at rest"),
        ] {
            let words = why.refuses_tare(rig);
            assert!(
                words.starts_with("tare is not possible: z ") && words.ends_with(wanted),
                "{words}"
            );
        }
        // What a homed rig is told of z contradicts neither: it is homed, and z is not.
        let words = NotClear::NotHomed.refuses_tare(RigState::Homed);
        assert!(words.contains("z is not homed") && !words.contains("raise z"), "{words}");
    }
}
