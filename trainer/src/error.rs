//! Why an order was not carried out.
//! Uses: the errors of its parts. Never: logging.

use std::path::PathBuf;

use crate::dataset::error::DatasetError;
use crate::learn::error::LearnError;
use crate::learn::order::OrderError;
use crate::simulate::model::ModelUnavailable;

/// Why an order was not carried out.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum TrainerError {
    #[error(transparent)]
    Order(#[from] OrderError),
    #[error("{}: another trainer works in it: wait for its end", .0.display())]
    Busy(PathBuf),
    #[error(transparent)]
    Learn(#[from] LearnError),
    #[error("sensor: {0}")]
    Sensor(#[from] sim_core::sensor::SensorError),
    #[error(transparent)]
    Calibration(#[from] sim_core::calibration::CalibrationError),
    #[error(transparent)]
    Skin(#[from] ModelUnavailable),
    #[error("residuals: {0}")]
    Json(#[from] serde_json::Error),
}

impl From<DatasetError> for TrainerError {
    fn from(error: DatasetError) -> Self {
        Self::Learn(error.into())
    }
}
