//! Why a job cannot be taken up, or gave no result.
//! Uses: the errors of the stages that jobs call. Never: HTTP, logging.

use crate::dataset::error::DatasetError;
use crate::infer::error::InferError;
use crate::learn::error::LearnError;
use crate::problem::Problem;
use crate::store::StoreError;

/// Why a job cannot be taken up, or gave no result.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// What was asked for cannot be.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Problems(Vec<Problem>),
    /// Too many wait.
    #[error("{0} jobs wait already: stop some, or ask when some have ended")]
    Full(u32),
    /// This build does not train.
    #[error("this build leaves training out: build it with the feature `train`")]
    Lean,
    /// The service went down each time that it was at work.
    #[error(
        "{0} times begun, and the service went down each time before anything was kept: given up"
    )]
    InVain(u32),
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The training.
    #[error(transparent)]
    Learn(#[from] LearnError),
    /// The models.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A request or a result is not JSON of the right shape.
    #[error("reading or writing a job: {0}")]
    Json(serde_json::Error),
    /// A thread ended before its work.
    #[error("a worker ended before its work was done")]
    Worker,
}

impl From<Vec<Problem>> for JobError {
    fn from(problems: Vec<Problem>) -> Self {
        Self::Problems(problems)
    }
}
