//! Why there is no model, or no answer: one enum, whose words name field and choices.
//! Uses: the errors of what models are made of. Never: HTTP, logging.

use std::io;
use std::path::{Path, PathBuf};

use super::answer::Method;
use super::plan::PlanError;
use crate::dataset::force_map::ForceMapError;
use crate::learn::model_file::ModelError;
use crate::problem::Problem;
use crate::simulate::model::ModelUnavailable;
use crate::store::StoreError;

/// Why there is no model, or no answer.
#[derive(Debug, thiserror::Error)]
pub enum InferError {
    /// What was asked for cannot be.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Problems(Vec<Problem>),
    /// There is no such model.
    #[error("there is no model {0}: palpate model list shows those there are")]
    NoModel(String),
    /// There is no such calibration.
    #[error("there is no calibration {0}: palpate model add-calibration FILE keeps one")]
    NoSkin(String),
    /// Nothing serves what a method needs.
    #[error("method = {}: no {needs} is promoted: palpate model promote ID", method.name())]
    NotServed {
        /// The method.
        method: Method,
        /// What it needs.
        needs: &'static str,
    },
    /// A model does something else than what it is asked for.
    #[error("model {id} is of task {task}: {wanted}")]
    OtherTask {
        /// The model.
        id: String,
        /// What it does.
        task: &'static str,
        /// What is wanted of it.
        wanted: &'static str,
    },
    /// A model is for another sensor.
    #[error("model {id} is for sensor {sensor} with {channels} channels, this is {here}")]
    OtherSensor {
        /// The model.
        id: String,
        /// Its sensor.
        sensor: String,
        /// Its channels.
        channels: usize,
        /// The sensor at hand, in words.
        here: String,
    },
    /// The slot never held anything else.
    #[error("slot {0}: nothing to go back to")]
    NoEarlier(&'static str),
    /// A model's files.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The engine.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A frame could not be fitted.
    #[error("exact: {0}")]
    Fit(#[from] sim_core::inverse::contacts::FitError),
    /// A skin could not be made ready for fits.
    #[error("exact: {0}")]
    Fitter(#[from] sim_core::inverse::contacts::FitterError),
    /// The noise could not be reckoned with.
    #[error("exact: {0}")]
    Errors(#[from] sim_core::inverse::contacts::ErrorModelError),
    /// A frame could not be added to a mean.
    #[error("exact: {0}")]
    Steady(#[from] sim_core::inverse::contacts::SteadyError),
    /// The one-step reconstruction failed.
    #[error("one step: {0}")]
    OneStep(#[from] sim_core::inverse::linear::LinearError),
    /// A calibration.
    #[error(transparent)]
    Calibration(#[from] sim_core::calibration::CalibrationError),
    /// The exact model.
    #[error(transparent)]
    Skin(#[from] ModelUnavailable),
    /// The map.
    #[error(transparent)]
    Map(#[from] ForceMapError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file.
    #[error("{operation} {}: {source}", path.display())]
    File {
        /// What was done.
        operation: &'static str,
        /// Which file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A file that should be JSON.
    #[error("{}: {source}", path.display())]
    Json {
        /// Which file.
        path: PathBuf,
        /// Why not.
        source: serde_json::Error,
    },
    /// A thread ended before its work.
    #[error("a worker ended before its work was done")]
    Worker,
}

impl InferError {
    /// A file's error, by what was done with it.
    pub fn file(operation: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { operation, path: path.clone(), source }
    }
}
