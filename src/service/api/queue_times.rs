//! When the waiting runs begin and end, as far as it can be predicted.
//! Uses: `conductor` (preflights), `store`, the estimate of the active run. Never: a start, the time of persons.

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::limits::ROOM_MAX;
use super::pages::Page;
use super::problem::ApiResult;
use super::refusals::DESK;
use crate::conductor::{ConductorError, ConductorResult};
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::schedule::preflight::Preflight;
use crate::store::RunRow;

/// Predicted times of a waiting run. They hold if each run is started before its turn, and exclude the time of persons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct QueueTime {
    /// Id of the run.
    pub run: RunUid,
    /// Number of the run.
    pub scan_id: i64,
    /// Likely duration, wall s; null if the run cannot be planned on this rig.
    pub duration_s: Option<f64>,
    /// Likely begin; null while the end of the active run is not known, and for a run that would be refused.
    pub begin: Option<Timestamp>,
    /// Likely end; null as `begin`.
    pub end: Option<Timestamp>,
    /// End under favourable assumptions; null as `begin`.
    pub low: Option<Timestamp>,
    /// End under unfavourable assumptions; null as `begin`.
    pub high: Option<Timestamp>,
    /// Why the run would be refused on this rig, as text; null if it would not.
    pub problem: Option<String>,
    /// Why the run must be started again, as text: it had been started and does not begin by itself any more; null
    /// for others. The reason is kept until the service ends.
    pub not_begun: Option<String>,
}

/// What the preflight of a waiting run states of its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Duration: likely, low, high, wall s.
    durations_s: Option<[f64; 3]>,
    problem: Option<String>,
}

/// Returns when the waiting runs begin and end, in the order of the queue.
///
/// A run whose start time has not come lets others pass. The first request for a run plans it, which takes up to a
/// second.
#[utoipa::path(get, operation_id = "queue_times", path = "/api/v1/queue/times", tag = "queue",
    responses((status = 200, body = Page<QueueTime>)))]
pub async fn times(app: App) -> ApiResult<Page<QueueTime>> {
    let rows = app.store.queue().await?;
    let mut planned = Vec::with_capacity(rows.len());
    for row in rows.iter().take(ROOM_MAX) {
        let key = (row.uid, row.plan_sha256.clone());
        let found = app.facts.memory.planned.get(key, plan(&app, row)).await;
        // A run that fails to be planned has its problem, and the others have their times.
        planned.push(found.unwrap_or_else(|error| Arc::new(Planned::refused(&error))));
    }
    let now = Timestamp::now();
    let run = app.campaign.status().run;
    let free_s = match run.as_ref().map(|run| run.eta) {
        _ if app.facts.desk => None,
        None => Some([0.0; 3]),
        Some(eta) => eta.map(|eta| [eta.remaining_s, eta.low_s, eta.high_s]),
    };
    let waiting: Vec<Waiting> = rows
        .iter()
        .zip(&planned)
        .map(|(row, planned)| Waiting {
            early_s: row.not_before.map_or(0.0, |at| at.duration_since(now).as_secs_f64()),
            durations_s: planned.taken_s(),
        })
        .collect();
    let mut times = free_s.map_or_else(Vec::new, |free_s| predict(&waiting, free_s));
    times.resize(rows.len(), None);
    let at = |s: f64| {
        SignedDuration::try_from_secs_f64(s).ok().and_then(|after| now.checked_add(after).ok())
    };
    let time = |(n, (row, time)): (usize, (&RunRow, Option<Times>))| QueueTime {
        run: row.uid,
        scan_id: row.scan_id,
        duration_s: planned.get(n).and_then(|planned| Some(planned.durations_s?[0])),
        begin: time.and_then(|time| at(time.begin_s)),
        end: time.and_then(|time| at(time.end_s[0])),
        low: time.and_then(|time| at(time.end_s[1])),
        high: time.and_then(|time| at(time.end_s[2])),
        problem: match app.facts.desk {
            true => Some(DESK.to_owned()),
            false => planned.get(n).and_then(|planned| planned.problem.clone()),
        },
        not_begun: app.conductor.why_dropped(row.uid),
    };
    Ok(Page::whole(rows.iter().zip(times).enumerate().map(time).collect()))
}

impl Planned {
    fn of(preflight: &Preflight) -> Self {
        let Preflight { duration_s, duration_low_s, duration_high_s, problems, .. } = preflight;
        Self {
            durations_s: Some([*duration_s, *duration_low_s, *duration_high_s]),
            problem: problems.first().map(ToString::to_string),
        }
    }

    /// Duration for which it will have the rig: none if it would be refused.
    fn taken_s(&self) -> Option<[f64; 3]> {
        self.durations_s.filter(|_| self.problem.is_none())
    }

    fn refused(error: &ConductorError) -> Self {
        Self { durations_s: None, problem: Some(error_chain(error)) }
    }
}

/// Plans a waiting run; that its files are refused is an answer, too, and is kept.
async fn plan(app: &App, row: &RunRow) -> ConductorResult<Arc<Planned>> {
    match app.conductor.preflight_of(row).await {
        Ok(preflight) => Ok(Arc::new(Planned::of(&preflight))),
        Err(error @ ConductorError::Problems { .. }) => Ok(Arc::new(Planned::refused(&error))),
        Err(error) => Err(error),
    }
}

/// A waiting run: the time until its earliest start, s, and its duration; absent if it would be refused.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    early_s: f64,
    durations_s: Option<[f64; 3]>,
}

/// Predicted begin and end of a run, s from now; the end likely, low and high.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Times {
    begin_s: f64,
    end_s: [f64; 3],
}

/// Predicts the times of waiting runs in the order of the queue; `free_s`: when the rig is free, likely, low and high.
/// A run that would be refused is passed over, and the next one begins.
fn predict(runs: &[Waiting], free_s: [f64; 3]) -> Vec<Option<Times>> {
    let mut times = vec![None; runs.len()];
    let mut open: Vec<usize> = (0..runs.len()).collect();
    let mut free_s = free_s;
    while !open.is_empty() {
        let due = open.iter().position(|run| runs[*run].early_s <= free_s[0]);
        let early = |place: &usize| runs[open[*place]].early_s;
        let earliest = || (0..open.len()).min_by(|a, b| early(a).total_cmp(&early(b)));
        let Some(place) = due.or_else(earliest) else { break };
        let run = open.remove(place);
        let Waiting { early_s, durations_s } = runs[run];
        let Some(durations_s) = durations_s else { continue };
        let begin_s = free_s[0].max(early_s);
        free_s = std::array::from_fn(|n| free_s[n].max(early_s) + durations_s[n]);
        times[run] = Some(Times { begin_s, end_s: free_s });
    }
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::shown::command::Refusal;

    fn waiting(early_s: f64, duration_s: f64) -> Waiting {
        let durations_s = Some([duration_s, 0.5 * duration_s, 2.0 * duration_s]);
        Waiting { early_s, durations_s }
    }

    #[test]
    fn runs_follow_one_another_and_one_whose_time_has_not_come_lets_others_pass() {
        let runs = [waiting(-5.0, 10.0), waiting(1000.0, 10.0), waiting(0.0, 20.0)];
        let times = predict(&runs, [100.0, 90.0, 120.0]);
        let of = |begin_s, end_s| Some(Times { begin_s, end_s });
        assert_eq!(times[0], of(100.0, [110.0, 95.0, 140.0]));
        assert_eq!(times[2], of(110.0, [130.0, 105.0, 180.0]));
        assert_eq!(times[1], of(1000.0, [1010.0, 1005.0, 1020.0]));
        assert_eq!(predict(&[], [0.0; 3]), []);
    }

    #[test]
    fn a_run_that_cannot_be_planned_has_its_problem_and_the_others_have_their_times() {
        let refused = Planned::refused(&ConductorError::Refused(Refusal::Gone));
        assert_eq!(refused.problem.as_deref(), Some("the rig's thread does not answer"));
        let outside =
            Planned { durations_s: Some([5.0; 3]), problem: Some("x beyond its travel".into()) };
        for planned in [refused, outside] {
            let refused = Waiting { early_s: 0.0, durations_s: planned.taken_s() };
            let times = predict(&[waiting(0.0, 10.0), refused, waiting(0.0, 10.0)], [0.0; 3]);
            let begins: Vec<Option<f64>> =
                times.iter().map(|time| time.map(|time| time.begin_s)).collect();
            assert_eq!(begins, [Some(0.0), None, Some(10.0)]);
        }
    }
}
