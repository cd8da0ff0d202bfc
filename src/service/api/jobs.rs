//! Long computations: trainings and evaluations, asked for, watched, ended.
//! Uses: `jobs`. Never: the computation itself.

use axum::extract::{Path, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, ProblemBody};
use crate::evaluate::request::EvaluationRequest;
use crate::ids::TaskId;
use crate::jobs::Progress;
use crate::store::{TaskKind, TaskRow, TaskState};

/// Jobs that are listed.
const LISTED: u32 = 500;

/// A wish for a training.
#[derive(Debug, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainingRequest {
    /// Text of the recipe file (TOML).
    pub recipe: String,
}

/// A job.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct JobOut {
    /// Its id.
    #[schema(value_type = String)]
    pub id: TaskId,
    /// What is computed.
    pub kind: TaskKind,
    /// What was asked for.
    #[schema(value_type = Object)]
    pub request: Value,
    /// How far it is.
    pub state: TaskState,
    /// How far it is in itself, while it runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
    /// The dataset, once it is known.
    pub dataset: Option<String>,
    /// What came of it: `{"model": id, "name": ..}` of a training, an EvaluationReport of an
    /// evaluation.
    #[schema(value_type = Option<Object>)]
    pub result: Option<Value>,
    /// Why it failed.
    pub error: Option<String>,
    /// Who asked.
    pub asked_by: String,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: jiff::Timestamp,
    /// When it first began.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<jiff::Timestamp>,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<jiff::Timestamp>,
}

fn out(app: &App, row: TaskRow) -> JobOut {
    JobOut {
        progress: app.jobs.progress(row.id),
        id: row.id,
        kind: row.kind,
        request: row.request,
        state: row.state,
        dataset: row.dataset,
        result: row.result,
        error: row.error,
        asked_by: row.asked_by,
        created_at: row.created_at,
        started_at: row.started_at,
        finished_at: row.finished_at,
    }
}

/// Asks for a training. It goes on after a restart, from its last checkpoint.
#[utoipa::path(post, path = "/api/v1/trainings", tag = "jobs", request_body = TrainingRequest,
    responses((status = 202, body = JobOut), (status = 422, body = ProblemBody)))]
pub async fn train(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(request): Body<TrainingRequest>,
) -> Result<(StatusCode, Json<JobOut>), ApiError> {
    let asked = app.jobs.train(&request.recipe, &asker.name(None)).await;
    let outcome = asked.map_err(ApiError::from);
    let row = app.logged(&asker, "train", (None, None, None), outcome).await?;
    Ok((StatusCode::ACCEPTED, Json(out(&app, row))))
}

/// Asks for an evaluation.
#[utoipa::path(post, path = "/api/v1/evaluations", tag = "jobs", request_body = EvaluationRequest,
    responses((status = 202, body = JobOut), (status = 422, body = ProblemBody)))]
pub async fn evaluate(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(request): Body<EvaluationRequest>,
) -> Result<(StatusCode, Json<JobOut>), ApiError> {
    let row = app.jobs.evaluate(&request, &asker.name(None)).await?;
    Ok((StatusCode::ACCEPTED, Json(out(&app, row))))
}

/// The last jobs, newest first; an evaluation's examples are left out.
#[utoipa::path(get, path = "/api/v1/jobs", tag = "jobs",
    responses((status = 200, body = Vec<JobOut>)))]
pub async fn list(State(app): State<App>) -> Result<Json<Vec<JobOut>>, ApiError> {
    let rows = app.store.tasks(TaskKind::JOBS, LISTED).await?;
    let brief =
        |row: TaskRow| out(&app, TaskRow { result: row.result.map(without_examples), ..row });
    Ok(Json(rows.into_iter().map(brief).collect()))
}

/// A result for a list: the maps of examples, which are large, are the job's own to hand over.
fn without_examples(mut result: Value) -> Value {
    if let Some(report) = result.as_object_mut() {
        report.remove("examples");
    }
    result
}

/// How far a job is, and what came of it.
#[utoipa::path(get, path = "/api/v1/jobs/{job}", tag = "jobs",
    params(("job" = String, Path, description = "its id")),
    responses((status = 200, body = JobOut), (status = 404, body = ProblemBody)))]
pub async fn one(
    State(app): State<App>,
    Path(job): Path<String>,
) -> Result<Json<JobOut>, ApiError> {
    Ok(Json(out(&app, find(&app, &job).await?)))
}

/// The losses of a training that is under way: a JSON object for each epoch. Those of one that is
/// done are its model's.
#[utoipa::path(get, path = "/api/v1/jobs/{job}/losses", tag = "jobs",
    params(("job" = String, Path, description = "its id")),
    responses((status = 200, body = String, content_type = "application/x-ndjson"),
        (status = 404, body = ProblemBody)))]
pub async fn losses(State(app): State<App>, Path(job): Path<String>) -> Result<Response, ApiError> {
    let row = find(&app, &job).await?;
    Ok(ndjson(app.jobs.losses(row.id)))
}

/// Ends a job. One that has ended stays as it is.
#[utoipa::path(post, path = "/api/v1/jobs/{job}/stop", tag = "jobs",
    params(("job" = String, Path, description = "its id")),
    responses((status = 202, body = JobOut), (status = 404, body = ProblemBody)))]
pub async fn stop(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Path(job): Path<String>,
) -> Result<(StatusCode, Json<JobOut>), ApiError> {
    let row = find(&app, &job).await?;
    let stopped = app.jobs.stop(row.id).await.map_err(ApiError::from);
    app.logged(&asker, "stop a job", (None, None, Some(&job)), stopped).await?;
    Ok((StatusCode::ACCEPTED, Json(out(&app, find(&app, &job).await?))))
}

/// Lines of JSON.
pub fn ndjson(text: String) -> Response {
    let kind = HeaderValue::from_static("application/x-ndjson");
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

async fn find(app: &App, job: &str) -> Result<TaskRow, ApiError> {
    let row = match job.parse() {
        Ok(id @ TaskId::Job(_)) => app.store.task(id).await?,
        _ => None,
    };
    row.ok_or_else(|| ApiError::not_found(format!("there is no job {job}")))
}
