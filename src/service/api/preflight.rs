//! Preflights on this rig, with what an earlier run on the same skin pressed at most.
//! Uses: `conductor`, `progress`, `tour`, `store`. Never: a prediction of forces.

use axum::Json;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiResult, Body, Path};
use super::progress::{ForcesOfTips, along};
use super::runs::find;
use super::turns::turn;
use crate::conductor::Submission;
use crate::digest::sha256_hex;
use crate::schedule::preflight::Preflight;
use crate::store::RunKind;

/// Preflight on this rig, and the forces of an earlier run.
#[derive(Debug, Serialize, ToSchema)]
pub struct RunPreflight {
    /// The preflight.
    #[serde(flatten)]
    pub preflight: Preflight,
    /// The newest run before it that pressed the same skin with a rig of the same label; null without one, and for
    /// manual trials.
    pub earlier: Option<EarlierRun>,
}

/// What an earlier run pressed at most.
#[derive(Debug, Serialize, ToSchema)]
pub struct EarlierRun {
    /// Number of the run.
    pub scan_id: i64,
    /// Name of its experiment.
    pub experiment: String,
    /// Its largest depth, mm.
    pub deepest_mm: f64,
    /// The largest forces of its configurations, for each number of tips.
    pub forces_by_tips: Vec<ForcesOfTips>,
}

/// Returns the preflight of a submission on this rig, without queuing it.
#[utoipa::path(post, operation_id = "preflight_submission", path = "/api/v1/preflight",
    tag = "queue", request_body = Submission, responses((status = 200, body = RunPreflight),
        (status = 422, description = "a file of the submission is invalid")))]
pub async fn of_submission(
    app: App,
    Body(submission): Body<Submission>,
) -> ApiResult<Json<RunPreflight>> {
    let _turn = turn(&app.turns.preflights).await?;
    let prepared = app.conductor.prepare(submission).await?;
    let sensor_sha256 = sha256_hex(&prepared.sensor_text);
    let earlier = earlier(&app, &prepared.preflight, &sensor_sha256, Timestamp::now()).await?;
    Ok(Json(RunPreflight { preflight: prepared.preflight, earlier }))
}

/// Returns the preflight of a stored run on this rig.
#[utoipa::path(get, operation_id = "run_preflight", path = "/api/v1/runs/{run}/preflight",
    tag = "runs", responses((status = 200, body = RunPreflight),
        (status = 422, description = "the run was not planned from an experiment")))]
pub async fn of_run(app: App, Path(run): Path<String>) -> ApiResult<Json<RunPreflight>> {
    let run = find(&app, &run).await?;
    let preflight = app.conductor.preflight_of(&run).await?;
    let before = run.started_at.unwrap_or_else(Timestamp::now);
    let earlier = earlier(&app, &preflight, &run.sensor_sha256, before).await?;
    Ok(Json(RunPreflight { preflight, earlier }))
}

/// What the newest run on a skin that began before a time pressed at most.
async fn earlier(
    app: &App,
    preflight: &Preflight,
    sensor_sha256: &str,
    before: Timestamp,
) -> ApiResult<Option<EarlierRun>> {
    if preflight.kind != RunKind::RealHex.as_str() {
        return Ok(None);
    }
    let label = app.facts.rig.config.label();
    let Some(run) = app.store.pressed_before(sensor_sha256, label, before).await? else {
        return Ok(None);
    };
    // A run whose plan this version cannot read has no forces for each number of tips.
    let Ok(kept) = app.tour(&run).await else { return Ok(None) };
    let progress = along(app, &run, &kept.tour).await?;
    Ok(Some(EarlierRun {
        scan_id: run.scan_id,
        experiment: run.experiment,
        deepest_mm: kept.tour.depths_mm.last().copied().unwrap_or_default(),
        forces_by_tips: progress.forces_by_tips,
    }))
}
