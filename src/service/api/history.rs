//! A run over time: trials, forces, failures and fits in bins, its states, its predictions, and what an
//! operator must see.
//! Uses: `store`, `conductor::estimates` (the kind of its events). Never: a row for each trial.

use std::sync::Arc;

use axum::Json;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::problem::{ApiError, ApiResult, Params, Path};
use super::runs::find;
use super::spans::{StateSpan, restarts, spans};
use crate::conductor::estimates::ESTIMATE;
use crate::event::{Importance, importance, is_placement, notable_kinds};
use crate::ids::RunUid;
use crate::journal::Event;
use crate::state::StoredState;
use crate::store::{Bins, RunRow, Store, StoreResult, StoredParts};

/// Most bins of a history.
const BINS_MAX: u32 = 1000;
/// Largest number of notable events, the newest ones.
const NOTABLE_MAX: usize = 500;
/// Largest number of events of notable kinds that are read for them, the newest ones: a manual trial has two that are
/// not listed.
const NOTABLE_READ: u32 = 5000;
/// Largest numbers of changes of state and of estimates, the newest ones.
const STATES_MAX: u32 = 5000;
const ESTIMATES_MAX: u32 = 5000;
/// Most predictions of an answer: beyond it they are taken evenly, the newest among them.
const PREDICTIONS_MAX: usize = 1000;

/// Selection of bins.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct HistoryParams {
    /// Number of bins of equal length, 1 to 1000; 120 if absent.
    #[param(minimum = 1, maximum = 1000, default = 120)]
    pub bins: Option<u32>,
}

/// A run over time. Lists of numbers have one entry per bin.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct History {
    /// Start of the run and of the first bin; null if the run has not started.
    pub from: Option<Timestamp>,
    /// End of the last bin: the end of the run, now if it is active, or its last record if it is
    /// interrupted; null if the run has not started.
    pub to: Option<Timestamp>,
    /// Length of a bin, s; null if the run has not started.
    pub bin_s: Option<f64>,
    /// Number of stored trials.
    pub trials: Vec<u32>,
    /// Number of failed attempts.
    pub attempts_failed: Vec<u32>,
    /// Largest force of the trials, N; null without a measured force.
    pub largest_force_n: Vec<Option<f64>>,
    /// Median FVU of the twins of the trials; null without twins.
    pub fvu: Vec<Option<f64>>,
    /// States of the run, oldest first.
    pub states: Vec<StateSpan>,
    /// Likely duration without the time of persons, as predicted at the start, wall s; null for a run
    /// that an older version started.
    pub predicted_s: Option<f64>,
    /// Wall time from the start to `to`, s; null if the run has not started.
    pub elapsed_s: Option<f64>,
    /// Estimates of the end during the run, oldest first, at most 1000; empty for a run that an older version
    /// drove.
    pub predictions: Vec<Prediction>,
    /// Notable events and those that matter more, oldest first: trips, suspensions, waits for a person (placements
    /// of weights excepted), skips, failed attempts, the end; at most 500, the newest ones. `states` lists the
    /// changes of state.
    pub events: Vec<NotableEvent>,
}

/// An estimate of the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Prediction {
    /// Time of the estimate.
    pub at: Timestamp,
    /// Expected wall time of the end.
    pub end: Timestamp,
    /// Early end of the band that contains 90 % of the ends.
    pub low: Timestamp,
    /// Late end of that band.
    pub high: Timestamp,
}

/// An event that is at least notable; `GET /events` has its details.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NotableEvent {
    /// Number of the event.
    pub seq: i64,
    /// Time of the event.
    pub at: Timestamp,
    /// Kind of the event.
    pub kind: String,
    /// How much it matters to a person.
    pub importance: Importance,
}

/// Returns the history of a run: trials, forces, failures and fits over time, its states, predictions
/// and notable events.
#[utoipa::path(get, operation_id = "run_history", path = "/api/v1/runs/{run}/history", tag = "runs",
    params(("run" = String, Path), HistoryParams), responses((status = 200, body = History),
        (status = 400, description = "`bins` is not 1 to 1000")))]
pub async fn of_run(
    app: App,
    Path(run): Path<String>,
    Params(params): Params<HistoryParams>,
) -> ApiResult<Json<Arc<History>>> {
    let bins = params.bins.unwrap_or(120);
    if !(1..=BINS_MAX).contains(&bins) {
        return Err(ApiError::query("bins", bins, "must be 1 to 1000"));
    }
    let run = find(&app, &run).await?;
    // The end of a run changes its history at once, and so does its resumption.
    let key = (run.uid, bins, run.ended_at);
    Ok(Json(app.facts.memory.histories.get(key, read(&app, &run, bins)).await?))
}

async fn read(app: &App, run: &RunRow, bins: u32) -> StoreResult<Arc<History>> {
    let store = &app.store;
    let kinds: Vec<&str> = notable_kinds().collect();
    let events = notable(store.events_of_kinds(run.uid, &kinds, NOTABLE_READ).await?);
    let Some(from) = run.started_at else {
        return Ok(Arc::new(History { events, ..History::default() }));
    };
    let now = Timestamp::now();
    let is_active = app.campaign.status().run.is_some_and(|active| active.uid == run.uid);
    let to = match run.ended_at {
        Some(ended) => ended,
        None if is_active => now,
        None => store.last_record_before(run.uid, now).await?.unwrap_or(from),
    };
    let range_s = to.duration_since(from).as_secs_f64().max(0.0);
    let bin_s = (range_s / f64::from(bins)).max(1e-3);
    let stored = store.history(run.uid, Bins { from, bin_s, count: bins }).await?;
    let states = store.events_of_kinds(run.uid, &["state"], STATES_MAX).await?;
    let mut last_records = Vec::new();
    for restart in restarts(&states) {
        last_records.push(store.last_record_before(run.uid, restart).await?.unwrap_or(restart));
    }
    let is_interrupted = run.state == StoredState::Interrupted;
    let states = spans(&states, &last_records, run.ended_at, is_interrupted.then_some(to));
    let estimates = store.events_of_kinds(run.uid, &[ESTIMATE], ESTIMATES_MAX).await?;
    Ok(Arc::new(History {
        from: Some(from),
        to: Some(to),
        bin_s: Some(bin_s),
        states,
        predicted_s: estimates.first().and_then(predicted_s),
        elapsed_s: Some(range_s),
        predictions: thinned(&estimates).filter_map(prediction).collect(),
        events,
        ..arranged(&stored, bins as usize)
    }))
}

/// The newest of these events that are at least notable, without placements of weights.
fn notable(events: Vec<Event>) -> Vec<NotableEvent> {
    let listed = events.into_iter().filter(|event| !is_placement(&event.kind, &event.data));
    let mut notable: Vec<NotableEvent> = listed.map(NotableEvent::from).collect();
    notable.retain(|event| event.importance >= Importance::Notable);
    let over = notable.len().saturating_sub(NOTABLE_MAX);
    notable.drain(..over);
    notable
}

impl From<Event> for NotableEvent {
    fn from(event: Event) -> Self {
        let importance = importance(&event.kind, &event.data);
        Self { seq: event.seq, at: event.at, kind: event.kind, importance }
    }
}

/// A history with what is stored by bin, of which there are `bins`.
fn arranged(stored: &StoredParts, bins: usize) -> History {
    let (mut trials, mut attempts_failed) = (vec![0; bins], vec![0; bins]);
    let (mut largest_force_n, mut fvu) = (vec![None; bins], vec![None; bins]);
    for bin in stored.trials.iter().filter(|bin| (bin.part as usize) < bins) {
        trials[bin.part as usize] = bin.stored;
        largest_force_n[bin.part as usize] = bin.largest_force_n;
    }
    for (bin, count) in stored.attempts_failed.iter().filter(|(bin, _)| (*bin as usize) < bins) {
        attempts_failed[*bin as usize] = *count;
    }
    for (bin, median) in stored.median_fvu.iter().filter(|(bin, _)| (*bin as usize) < bins) {
        fvu[*bin as usize] = Some(*median);
    }
    History { trials, attempts_failed, largest_force_n, fvu, ..History::default() }
}

/// Returns the start of a run, and its duration as it was predicted then, s; absent before either.
pub(super) async fn predicted(store: &Store, run: RunUid) -> StoreResult<Option<(Timestamp, f64)>> {
    let from = store.run(run).await?.and_then(|run| run.started_at);
    let estimates = store.events_of_kinds(run, &[ESTIMATE], ESTIMATES_MAX).await?;
    Ok(from.zip(estimates.first().and_then(predicted_s)))
}

/// The prediction at the start, from the first estimate of a run: it was made before the first trial.
fn predicted_s(first: &Event) -> Option<f64> {
    let is_first = first.data["trials_stored"].as_u64() == Some(0);
    first.data["remaining_s"].as_f64().filter(|_| is_first)
}

/// At most `PREDICTIONS_MAX` of the estimates, evenly, the last one included.
fn thinned(estimates: &[Event]) -> impl Iterator<Item = &Event> {
    let step = estimates.len().div_ceil(PREDICTIONS_MAX).max(1);
    let skipped = estimates.len().saturating_sub(1) % step;
    estimates.iter().skip(skipped).step_by(step)
}

fn prediction(event: &Event) -> Option<Prediction> {
    let after = |key: &str| {
        let seconds = event.data[key].as_f64()?;
        event.at.checked_add(SignedDuration::try_from_secs_f64(seconds).ok()?).ok()
    };
    Some(Prediction {
        at: event.at,
        end: after("remaining_s")?,
        low: after("low_s")?,
        high: after("high_s")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::PartTrials;
    use serde_json::json;

    fn estimate(trials_stored: u64, remaining_s: f64) -> Event {
        let data = json!({ "remaining_s": remaining_s, "low_s": remaining_s - 5.0,
            "high_s": remaining_s + 5.0, "trials_stored": trials_stored });
        Event { seq: 1, run: None, at: Timestamp::UNIX_EPOCH, kind: ESTIMATE.into(), data }
    }

    #[test]
    fn the_first_estimate_of_a_run_is_its_prediction_unless_trials_were_stored_before() {
        assert_eq!(predicted_s(&estimate(0, 100.0)), Some(100.0));
        assert_eq!(predicted_s(&estimate(3, 100.0)), None);
        let at = |s| Timestamp::from_second(s).unwrap();
        let told = prediction(&estimate(3, 100.0)).unwrap();
        assert_eq!((told.at, told.end, told.low, told.high), (at(0), at(100), at(95), at(105)));
        let unreadable = Event { data: json!({}), ..estimate(0, 1.0) };
        assert_eq!(prediction(&unreadable), None);
    }

    #[test]
    fn placements_do_not_hide_what_matters_and_the_newest_events_are_kept() {
        let event = |seq: i64, kind: &str, data: &serde_json::Value| {
            let (kind, data) = (kind.to_owned(), data.clone());
            Event { seq, run: None, at: Timestamp::UNIX_EPOCH, kind, data }
        };
        let (none, right) = (json!({}), json!({ "trial": 1, "verdict": "right" }));
        let wanted = json!({ "wanted": { "trial": 1, "contacts": [] } });
        let listed = |events: Vec<Event>| -> Vec<i64> {
            notable(events).iter().map(|event| event.seq).collect()
        };
        let mut events = vec![event(1, "trip", &none)];
        events.extend((2..800).map(|seq| event(seq, "wanted", &wanted)));
        events.extend((800..1600).map(|seq| event(seq, "placed", &right)));
        assert_eq!(listed(events), [1]);
        let trips = listed((1..=501).map(|seq| event(seq, "trip", &none)).collect());
        assert_eq!((trips.len(), trips[0]), (500, 2));
    }

    #[test]
    fn many_predictions_are_thinned_evenly_and_the_newest_one_is_kept() {
        for (count, shown) in [(0, 0), (1, 1), (1000, 1000), (1001, 501), (5000, 1000)] {
            let all: Vec<Event> = (0..count).map(|n| estimate(n, 1.0)).collect();
            let kept: Vec<u64> =
                thinned(&all).map(|e| e.data["trials_stored"].as_u64().unwrap()).collect();
            assert_eq!((kept.len(), kept.last().copied()), (shown, count.checked_sub(1)));
        }
    }

    #[test]
    fn bins_without_records_are_empty_and_a_value_that_was_not_measured_is_null() {
        let bin = |part, largest_force_n| PartTrials { part, stored: 4, largest_force_n };
        let stored = StoredParts {
            skipped: Vec::new(),
            trials: vec![bin(0, Some(9.5)), bin(2, None), bin(7, None)],
            attempts_failed: vec![(1, 2), (7, 1)],
            median_fvu: vec![(2, 0.25), (7, 0.5)],
        };
        let History { trials, attempts_failed, largest_force_n, fvu, .. } = arranged(&stored, 3);
        assert_eq!((trials, attempts_failed), (vec![4, 0, 4], vec![0, 2, 0]));
        assert_eq!(largest_force_n, [Some(9.5), None, None]);
        assert_eq!(fvu, [None, None, Some(0.25)]);
    }
}
