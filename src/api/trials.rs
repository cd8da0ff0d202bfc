//! Trials, their frames, and the other records of a run.
//! Uses: `store`. Never: a write.

use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ProblemBody};
use super::query::trial_query;
use super::runs::find;
use crate::ids::{RunUid, TrialId};
use crate::store::TrialRow;

/// A page of trials.
#[derive(Debug, Serialize, ToSchema)]
pub struct TrialPage {
    /// The trials.
    pub trials: Vec<TrialRow>,
    /// Hand this in as `cursor` for the page that follows; absent on the last.
    pub next: Option<i64>,
}

/// A raw frame of a trial.
#[derive(Debug, Serialize, ToSchema)]
pub struct FrameOut {
    /// Counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Scale of the counts, V.
    pub volts_per_count: f32,
    /// Raw counts, injection-major.
    pub counts: Vec<i16>,
    /// The same in volts.
    pub voltages_v: Vec<f32>,
}

type Pairs = Query<Vec<(String, String)>>;

/// Trials of a run, in the order in which they were stored. Filters: `COLUMN__eq|gt|gte|lt|lte|in`;
/// also `limit`, `cursor`, `sort=trial_id|-trial_id`, `flag`, `flagged`, `voltages=true`. With
/// `Accept: application/x-ndjson` one trial a line.
#[utoipa::path(get, path = "/api/v1/runs/{run}/trials", tag = "trials",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = TrialPage), (status = 422, body = ProblemBody)))]
pub async fn of_run(
    State(app): State<App>,
    Path(run): Path<String>,
    Query(pairs): Pairs,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let run = find(&app, &run).await?.uid;
    page(&app, Some(run), &pairs, &headers).await
}

/// Trials of all runs; filters as for one run.
#[utoipa::path(get, path = "/api/v1/trials", tag = "trials",
    responses((status = 200, body = TrialPage), (status = 422, body = ProblemBody)))]
pub async fn all(
    State(app): State<App>,
    Query(pairs): Pairs,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    page(&app, None, &pairs, &headers).await
}

async fn page(
    app: &App,
    run: Option<RunUid>,
    pairs: &[(String, String)],
    headers: &HeaderMap,
) -> Result<Response, ApiError> {
    let query = trial_query(run, pairs).map_err(ApiError::problems)?;
    let trials = app.store.trials(&query).await?;
    let full = trials.len() == query.limit as usize;
    let next = trials.last().filter(|_| full).map(|t| t.trial_id.0);
    let accept = headers.get(header::ACCEPT).and_then(|v| v.to_str().ok()).unwrap_or_default();
    if accept.contains("application/x-ndjson") {
        let mut lines = String::new();
        for trial in &trials {
            let line = serde_json::to_string(trial).map_err(|e| {
                ApiError::new(axum::http::StatusCode::INTERNAL_SERVER_ERROR, e.to_string())
            })?;
            lines.push_str(&line);
            lines.push('\n');
        }
        return Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], lines).into_response());
    }
    Ok(Json(TrialPage { trials, next }).into_response())
}

/// One trial, with its mean voltages.
#[utoipa::path(get, path = "/api/v1/trials/{trial}", tag = "trials",
    params(("trial" = i64, Path, description = "its id")),
    responses((status = 200, body = TrialRow), (status = 404, body = ProblemBody)))]
pub async fn one(
    State(app): State<App>,
    Path(trial): Path<i64>,
) -> Result<Json<TrialRow>, ApiError> {
    let found = app.store.trial_by_id(TrialId(trial)).await?;
    Ok(Json(found.ok_or_else(|| ApiError::not_found(format!("there is no trial {trial}")))?))
}

/// The raw frames of a trial.
#[utoipa::path(get, path = "/api/v1/trials/{trial}/frames", tag = "trials",
    params(("trial" = i64, Path, description = "its id")),
    responses((status = 200, body = Vec<FrameOut>), (status = 404, body = ProblemBody)))]
pub async fn frames(
    State(app): State<App>,
    Path(trial): Path<i64>,
) -> Result<Json<Vec<FrameOut>>, ApiError> {
    let frames = app.store.frames(TrialId(trial)).await?;
    if frames.is_empty() {
        return Err(ApiError::not_found(format!("there is no trial {trial}")));
    }
    let out = frames.into_iter().map(|f| FrameOut {
        sequence: f.sequence,
        device_time_us: f.device_time_us,
        volts_per_count: f.volts_per_count,
        voltages_v: f.counts.iter().map(|&c| f32::from(c) * f.volts_per_count).collect(),
        counts: f.counts,
    });
    Ok(Json(out.collect()))
}

/// The other records of a run: `attempts`, `tares`, `touch-offs` or `references`.
#[utoipa::path(get, path = "/api/v1/runs/{run}/records/{kind}", tag = "trials",
    params(("run" = String, Path, description = "uid or scan_id"),
        ("kind" = String, Path, description = "attempts, tares, touch-offs or references")),
    responses((status = 200, body = Vec<Object>), (status = 404, body = ProblemBody)))]
pub async fn bench_records(
    State(app): State<App>,
    Path((run, kind)): Path<(String, String)>,
) -> Result<Json<serde_json::Value>, ApiError> {
    use serde_json::{Value, json};
    let run = find(&app, &run).await?.uid;
    let rows: Vec<Value> = match kind.as_str() {
        "attempts" => app
            .store
            .attempts(run, 10_000)
            .await?
            .into_iter()
            .map(|a| {
                let k = a.key;
                json!({ "configuration": k.configuration, "depth_index": k.depth_index,
                    "attempt": a.attempt, "reason": a.reason, "at": a.at })
            })
            .collect(),
        "tares" => app
            .store
            .tares(run)
            .await?
            .into_iter()
            .map(|t| {
                json!({ "configuration": t.configuration, "volts": t.volts,
                    "samples": t.samples, "at": t.at })
            })
            .collect(),
        "touch-offs" => app.store.touch_offs(run).await?.iter().map(|t| json!(t)).collect(),
        "references" => app
            .store
            .references(run)
            .await?
            .into_iter()
            .map(|r| {
                json!({ "before_configuration": r.before_configuration, "depth_mm": r.depth_mm,
                    "reached": r.reached, "arms": r.arms, "at": r.at })
            })
            .collect(),
        _ => {
            let limit = "must be attempts, tares, touch-offs or references";
            return Err(ApiError::value("kind", kind, limit));
        }
    };
    Ok(Json(Value::Array(rows)))
}
