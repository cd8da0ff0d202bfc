//! What training leaves behind: a net as an ONNX file, and the manifest beside it.
//! Uses: dataset, store (a label), and `nets` where training is built in. Never: HTTP, answers.

pub mod model_file;
pub mod onnx;
