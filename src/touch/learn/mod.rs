//! From a dataset and a recipe to a model: a net as an ONNX file, with its manifest.
//! Uses: dataset, store (a label), `nets`. Never: HTTP, answers, the training itself (`trainer/`).
//!
//! ```text
//! recipe, dataset -> order -> trainer: examples (frames in a flat file) -> train -> onnx, model_file
//! ```

pub mod error;
pub mod task;
pub mod model_file;
pub mod onnx;
pub mod examples;
pub mod targets;
pub mod residuals;
pub mod recipe;
pub mod order;
