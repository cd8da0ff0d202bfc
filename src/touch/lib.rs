//! From frames to contacts: training, inference and evaluation of nets.
//! Uses: `words`, `store`, `model`, `data`. Never: motion, HTTP.
//!
//! ```text
//! dataset, recipe --> learn --> order --> trainer (a process) --> model: ONNX file and manifest
//!                                                                   |
//! frame ---------------------------> infer, the promoted models  <--+
//!                                      |
//!                                      +--> contacts, force map --> evaluate --> scores, figures
//! ```
//! - `learn` makes samples of rows and an order of a recipe, and defines the file of a model.
//! - `infer` answers a frame with the serving models: contacts by the methods in `infer/methods`, and
//!   quantities of a whole frame.
//! - `evaluate` compares answers with true contacts and the model with measured frames; it returns numbers
//!   and figures, and starts nothing.
//! - `jobs` runs trainings and evaluations, one at a time, as tasks of the store that survive a restart; and
//!   trainings as chunks, which need no store.
//!
//! `service::api` requests jobs, promotes models and serves live answers; `service::placement` compares the
//! contacts of a frame with the requested weights; `studies` compute the paper's tables with `evaluate`. The
//! training itself is in `trainer`, which uses `learn` and files and never opens the store.

use palpate_data::dataset;
use palpate_model::{calibrate, chunk, figure, simulate};
use palpate_store as store;
use palpate_words::{
    chance, clock, commit, digest, ids, journal, new_file, plain, problem, program, record, state,
    syntax,
};

pub mod learn;
pub mod infer;
pub mod evaluate;
pub mod jobs;
