//! The queue of runs.
//! Uses: `conductor`, `store`. Never: starting a run (`runs` does).

use axum::Json;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::audit::Act;
use super::pages::Page;
use super::problem::{ApiResult, Body, Params, Path};
use super::runs::find;
use super::send::Created;
use crate::conductor::{Submission, Terms};
use crate::store::RunRow;

/// Request to queue a run, or to replace a queued one.
#[derive(Debug, Deserialize, ToSchema)]
pub struct QueueRequest {
    /// Text and names of the files.
    #[serde(flatten)]
    pub submission: Submission,
    /// Name of the person, for the log of actions.
    pub who: Option<String>,
    /// True if the run may resume automatically; absent: as in the policy of the experiment.
    pub auto_resume: Option<bool>,
    /// Earliest start, at most 366 days ahead; absent or in the past: any time.
    pub not_before: Option<Timestamp>,
}

impl QueueRequest {
    fn terms(&self) -> Terms {
        Terms { auto_resume: self.auto_resume, not_before: self.not_before }
    }
}

/// Parameters of a request that only names the person.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct WhoParams {
    /// Name of the person, for the log of actions.
    pub who: Option<String>,
}

/// Request to move a run in the queue.
#[derive(Debug, Deserialize, ToSchema)]
pub struct MoveRequest {
    /// New position, from 1; a position after the end is the end.
    pub position: u32,
    /// Name of the person, for the log of actions.
    pub who: Option<String>,
}

/// Returns the waiting runs, the next one first.
#[utoipa::path(get, operation_id = "queue",
    path = "/api/v1/queue", tag = "queue", responses((status = 200, body = Page<RunRow>)))]
pub async fn list(app: App) -> ApiResult<Page<RunRow>> {
    Ok(Page::whole(app.store.queue().await?))
}

/// Queues a run.
#[utoipa::path(post, operation_id = "queue_run", path = "/api/v1/queue", tag = "queue",
    request_body = QueueRequest,
    responses((status = 201, body = RunRow, headers(("Location", description = "the run"))),
        (status = 422, description = "a file of the submission is invalid")))]
pub async fn add(app: App, act: Act, Body(item): Body<QueueRequest>) -> ApiResult<Created<RunRow>> {
    act.stated(item.who.as_deref(), None);
    let terms = item.terms();
    let row = app.conductor.enqueue(item.submission, act.name(), terms).await?;
    act.on(row.uid);
    Ok(Created::at(format!("/api/v1/runs/{}", row.uid), row))
}

/// Replaces the files and the start time of a queued run.
///
/// The run gets a new plan and keeps its number, its uid and its place. It must be armed and started
/// again if it was.
#[utoipa::path(put, operation_id = "edit_run", path = "/api/v1/queue/{run}", tag = "queue",
    request_body = QueueRequest, responses((status = 200, body = RunRow),
        (status = 409,
            description = "the run is not queued, or another person holds the operator lock"),
        (status = 422, description = "a file of the submission is invalid")))]
pub async fn edit(
    app: App,
    act: Act,
    Path(run): Path<String>,
    Body(item): Body<QueueRequest>,
) -> ApiResult<Json<RunRow>> {
    act.stated(item.who.as_deref(), None);
    let run = find(&app, &run).await?;
    act.on(run.uid);
    let terms = item.terms();
    Ok(Json(app.conductor.edit(&run, item.submission, terms).await?))
}

/// Removes a run from the queue.
#[utoipa::path(delete, operation_id = "remove_run", path = "/api/v1/queue/{run}", tag = "queue",
    params(WhoParams, ("run" = String, Path)), responses((status = 200, body = RunRow),
        (status = 409,
            description = "the run is not queued, or another person holds the operator lock")))]
pub async fn remove(
    app: App,
    act: Act,
    Path(run): Path<String>,
    Params(by): Params<WhoParams>,
) -> ApiResult<Json<RunRow>> {
    act.stated(by.who.as_deref(), None);
    let run = find(&app, &run).await?;
    act.on(run.uid);
    Ok(Json(app.conductor.remove(&run).await?))
}

/// Moves a run in the queue.
#[utoipa::path(post, operation_id = "move_run", path = "/api/v1/queue/{run}/move", tag = "queue",
    request_body = MoveRequest, responses((status = 200, body = Page<RunRow>),
        (status = 409,
            description = "the run is not queued, or another person holds the operator lock")))]
pub async fn shift(
    app: App,
    act: Act,
    Path(run): Path<String>,
    Body(shift): Body<MoveRequest>,
) -> ApiResult<Page<RunRow>> {
    act.stated(shift.who.as_deref(), None);
    let run = find(&app, &run).await?;
    act.on(run.uid);
    Ok(Page::whole(app.conductor.shift(&run, shift.position).await?))
}
