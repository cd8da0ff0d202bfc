//! Replacement of trainings in a lean build.
//! Uses: nothing. Never: a training.

use std::sync::Arc;

use serde_json::Value;

use super::error::JobError;
use super::{Jobs, Watch};
use crate::store::TaskRow;

/// Rejects every recipe.
///
/// # Errors
/// `JobError::Lean`, always.
pub fn check(_recipe: &str) -> Result<(), JobError> {
    Err(JobError::Lean)
}

/// Rejects a training that another build has queued.
///
/// # Errors
/// `JobError::Lean`, always.
pub async fn run(
    _jobs: &Jobs,
    _job: &TaskRow,
    _watch: &Arc<Watch>,
) -> Result<Option<Value>, JobError> {
    Err(JobError::Lean)
}
