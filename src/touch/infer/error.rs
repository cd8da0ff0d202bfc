//! Why a model or an answer is not available: one enum, whose messages name field and choices.
//! Uses: the errors of the parts of models. Never: HTTP, logging.

use std::io;
use std::path::{Path, PathBuf};

use super::plan::PlanError;
use crate::dataset::force_map::ForceMapError;
use crate::ids::{CalibrationId, ModelId};
use crate::learn::model_file::ModelError;
use crate::problem::{Problem, listed};
use crate::simulate::model::ModelUnavailable;
use crate::store::StoreError;

/// Result of work on models and answers.
pub type InferResult<T> = Result<T, InferError>;

/// Why a model or an answer is not available.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum InferError {
    #[error("{}", listed(.0))]
    Problems(Vec<Problem>),
    #[error("no model {0}: `palpate model list` lists the models")]
    NoModel(String),
    #[error("model {start}: several ids begin like this, state more digits of one: {ids}")]
    SeveralModels { start: String, ids: String },
    #[error("no calibration {0}: add it with `palpate model add-calibration FILE`")]
    NoSkin(CalibrationId),
    #[error("method = {method}: no {needs} is promoted: run `palpate model promote ID`")]
    NotServed { method: &'static str, needs: &'static str },
    #[error("model {id} is of task {task}: {wanted}")]
    OtherTask { id: ModelId, task: &'static str, wanted: &'static str },
    #[error("model {id} is for sensor {sensor} with {channels} channels, this is {here}")]
    OtherSensor { id: String, sensor: String, channels: usize, here: String },
    #[error("slot {0}: there is no earlier promotion")]
    NoEarlier(&'static str),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Plan(#[from] PlanError),
    #[error("exact: {0}")]
    Fit(#[from] sim_core::inverse::contacts::FitError),
    #[error("exact: {0}")]
    Fitter(#[from] sim_core::inverse::contacts::FitterError),
    #[error("exact: {0}")]
    Errors(#[from] sim_core::inverse::contacts::ErrorModelError),
    #[error("exact: {0}")]
    Steady(#[from] sim_core::inverse::contacts::SteadyError),
    #[error("one step: {0}")]
    OneStep(#[from] sim_core::inverse::linear::LinearError),
    #[error(transparent)]
    Calibration(#[from] sim_core::calibration::CalibrationError),
    #[error(transparent)]
    Skin(#[from] ModelUnavailable),
    #[error(transparent)]
    Map(#[from] ForceMapError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("{operation} {}: {source}", path.display())]
    File { operation: &'static str, path: PathBuf, source: io::Error },
    #[error("{}: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    #[error("a worker thread ended before its result")]
    Worker,
}

impl InferError {
    /// Returns a conversion from an I/O error of an operation on a file.
    pub fn file(operation: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { operation, path: path.clone(), source }
    }
}
