//! The service: what runs next, the simulated twins of stored trials, the contacts estimated during
//! manual trials, and HTTP.
//! Uses: all chapters before it. Never: motion, except as a request to the campaign.

use palpate_bench::{campaign, rig, schedule};
use palpate_data::{dataset, query};
use palpate_model::{chunk, overlay, simulate};
use palpate_store as store;
use palpate_touch::{evaluate, infer, jobs, learn};
#[cfg(test)]
use palpate_words::query_lines;
use palpate_words::{
    carried, clock, commit, digest, event, ids, journal, new_file, plain, priority, problem,
    program, record, state, suspension, syntax,
};

pub mod conductor;
pub mod twins;
pub mod placement;
pub mod api;
