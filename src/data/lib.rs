//! Datasets: stored trials as labelled, split and exported tables; questions in SQL.
//! Uses: `words`, `store`, `model`. Never: motion, HTTP.
//!
//! ```text
//! store: trials, twins --+                 +--> read, select --> rows of a training or an answer
//! definition file -------+--> dataset -----+--> format -------> Parquet, Arrow, CSV, NPZ, ..: an export
//! foreign file ----------+    (Parquet) ---+
//! SELECT statement -----------> query -----+--> engine, a process --> batches of rows
//! ```
//! - `dataset` selects, labels and splits trials as a definition states, and writes them to a file. The id is
//!   a hash of the content: a dataset never changes under its name. It also imports foreign files, renders
//!   force maps, exports, joins the datasets of several rigs, and removes old datasets.
//! - `query` answers a statement over stored trials and datasets with the process `palpate-query`, within
//!   bounds of time, memory and rows.
//!
//! `service::api` builds, exports and queries on request; `touch` and the trainer's process read the files
//! of datasets. Measured values come from `store` with their checksums; a number that was not measured stays
//! absent in each format.

use palpate_model::simulate;
use palpate_store as store;
use palpate_words::{
    carried, clock, commit, digest, file_kind, ids, journal, near, new_file, plain, priority,
    problem, program, query_lines, record, state, syntax,
};

pub mod dataset;
pub mod query;
