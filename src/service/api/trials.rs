//! Trials, their frames, and the bench records of a run.
//! Uses: `store`. Never: a write.

use std::collections::HashMap;

use arrow_array::cast::AsArray;
use arrow_array::types::Int64Type;
use arrow_schema::SchemaRef;
use axum::Json;
use axum::extract::Query;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use serde::Serialize;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::encoder::RowEncoder;
use super::pages::{Cursors, Page, PageParams, PageRequest};
use super::params::{TrialGroupParams, TrialParams};
use super::problem::{ApiError, ApiResult, Path};
use super::query::{GroupsOf, GroupsRequest, TrialsRequest, for_pages, groups_query, trial_query};
use super::runs::find;
use super::{App, accept, send, sql};
use crate::dataset::batch::{self, Row};
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::format::Format;
use crate::dataset::schema;
use crate::dataset::select::{Selection, Wanted};
use crate::dataset::sort::Sort;
use crate::ids::{RunUid, TrialId};
use crate::problem::Problem;
use crate::query::groups;
use crate::record::ReferenceRecord;
use crate::store::table::Column;
use crate::store::{MAX_PAGE, RunKind, Store, StoreResult, TrialQuery, TrialRow};

/// Number of trials per piece of a page.
const PIECE_ROWS: usize = 250;
/// Number of pieces that are read concurrently.
const PIECES_AT_ONCE: usize = 3;

/// A raw frame of a trial.
#[derive(Debug, Serialize, ToSchema)]
pub struct FrameOut {
    /// Frame counter of the device; absent for an imported trial.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sequence: Option<u32>,
    /// Device time of the first sample, microseconds; absent for an imported trial.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device_time_us: Option<u64>,
    /// Scale of the counts, V per count.
    pub volts_per_count: f32,
    /// Raw counts, one per channel, injection-major.
    pub counts: Vec<i16>,
    /// Voltages, V, one per channel, injection-major.
    pub voltages_v: Vec<f32>,
}

type Pairs = Query<Vec<(String, String)>>;

/// Returns a page of the trials of a run, in the order of storing.
///
/// JSON holds whole trials; the other formats are tables of columns. The header `Link` has the address
/// of the next page in every format.
#[utoipa::path(get, operation_id = "run_trials", path = "/api/v1/runs/{run}/trials", tag = "trials",
    params(("run" = String, Path), TrialParams), responses((status = 200, body = Page<TrialRow>)))]
pub async fn of_run(
    app: App,
    Path(run): Path<String>,
    Query(pairs): Pairs,
    cursors: Cursors,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let run = find(&app, &run).await?.uid;
    page(&app, Some(run), &pairs, &cursors, &headers).await
}

/// Returns a page of the trials of all runs, in the order of storing.
///
/// JSON holds whole trials; the other formats are tables of columns. The header `Link` has the address
/// of the next page in every format.
#[utoipa::path(get, operation_id = "list_trials", path = "/api/v1/trials", tag = "trials",
    params(TrialParams), responses((status = 200, body = Page<TrialRow>)))]
pub async fn all(
    app: App,
    Query(pairs): Pairs,
    cursors: Cursors,
    headers: HeaderMap,
) -> ApiResult<Response> {
    page(&app, None, &pairs, &cursors, &headers).await
}

async fn page(
    app: &App,
    run: Option<RunUid>,
    pairs: &[(String, String)],
    cursors: &Cursors,
    headers: &HeaderMap,
) -> ApiResult<Response> {
    let TrialsRequest { query, sort, wanted, format } =
        trial_query(run, pairs).map_err(ApiError::bad_query)?;
    let format = accept::of_list(format, pairs, headers)?;
    let request = PageOf { query, sort, from: cursors.position(pairs)?.unwrap_or_default() };
    let (next, response) = match format {
        Some(format) => {
            let (next, response) = table(app, &request, &wanted, format).await?;
            (next.map(|id| cursors.cursor(id)), response)
        }
        None => {
            let (items, next) = whole_trials(app, &request, &wanted).await?;
            let next = next.map(|id| cursors.cursor(id));
            (next.clone(), Page { items, next }.into_response())
        }
    };
    let link = next.and_then(|next| cursors.link(&next)).map(|link| [link]);
    Ok((link, response).into_response())
}

/// Returns groups of the stored trials with their aggregates, by the conditions of lists of trials.
#[utoipa::path(get, operation_id = "trial_groups", path = "/api/v1/trials/groups", tag = "trials",
    params(TrialGroupParams), responses((status = 200, body = Page<Object>),
        (status = 503, description = "as of queries (with `Retry-After`)")))]
pub async fn groups(app: App, Query(mut pairs): Pairs, headers: HeaderMap) -> ApiResult<Response> {
    number_runs(&app, &mut pairs).await?;
    let GroupsRequest { query, groups, format } =
        groups_query(&pairs, GroupsOf::StoredTrials).map_err(ApiError::bad_query)?;
    let sql = groups.sql("trials", &groups::conditions(&query), query.limit);
    grouped(&app, sql, accept::of_list(format, &pairs, &headers)?).await
}

/// Replaces the uid of a run by its number, which frames have, too: those of other runs are then not read.
///
/// # Errors
/// Those of the store.
async fn number_runs(app: &App, pairs: &mut [(String, String)]) -> ApiResult<()> {
    for (key, value) in pairs {
        if key.as_str() == "run"
            && let Ok(uid) = value.parse::<RunUid>()
            && let Some(run) = app.store.run(uid).await?
        {
            *key = "scan_id".to_owned();
            *value = run.scan_id.to_string();
        }
    }
    Ok(())
}

/// The groups of a statement, as a page.
///
/// # Errors
/// 400 if a parameter is invalid; the errors of queries.
pub async fn grouped(
    app: &App,
    sql: Result<String, String>,
    format: Option<Format>,
) -> ApiResult<Response> {
    let sql = sql.map_err(|limit| ApiError::bad_query(vec![Problem::whole("query", limit)]))?;
    format.map_or(Ok(()), for_pages).map_err(ApiError::bad_query)?;
    let rows = app.queries.answer(&sql).await?;
    if rows.count > u64::from(MAX_PAGE) {
        let limit =
            format!("must make at most {MAX_PAGE} groups: choose wider bins, or add limit=");
        return Err(ApiError::bad_query(vec![Problem::whole("query", limit)]));
    }
    match format {
        Some(format) => sql::streamed(format, rows).await,
        None => Ok(Page::whole(sql::items(rows).await?).into_response()),
    }
}

/// A page of trials.
struct PageOf {
    query: TrialQuery,
    /// Order by a column; `None`: by id.
    sort: Option<Sort>,
    /// Last id of the page before; with `sort` the number of trials before.
    from: i64,
}

/// The whole trials of a page, and the cursor of the next one if more trials follow.
async fn whole_trials(
    app: &App,
    request: &PageOf,
    wanted: &Wanted,
) -> ApiResult<(Vec<TrialRow>, Option<i64>)> {
    let selects = [("columns", !wanted.columns.is_empty()), ("slice", wanted.slice.is_some())];
    if let Some((key, _)) = selects.into_iter().find(|(_, given)| *given) {
        let limit = "must be absent for JSON, which holds whole trials: add format=ndjson";
        return Err(ApiError::query(key, "given", limit));
    }
    let query = &request.query;
    let (ids, next) = ids(app, request).await?;
    if query.with_voltages {
        let longest = app.store.frame_lengths(&ids).await?.pop().unwrap_or_default();
        send::check_numbers(2 * u64::from(longest), query.limit)?;
    }
    Ok((read(&app.store, &ids, query.with_voltages).await?, next))
}

/// The trials with these ids, in the order of the ids.
async fn read(store: &Store, ids: &[TrialId], with_voltages: bool) -> StoreResult<Vec<TrialRow>> {
    let mut trials = match with_voltages {
        true => store.trials_with_voltages(ids).await?,
        false => store.trials_of(ids).await?,
    };
    // So they are in the order of the store.
    if ids.is_sorted() {
        return Ok(trials);
    }
    let places: HashMap<TrialId, usize> =
        ids.iter().enumerate().map(|(place, &id)| (id, place)).collect();
    trials.sort_by_key(|trial| places.get(&trial.trial_id).copied());
    Ok(trials)
}

/// The ids of a page, and the cursor of the next one if more trials follow.
async fn ids(app: &App, request: &PageOf) -> ApiResult<(Vec<TrialId>, Option<i64>)> {
    let PageOf { query, sort, from } = request;
    let limit = query.limit as usize;
    let mut one_more = TrialQuery { limit: query.limit + 1, ..query.clone() };
    let Some(sort) = sort else {
        one_more.after = (*from > 0).then_some(TrialId(*from));
        let mut ids = app.store.trial_ids(&one_more).await?;
        let more = ids.len() > limit;
        ids.truncate(limit);
        let next = ids.last().filter(|_| more).map(|id| id.0);
        return Ok((ids, next));
    };
    let sql = groups::sorted_ids(&one_more, sort, from.unsigned_abs())
        .map_err(|limit| ApiError::query("sort", &sort.column, &limit))?;
    let mut rows = app.queries.answer(&sql).await?;
    let mut ids = Vec::new();
    while let Some(batch) = rows.next().await {
        let batch = batch.map_err(DatasetError::from)?;
        if let Some(column) =
            batch.columns().first().and_then(|c| c.as_primitive_opt::<Int64Type>())
        {
            ids.extend(column.values().iter().map(|&id| TrialId(id)));
        }
    }
    let more = ids.len() > limit;
    ids.truncate(limit);
    let next = from + ids.len() as i64;
    Ok((ids, more.then_some(next)))
}

/// A page in a row format, encoded in pieces while it is sent, so that only a few pieces are in memory;
/// and the cursor of the next one if more trials follow.
async fn table(
    app: &App,
    request: &PageOf,
    wanted: &Wanted,
    format: Format,
) -> ApiResult<(Option<i64>, Response)> {
    for_pages(format).map_err(ApiError::bad_query)?;
    let query = &request.query;
    let (ids, next) = ids(app, request).await?;
    let frames = |name: &String| Column::find(name).is_some_and(Column::is_frame);
    let with_voltages = query.with_voltages || wanted.columns.iter().any(frames);
    let lengths = match with_voltages {
        true => app.store.frame_lengths(&ids).await?,
        false => Vec::new(),
    };
    if lengths.len() > 1 {
        let words = format!(
            "the trials of this page have frames of {lengths:?} voltages, a table must have one \
             length: select a run"
        );
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let channels = lengths.first().map_or(schema::PAPER_CHANNELS, |&length| length as i32);
    let table = trials_schema(channels, with_voltages);
    let selection = Selection::new(wanted, &table, None).map_err(ApiError::bad_query)?;
    send::check_numbers(send::numbers_per_row(selection.schema()), query.limit)?;
    let encoder = RowEncoder::new(format, selection.schema())?;
    let store = app.store.clone();
    let chunks: Vec<Vec<TrialId>> = ids.chunks(PIECE_ROWS).map(<[_]>::to_vec).collect();
    let reads = chunks.into_iter().map(move |chunk| {
        let store = store.clone();
        async move { read(&store, &chunk, with_voltages).await }
    });
    let encodable = move |trials: StoreResult<Vec<TrialRow>>| -> DatasetResult<_> {
        let rows: Vec<Row> = trials?.into_iter().map(|trial| Row { trial, part: None }).collect();
        Ok(selection.apply(&batch::of_trials(&table, &rows)?, None)?)
    };
    let batches = futures::stream::iter(reads).buffered(PIECES_AT_ONCE).map(encodable);
    Ok((next, encoder.response(batches, "a page of trials is incomplete")))
}

/// The columns of stored trials; frames only where they are requested.
fn trials_schema(channels: i32, with_voltages: bool) -> SchemaRef {
    let all = schema::stored(channels);
    let has = |column: &Column| with_voltages || !column.is_frame();
    let fields = all.fields().iter().filter(|f| Column::find(f.name()).is_some_and(has));
    SchemaRef::new(arrow_schema::Schema::new(fields.cloned().collect::<Vec<_>>()))
}

/// Returns a trial with its mean voltages.
#[utoipa::path(get, operation_id = "trial", path = "/api/v1/trials/{trial}", tag = "trials",
    params(("trial" = i64, Path, description = "id of the trial")),
    responses((status = 200, body = TrialRow),
        (status = 404, description = "no trial has this id")))]
pub async fn one(app: App, Path(trial): Path<i64>) -> ApiResult<Json<TrialRow>> {
    let found = app.store.trial_by_id(TrialId(trial)).await?;
    Ok(Json(found.ok_or_else(|| ApiError::not_found(format!("no trial {trial}")))?))
}

/// Returns the raw frames of a trial.
///
/// Imported trials have those that their file states, of 16 bits: the largest voltage is 32767 counts.
#[utoipa::path(get, operation_id = "trial_frames", path = "/api/v1/trials/{trial}/frames",
    tag = "trials", params(("trial" = i64, Path, description = "id of the trial")),
    responses((status = 200, body = Page<FrameOut>),
        (status = 404, description = "no trial has this id, or it has no raw frames")))]
pub async fn frames(app: App, Path(trial): Path<i64>) -> ApiResult<Page<FrameOut>> {
    let found = app.store.trial_by_id(TrialId(trial)).await?;
    let found = found.ok_or_else(|| ApiError::not_found(format!("no trial {trial}")))?;
    let frames = app.store.frames(TrialId(trial)).await?;
    if frames.is_empty() {
        return Err(ApiError::not_found(format!(
            "trial {trial} has no raw frames: only its mean voltages are stored"
        )));
    }
    let of_device = found.kind != RunKind::Imported;
    let out = frames.into_iter().map(|f| FrameOut {
        sequence: of_device.then_some(f.sequence),
        device_time_us: of_device.then_some(f.device_time_us),
        volts_per_count: f.volts_per_count,
        voltages_v: f.counts.iter().map(|&c| f32::from(c) * f.volts_per_count).collect(),
        counts: f.counts,
    });
    Ok(Page::whole(out.collect()))
}

/// Returns a page of the bench records of a run in the order of storing: attempts, tares, touch-offs
/// or references.
#[utoipa::path(get, path = "/api/v1/runs/{run}/records/{kind}", tag = "trials",
    params(("run" = String, Path),
        ("kind" = String, Path, description = "attempts, tares, touch-offs or references"), PageParams),
    responses((status = 200, body = Page<Object>),
        (status = 422, description = "the kind is unknown")))]
pub async fn bench_records(
    app: App,
    Path((run, kind)): Path<(String, String)>,
    asked: PageRequest,
) -> ApiResult<Page<Value>> {
    let run = find(&app, &run).await?.uid;
    let store = &app.store;
    let rows: Vec<Value> = match kind.as_str() {
        "attempts" => store.attempts(run, u32::MAX).await?.iter().rev().map(|a| json!(a)).collect(),
        "tares" => store.tares(run).await?.iter().map(|t| json!(t)).collect(),
        "touch-offs" => store.touch_offs(run).await?.iter().map(|t| json!(t)).collect(),
        "references" => {
            let without_frame = |r: &ReferenceRecord| {
                json!({ "before_configuration": r.before_configuration, "depth_mm": r.depth_mm,
                    "reached": r.reached, "arms": r.arms, "at": r.at })
            };
            store.references(run).await?.iter().map(without_frame).collect()
        }
        _ => {
            let limit = "must be attempts, tares, touch-offs or references";
            return Err(ApiError::value("kind", kind, limit));
        }
    };
    let numbered = rows.into_iter().enumerate().collect();
    let Page { items, next } = asked.of_all(numbered, |(number, _)| *number)?;
    Ok(Page { items: items.into_iter().map(|(_, record)| record).collect(), next })
}
