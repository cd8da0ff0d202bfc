//! Why an order was not carried out.
//! Uses: the errors of its parts. Never: logging.

use std::path::PathBuf;

use crate::dataset::error::DatasetError;
use crate::learn::error::LearnError;
use crate::learn::order::OrderError;
use crate::simulate::model::ModelUnavailable;

/// Why an order was not carried out.
#[derive(Debug, thiserror::Error)]
pub enum TrainerError {
    /// The order is invalid.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// Another trainer works in the folder.
    #[error("{}: another trainer works in it: wait for its end", .0.display())]
    Busy(PathBuf),
    /// Data, training or model failed.
    #[error(transparent)]
    Learn(#[from] LearnError),
    /// The sensor is invalid.
    #[error("sensor: {0}")]
    Sensor(#[from] sim_core::sensor::SensorError),
    /// The calibration is invalid.
    #[error(transparent)]
    Calibration(#[from] sim_core::calibration::CalibrationError),
    /// The model of the skin is not available.
    #[error(transparent)]
    Skin(#[from] ModelUnavailable),
    /// The residuals cannot be written as JSON.
    #[error("residuals: {0}")]
    Json(#[from] serde_json::Error),
}

impl From<DatasetError> for TrainerError {
    fn from(error: DatasetError) -> Self {
        Self::Learn(error.into())
    }
}
