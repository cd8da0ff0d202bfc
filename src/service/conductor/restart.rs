//! Decides after a start of the service, from the open and waiting runs of the earlier process,
//! which run is driven first, which runs still wait, and which a person must start again.
//! PURE. Uses: `state`, `store` (its rows). Never: the rig, a request.

use crate::state::{PausedWhy, StoredState};
use crate::store::{RunKind, RunRow};

/// This start of the service does not allow automatic resumes.
const NOT_ASKED: &str =
    "the service was started without automatic resume, or at a desk: start it again at its rig";
/// The arming of the run does not allow automatic resumes.
const NOT_ALLOWED: &str =
    "its arming does not allow an automatic start after a restart of the service: start it again";
/// Tips may be partly mounted, or hands in the way.
const SOMEBODY_THERE: &str = "the run before it was manual, waiting, tripped or ending, and a person may be at \
                              the rig: start it again";

/// Whether a start of the service may resume runs automatically, if their arming allows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AutoResume {
    /// Runs may resume.
    Allowed,
    /// No run resumes: a person starts each again.
    Off,
    /// Nothing is decided: the runs stay as they are stored, for the next service. This one drives no rig.
    Later,
}

/// Decision on open and waiting runs.
#[derive(Debug, PartialEq)]
pub(super) struct TakenOver {
    /// The run that was active, if it may resume automatically.
    pub driven: Option<RunRow>,
    /// Runs that were armed and started behind it and still wait, the next one first.
    pub waiting: Vec<RunRow>,
    /// Runs that waited and must be started again, with the reason.
    pub dropped: Vec<(RunRow, &'static str)>,
}

impl TakenOver {
    /// Decides on the open runs and on those that wait, both in their order.
    pub(super) fn of(open: Vec<RunRow>, waiting: Vec<RunRow>, resume: AutoResume) -> Self {
        let may_resume = resume == AutoResume::Allowed;
        let somebody_there = open.iter().any(|run| is_manual(run) || !was_driven(run));
        let refusal = |run: &RunRow| match run.auto_resume {
            _ if !may_resume => Some(NOT_ASKED),
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
        let driven = open.into_iter().rfind(|run| may_resume && resumes_automatically(run));
        Self { driven, waiting: kept, dropped }
    }
}

/// Whether a service that starts now, and may resume runs, resumes this one: its row is all that it knows.
pub fn resumes_automatically(run: &RunRow) -> bool {
    run.auto_resume && was_driven(run)
}

/// Whether a run was driven without a person. A run that waited for a person, was tripped, or was
/// ending when the process ended does not resume automatically: a person may be at the rig.
fn was_driven(run: &RunRow) -> bool {
    run.state == StoredState::Running || run.paused_why == Some(PausedWhy::Restart)
}

/// Whether a person is at the skin all the time.
fn is_manual(run: &RunRow) -> bool {
    run.kind == RunKind::RealRandom
}

#[cfg(test)]
pub(super) mod tests {
    use jiff::Timestamp;
    use serde_json::json;

    use super::AutoResume::{Allowed, Off};
    use super::*;
    use crate::ids::RunUid;

    /// A stored run.
    pub(in super::super) fn run(
        state: StoredState,
        paused_why: Option<PausedWhy>,
        auto_resume: bool,
    ) -> RunRow {
        let stored = json!({ "uid": RunUid::new(), "scan_id": 1, "experiment": "quickstart",
            "kind": "real-hex", "definition": "", "definition_sha256": "", "seed": 1, "sensor": "",
            "sensor_sha256": "", "label": "virtual", "version": "", "deadband_n": 5.0,
            "trials_planned": 1, "auto_resume": auto_resume, "state": state,
            "paused_why": paused_why, "is_resumable": false, "created_at": Timestamp::UNIX_EPOCH,
            "submitted_by": "local" });
        serde_json::from_value(stored).unwrap()
    }

    /// Decision on one open run and one that waits: driven, waiting, reason of the drop.
    fn becomes(
        open: Option<RunRow>,
        waits_and_may: Option<bool>,
        resume: AutoResume,
    ) -> (bool, bool, Option<&'static str>) {
        let waiting = waits_and_may.map(|may| run(StoredState::Queued, None, may));
        let taken =
            TakenOver::of(open.into_iter().collect(), waiting.into_iter().collect(), resume);
        let why = taken.dropped.first().map(|(_, why)| *why);
        (taken.driven.is_some(), !taken.waiting.is_empty(), why)
    }

    #[test]
    fn a_run_that_was_under_way_goes_on_where_its_arming_allows_it() {
        let running = |may| Some(run(StoredState::Running, None, may));
        assert_eq!(becomes(running(true), None, Allowed), (true, false, None));
        assert_eq!(becomes(running(false), None, Allowed), (false, false, None));
        assert_eq!(becomes(running(true), None, Off), (false, false, None));
        let restarted = run(StoredState::Paused, Some(PausedWhy::Restart), true);
        assert_eq!(becomes(Some(restarted), None, Allowed), (true, false, None));
        for (state, why) in [
            (StoredState::Paused, Some(PausedWhy::Operator)),
            (StoredState::Paused, Some(PausedWhy::Trip)),
            (StoredState::Stopping, None),
        ] {
            assert_eq!(becomes(Some(run(state, why, true)), None, Allowed), (false, false, None));
        }
    }

    #[test]
    fn a_run_that_waits_keeps_its_turn_where_its_arming_allows_it() {
        let running = |may| Some(run(StoredState::Running, None, may));
        // Behind one that resumes, behind one that may not, and without one before it.
        assert_eq!(becomes(running(true), Some(true), Allowed), (true, true, None));
        assert_eq!(becomes(running(false), Some(true), Allowed), (false, true, None));
        assert_eq!(becomes(None, Some(true), Allowed), (false, true, None));
        assert_eq!(becomes(None, Some(false), Allowed), (false, false, Some(NOT_ALLOWED)));
        assert_eq!(becomes(running(true), Some(false), Allowed), (true, false, Some(NOT_ALLOWED)));
        assert_eq!(becomes(None, Some(true), Off), (false, false, Some(NOT_ASKED)));
    }

    #[test]
    fn nothing_begins_by_itself_where_somebody_may_be_at_the_rig() {
        let change = run(StoredState::Paused, Some(PausedWhy::TipChange), true);
        let dropped = Some(SOMEBODY_THERE);
        assert_eq!(becomes(Some(change), Some(true), Allowed), (false, false, dropped));
        // Also while a placement was measured, and whether or not the manual run itself may resume.
        for may in [true, false] {
            let manual =
                RunRow { kind: RunKind::RealRandom, ..run(StoredState::Running, None, may) };
            assert_eq!(becomes(Some(manual), Some(true), Allowed), (may, false, dropped));
        }
    }
}
