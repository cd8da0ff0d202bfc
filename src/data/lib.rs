//! Trials become datasets.
//! Uses: `words`, `store`, `model`. Never: motion, HTTP.

use palpate_model::simulate;
use palpate_store as store;
use palpate_words::{clock, commit, ids, problem, record, syntax};

pub mod dataset;
