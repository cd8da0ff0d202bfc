//! Datasets: stored trials as labelled, split and exported tables; questions in SQL.
//! Uses: `words`, `store`, `model`. Never: motion, HTTP.

use palpate_model::simulate;
use palpate_store as store;
use palpate_words::{
    carried, clock, commit, digest, ids, journal, near, new_file, problem, program, query_lines,
    record, state, syntax,
};

pub mod dataset;
pub mod query;
