//! The queue, and what a submission would be.
//! Uses: `conductor`, `store`. Never: starting a run (`runs` does).

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, Params, ProblemBody};
use super::runs::find;
use crate::conductor::Submission;
use crate::schedule::preflight::Preflight;
use crate::store::RunRow;

/// Runs in their order.
#[derive(Debug, Serialize, ToSchema)]
pub struct Queue {
    /// The next one first.
    pub runs: Vec<RunRow>,
}

/// What is to be queued.
#[derive(Debug, Deserialize, ToSchema)]
pub struct NewItem {
    /// The files.
    #[serde(flatten)]
    pub submission: Submission,
    /// Who asks.
    pub who: Option<String>,
    /// The run may go on by itself; the experiment's own policy if absent.
    pub auto_resume: Option<bool>,
}

/// Who asks, in a query.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ByWhom {
    /// A name for the log of actions.
    pub who: Option<String>,
}

/// Where a run is moved to.
#[derive(Debug, Deserialize, ToSchema)]
pub struct Shift {
    /// From 1; beyond the end means the end.
    pub position: u32,
    /// Who asks.
    pub who: Option<String>,
}

/// The queue.
#[utoipa::path(get, path = "/api/v1/queue", tag = "queue", responses((status = 200, body = Queue)))]
pub async fn list(State(app): State<App>) -> Result<Json<Queue>, ApiError> {
    Ok(Json(Queue { runs: app.store.queue().await? }))
}

/// Queues a run.
#[utoipa::path(post, path = "/api/v1/queue", tag = "queue", request_body = NewItem,
    responses((status = 201, body = RunRow), (status = 422, body = ProblemBody)))]
pub async fn add(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(item): Body<NewItem>,
) -> Result<(StatusCode, Json<RunRow>), ApiError> {
    let who = item.who.clone();
    let outcome = async {
        app.unlocked(&asker, who.as_deref()).await?;
        let name = asker.name(who.as_deref());
        Ok(app.conductor.enqueue(item.submission, name, item.auto_resume).await?)
    }
    .await;
    let run = outcome.as_ref().ok().map(|r: &RunRow| r.uid);
    let row = app.logged(&asker, "queue", (run, who.as_deref(), None), outcome).await?;
    Ok((StatusCode::CREATED, Json(row)))
}

/// Takes a run out of the queue.
#[utoipa::path(delete, path = "/api/v1/queue/{run}", tag = "queue", params(ByWhom,
    ("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = RunRow), (status = 409, body = ProblemBody)))]
pub async fn remove(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Path(run): Path<String>,
    Params(by): Params<ByWhom>,
) -> Result<Json<RunRow>, ApiError> {
    let run = find(&app, &run).await?.uid;
    let outcome = async {
        app.unlocked(&asker, by.who.as_deref()).await?;
        Ok(app.store.remove(run).await?)
    }
    .await;
    let about = (Some(run), by.who.as_deref(), None);
    Ok(Json(app.logged(&asker, "remove", about, outcome).await?))
}

/// Moves a run in the queue.
#[utoipa::path(post, path = "/api/v1/queue/{run}/move", tag = "queue", request_body = Shift,
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = Queue), (status = 409, body = ProblemBody)))]
pub async fn shift(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Path(run): Path<String>,
    Body(shift): Body<Shift>,
) -> Result<Json<Queue>, ApiError> {
    let run = find(&app, &run).await?.uid;
    let outcome = async {
        app.unlocked(&asker, shift.who.as_deref()).await?;
        Ok(app.store.move_item(run, shift.position).await?)
    }
    .await;
    let about = (Some(run), shift.who.as_deref(), None);
    let runs = app.logged(&asker, "move", about, outcome).await?;
    Ok(Json(Queue { runs }))
}

/// What a submission would be on this rig; nothing is queued.
#[utoipa::path(post, path = "/api/v1/preflight", tag = "queue", request_body = Submission,
    responses((status = 200, body = Preflight), (status = 422, body = ProblemBody)))]
pub async fn preflight(
    State(app): State<App>,
    Body(submission): Body<Submission>,
) -> Result<Json<Preflight>, ApiError> {
    Ok(Json(app.conductor.preflight(submission).await?))
}
