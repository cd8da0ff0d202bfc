//! Why a job is rejected, or failed.
//! Uses: the errors of the modules that jobs call. Never: HTTP, logging.

use super::trainer::TrainerError;
use crate::dataset::error::DatasetError;
use crate::infer::error::InferError;
use crate::learn::error::LearnError;
use crate::problem::{Problem, listed};
use crate::store::StoreError;

/// Result of work on jobs.
pub type JobResult<T> = Result<T, JobError>;

/// Why a job is rejected, or failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum JobError {
    #[error("{}", listed(.0))]
    Problems(Vec<Problem>),
    #[error("the queue is full with {0} jobs: stop some, or request again when some have ended")]
    Full(u32),
    #[error(
        "started {0} times, and the service ended each time before any progress: the job has failed"
    )]
    InVain(u32),
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(transparent)]
    Learn(#[from] LearnError),
    #[error(transparent)]
    Trainer(#[from] TrainerError),
    #[error(transparent)]
    Infer(#[from] InferError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("reading or writing a job: {0}")]
    Json(serde_json::Error),
    #[error("a worker thread ended before its result")]
    Worker,
}

impl From<Vec<Problem>> for JobError {
    fn from(problems: Vec<Problem>) -> Self {
        Self::Problems(problems)
    }
}
