//! Trials, their frames, and the other records of a run.
//! Uses: `store`. Never: a write.

use arrow_schema::SchemaRef;
use axum::Json;
use axum::body::Body;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use futures::{StreamExt, TryStreamExt};
use serde::Serialize;
use serde_json::{Value, json};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ProblemBody};
use super::query::{OF_DATASETS, TrialsWanted, trial_query};
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

/// Trials of a piece of a page.
const ROWS_AT_ONCE: usize = 500;
/// Pieces that are read at a time.
const READS: usize = 3;

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
        let Table { pieces, next } = table(app, query, &wanted, format).await?;
        return Ok(send::with_headers(format, next, Body::from_stream(pieces)));
    }
    if !wanted.columns.is_empty() || wanted.slice.is_some() {
        let Table { pieces, next } = table(app, query, &wanted, Format::Ndjson).await?;
        let pieces: Vec<Vec<u8>> = pieces.try_collect().await.map_err(internal)?;
        let trials = send::values(&pieces.concat())?;
        let next = next.and_then(|next| next.parse::<i64>().ok());
        return Ok(Json(ChosenPage { trials, next }).into_response());
    }
    let trials = app.store.trials(&query).await?;
    let full = trials.len() == query.limit as usize;
    let next = trials.last().filter(|_| full).map(|t| t.trial_id.0);
    Ok(Json(TrialPage { trials, next }).into_response())
}

/// A page of some columns.
#[derive(Debug, Serialize)]
struct ChosenPage {
    trials: Vec<Box<serde_json::value::RawValue>>,
    next: Option<i64>,
}

/// A page in the columns of the trials table, in pieces as they are read and written, so that a
/// page of frames takes no more memory than some of its rows; and the cursor of the next.
struct Table {
    pieces: ReceiverStream<std::io::Result<Vec<u8>>>,
    next: Option<String>,
}

async fn table(
    app: &App,
    mut query: TrialQuery,
    wanted: &Wanted,
    format: Format,
) -> Result<Table, ApiError> {
    if format == Format::Npz {
        let limit = "pages come as json, ndjson, csv, parquet or arrow";
        return Err(ApiError::bad_query(vec![Problem::new("query", "format", "npz", limit)]));
    }
    let limit = query.limit as usize;
    let ids = app.store.trial_ids(&query).await?;
    let next = ids.last().filter(|_| ids.len() == limit).map(|id| id.0.to_string());
    let frames = wanted.columns.iter().any(|column| column.ends_with("voltages_v"));
    query.with_voltages = query.with_voltages || frames;
    let lengths = match query.with_voltages {
        true => app.store.frame_lengths(&ids).await?,
        false => Vec::new(),
    };
    if lengths.len() > 1 {
        let words = format!(
            "these trials have frames of {lengths:?} voltages, which make no table: name a run"
        );
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let channels = lengths.first().map_or(schema::CHANNELS, |&length| length as i32);
    let table = trials_schema(channels, query.with_voltages);
    let skin = Skin { width_mm: 0.0, height_mm: 0.0 };
    let selection = Selection::new(wanted, &table, skin).map_err(ApiError::bad_query)?;
    let piece = send::Piece::default();
    let mut stream =
        Stream::new(format, selection.schema(), piece.clone()).map_err(DatasetError::from)?;
    let (sender, pieces) = tokio::sync::mpsc::channel(2);
    let store = app.store.clone();
    tokio::spawn(async move {
        let mut work = async || -> Result<(), DatasetError> {
            let chunks: Vec<Vec<TrialId>> = ids.chunks(ROWS_AT_ONCE).map(<[_]>::to_vec).collect();
            let frames = query.with_voltages;
            let reads = chunks.into_iter().map(|chunk| {
                let store = store.clone();
                async move {
                    match frames {
                        true => store.trials_with_voltages(&chunk).await,
                        false => store.trials_of(&chunk).await,
                    }
                }
            });
            let mut reads = futures::stream::iter(reads).buffered(READS);
            while let Some(trials) = reads.next().await {
                let mut trials = trials?;
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
    Ok(Table { pieces: ReceiverStream::new(pieces), next })
}

fn internal(error: std::io::Error) -> ApiError {
    ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())
}

/// The columns of stored trials; frames only where they are asked for.
fn trials_schema(channels: i32, with_voltages: bool) -> SchemaRef {
    let all = schema::all(channels);
    let fields: Vec<_> = all
        .fields()
        .iter()
        .filter(|field| match field.name().as_str() {
            name if OF_DATASETS.contains(&name) => false,
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
