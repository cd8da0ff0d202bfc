//! Palpate: presses a tactile robot skin with a rig, trains models on the measured trials, and
//! estimates position and force of contacts. The chapters below are listed in the order in which data flows
//! through them; each is a crate, except `cli`, and uses only those before it.

// The macros of std that print panic on a closed pipe: `cli::output` does not.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub use palpate_words::{
    carried, chance, clock, commit, digest, event, file_kind, ids, journal, locate, near, new_file,
    plain, problem, program, record, state, syntax, toml_words,
};

pub use palpate_bench::{campaign, rig, schedule};
pub use palpate_data::{dataset, query};
pub use palpate_model::{calibrate, chunk, figure, overlay, simulate};
pub use palpate_service::{api, conductor, placement, twins};
pub use palpate_store as store;
pub use palpate_studies as studies;
pub use palpate_touch::{evaluate, infer, jobs, learn};

pub mod cli;
