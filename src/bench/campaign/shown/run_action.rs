//! The actions on a run, and why the active run, or the rig for a run that waits, refuses one.
//! PURE. Uses: `campaign::{bench::rig_state, run::run_state, shown::status}`. Never: motion, storage, who asks.

use serde::{Deserialize, Serialize};
use strum::IntoStaticStr;
use utoipa::ToSchema;

use crate::campaign::bench::rig_state::{self, RigEvent, RigState};
use crate::campaign::run::run_state::{self, PausedWhy, RunEvent, RunState};
use crate::campaign::shown::rig_action::NO_WIRES;
use crate::campaign::shown::status::{Phase, RigStatus, RunStatus, Status, Wanted};
use crate::state::StoredState;

/// Refusal of a repetition by a run that waits for no weights.
pub const NO_PLACEMENT: &str = "repeat is not possible: the run awaits no placement";

/// Action on a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum ActionOnRun {
    /// Start an armed run, or resume an interrupted one.
    Start,
    /// Pause the run.
    Pause,
    /// Resume a paused run.
    Resume,
    /// Finish the trial, raise the tips, end the run.
    Stop,
    /// Raise the tips now, end the run. An interrupted run ends without motion; one that waits for its turn does not
    /// begin by itself any more.
    Abort,
    /// Confirm the work that the run waits for: a tip change or a placement. A placement that the
    /// skin contradicts is refused, unless `anyway` is true.
    Confirm,
    /// Repeat a manual trial while the run waits for a placement: the stored trial is withdrawn (it
    /// is kept with the failed attempts), and the run asks for its placement again before it continues.
    Repeat,
}

impl ActionOnRun {
    /// All actions.
    pub const ALL: [Self; 7] = [
        Self::Start,
        Self::Pause,
        Self::Resume,
        Self::Confirm,
        Self::Repeat,
        Self::Stop,
        Self::Abort,
    ];

    /// Name in requests.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// Why it is refused at this status, as text; `None` if it is not. `Start` is of a run that waits and presses;
    /// all others are of the active run. While the rig moves in a paused run, which the status does not show, more is
    /// refused.
    pub fn refused(self, status: &Status) -> Option<String> {
        let Some(run) = &status.run else {
            return match self {
                Self::Start => begin_refused(&status.rig),
                _ => Some(format!("{} is not possible: no run is active", self.as_str())),
            };
        };
        match self {
            Self::Start => wait_refused(status),
            Self::Pause => pause_refused(RunEvent::PauseAtCheckpoint, run),
            Self::Resume if needs_person(run) => {
                Some("resume is not possible: confirm what the run waits for".into())
            }
            Self::Resume => continue_refused(self, &status.rig, run),
            Self::Confirm if !needs_person(run) || run.phase != Phase::Wait => {
                Some(format!("nothing is to be confirmed: {}", doing(run)))
            }
            Self::Confirm => continue_refused(self, &status.rig, run),
            Self::Repeat => {
                let awaits = run.paused_why == Some(PausedWhy::ManualTrial)
                    && matches!(run.wanted, Some(Wanted::Placement { .. }));
                (!awaits).then(|| NO_PLACEMENT.into())
            }
            Self::Stop => event_refused(self, RunEvent::Stop, run),
            Self::Abort => event_refused(self, RunEvent::Abort, run),
        }
    }
}

/// The trip that brings a person to the rig, if there is one: without a run any, during a run one that does not pass
/// without a person.
fn trip_for_person(status: &Status) -> Option<&str> {
    let trip = status.rig.trip.as_ref()?;
    (status.run.is_none() || !trip.kind.may_pass()).then_some(trip.detail.as_str())
}

/// The trip that brings a person to the rig, as text for the queue.
pub fn tripped(status: &Status) -> Option<String> {
    trip_for_person(status).map(|trip| format!("the rig tripped ({trip})"))
}

/// Why a run is not accepted to wait for its turn, as text; `None` if it is.
pub fn wait_refused(status: &Status) -> Option<String> {
    let trip = trip_for_person(status)?;
    Some(format!("the rig has tripped ({trip}): reset it, then start the run"))
}

/// Why a free rig does not begin a run, as text; `None` if it does: it is armed for one that presses. A rig without
/// a stage needs open wires only.
fn begin_refused(rig: &RigStatus) -> Option<String> {
    if rig.state == RigState::Disconnected {
        return Some(NO_WIRES.into());
    }
    let armed = rig_state::step(rig.state, RigEvent::Arm);
    armed.err().filter(|_| rig.has_stage).map(|refused| refused.to_string())
}

/// Why the active run refuses a pause, as text; `None` if it does not. `event`: at the checkpoint, or now.
pub(super) fn pause_refused(event: RunEvent, run: &RunStatus) -> Option<String> {
    // It waits already, for its wires: nothing more can be paused.
    let waits = run.phase == Phase::Wait && run.state == StoredState::Pausing;
    match event_refused(ActionOnRun::Pause, event, run) {
        None if waits => Some(not_while(ActionOnRun::Pause, run)),
        refused => refused,
    }
}

/// Why a run that waits, or its rig, does not continue, as text. A manual run moves nothing.
fn continue_refused(action: ActionOnRun, rig: &RigStatus, run: &RunStatus) -> Option<String> {
    let may_move = matches!(rig.state, RigState::Homed | RigState::Armed);
    let refused = event_refused(action, RunEvent::Resume, run);
    refused.or_else(|| {
        let rig = rig.state.as_str();
        let words =
            || format!("{} is not possible while the rig is {rig}: reset, home", action.as_str());
        (!may_move && !run.is_manual).then(words)
    })
}

/// Why the state of the active run does not allow an event, as text.
fn event_refused(action: ActionOnRun, event: RunEvent, run: &RunStatus) -> Option<String> {
    let allowed = state_of(run).is_some_and(|state| run_state::step(state, event).is_ok());
    (!allowed).then(|| not_while(action, run))
}

fn not_while(action: ActionOnRun, run: &RunStatus) -> String {
    let next = state_of(run).map_or("read the status", RunState::allowed);
    format!("{} is not possible while the run is {}: {next}", action.as_str(), run.state)
}

fn state_of(run: &RunStatus) -> Option<RunState> {
    RunState::of(run.state, run.paused_why)
}

/// Whether the run waits, or is about to wait, for the work of a person.
fn needs_person(run: &RunStatus) -> bool {
    matches!(run.paused_why, Some(PausedWhy::TipChange | PausedWhy::ManualTrial))
}

/// What the active run does, as text, for a refusal.
pub(in crate::campaign) fn doing(run: &RunStatus) -> String {
    match (run.state, run.phase) {
        (StoredState::Running, Phase::Settle) => "the forces of the trial settle".into(),
        (StoredState::Running, Phase::Measure | Phase::Commit) => {
            "the frames of the trial are taken".into()
        }
        (state, _) => format!("the run is {state}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::interlock::{Trip, TripKind};
    use crate::campaign::shown::rig_action::tests::{BENCH, SKIN, status, waiting};

    /// Names of the actions that are not refused.
    fn allowed(status: &Status) -> String {
        let actions = ActionOnRun::ALL.into_iter();
        let allowed = actions.filter(|action| action.refused(status).is_none());
        allowed.map(ActionOnRun::as_str).collect::<Vec<_>>().join(" ")
    }

    fn refusal(action: ActionOnRun, status: &Status) -> String {
        action.refused(status).unwrap()
    }

    #[test]
    fn a_free_rig_begins_a_run_only_if_it_is_homed() {
        for (state, wanted) in [
            (RigState::Disconnected, ""),
            (RigState::Disarmed, ""),
            (RigState::Homed, "start"),
            (RigState::Tripped, ""),
        ] {
            assert_eq!(allowed(&status(BENCH, state)), wanted, "{state:?}");
        }
        assert_eq!(allowed(&status(SKIN, RigState::Disarmed)), "start");
        assert_eq!(refusal(ActionOnRun::Start, &status(SKIN, RigState::Disconnected)), NO_WIRES);
        let none = refusal(ActionOnRun::Pause, &status(BENCH, RigState::Homed));
        assert_eq!(none, "pause is not possible: no run is active");
    }

    #[test]
    fn the_states_of_a_run_decide_what_may_be_asked_of_it() {
        use PausedWhy::{Operator, Suspender, TipChange, Trip};
        use StoredState as S;
        let mut now = status(BENCH, RigState::Armed);
        now.run = Some(waiting(Operator));
        for (state, why, phase, wanted) in [
            (S::Running, None, Phase::Press, "start pause stop abort"),
            (S::Pausing, Some(Operator), Phase::Press, "start resume stop abort"),
            (S::Pausing, Some(TipChange), Phase::Raise, "start stop abort"),
            (S::Paused, Some(Operator), Phase::Wait, "start resume stop abort"),
            (S::Paused, Some(Trip), Phase::Wait, "start pause resume stop abort"),
            (S::Paused, Some(TipChange), Phase::Wait, "start confirm stop abort"),
            (S::Suspending, Some(Suspender), Phase::Raise, "start stop abort"),
            (S::Stopping, None, Phase::Press, "start abort"),
            (S::Aborting, None, Phase::Raise, "start"),
            (S::Panicked, None, Phase::Wait, "start"),
        ] {
            let run = now.run.as_mut().unwrap();
            (run.state, run.paused_why, run.phase) = (state, why, phase);
            assert_eq!(allowed(&now), wanted, "{state:?} {why:?} {phase:?}");
        }
    }

    #[test]
    fn a_halted_run_presses_again_only_on_a_homed_rig() {
        let mut tripped = status(BENCH, RigState::Tripped);
        tripped.rig.trip = Some(Trip { kind: TripKind::Estop, detail: "hands".into() });
        tripped.run = Some(waiting(PausedWhy::Operator));
        assert_eq!(allowed(&tripped), "stop abort");
        let words = refusal(ActionOnRun::Resume, &tripped);
        assert_eq!(words, "resume is not possible while the rig is tripped: reset, home");
        let words = refusal(ActionOnRun::Start, &tripped);
        assert_eq!(words, "the rig has tripped (hands): reset it, then start the run");
        let words = refusal(ActionOnRun::Pause, &tripped);
        let wanted = "pause is not possible while the run is paused: resume, stop or abort it";
        assert_eq!(words, wanted);
        tripped.run.as_mut().unwrap().is_manual = true;
        assert_eq!(allowed(&tripped), "resume stop abort", "weights move nothing");
    }

    #[test]
    fn only_a_run_that_awaits_weights_repeats_a_placement() {
        let mut waits = status(SKIN, RigState::Disarmed);
        let wanted = Some(Wanted::Placement { trial: 7, contacts: Vec::new() });
        let run = RunStatus { is_manual: true, wanted, ..waiting(PausedWhy::ManualTrial) };
        waits.run = Some(run);
        assert_eq!(allowed(&waits), "start confirm repeat stop abort");
        let words = refusal(ActionOnRun::Resume, &waits);
        assert_eq!(words, "resume is not possible: confirm what the run waits for");
        let run = waits.run.as_mut().unwrap();
        (run.state, run.paused_why, run.phase) = (StoredState::Running, None, Phase::Settle);
        let words = refusal(ActionOnRun::Confirm, &waits);
        assert_eq!(words, "nothing is to be confirmed: the forces of the trial settle");
        assert_eq!(refusal(ActionOnRun::Repeat, &waits), NO_PLACEMENT);
    }

    #[test]
    fn a_trip_without_a_run_brings_a_person_to_the_rig() {
        let mut now = status(BENCH, RigState::Disarmed);
        assert_eq!(trip_for_person(&now), None);
        for kind in [TripKind::Wire, TripKind::Estop] {
            now.rig.trip = Some(Trip { kind, detail: "why".into() });
            assert_eq!(trip_for_person(&now), Some("why"), "{kind:?}");
        }
        now.run = Some(waiting(PausedWhy::Trip));
        now.rig.trip = Some(Trip { kind: TripKind::Wire, detail: "why".into() });
        assert_eq!(trip_for_person(&now), None, "it may pass without a person");
    }
}
