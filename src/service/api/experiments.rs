//! The experiments that the program carries, and the schema of an experiment file.
//! Uses: `carried`, `schedule::experiment`, `store` (the kinds). Never: files, a plan.

use axum::Json;
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

use super::pages::Page;
use super::problem::{ApiError, ApiResult};
use crate::carried::{EXPERIMENTS, about};
use crate::schedule::experiment::Experiment;
use crate::schedule::schema::of_experiments;
use crate::store::RunKind;

/// An experiment that the program carries.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct CarriedExperiment {
    /// Name of the experiment.
    pub name: String,
    /// Name of its file.
    pub file: String,
    /// The comment at the start of the file.
    pub about: String,
    /// Text of the file, for the queue. The program carries the sensor file that it names, too.
    pub text: String,
    /// Kind of the experiment; null if the file cannot be read.
    pub kind: Option<RunKind>,
    /// Number of trials; null if the file cannot be read.
    pub trials: Option<u64>,
    /// Forces of the weights that a person places, N; empty unless the experiment is a manual one.
    pub weights_n: Vec<f64>,
}

/// Returns the experiments that the program carries.
#[utoipa::path(get, operation_id = "list_experiments", path = "/api/v1/experiments", tag = "queue",
    responses((status = 200, body = Page<CarriedExperiment>)))]
pub async fn list() -> ApiResult<Page<CarriedExperiment>> {
    let carried = |(name, text): &(&str, &str)| {
        let file = format!("{name}.toml");
        let parsed = Experiment::from_toml(&file, text).ok();
        let kind = |experiment: &Experiment| match experiment.real_hex {
            Some(_) => RunKind::RealHex,
            None => RunKind::RealRandom,
        };
        CarriedExperiment {
            name: (*name).into(),
            about: about(text),
            text: (*text).into(),
            kind: parsed.as_ref().map(kind),
            trials: parsed.as_ref().map(Experiment::trials),
            weights_n: parsed
                .and_then(|experiment| experiment.real_random)
                .map_or_else(Vec::new, |random| random.weights_n),
            file,
        }
    };
    Ok(Page::whole(EXPERIMENTS.iter().map(carried).collect()))
}

/// Returns the JSON schema of an experiment file, as the component `Experiment` of this description
/// states it, with its tables written out.
///
/// It states the limits of every rig. Those of the rig, and limits between keys, are in the preflight.
#[utoipa::path(get, operation_id = "experiment_schema",
    path = "/api/v1/experiments/schema", tag = "queue",
    responses((status = 200, body = Object, description = "the schema of `Experiment`")))]
pub async fn schema() -> ApiResult<Json<Value>> {
    Ok(Json(of_experiments().map_err(ApiError::internal)?))
}
