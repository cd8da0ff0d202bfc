//! From a dataset and a recipe to a model: a net as an ONNX file, with its manifest.
//! Uses: dataset, store (a label), and `nets` if training is built in. Never: HTTP, answers.
//!
//! ```text
//! recipe, dataset -> examples (frames in a flat file) -> samples -> train -> onnx, model_file
//! ```

pub mod error;
pub mod task;
pub mod model_file;
pub mod onnx;
pub mod examples;
pub mod residuals;
#[cfg(feature = "train")]
pub mod recipe;
#[cfg(feature = "train")]
pub mod samples;
#[cfg(feature = "train")]
pub mod train;
