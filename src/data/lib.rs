//! Datasets: stored trials as labelled, split and exported tables.
//! Uses: `words`, `store`, `model`. Never: motion, HTTP.

use palpate_model::simulate;
use palpate_store as store;
use palpate_words::{clock, commit, ids, journal, problem, record, state, syntax};

pub mod dataset;
