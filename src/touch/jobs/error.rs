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
pub enum JobError {
    /// Values of the request are invalid.
    #[error("{}", listed(.0))]
    Problems(Vec<Problem>),
    /// The queue is full.
    #[error("the queue is full with {0} jobs: stop some, or request again when some have ended")]
    Full(u32),
    /// The service ended during every start of the job.
    #[error(
        "started {0} times, and the service ended each time before any progress: the job has failed"
    )]
    InVain(u32),
    /// The dataset is not available.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Data or result of a training are invalid.
    #[error(transparent)]
    Learn(#[from] LearnError),
    /// The trainer failed.
    #[error(transparent)]
    Trainer(#[from] TrainerError),
    /// A model is not available or failed.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A request or a result is not JSON of the right shape.
    #[error("reading or writing a job: {0}")]
    Json(serde_json::Error),
    /// A thread ended before its result.
    #[error("a worker thread ended before its result")]
    Worker,
}

impl From<Vec<Problem>> for JobError {
    fn from(problems: Vec<Problem>) -> Self {
        Self::Problems(problems)
    }
}
