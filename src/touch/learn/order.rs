//! What a trainer is asked for and what it reports: the contents of the order, the names of the files
//! in a job's folder, the lines of the trainer's standard output.
//! PURE. Uses: serde. Never: files, processes.
//!
//! A training is a separate process. The service writes `order.json` into the job's folder and starts
//! `palpate-trainer FOLDER`; the trainer writes checkpoint, losses and result into the same folder.
//! Closing its standard input, or a line `stop`, ends it after a checkpoint.

use std::path::PathBuf;

use nets::compute::Compute;
use serde::{Deserialize, Serialize};

use crate::ids::{CalibrationId, DatasetId};
use crate::store::Label;

/// Name of the order.
pub const ORDER: &str = "order.json";
/// Name of the file with a training's losses.
pub const LOSSES: &str = "losses.ndjson";
/// Name of the file with a training's last checkpoint.
pub const CHECKPOINT: &str = "checkpoint.bin";
/// Names of the result's files. The manifest is written last: a folder without one has no result.
pub const ONNX: &str = "model.onnx";
/// Manifest of the result.
pub const MANIFEST: &str = "manifest.toml";
/// Residuals of the result; only of a Transfer-Net.
pub const RESIDUALS: &str = "residuals.json";
/// Line on standard input that requests the end.
pub const STOP_LINE: &str = "stop";
/// Version of orders: service and trainer must be of the same one.
pub const ORDER_VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), ", order 1");

/// What a trainer is asked for: all names are resolved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Order {
    /// [`ORDER_VERSION`] of the service.
    pub version: String,
    /// Text of the recipe, TOML.
    pub recipe: String,
    /// Program and commit, as the manifest states them.
    pub code: String,
    /// Text of the sensor file.
    pub sensor: String,
    /// Standard deviation of each channel, V, that the recipe's noise level multiplies.
    pub noise_sd_v: Option<Vec<f32>>,
    /// Device; `None`: the one that the trainer was built for.
    pub compute: Option<Compute>,
    /// Source of the samples.
    pub source: Source,
}

/// Source of a training's samples, and what the model inherits from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub enum Source {
    /// The rows of a dataset.
    Dataset {
        /// Id of the dataset.
        id: DatasetId,
        /// Parquet file of its rows.
        file: PathBuf,
        /// Number of its rows.
        rows: u64,
        /// Folder for the frames while the net trains.
        scratch: PathBuf,
        /// Label of the model.
        label: Label,
        /// Calibration of the dataset's twins.
        calibration: Option<CalibrationId>,
        /// Hash of the model that simulated them.
        simulation: Option<String>,
    },
    /// Simulations that are made during the training.
    Stream {
        /// File of the skin's calibration; `None`: the nominal skin.
        calibration: Option<PathBuf>,
        /// Folder of cached unit responses.
        cache: PathBuf,
    },
}

/// Why an order is rejected.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum OrderError {
    #[error("{ORDER}: {0}")]
    Json(#[from] serde_json::Error),
    #[error(
        "{ORDER}: version = {found}: this trainer is of version {ORDER_VERSION}; install service and \
         trainer of the same version"
    )]
    Version { found: String },
}

impl Order {
    /// Reads an order of this version.
    ///
    /// # Errors
    /// `OrderError::Version` if it is of another version; `Json` if it is not an order.
    pub fn read(text: &str) -> Result<Self, OrderError> {
        // The version first: an order of another version may have other fields.
        let value: serde_json::Value = serde_json::from_str(text)?;
        let found = value["version"].as_str().unwrap_or("unknown");
        if found != ORDER_VERSION {
            return Err(OrderError::Version { found: found.into() });
        }
        Ok(serde_json::from_value(value)?)
    }
}

/// A line of a trainer's standard output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// A phase begins.
    Phase {
        /// Name of the phase.
        phase: String,
        /// Number of samples of this phase; 0 while it is unknown.
        total: u64,
    },
    /// Progress of the learning.
    Learned {
        /// Number of samples learned, including before checkpoints.
        done: u64,
        /// Number of samples of all epochs.
        total: u64,
        /// Number of samples learned since this start.
        new: u64,
        /// Time in which they were learned, s.
        elapsed_s: f64,
        /// Current epoch, from 1.
        epoch: u64,
        /// Mean loss of the epoch's learned batches; absent if it is not finite.
        train_loss: Option<f64>,
        /// Loss of the last validation.
        validation_loss: Option<f64>,
    },
    /// A checkpoint is stored.
    Checkpoint,
    /// Something that does not end the training.
    Warning {
        /// Text of the warning.
        message: String,
    },
    /// The end: the result is in the folder.
    Done,
    /// The end: stopped as requested.
    Stopped,
    /// The end: without a result.
    Failed {
        /// Cause of the failure, as text.
        error: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order() -> Order {
        Order {
            version: ORDER_VERSION.into(),
            recipe: "name = \"a\"\n".into(),
            code: "palpate".into(),
            sensor: "name = \"s\"\n".into(),
            noise_sd_v: Some(vec![0.1, 1.0 / 3.0]),
            compute: Some(Compute::Cpu { threads: 1 }),
            source: Source::Stream { calibration: None, cache: "cache".into() },
        }
    }

    #[test]
    fn an_order_survives_its_file() {
        let dataset = Source::Dataset {
            id: DatasetId::unchecked("ds-0123456789abcdef"),
            file: "data.parquet".into(),
            rows: 3,
            scratch: "cache".into(),
            label: Label::Virtual,
            calibration: Some(CalibrationId::unchecked("cal-1")),
            simulation: None,
        };
        for order in [order(), Order { source: dataset, ..order() }] {
            let text = serde_json::to_string(&order).unwrap();
            assert_eq!(Order::read(&text).unwrap(), order);
        }
    }

    #[test]
    fn an_order_of_another_version_is_refused_by_its_version() {
        for text in [r#"{"version": "9.9.9, order 7", "other": 1}"#, "{}"] {
            let error = Order::read(text).unwrap_err();
            assert!(matches!(error, OrderError::Version { .. }), "{error}");
        }
        let unknown = format!(r#"{{"version": "{ORDER_VERSION}", "other": 1}}"#);
        assert!(matches!(Order::read(&unknown), Err(OrderError::Json(_))));
        assert!(matches!(Order::read("{"), Err(OrderError::Json(_))));
    }

    #[test]
    fn a_loss_that_is_not_finite_is_absent() {
        let event = Event::Learned {
            done: 1,
            total: 2,
            new: 1,
            elapsed_s: 0.5,
            epoch: 1,
            train_loss: Some(f64::INFINITY),
            validation_loss: None,
        };
        let line = serde_json::to_string(&event).unwrap();
        let Event::Learned { train_loss, .. } = serde_json::from_str(&line).unwrap() else {
            panic!("{line}")
        };
        assert_eq!(train_loss, None);
    }
}
