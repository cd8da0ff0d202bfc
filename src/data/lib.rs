//! Datasets: stored trials as labelled, split and exported tables.
//! Uses: `words`, `store`, `model`. Never: motion, HTTP.

use palpate_model::simulate;
use palpate_store as store;
use palpate_words::{
    carried, clock, commit, digest, ids, journal, new_file, problem, record, state, syntax,
};

pub mod dataset;
