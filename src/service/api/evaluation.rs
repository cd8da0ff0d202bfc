//! Quality of the simulation on a run.
//! Uses: `evaluate`, `store`. Never: a computation that a motion waits for.

use axum::Json;

use super::App;
use super::problem::{ApiError, ApiResult, Path};
use super::runs::find;
use crate::evaluate::simulation::{SimulationReport, newest_touched, with_frames};
use crate::store::StoreError;

/// Returns the fit of the simulated twins to the trials of a run (paper, Fig. 7B to 7F), also by pair of electrodes.
///
/// Trials without a twin are excluded.
#[utoipa::path(get, operation_id = "evaluate_simulation",
    path = "/api/v1/runs/{run}/evaluation/simulation", tag = "simulation",
    responses((status = 200, body = SimulationReport)))]
pub async fn simulation(app: App, Path(run): Path<String>) -> ApiResult<Json<SimulationReport>> {
    let run = find(&app, &run).await?.uid;
    let fits = app.store.fits(run).await?;
    let trials = match app.store.trials_with_voltages(&newest_touched(&fits)).await {
        // The fits are stored apart from the frames: the report is complete except for the pairs.
        Err(StoreError::Damaged { .. }) => Vec::new(),
        read => read?,
    };
    let report = tokio::task::spawn_blocking(move || {
        let frames = trials.iter().filter_map(|trial| {
            Some((trial.voltages_v.as_deref()?, trial.sim_voltages_v.as_deref()?))
        });
        with_frames(&fits, &frames.collect::<Vec<_>>())
    });
    report.await.map(Json).map_err(ApiError::internal)
}
