//! From frames to contacts: training, inference and evaluation of nets.
//! Uses: `words`, `store`, `model`, `data`. Never: motion, HTTP.

use palpate_data::dataset;
use palpate_model::{calibrate, figure, simulate};
use palpate_store as store;
use palpate_words::{
    chance, clock, commit, digest, ids, journal, new_file, problem, program, record, state, syntax,
};

pub mod learn;
pub mod infer;
pub mod evaluate;
pub mod jobs;
