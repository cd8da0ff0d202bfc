//! Decides which of the runs that were started and wait may begin, and when to decide again.
//! PURE. Uses: `problem`, `campaign::shown` (the status), `store` (its rows). Never: the clock (the time is passed in),
//! a request.

use std::collections::BTreeMap;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use crate::campaign::shown::status::Status;
use crate::ids::RunUid;
use crate::problem::Problem;
use crate::store::{LockRow, RunRow};

/// Longest time between two decisions: the wall clock may be set, and the machine may sleep.
const DECIDE_AGAIN: Duration = Duration::from_secs(30);
/// Largest distance of a start time from now; a later one is assumed to be an error.
const AHEAD_MAX_DAYS: i64 = 366;

/// Whether the time of a run has come.
pub(super) fn is_due(run: &RunRow, now: Timestamp) -> bool {
    run.not_before.is_none_or(|at| at <= now)
}

/// When it is decided, and the operator lock at that time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Present<'a> {
    /// Wall time of the decision.
    pub now: Timestamp,
    /// The lock; `None` if it is free.
    pub lock: Option<&'a LockRow>,
    /// Who started runs in this process. Any other run counts as started by who submitted it.
    pub starters: &'a BTreeMap<RunUid, String>,
}

impl Present<'_> {
    /// Whether the time of a run has come and no lock refuses it.
    pub fn lets_begin(self, run: &RunRow) -> bool {
        self.is_due(run) && self.refusal(run).is_none()
    }

    fn is_due(self, run: &RunRow) -> bool {
        is_due(run, self.now)
    }

    /// The lock that refuses the beginning of a run: another person took it after the run was started, for
    /// example with hands in the rig. One who started a run and then took the lock does not stop it.
    fn refusal(&self, run: &RunRow) -> Option<&LockRow> {
        let is_later = |lock: &&LockRow| run.waiting_since.is_some_and(|start| lock.since >= start);
        let starter = self.starters.get(&run.uid).unwrap_or(&run.submitted_by);
        self.lock.filter(is_later).filter(|lock| lock.holder != *starter)
    }
}

/// Time after which to decide again, because a run may begin then; `None` if no run is early or refused
/// by a lock.
pub(super) fn decide_again(waiting: &[RunRow], present: Present<'_>) -> Option<Duration> {
    let early = |run: &RunRow| run.not_before.filter(|at| *at > present.now);
    let first = waiting.iter().filter_map(early).min();
    let left =
        first.map(|at| Duration::try_from(at.duration_since(present.now)).unwrap_or_default());
    let refused = waiting.iter().any(|run| present.refusal(run).is_some());
    let left = left.or(refused.then_some(DECIDE_AGAIN))?;
    Some(left.min(DECIDE_AGAIN))
}

/// What a run that is due waits for, apart from a lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Obstacle {
    /// Another run is active.
    ActiveRun,
    /// An axis has not acknowledged the stop of the last safe end, or moves after it: the rig is busy.
    SafeEnd,
    /// The rig is not homed.
    NotHomed,
}

impl Obstacle {
    /// At this status.
    pub(super) fn of(status: &Status) -> Self {
        if status.run.is_some() {
            Self::ActiveRun
        } else if status.rig.safe_end.as_ref().is_some_and(|end| !end.is_stopped()) {
            Self::SafeEnd
        } else {
            Self::NotHomed
        }
    }

    /// When it is gone, as text.
    fn when_gone(self) -> &'static str {
        match self {
            Self::ActiveRun => "the active run has ended",
            Self::SafeEnd => {
                "the last safe end is complete: an axis has not acknowledged its stop, or moves after it"
            }
            Self::NotHomed => "the rig is homed",
        }
    }
}

/// What the next of the waiting runs waits for, as text; `None` if none waits.
pub(super) fn waits_for(
    waiting: &[RunRow],
    obstacle: Obstacle,
    present: Present<'_>,
) -> Option<String> {
    let next = waiting.iter().find(|run| present.is_due(run));
    let first = next.or_else(|| waiting.iter().min_by_key(|run| run.not_before))?;
    let run = format!("run {} ({})", first.scan_id, first.experiment);
    if let Some(lock) = present.refusal(first).filter(|_| present.is_due(first)) {
        let LockRow { holder, note, .. } = lock;
        return Some(format!("{run} starts when {holder} releases the operator lock: {note}"));
    }
    Some(match first.not_before.filter(|at| *at > present.now) {
        Some(at) => format!("{run} starts at {at:.0} or later"),
        None => format!("{run} starts when {}", obstacle.when_gone()),
    })
}

/// Checks a requested start time. A time in the past means: at once.
///
/// # Errors
/// A problem if it is too far ahead.
pub(super) fn check(not_before: Option<Timestamp>, now: Timestamp) -> Result<(), Vec<Problem>> {
    let ahead =
        |at: Timestamp| at.duration_since(now) > SignedDuration::from_hours(24 * AHEAD_MAX_DAYS);
    match not_before.filter(|at| ahead(*at)) {
        None => Ok(()),
        Some(at) => {
            let limit = format!("must be at most {AHEAD_MAX_DAYS} days ahead");
            Err(vec![Problem::new("request", "not_before", at, limit)])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::restart::tests::run;
    use super::*;
    use crate::campaign::bench::estop::AxisStop;
    use crate::campaign::bench::rig_state::RigState;
    use crate::campaign::shown::safe_end::{SafeEnd, Tips};
    use crate::campaign::shown::show;
    use crate::rig::setup::RigSetup;
    use crate::state::StoredState;

    const NOW_S: i64 = 1_795_000_000;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_second(NOW_S + seconds).unwrap()
    }

    /// Waiting runs with these start times, in seconds from now.
    fn waiting(starts: &[Option<i64>]) -> Vec<RunRow> {
        let one = |(start, scan_id): (&Option<i64>, i64)| RunRow {
            not_before: start.map(at),
            scan_id,
            ..run(StoredState::Queued, None, true)
        };
        starts.iter().zip(1..).map(one).collect()
    }

    fn due(starts: &[Option<i64>]) -> Vec<i64> {
        let runs = waiting(starts);
        runs.iter().filter(|run| free().lets_begin(run)).map(|run| run.scan_id).collect()
    }

    static NOBODY: BTreeMap<RunUid, String> = BTreeMap::new();

    fn free() -> Present<'static> {
        Present { now: at(0), lock: None, starters: &NOBODY }
    }

    #[test]
    fn a_run_is_due_from_its_time_on_and_holds_up_no_other() {
        assert_eq!(due(&[None, Some(-1), Some(0), Some(1)]), [1, 2, 3]);
        assert_eq!(due(&[Some(3600), None]), [2]);
        assert_eq!(due(&[]), [0_i64; 0]);
    }

    #[test]
    fn the_next_decision_is_when_the_first_early_run_is_due_or_soon() {
        let again = |starts: &[Option<i64>]| decide_again(&waiting(starts), free());
        assert_eq!(again(&[None, Some(-5), Some(0)]), None);
        assert_eq!(again(&[Some(20), None, Some(7)]), Some(Duration::from_secs(7)));
        assert_eq!(again(&[Some(7200)]), Some(DECIDE_AGAIN));
    }

    #[test]
    fn the_status_names_the_next_run_and_its_reason() {
        let words =
            |starts: &[Option<i64>], obstacle| waits_for(&waiting(starts), obstacle, free());
        assert_eq!(words(&[], Obstacle::ActiveRun), None);
        let homed = "run 1 (quickstart) starts when the rig is homed";
        assert_eq!(words(&[Some(-1), None], Obstacle::NotHomed).unwrap(), homed);
        let ended = "run 2 (quickstart) starts when the active run has ended";
        assert_eq!(words(&[Some(60), None], Obstacle::ActiveRun).unwrap(), ended);
        let later = "run 2 (quickstart) starts at 2026-11-18T11:07:40Z or later";
        assert_eq!(words(&[Some(90), Some(60)], Obstacle::NotHomed).unwrap(), later);
    }

    #[test]
    fn a_homed_rig_is_busy_until_its_safe_end_is_complete() {
        let rig = include_str!("../../../experiments/rigs/virtual.toml");
        let mut status = show::closed(&RigSetup::from_toml("virtual.toml", rig).unwrap());
        status.rig.state = RigState::Homed;
        let mut end = SafeEnd {
            stops: vec![AxisStop::of("y")],
            tips: Tips::Raised,
            sample_to_stop_ms: None,
            travelled_mm: None,
            took_ms: 2100.0,
        };
        status.rig.safe_end = Some(end.clone());
        assert_eq!(Obstacle::of(&status), Obstacle::SafeEnd);
        let words = waits_for(&waiting(&[None]), Obstacle::of(&status), free()).unwrap();
        assert!(words.contains(" starts when the last safe end is complete: an axis"), "{words}");
        end.stops[0].acknowledged_ms = Some(3.0);
        status.rig.safe_end = Some(end);
        assert_eq!(Obstacle::of(&status), Obstacle::NotHomed);
    }

    #[test]
    fn a_lock_that_another_person_took_after_the_start_refuses_the_run() {
        let lock = |holder: &str, since: i64| LockRow {
            holder: holder.into(),
            note: "hands in the rig".into(),
            since: at(since),
        };
        let mut runs = waiting(&[Some(-1)]);
        runs[0].waiting_since = Some(at(-100));
        runs[0].submitted_by = "ada".into();
        let of = |lock: LockRow| {
            let present = Present { lock: Some(&lock), ..free() };
            let again = decide_again(&runs, present);
            let words = waits_for(&runs, Obstacle::NotHomed, present).unwrap();
            (present.lets_begin(&runs[0]), again, words)
        };
        let (begins, again, words) = of(lock("bob", -50));
        assert!(!begins && again == Some(DECIDE_AGAIN));
        assert!(!of(lock("bob", -100)).0, "the clock was set back between the two");
        assert_eq!(
            words,
            "run 1 (quickstart) starts when bob releases the operator lock: hands in the rig"
        );
        // Who took the lock before could start the run himself, or gave it to no other.
        assert!(of(lock("bob", -200)).0 && of(lock("ada", -50)).0);
        // Of who submitted it and who started it, the one who started it.
        let starters = BTreeMap::from([(runs[0].uid, "cyd".to_owned())]);
        let begins = |lock: LockRow| {
            Present { lock: Some(&lock), starters: &starters, ..free() }.lets_begin(&runs[0])
        };
        assert!(begins(lock("cyd", -50)) && !begins(lock("ada", -50)));
    }

    #[test]
    fn a_start_in_another_year_is_an_error_and_one_in_the_past_is_none() {
        let day = 86_400;
        for sound in [None, Some(at(-9 * day)), Some(at(0)), Some(at(366 * day))] {
            assert_eq!(check(sound, at(0)), Ok(()));
        }
        let problem = &check(Some(at(366 * day + 1)), at(0)).unwrap_err()[0];
        assert_eq!((problem.key.as_str(), problem.file.as_str()), ("not_before", "request"));
    }
}
