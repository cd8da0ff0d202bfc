//! Exports: requests, progress and files.
//! Uses: `dataset::catalog`. Never: the rows themselves.

use axum::Json;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::pages::{Page, PageParams, PageRequest};
use super::problem::{ApiError, ApiResult, Body, Path};
use super::send::{self, Created, Download};
use crate::dataset::error::DatasetError;
use crate::dataset::export::{ExportRequest, ExportResult};
use crate::dataset::used;
use crate::ids::{DatasetId, TaskId};
use crate::store::{TaskKind, TaskRow, TaskState};

/// An export: what was requested, and its progress.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ExportOut {
    /// Id of the export, `ex-..`.
    #[schema(value_type = String)]
    pub id: TaskId,
    /// Dataset, format and columns, as they were requested.
    #[schema(value_type = ExportRequest)]
    pub request: Value,
    /// State of the export.
    pub state: TaskState,
    /// Number of rows written; 0 unless the export is running.
    pub rows_done: u64,
    /// Number of rows to write; 0 until they are counted, and unless the export is running.
    pub rows_total: u64,
    /// Id of the dataset; absent until it is determined.
    pub dataset: Option<DatasetId>,
    /// Length of the file, bytes; absent until the export is done.
    pub bytes: Option<u64>,
    /// sha256 of the file, in hexadecimal digits; absent until the export is done.
    pub sha256: Option<String>,
    /// Cause of the failure; absent unless the export failed.
    pub error: Option<String>,
    /// Name of the person or key that requested the export.
    pub asked_by: String,
    /// Time of the request.
    pub created_at: jiff::Timestamp,
    /// Time of completion or failure; absent before it.
    pub finished_at: Option<jiff::Timestamp>,
    /// Wall time at which the file was last read; absent without a file, or if it is unknown.
    pub last_used_at: Option<jiff::Timestamp>,
    /// Address of the file; absent before completion, and after removal of the file.
    pub url: Option<String>,
}

fn out(app: &App, row: TaskRow) -> ExportOut {
    let done = app.datasets.export_progress(row.id);
    let file = app.datasets.export_file(&row);
    let result = ExportResult::of(&row);
    ExportOut {
        last_used_at: file.as_ref().and_then(|file| used::last_used_at(&file.path)),
        url: file.map(|_| format!("/api/v1/exports/{}/file", row.id)),
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

/// Requests an export.
///
/// It continues after a restart and produces the same bytes.
#[utoipa::path(post, operation_id = "request_export", path = "/api/v1/exports", tag = "datasets",
    request_body = ExportRequest,
    responses((status = 202, body = ExportOut, headers(("Location", description = "the export"))),
        (status = 400, description = "the selection is invalid, or too many exports wait"),
        (status = 404, description = "no dataset has this id or name")))]
pub async fn request(
    app: App,
    act: Act,
    Body(request): Body<ExportRequest>,
) -> ApiResult<Created<ExportOut>> {
    let row = app.datasets.request_export(&request, &act.name()).await?;
    act.about(&row.id.to_string());
    Ok(Created::later(format!("/api/v1/exports/{}", row.id), out(&app, row)))
}

/// Returns a page of the exports, newest first.
#[utoipa::path(get, operation_id = "list_exports", path = "/api/v1/exports", tag = "datasets",
    params(PageParams), responses((status = 200, body = Page<ExportOut>)))]
pub async fn list(app: App, asked: PageRequest) -> ApiResult<Page<ExportOut>> {
    let rows = app.store.tasks(TaskKind::EXPORTS, asked.limit + 1, asked.after()?).await?;
    Ok(asked.first(rows.into_iter().map(|row| out(&app, row)).collect(), |export| export.id))
}

/// Returns the state and progress of an export.
#[utoipa::path(get, operation_id = "export", path = "/api/v1/exports/{export}", tag = "datasets",
    responses((status = 200, body = ExportOut)))]
pub async fn one(app: App, Path(export): Path<String>) -> ApiResult<Json<ExportOut>> {
    Ok(Json(out(&app, find(&app, &export).await?)))
}

/// Returns the file of a completed export.
///
/// The header `Range` selects a part of it; the entity tag is its sha256.
#[utoipa::path(get, operation_id = "export_file", path = "/api/v1/exports/{export}/file",
    tag = "datasets",
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 206, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 409, description = "the export is not done, or it failed"),
        (status = 410, description = "the file was removed to free space")))]
pub async fn file(app: App, Path(export): Path<String>, request: Request) -> ApiResult<Response> {
    let row = find(&app, &export).await?;
    let refused = match row.state {
        TaskState::Done => None,
        TaskState::Failed => {
            Some(format!("export {export} failed: {}", row.error.as_deref().unwrap_or_default()))
        }
        TaskState::Waiting | TaskState::Running | TaskState::Stopped => {
            Some(format!("export {export} is not done: see /api/v1/exports/{export}"))
        }
    };
    if let Some(words) = refused {
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let Some(export_file) = app.datasets.export_file(&row) else {
        let words = format!("the file of export {export} was removed: request the export again");
        return Err(ApiError::new(StatusCode::GONE, words));
    };
    let asked: ExportRequest =
        serde_json::from_value(row.request.clone()).map_err(DatasetError::Json)?;
    let name = format!("{export}.{}", asked.format.extension());
    let download = Download { name: &name, immutable: true };
    send::file(request, &export_file, asked.format, download).await
}

async fn find(app: &App, export: &str) -> ApiResult<TaskRow> {
    let row = match export.parse() {
        Ok(id @ TaskId::Export(_)) => app.store.task(id).await?,
        _ => None,
    };
    row.ok_or_else(|| ApiError::not_found(format!("no export {export}")))
}
