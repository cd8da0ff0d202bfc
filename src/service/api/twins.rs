//! Simulated twins: where the pool stands, and how far each run's twins are.
//! Uses: `simulate::twins`, `store`. Never: a computation.

use axum::Json;
use axum::extract::{Path, State};
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ProblemBody};
use super::runs::find;
use crate::ids::RunUid;
use crate::store::TwinCount;
use crate::twins::PoolStatus;

/// Runs that are counted, newest first: counting one of 33,000 trials takes some 20 ms.
const RUNS: usize = 10;

/// The twins of a service.
#[derive(Debug, Serialize, ToSchema)]
pub struct Twins {
    /// The pool that makes them.
    pub pool: PoolStatus,
    /// The newest runs with trials.
    pub runs: Vec<RunTwins>,
}

/// The twins of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct RunTwins {
    /// The run.
    pub run: RunUid,
    /// How far they are.
    #[serde(flatten)]
    pub count: TwinCount,
    /// Trials that wait for theirs.
    pub pending: u64,
}

impl RunTwins {
    async fn of(app: &App, run: RunUid) -> Result<Self, ApiError> {
        let count = app.twins.count(run).await?;
        Ok(Self { run, count, pending: count.pending() })
    }
}

/// Where the simulated twins stand.
#[utoipa::path(get, path = "/api/v1/twins", tag = "simulation",
    responses((status = 200, body = Twins)))]
pub async fn all(State(app): State<App>) -> Result<Json<Twins>, ApiError> {
    let mut runs = Vec::new();
    for run in app.store.runs_with_trials().await?.into_iter().take(RUNS) {
        runs.push(RunTwins::of(&app, run).await?);
    }
    Ok(Json(Twins { pool: app.twins.status(), runs }))
}

/// How far the twins of one run are.
#[utoipa::path(get, path = "/api/v1/runs/{run}/twins", tag = "simulation",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = RunTwins), (status = 404, body = ProblemBody)))]
pub async fn of_run(
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<RunTwins>, ApiError> {
    let run = find(&app, &run).await?.uid;
    RunTwins::of(&app, run).await.map(Json)
}
