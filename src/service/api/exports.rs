//! Exports: wishes that take a while, how far they are, and their files.
//! Uses: `dataset::catalog`. Never: the rows themselves.

use axum::extract::{Path, Request, State};
use axum::http::StatusCode;
use axum::response::Response;
use axum::{Extension, Json};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, ProblemBody};
use super::send;
use crate::dataset::export::{ExportRequest, ExportResult};
use crate::dataset::format::Format;
use crate::ids::TaskId;
use crate::store::{TaskKind, TaskRow, TaskState};

/// Exports that are listed.
const LISTED: u32 = 200;

/// An export.
#[derive(Debug, Serialize, ToSchema)]
pub struct ExportOut {
    /// Its id.
    #[schema(value_type = String)]
    pub id: TaskId,
    /// What was asked for.
    #[schema(value_type = ExportRequest)]
    pub request: Value,
    /// How far it is.
    pub state: TaskState,
    /// Rows that are written.
    pub rows_done: u64,
    /// Rows to write; 0 while they are being counted.
    pub rows_total: u64,
    /// The dataset, once it is known.
    pub dataset: Option<String>,
    /// Length of its file, once it is done.
    pub bytes: Option<u64>,
    /// sha256 of its file, once it is done.
    pub sha256: Option<String>,
    /// Why it failed.
    pub error: Option<String>,
    /// Who asked.
    pub asked_by: String,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: jiff::Timestamp,
    /// When it was done, or failed.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<jiff::Timestamp>,
    /// Where its file is, once it is done.
    pub url: Option<String>,
}

fn out(app: &App, row: TaskRow) -> ExportOut {
    let done = app.datasets.export_progress(row.id);
    let url = app.datasets.export_file(&row).map(|_| format!("/api/v1/exports/{}/file", row.id));
    let result = ExportResult::of(&row);
    ExportOut {
        url,
        rows_done: done.rows_done,
        rows_total: done.rows_total,
        id: row.id,
        request: row.request,
        state: row.state,
        dataset: row.dataset,
        bytes: result.as_ref().map(|result| result.bytes),
        sha256: result.map(|result| result.sha256),
        error: row.error,
        asked_by: row.asked_by,
        created_at: row.created_at,
        finished_at: row.finished_at,
    }
}

/// Asks for an export. It goes on after a restart, and gives the same bytes.
#[utoipa::path(post, path = "/api/v1/exports", tag = "datasets", request_body = ExportRequest,
    responses((status = 202, body = ExportOut), (status = 400, body = ProblemBody),
        (status = 404, body = ProblemBody)))]
pub async fn ask(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(request): Body<ExportRequest>,
) -> Result<(StatusCode, Json<ExportOut>), ApiError> {
    let row = app.datasets.request_export(&request, &asker.name(None)).await?;
    Ok((StatusCode::ACCEPTED, Json(out(&app, row))))
}

/// The last exports, newest first.
#[utoipa::path(get, path = "/api/v1/exports", tag = "datasets",
    responses((status = 200, body = Vec<ExportOut>)))]
pub async fn list(State(app): State<App>) -> Result<Json<Vec<ExportOut>>, ApiError> {
    let rows = app.store.tasks(TaskKind::EXPORTS, LISTED).await?;
    Ok(Json(rows.into_iter().map(|row| out(&app, row)).collect()))
}

/// How far an export is.
#[utoipa::path(get, path = "/api/v1/exports/{export}", tag = "datasets",
    params(("export" = String, Path, description = "its id")),
    responses((status = 200, body = ExportOut), (status = 404, body = ProblemBody)))]
pub async fn one(
    State(app): State<App>,
    Path(export): Path<String>,
) -> Result<Json<ExportOut>, ApiError> {
    Ok(Json(out(&app, find(&app, &export).await?)))
}

/// The file of an export that is done. Takes `Range`; the entity tag is its sha256.
#[utoipa::path(get, path = "/api/v1/exports/{export}/file", tag = "datasets",
    params(("export" = String, Path, description = "its id")),
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 206, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 404, body = ProblemBody), (status = 409, body = ProblemBody),
        (status = 410, body = ProblemBody)))]
pub async fn file(
    State(app): State<App>,
    Path(export): Path<String>,
    request: Request,
) -> Result<Response, ApiError> {
    let row = find(&app, &export).await?;
    match row.state {
        TaskState::Done => {}
        TaskState::Failed => {
            let why = row.error.unwrap_or_default();
            return Err(ApiError::new(StatusCode::CONFLICT, format!("{export} failed: {why}")));
        }
        _ => {
            let words = format!("{export} is not done: look at /api/v1/exports/{export}");
            return Err(ApiError::new(StatusCode::CONFLICT, words));
        }
    }
    let Some(export_file) = app.datasets.export_file(&row) else {
        let words = format!("the file of {export} made room for later ones: ask for it again");
        return Err(ApiError::new(StatusCode::GONE, words));
    };
    let format = row.request["format"].as_str().and_then(|name| name.parse().ok());
    let format: Format = format.unwrap_or(Format::Parquet);
    let name = format!("{export}.{}", format.extension());
    send::file(request, &export_file, format, (&name, true)).await
}

async fn find(app: &App, export: &str) -> Result<TaskRow, ApiError> {
    let row = match export.parse() {
        Ok(id @ TaskId::Export(_)) => app.store.task(id).await?,
        _ => None,
    };
    row.ok_or_else(|| ApiError::not_found(format!("there is no export {export}")))
}
