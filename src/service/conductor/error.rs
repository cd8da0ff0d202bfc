//! Why a request to the conductor was refused or failed.
//! Uses: `problem`, `campaign` (its refusals), `journal`, `store`. Never: HTTP.

use crate::campaign::shown::command::Refusal;
use crate::journal::JournalError;
use crate::problem::{Problem, listed};
use crate::store::StoreError;

/// Result of a request to the conductor.
pub type ConductorResult<T> = Result<T, ConductorError>;

/// Why a request was refused or failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ConductorError {
    /// The files cannot be used on this rig.
    #[error("{}", listed(problems))]
    Problems { problems: Vec<Problem> },
    #[error("there is no run {0}")]
    NoRun(String),
    #[error(
        "run {run} was queued by version {version}, and this version plans it differently: \
         {difference}. The trials of one run come from one plan: abort it (palpate abort {run}), and \
         queue its files again (palpate run --new)"
    )]
    PlanDiffers { run: i64, version: String, difference: String },
    /// The state of the run or the store forbids it.
    #[error("{0}")]
    Forbidden(String),
    /// The campaign refused the request.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The end of a run could not be stored.
    #[error(transparent)]
    NotEnded(#[from] JournalError),
}
