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
    /// Values of the request are invalid.
    #[error("{}", listed(.0))]
    Problems(Vec<Problem>),
    /// No model has this id or name.
    #[error("no model {0}: `palpate model list` lists the models")]
    NoModel(String),
    /// The ids of several models begin with this text.
    #[error("model {start}: several ids begin like this, state more digits of one: {ids}")]
    SeveralModels { start: String, ids: String },
    /// No calibration has this id.
    #[error("no calibration {0}: add it with `palpate model add-calibration FILE`")]
    NoSkin(CalibrationId),
    /// No model is promoted to a slot that the method needs.
    #[error("method = {method}: no {needs} is promoted: run `palpate model promote ID`")]
    NotServed { method: &'static str, needs: &'static str },
    /// The task of a model is not the one needed.
    #[error("model {id} is of task {task}: {wanted}")]
    OtherTask { id: ModelId, task: &'static str, wanted: &'static str },
    /// The model is for another sensor.
    #[error("model {id} is for sensor {sensor} with {channels} channels, this is {here}")]
    OtherSensor { id: String, sensor: String, channels: usize, here: String },
    /// The slot has no earlier content.
    #[error("slot {0}: there is no earlier promotion")]
    NoEarlier(&'static str),
    /// The files of a model are invalid.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The ONNX engine failed.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A frame could not be fitted.
    #[error("exact: {0}")]
    Fit(#[from] sim_core::inverse::contacts::FitError),
    /// A skin could not be made ready for fits.
    #[error("exact: {0}")]
    Fitter(#[from] sim_core::inverse::contacts::FitterError),
    /// The error model of the skin is invalid.
    #[error("exact: {0}")]
    Errors(#[from] sim_core::inverse::contacts::ErrorModelError),
    /// A frame could not be added to a mean.
    #[error("exact: {0}")]
    Steady(#[from] sim_core::inverse::contacts::SteadyError),
    /// The one-step reconstruction failed.
    #[error("one step: {0}")]
    OneStep(#[from] sim_core::inverse::linear::LinearError),
    /// The calibration is invalid.
    #[error(transparent)]
    Calibration(#[from] sim_core::calibration::CalibrationError),
    /// The exact model is not available.
    #[error(transparent)]
    Skin(#[from] ModelUnavailable),
    /// The force map could not be drawn.
    #[error(transparent)]
    Map(#[from] ForceMapError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file could not be read or written.
    #[error("{operation} {}: {source}", path.display())]
    File { operation: &'static str, path: PathBuf, source: io::Error },
    /// The content of a file is not the expected JSON.
    #[error("{}: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    /// A thread ended before its result.
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
