//! What a start of the service makes of what the process before it left: which run is driven first,
//! which runs still wait for their turn, and which must be started anew by a person.
//! PURE. Uses: `campaign::run::run_state`, `store` (its rows). Never: the rig, a request.

use crate::campaign::run::run_state::{PausedWhy, RunState};
use crate::store::RunRow;

/// Nobody asked this start to go on by itself.
const NOT_ASKED: &str = "the service was started without going on by itself";
/// The run's own arming says no.
const NOT_ALLOWED: &str = "its arming does not allow it to begin by itself after a restart";
/// Tips may be half mounted, hands in the way.
const SOMEBODY_THERE: &str = "the run before it was not under way by itself: somebody may be at the \
                              rig";

/// What becomes of open and waiting runs.
#[derive(Debug, PartialEq)]
pub(super) struct TakenOver {
    /// The run that was under way, if it may go on by itself.
    pub driven: Option<RunRow>,
    /// Runs that were armed and started behind it and still wait, the next first.
    pub waiting: Vec<RunRow>,
    /// Runs that waited and must be started anew, and why.
    pub dropped: Vec<(RunRow, &'static str)>,
}

impl TakenOver {
    /// Of the runs in a state of the engine and of those that wait, both in their order. `resume`:
    /// this start may go on by itself.
    pub(super) fn of(open: Vec<RunRow>, waiting: Vec<RunRow>, resume: bool) -> Self {
        let somebody_there = !open.iter().all(was_driven);
        let refusal = |run: &RunRow| match run.auto_resume {
            _ if !resume => Some(NOT_ASKED),
            false => Some(NOT_ALLOWED),
            true => somebody_there.then_some(SOMEBODY_THERE),
        };
        let (mut kept, mut dropped) = (Vec::new(), Vec::new());
        for run in waiting {
            match refusal(&run) {
                Some(why) => dropped.push((run, why)),
                None => kept.push(run),
            }
        }
        let driven = open.into_iter().rfind(|run| resume && run.auto_resume && was_driven(run));
        Self { driven, waiting: kept, dropped }
    }
}

/// A run that waited for a person, stood in a trip, or was to end when the process ended is not gone
/// on with unasked: somebody may be at the rig.
fn was_driven(run: &RunRow) -> bool {
    run.state == RunState::Running.as_str()
        || run.paused_why.as_deref() == Some(PausedWhy::Restart.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::RunUid;
    use crate::store::{Label, RunKind};

    fn run(state: &str, paused_why: Option<&str>, auto_resume: bool) -> RunRow {
        RunRow {
            uid: RunUid::new(),
            scan_id: 1,
            experiment: "quickstart".into(),
            kind: RunKind::RealHex,
            definition: String::new(),
            definition_sha256: String::new(),
            seed: Some(1),
            rig: None,
            rig_sha256: None,
            sensor: String::new(),
            sensor_sha256: String::new(),
            calibration_id: None,
            label: Label::Virtual,
            version: String::new(),
            git_commit: None,
            deadband_n: 5.0,
            tip_diameter_mm: None,
            trials_planned: 1,
            auto_resume,
            state: state.into(),
            requested_state: None,
            paused_why: paused_why.map(Into::into),
            exit_status: None,
            reason: None,
            queue_position: None,
            waiting_since: None,
            created_at: jiff::Timestamp::UNIX_EPOCH,
            started_at: None,
            ended_at: None,
            submitted_by: "local".into(),
        }
    }

    /// What becomes of one open run and one that waits: driven, waiting, why dropped.
    fn becomes(
        open: Option<RunRow>,
        waits_and_may: Option<bool>,
        resume: bool,
    ) -> (bool, bool, Option<&'static str>) {
        let waiting = waits_and_may.map(|may| run("queued", None, may));
        let taken =
            TakenOver::of(open.into_iter().collect(), waiting.into_iter().collect(), resume);
        let why = taken.dropped.first().map(|(_, why)| *why);
        (taken.driven.is_some(), !taken.waiting.is_empty(), why)
    }

    #[test]
    fn a_run_that_was_under_way_goes_on_where_its_arming_allows_it() {
        let running = |may| Some(run("running", None, may));
        assert_eq!(becomes(running(true), None, true), (true, false, None));
        assert_eq!(becomes(running(false), None, true), (false, false, None));
        assert_eq!(becomes(running(true), None, false), (false, false, None));
        let restarted = run("paused", Some("restart"), true);
        assert_eq!(becomes(Some(restarted), None, true), (true, false, None));
        for (state, why) in
            [("paused", Some("operator")), ("paused", Some("trip")), ("stopping", None)]
        {
            assert_eq!(becomes(Some(run(state, why, true)), None, true), (false, false, None));
        }
    }

    #[test]
    fn a_run_that_waits_keeps_its_turn_where_its_arming_allows_it() {
        let running = |may| Some(run("running", None, may));
        // Behind one that goes on, behind one that may not, and with none before it.
        assert_eq!(becomes(running(true), Some(true), true), (true, true, None));
        assert_eq!(becomes(running(false), Some(true), true), (false, true, None));
        assert_eq!(becomes(None, Some(true), true), (false, true, None));
        assert_eq!(becomes(None, Some(false), true), (false, false, Some(NOT_ALLOWED)));
        assert_eq!(becomes(running(true), Some(false), true), (true, false, Some(NOT_ALLOWED)));
        assert_eq!(becomes(None, Some(true), false), (false, false, Some(NOT_ASKED)));
    }

    #[test]
    fn nothing_begins_by_itself_where_somebody_may_be_at_the_rig() {
        let change = run("paused", Some("tip_change"), true);
        assert_eq!(becomes(Some(change), Some(true), true), (false, false, Some(SOMEBODY_THERE)));
    }
}
