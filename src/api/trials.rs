//! Trials, their frames, and the other records of a run.
//! Uses: `store`. Never: a write.

use arrow_schema::SchemaRef;
use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ProblemBody};
use super::query::{TrialsWanted, trial_query};
use super::runs::find;
use super::send;
use crate::dataset::batch::{self, Row};
use crate::dataset::error::DatasetError;
use crate::dataset::format::{Format, Stream};
use crate::dataset::schema;
use crate::dataset::select::{Selection, Skin, Wanted};
use crate::ids::{RunUid, TrialId};
use crate::problem::Problem;
use crate::store::{Order, TrialQuery, TrialRow};

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
/// also `limit`, `cursor`, `sort=trial_id|-trial_id`, `flag`, `flagged`, `voltages=true`, `columns`,
/// `slice` of each frame, `format=json|ndjson|csv|parquet|arrow` (or `Accept`); then the next cursor is
/// in the header `x-next-cursor`.
#[utoipa::path(get, path = "/api/v1/runs/{run}/trials", tag = "trials",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = TrialPage), (status = 400, body = ProblemBody)))]
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
    responses((status = 200, body = TrialPage), (status = 400, body = ProblemBody)))]
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
    let TrialsWanted { query, wanted, format } =
        trial_query(run, pairs).map_err(ApiError::bad_query)?;
    if let Some(format) = format.or_else(|| send::accepted(headers)) {
        return as_table(app, query, &wanted, format).await;
    }
    let trials = app.store.trials(&query).await?;
    let full = trials.len() == query.limit as usize;
    let next = trials.last().filter(|_| full).map(|t| t.trial_id.0);
    if wanted.columns.is_empty() {
        return Ok(Json(TrialPage { trials, next }).into_response());
    }
    let chosen = |trial: &TrialRow| -> Result<Value, serde_json::Error> {
        let Value::Object(fields) = serde_json::to_value(trial)? else { return Ok(Value::Null) };
        Ok(fields.into_iter().filter(|(name, _)| wanted.columns.contains(name)).collect())
    };
    let chosen: Result<Vec<Value>, _> = trials.iter().map(chosen).collect();
    let trials = chosen.map_err(DatasetError::Json)?;
    Ok(Json(json!({ "trials": trials, "next": next })).into_response())
}

/// A page in the columns of the trials table, read and sent in pieces, so that a page of frames
/// takes no more memory than some of its rows.
async fn as_table(
    app: &App,
    mut query: TrialQuery,
    wanted: &Wanted,
    format: Format,
) -> Result<Response, ApiError> {
    if format == Format::Npz {
        let limit = "pages come as json, ndjson, csv, parquet or arrow";
        return Err(ApiError::bad_query(vec![Problem::new("query", "format", "npz", limit)]));
    }
    let limit = query.limit as usize;
    let ids = app.store.trial_ids(&query).await?;
    let next = ids.last().filter(|_| ids.len() == limit).map(|id| id.0.to_string());
    query.with_voltages =
        query.with_voltages || wanted.columns.iter().any(|c| c.ends_with("voltages_v"));
    let first = match ids.first() {
        Some(&first) => app.store.trial_voltages(first).await?,
        None => None,
    };
    let channels = first.map_or(schema::CHANNELS, |frame| frame.len() as i32);
    let table = trials_schema(channels, query.with_voltages);
    let skin = Skin { width_mm: 0.0, height_mm: 0.0 };
    let selection = Selection::new(wanted, &table, skin).map_err(ApiError::bad_query)?;
    let (sender, pieces) = tokio::sync::mpsc::channel(2);
    let piece = send::Piece::default();
    let mut stream =
        Stream::new(format, selection.schema(), piece.clone()).map_err(DatasetError::from)?;
    let store = app.store.clone();
    tokio::spawn(async move {
        let mut work = async || -> Result<(), DatasetError> {
            for chunk in ids.chunks(schema::BATCH_ROWS) {
                let mut trials = if query.with_voltages {
                    store.trials_with_voltages(chunk).await?
                } else {
                    store.trials_of(chunk).await?
                };
                if query.order == Order::NewestFirst {
                    trials.reverse();
                }
                let rows: Vec<Row> =
                    trials.into_iter().map(|trial| Row { trial, part: None }).collect();
                let batch = selection.apply(&batch::of_trials(&table, &rows)?, None)?;
                stream.push(&batch)?;
                if sender.send(Ok(piece.take())).await.is_err() {
                    // Who asked has gone.
                    return Ok(());
                }
            }
            Ok(())
        };
        let ended = match work().await {
            Ok(()) => stream.finish().map(|piece| piece.take()).map_err(DatasetError::from),
            Err(error) => Err(error),
        };
        let last = ended.map_err(|error| std::io::Error::other(error.to_string()));
        // Who asked may have gone.
        let _ = sender.send(last).await;
    });
    let body = axum::body::Body::from_stream(tokio_stream::wrappers::ReceiverStream::new(pieces));
    Ok(send::with_headers(format, next, body))
}

/// The columns of stored trials; frames only where they are asked for.
fn trials_schema(channels: i32, with_voltages: bool) -> SchemaRef {
    let all = schema::all(channels);
    let fields: Vec<_> = all
        .fields()
        .iter()
        .filter(|field| match field.name().as_str() {
            "seed" | "index" | schema::SPLIT => false,
            name => with_voltages || !name.ends_with("voltages_v"),
        })
        .cloned()
        .collect();
    SchemaRef::new(arrow_schema::Schema::new(fields))
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
