//! Trainings and evaluations: requests, progress, results, stop.
//! Uses: `jobs`. Never: the computation itself.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::pages::{Page, PageParams, PageRequest};
use super::problem::{ApiError, ApiResult, Body, Path};
use super::send::Created;
use crate::evaluate::request::EvaluationRequest;
use crate::ids::TaskId;
use crate::jobs::{Progress, TrainingRequest};
use crate::store::{TaskKind, TaskRow};

/// A training or an evaluation.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct JobOut {
    /// The task as it is stored.
    #[serde(flatten)]
    pub task: TaskRow,
    /// Progress; absent unless the job is running.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
}

fn out(app: &App, task: TaskRow) -> JobOut {
    JobOut { progress: app.jobs.progress(task.id), task }
}

/// Requests a training.
///
/// After a restart the training continues from its last checkpoint.
#[utoipa::path(post, path = "/api/v1/trainings", tag = "jobs", request_body = TrainingRequest,
    responses((status = 202, body = JobOut, headers(("Location", description = "the job"))),
        (status = 422, description = "the recipe is invalid")))]
pub async fn train(
    app: App,
    act: Act,
    Body(request): Body<TrainingRequest>,
) -> ApiResult<Created<JobOut>> {
    let row = app.jobs.train(&request, &act.name()).await?;
    act.about(&row.id.to_string());
    Ok(Created::later(format!("/api/v1/jobs/{}", row.id), out(&app, row)))
}

/// Requests an evaluation.
#[utoipa::path(post, path = "/api/v1/evaluations", tag = "jobs", request_body = EvaluationRequest,
    responses((status = 202, body = JobOut, headers(("Location", description = "the job"))),
        (status = 422, description = "a value of the request is invalid")))]
pub async fn evaluate(
    app: App,
    act: Act,
    Body(request): Body<EvaluationRequest>,
) -> ApiResult<Created<JobOut>> {
    let row = app.jobs.evaluate(&request, &act.name()).await?;
    act.about(&row.id.to_string());
    Ok(Created::later(format!("/api/v1/jobs/{}", row.id), out(&app, row)))
}

/// Returns a page of the jobs, newest first, without the examples of evaluations.
#[utoipa::path(get, operation_id = "list_jobs", path = "/api/v1/jobs", tag = "jobs",
    params(PageParams), responses((status = 200, body = Page<JobOut>)))]
pub async fn list(app: App, asked: PageRequest) -> ApiResult<Page<JobOut>> {
    let rows = app.store.tasks(TaskKind::JOBS, asked.limit + 1, asked.after()?).await?;
    let brief =
        |row: TaskRow| out(&app, TaskRow { result: row.result.map(without_examples), ..row });
    Ok(asked.first(rows.into_iter().map(brief).collect(), |job| job.task.id))
}

/// A result without the maps of its examples, which are large.
fn without_examples(mut result: Value) -> Value {
    if let Some(report) = result.as_object_mut() {
        report.remove("examples");
    }
    result
}

/// Returns the state, progress and result of a job.
#[utoipa::path(get, operation_id = "job", path = "/api/v1/jobs/{job}", tag = "jobs",
    responses((status = 200, body = JobOut)))]
pub async fn one(app: App, Path(job): Path<String>) -> ApiResult<Json<JobOut>> {
    Ok(Json(out(&app, find(&app, &job).await?)))
}

/// Returns the losses of a running training, a JSON object per epoch.
///
/// After its end the losses are those of its model.
#[utoipa::path(get, operation_id = "job_losses", path = "/api/v1/jobs/{job}/losses", tag = "jobs",
    responses((status = 200, body = String, content_type = "application/x-ndjson")))]
pub async fn losses(app: App, Path(job): Path<String>) -> ApiResult<Response> {
    let row = find(&app, &job).await?;
    Ok(ndjson(app.jobs.losses(row.id)))
}

/// Stops a job.
///
/// A job that has ended does not change.
#[utoipa::path(post, operation_id = "stop_job", path = "/api/v1/jobs/{job}/stop", tag = "jobs",
    responses((status = 202, body = JobOut)))]
pub async fn stop(
    app: App,
    act: Act,
    Path(job): Path<String>,
) -> ApiResult<(StatusCode, Json<JobOut>)> {
    act.about(&job);
    let row = find(&app, &job).await?;
    app.jobs.stop(row.id).await?;
    Ok((StatusCode::ACCEPTED, Json(out(&app, find(&app, &job).await?))))
}

/// Returns a response of JSON lines.
pub fn ndjson(text: String) -> Response {
    let kind = HeaderValue::from_static("application/x-ndjson");
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

async fn find(app: &App, job: &str) -> ApiResult<TaskRow> {
    let row = match job.parse() {
        Ok(id @ TaskId::Job(_)) => app.store.task(id).await?,
        _ => None,
    };
    row.ok_or_else(|| ApiError::not_found(format!("no job {job}")))
}
