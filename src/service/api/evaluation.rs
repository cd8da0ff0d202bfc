//! Quality of the simulation on a run.
//! Uses: `evaluate`, `store`. Never: a computation that a motion waits for.

use axum::Json;

use super::App;
use super::problem::{ApiError, ApiResult, Path};
use super::runs::find;
use crate::evaluate::simulation::{SimulationReport, report};

/// Returns the fit of the simulated twins to the trials of a run (paper, Fig. 7B to 7F).
///
/// Trials without a twin are excluded.
#[utoipa::path(get, operation_id = "evaluate_simulation",
    path = "/api/v1/runs/{run}/evaluation/simulation", tag = "simulation",
    responses((status = 200, body = SimulationReport)))]
pub async fn simulation(app: App, Path(run): Path<String>) -> ApiResult<Json<SimulationReport>> {
    let run = find(&app, &run).await?.uid;
    let fits = app.store.fits(run).await?;
    let report = tokio::task::spawn_blocking(move || report(&fits)).await;
    report.map(Json).map_err(ApiError::internal)
}
