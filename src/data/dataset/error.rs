//! What can go wrong with datasets: one enum, whose words name the field and the choices.
//! Uses: the errors of what datasets are made with. Never: HTTP, logging.

use std::io;
use std::path::{Path, PathBuf};

use arrow_schema::ArrowError;
use parquet::errors::ParquetError;

use super::format::FormatError;
use super::shards::ShardsError;
use crate::problem::Problem;
use crate::store::StoreError;

/// Why there is no dataset, no export or no import.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// What was asked for cannot be.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Problems(Vec<Problem>),
    /// There is no dataset of this id or name.
    #[error(
        "there is no dataset {name}; there are {choices} (and run-N for every run that has ended)"
    )]
    NoDataset {
        /// What was asked for.
        name: String,
        /// Names that can be asked for.
        choices: String,
    },
    /// A definition names a run that is not there.
    #[error("runs: no run has the uid, the scan id or the experiment {0}")]
    NoRun(String),
    /// A run that still gets trials.
    #[error("run {0} has not ended: page through its trials, or ask when it has")]
    NotEnded(i64),
    /// There is nothing to make a dataset of.
    #[error("dataset {name} has no rows: {why}")]
    Empty {
        /// Its name.
        name: String,
        /// Why.
        why: String,
    },
    /// Trials that touched a skin and trials that did not.
    #[error("label must be given, since measured and simulated never mix unasked: {0}")]
    Labels(String),
    /// Frames of different lengths.
    #[error("frames of different lengths make no dataset: {one}, {other}; name the runs")]
    Channels {
        /// One of them.
        one: String,
        /// Another.
        other: String,
    },
    /// Simulations of different models.
    #[error("sim_random = {folder}: simulated with {there}, the twins with {here}")]
    Models {
        /// The folder of shards.
        folder: String,
        /// Its model.
        there: String,
        /// The twins' model.
        here: String,
    },
    /// Trials were taken back while they were read.
    #[error("trials were taken back while they were read: ask again")]
    Changed,
    /// The disk is too full.
    #[error(
        "an export of about {needed} bytes: only {free} are free, {kept} of them kept for runs"
    )]
    DiskFull {
        /// Bytes of the export, about.
        needed: u64,
        /// Free bytes.
        free: u64,
        /// Free bytes that stay.
        kept: u64,
    },
    /// A dataset's file is gone or is another one.
    #[error("dataset {0}: its file is not what was stored; make it again")]
    Damaged(String),
    /// Shards cannot be read.
    #[error(transparent)]
    Shards(#[from] ShardsError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file.
    #[error("{doing} {path}: {source}", path = path.display())]
    File {
        /// What was being done.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A format.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Columns.
    #[error(transparent)]
    Arrow(#[from] ArrowError),
    /// A Parquet file.
    #[error(transparent)]
    Parquet(#[from] ParquetError),
    /// A value that JSON cannot hold.
    #[error("a value cannot be written as JSON: {0}")]
    Json(serde_json::Error),
    /// A thread ended early.
    #[error("a worker panicked")]
    Worker,
}

impl DatasetError {
    /// Says what was being done to which file.
    pub(super) fn file(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { doing, path: path.clone(), source }
    }

    pub(super) fn json(error: serde_json::Error) -> Self {
        Self::Json(error)
    }

    /// One value that cannot be used.
    pub(super) fn value(key: &str, value: impl std::fmt::Display, limit: &str) -> Self {
        Self::Problems(vec![Problem::new("request", key, value, limit)])
    }
}
