//! The tour of a run or of a submission: where its plan presses, in the order of driving.
//! Uses: `schedule`, `store`. Never: what was measured there (`progress` and the trials have it).

use std::sync::Arc;

use axum::Json;
use axum::body::Bytes;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use sim_core::sensor::Sensor;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ApiResult, Body, Path};
use super::runs::find;
use super::sensor::SensorOut;
use super::tags::{add_tag, tag_of, unless_known};
use super::turns::turn;
use crate::conductor::{Submission, run_kind};
use crate::problem::Problem;
use crate::schedule::experiment::Experiment;
use crate::schedule::plan::Plan;
use crate::schedule::visits::Visits;
use crate::store::{RunKind, RunRow};

/// Where the plan of a run presses, in the order of driving.
#[derive(Debug, Serialize, ToSchema)]
pub struct Tour {
    /// Number of the run.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Kind of the experiment.
    pub kind: RunKind,
    /// Depths of each configuration, mm; empty for manual trials.
    pub depths_mm: Vec<f64>,
    /// Limit of the experiment of the force on one tip, N; null if its file cannot be read. The limit of
    /// the rig applies too.
    pub force_limit_n: Option<f64>,
    /// Limit of the experiment of the sum over the tips, N; null if its file cannot be read.
    pub force_sum_limit_n: Option<f64>,
    /// The configurations or placements.
    pub steps: Visits,
}

/// Where the plan of a submission would press, in the order of driving.
#[derive(Debug, Serialize, ToSchema)]
pub struct SubmittedTour {
    /// Name of the experiment.
    pub experiment: String,
    /// Kind of the experiment.
    pub kind: RunKind,
    /// Depths of each configuration, mm; empty for manual trials.
    pub depths_mm: Vec<f64>,
    /// Limit of the experiment of the force on one tip, N. The limit of the rig applies too.
    pub force_limit_n: f64,
    /// Limit of the experiment of the sum over the tips, N.
    pub force_sum_limit_n: f64,
    /// The configurations or placements.
    pub steps: Visits,
    /// The sensor of the submission.
    pub sensor: SensorOut,
}

impl SubmittedTour {
    /// Plans a submission.
    ///
    /// # Errors
    /// All problems of the experiment or sensor file.
    fn of(submission: &Submission) -> Result<Self, Vec<Problem>> {
        let file = &submission.file;
        let experiment = Experiment::from_toml(file, &submission.definition)?;
        let named = experiment.sensor.as_str();
        let sensor = Sensor::from_toml(&submission.sensor_text(named)?)
            .map_err(|e| vec![Problem::whole(named, e.to_string())])?;
        let plan = Plan::of(file, &experiment, &sensor)?;
        Ok(Self {
            kind: run_kind(&plan),
            force_limit_n: plan.limits.force_n,
            force_sum_limit_n: plan.limits.force_sum_n,
            steps: Visits::of(&plan),
            sensor: SensorOut::of(&sensor),
            experiment: plan.experiment,
            depths_mm: plan.depths_mm,
        })
    }
}

/// Returns the tour of a submission and its sensor, without queuing it.
///
/// The preflight has the problems of the submission on this rig.
#[utoipa::path(post, operation_id = "submission_tour", path = "/api/v1/tour", tag = "queue",
    request_body = Submission, responses((status = 200, body = SubmittedTour),
        (status = 422, description = "a file of the submission is invalid")))]
pub async fn of_submission(
    app: App,
    Body(submission): Body<Submission>,
) -> ApiResult<Json<SubmittedTour>> {
    let _turn = turn(&app.turns.preflights).await?;
    // A plan of 198,000 trials takes about 0.3 s: not on a thread that answers requests.
    let planning = tokio::task::spawn_blocking(move || SubmittedTour::of(&submission));
    planning.await.map_err(ApiError::internal)?.map(Json).map_err(ApiError::problems)
}

impl Tour {
    /// Number of planned trials of each configuration.
    pub(super) fn trials_each(&self) -> u32 {
        // A manual trial has no depth.
        self.depths_mm.len().max(1) as u32
    }
}

/// A tour with its response.
#[derive(Debug)]
pub struct KeptTour {
    /// Configurations in the planned order.
    pub tour: Tour,
    body: Bytes,
    tag: String,
}

/// Returns the tour of a run: where its plan presses, in the planned order.
///
/// It changes only if a queued run is edited.
#[utoipa::path(get, operation_id = "run_tour", path = "/api/v1/runs/{run}/tour", tag = "runs",
    params(("run" = String, Path),
        ("If-None-Match" = Option<String>, Header, description = "entity tags that the client has")),
    responses((status = 200, body = Tour, headers(("ETag" = String, description = "entity tag"))),
        (status = 304, description = "the client has it already"),
        (status = 404, description = "no run has this uid or scan_id, or it has no plan")))]
pub async fn of_run(app: App, Path(run): Path<String>, headers: HeaderMap) -> ApiResult<Response> {
    let run = find(&app, &run).await?;
    let kept = app.tour(&run).await?;
    let json = [(header::CONTENT_TYPE, "application/json")];
    let mut response = (json, kept.body.clone()).into_response();
    add_tag(&mut response, &kept.tag)?;
    Ok(unless_known(&headers, response, Some(kept.tag.clone())))
}

impl App {
    /// The tour of a run. A plan that was kept is read; the run of a version that kept none is planned
    /// again from its files.
    ///
    /// # Errors
    /// 404 if the run has no plan, or none that this version can read; errors of the store.
    pub(super) async fn tour(&self, run: &RunRow) -> ApiResult<Arc<KeptTour>> {
        let key = (run.uid, run.plan_sha256.clone());
        self.facts.memory.tours.get(key, read(self, run)).await
    }
}

async fn read(app: &App, run: &RunRow) -> ApiResult<Arc<KeptTour>> {
    let none = |why: &str| ApiError::not_found(format!("run {} has no plan: {why}", run.scan_id));
    if run.kind == RunKind::Imported {
        return Err(none("it was imported"));
    }
    let plan = app.store.plan_of(run.uid).await?;
    let (scan_id, experiment, kind) = (run.scan_id, run.experiment.clone(), run.kind);
    let run = run.clone();
    // A plan of 198,000 trials takes about 0.3 s: not on a thread that answers requests.
    let reading = tokio::task::spawn_blocking(move || {
        let (depths_mm, steps) = match plan {
            Some(plan) => Visits::of_text(&plan).map_err(|e| e.to_string())?,
            None => planned(&run)?,
        };
        let file = Experiment::from_toml(&run.experiment, &run.definition).ok();
        let tour = Tour {
            scan_id,
            experiment,
            kind,
            depths_mm,
            force_limit_n: file.as_ref().map(|file| file.limits.force_n),
            force_sum_limit_n: file.as_ref().map(|file| file.limits.force_sum_n),
            steps,
        };
        let body = Bytes::from(serde_json::to_vec(&tour).map_err(|e| e.to_string())?);
        let tag = tag_of(&body);
        Ok(Arc::new(KeptTour { tour, body, tag }))
    });
    let read: Result<_, String> = reading.await.unwrap_or_else(|error| Err(error.to_string()));
    read.map_err(|why| none(&why))
}

/// Plans an experiment. Returns its depths, mm, and its places.
fn planned(run: &RunRow) -> Result<(Vec<f64>, Visits), String> {
    let first = |problems: Vec<crate::problem::Problem>| {
        problems.first().map_or_else(String::new, ToString::to_string)
    };
    let experiment = Experiment::from_toml(&run.experiment, &run.definition).map_err(first)?;
    let sensor = Sensor::from_toml(&run.sensor).map_err(|e| e.to_string())?;
    let plan = Plan::of(&run.experiment, &experiment, &sensor).map_err(first)?;
    Ok((plan.depths_mm.clone(), Visits::of(&plan)))
}
