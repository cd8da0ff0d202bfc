//! From experiment files to plans, and from plans to measured trials on one bench.
//! Uses: `words`. Never: SQL, HTTP.

#[cfg(test)]
use palpate_words::carried;
use palpate_words::{chance, clock, ids, journal, plain, problem, record, state, syntax};

pub mod schedule;
pub mod rig;
pub mod campaign;
