//! Simulated twins: status of the pool, and progress for each run.
//! Uses: `twins`, `store`. Never: a computation.

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, Path, ProblemBody};
use super::runs::find;
use crate::ids::RunUid;
use crate::store::TwinCount;
use crate::twins::PoolStatus;

/// Number of runs that are counted, newest first: counting 33,000 trials takes about 20 ms.
const COUNTED_RUNS: usize = 10;

/// Status of the simulated twins.
#[derive(Debug, Serialize, ToSchema)]
pub struct Twins {
    /// Status of the pool that simulates twins.
    pub pool: PoolStatus,
    /// The newest 10 runs with trials, newest first.
    pub runs: Vec<RunTwins>,
}

/// Number of twins of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct RunTwins {
    /// uid of the run.
    pub run: RunUid,
    /// Number of trials, twins and failures.
    #[serde(flatten)]
    pub count: TwinCount,
    /// Number of trials without twin and without failure.
    pub pending: u64,
}

impl RunTwins {
    async fn of(app: &App, run: RunUid) -> Result<Self, ApiError> {
        let count = app.twins.count(run).await?;
        Ok(Self { run, count, pending: count.pending() })
    }
}

/// Returns the status of the simulated twins.
#[utoipa::path(get, operation_id = "twins", path = "/api/v1/twins", tag = "simulation",
    responses((status = 200, body = Twins)))]
pub async fn all(State(app): State<App>) -> Result<Json<Twins>, ApiError> {
    let mut runs = Vec::new();
    for run in app.store.runs_with_trials().await?.into_iter().take(COUNTED_RUNS) {
        runs.push(RunTwins::of(&app, run).await?);
    }
    Ok(Json(Twins { pool: app.twins.status(), runs }))
}

/// Returns the number of twins of a run.
#[utoipa::path(get, operation_id = "run_twins",
    path = "/api/v1/runs/{run}/twins", tag = "simulation",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = RunTwins),
        (status = 404, body = ProblemBody, description = "no run has this uid or scan_id")))]
pub async fn of_run(
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<RunTwins>, ApiError> {
    let run = find(&app, &run).await?.uid;
    RunTwins::of(&app, run).await.map(Json)
}
