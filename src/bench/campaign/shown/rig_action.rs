//! The manual actions on the rig, and why the rig or its run refuses one.
//! PURE. Uses: `campaign::{bench::rig_state, run::run_state, shown::status}`. Never: motion, wires, who asks.

use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use crate::campaign::bench::rig_state::RigState;
use crate::campaign::run::run_state::PausedWhy;
use crate::campaign::shown::status::{Phase, RigStatus, Status};
use crate::state::StoredState;

/// Refusal of a rig without a stage.
pub const NO_STAGE: &str = "the rig is a skin alone: it has no stage and no cells";
/// Refusal of a rig without open wires.
pub const NO_WIRES: &str = "the rig is disconnected";

/// Manual action on the rig.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum RigAction {
    /// Open the wires.
    Connect,
    /// Close the wires.
    Disconnect,
    /// Home all axes, z first.
    Home,
    /// Move one axis.
    Jog,
    /// Measure the output of the load cells without load; in a manual run, the frame of the untouched skin.
    Tare,
    /// Enter the number of mounted tips.
    Tips,
    /// Acknowledge a trip.
    Reset,
}

impl RigAction {
    /// All actions.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Name in requests.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// Whether it needs a stage with load cells, outside a manual run.
    pub fn needs_stage(self) -> bool {
        matches!(self, Self::Home | Self::Jog | Self::Tare | Self::Tips)
    }

    /// Why it is refused at this status, as text; `None` if it is not. While the rig homes or jogs, it is refused, too:
    /// a held button requests the next jog before the status shows the end of the one before.
    pub fn refused(self, Status { rig, run, .. }: &Status) -> Option<String> {
        match run {
            None => self.refused_by_rig(rig),
            Some(run) if run.phase != Phase::Wait => Some(format!(
                "{} is not possible while run {} is {}: pause or end it first",
                self.as_str(),
                run.scan_id,
                run.state
            )),
            Some(run) if run.state == StoredState::Panicked && self == Self::Reset => None,
            Some(run) if run.is_manual => self.refused_by_manual_run(rig, run.paused_why),
            Some(_) => self.refused_by_rig(rig),
        }
    }

    /// As [`Self::refused`], and a tare also because of the last reading of z. For those who offer it: the campaign
    /// reads z again before it refuses.
    pub fn refused_now(self, status: &Status) -> Option<String> {
        self.refused(status).or_else(|| {
            // The tare of a manual run is that of the skin.
            let is_manual = status.run.as_ref().is_some_and(|run| run.is_manual);
            let z = status.rig.not_clear.as_ref().filter(|_| self == Self::Tare && !is_manual)?;
            Some(z.refuses_tare(status.rig.state))
        })
    }

    /// Why the rig refuses it in this state, as text; `None` if it does not.
    pub fn refused_by_rig(self, rig: &RigStatus) -> Option<String> {
        if self.needs_stage() && !rig.has_stage {
            return Some(NO_STAGE.into());
        }
        let state = rig.state;
        let is_allowed = match self {
            Self::Connect => state == RigState::Disconnected,
            Self::Home => matches!(state, RigState::Disarmed | RigState::Homed),
            Self::Jog => state == RigState::Homed,
            Self::Tare | Self::Tips => state != RigState::Disconnected,
            Self::Reset => state == RigState::Tripped,
            Self::Disconnect => state != RigState::Armed,
        };
        let (name, rig) = (self.as_str(), state.as_str());
        (!is_allowed).then(|| match self {
            Self::Reset => format!("the rig is {rig}, not tripped: nothing to reset"),
            Self::Connect => format!("the rig is {rig}: its wires are open already"),
            Self::Disconnect | Self::Home | Self::Jog | Self::Tare | Self::Tips => {
                format!("{name} is not possible while the rig is {rig}: {}", state.next())
            }
        })
    }

    /// Why a manual run that waits, or its rig, refuses it, as text; `None` if they do not. A hand may be on the
    /// skin, and tips that are entered now would let the next run press at once, on weights.
    fn refused_by_manual_run(self, rig: &RigStatus, why: Option<PausedWhy>) -> Option<String> {
        match self {
            Self::Home | Self::Jog | Self::Tips => Some(format!(
                "{} is not possible during a manual run: hands may be on the skin; end the run first",
                self.as_str()
            )),
            Self::Tare if rig.state == RigState::Disconnected => Some(NO_WIRES.into()),
            Self::Tare => (why != Some(PausedWhy::ManualTrial))
                .then(|| "tare is not possible: the run awaits no placement".into()),
            Self::Connect | Self::Disconnect | Self::Reset => self.refused_by_rig(rig),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::campaign::bench::not_clear::NotClear;
    use crate::campaign::bench::stand_in::job;
    use crate::campaign::shown::show;
    use crate::campaign::shown::status::RunStatus;
    use crate::rig::setup::RigSetup;

    pub fn status(rig: &str, state: RigState) -> Status {
        let mut status = show::closed(&RigSetup::from_toml("rig.toml", rig).unwrap());
        status.rig.state = state;
        status
    }

    pub const BENCH: &str = include_str!("../../../../experiments/rigs/virtual.toml");
    pub const SKIN: &str = include_str!("../../../../experiments/rigs/skin-only.toml");

    pub fn waiting(why: PausedWhy) -> RunStatus {
        let (state, phase) = (StoredState::Paused, Phase::Wait);
        RunStatus { scan_id: 3, state, paused_why: Some(why), phase, ..show::started(&job()) }
    }

    /// Names of the actions that are not refused.
    fn allowed(status: &Status) -> String {
        let allowed = RigAction::ALL.iter().filter(|action| action.refused(status).is_none());
        allowed.map(|action| action.as_str()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn the_state_of_the_rig_decides_without_a_run() {
        for (state, wanted) in [
            (RigState::Disconnected, "connect disconnect"),
            (RigState::Disarmed, "disconnect home tare tips"),
            (RigState::Homed, "disconnect home jog tare tips"),
            (RigState::Armed, "tare tips"),
            (RigState::Tripped, "disconnect tare tips reset"),
        ] {
            assert_eq!(allowed(&status(BENCH, state)), wanted, "{state:?}");
        }
        assert_eq!(allowed(&status(SKIN, RigState::Disarmed)), "disconnect");
        let why = RigAction::Jog.refused(&status(BENCH, RigState::Disarmed)).unwrap();
        assert_eq!(
            why,
            "jog is not possible while the rig is disarmed: home it first (palpate rig home)"
        );
    }

    #[test]
    fn a_run_allows_actions_only_while_it_waits() {
        let mut tripped = status(BENCH, RigState::Tripped);
        tripped.run = Some(waiting(PausedWhy::Trip));
        assert_eq!(allowed(&tripped), "disconnect tare tips reset");
        tripped.rig.state = RigState::Homed;
        let run = tripped.run.as_mut().unwrap();
        run.state = StoredState::Panicked;
        assert!(allowed(&tripped).contains("reset"), "a panicked run awaits it");
        let run = tripped.run.as_mut().unwrap();
        (run.state, run.phase) = (StoredState::Running, Phase::Press);
        assert!(allowed(&tripped).is_empty());
        let why = RigAction::Home.refused(&tripped).unwrap();
        assert_eq!(why, "home is not possible while run 3 is running: pause or end it first");
    }

    #[test]
    fn a_tare_is_not_offered_while_the_last_reading_of_z_refuses_it() {
        let mut homed = status(BENCH, RigState::Homed);
        assert_eq!(RigAction::Tare.refused_now(&homed), None);
        homed.rig.not_clear = Some(NotClear::NotHomed);
        let refused = |status: &Status| -> Vec<&'static str> {
            let refused = RigAction::ALL.iter().filter(|one| one.refused_now(status).is_some());
            refused.map(|action| action.as_str()).collect()
        };
        assert_eq!(refused(&homed), ["connect", "tare", "reset"]);
        let words = NotClear::NotHomed.refuses_tare(RigState::Homed);
        assert_eq!(RigAction::Tare.refused_now(&homed), Some(words));
        // The frame of the untouched skin needs no z.
        homed.run = Some(RunStatus { is_manual: true, ..waiting(PausedWhy::ManualTrial) });
        assert_eq!(RigAction::Tare.refused_now(&homed), None);
        homed.rig.state = RigState::Disconnected;
        assert_eq!(RigAction::Tare.refused_now(&homed).as_deref(), Some(NO_WIRES));
    }

    #[test]
    fn a_manual_run_allows_no_motion() {
        let mut waits = status(SKIN, RigState::Disarmed);
        waits.run = Some(RunStatus { is_manual: true, ..waiting(PausedWhy::ManualTrial) });
        assert_eq!(allowed(&waits), "disconnect tare");
        waits.run.as_mut().unwrap().paused_why = Some(PausedWhy::Operator);
        assert_eq!(allowed(&waits), "disconnect");
        waits.rig.state = RigState::Disconnected;
        assert_eq!(RigAction::Tare.refused(&waits).as_deref(), Some(NO_WIRES));
        waits.rig.has_stage = true;
        waits.rig.state = RigState::Homed;
        assert!(RigAction::Home.refused(&waits).unwrap().contains("hands may be on the skin"));
    }
}
