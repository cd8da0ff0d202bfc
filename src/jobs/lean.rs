//! What stands in for trainings in a build that leaves them out.
//! Uses: nothing. Never: a training.

use std::sync::Arc;

use serde_json::Value;

use super::error::JobError;
use super::{Jobs, Watch};
use crate::store::JobRow;

/// Refuses every recipe.
pub fn check(_recipe: &str) -> Result<(), JobError> {
    Err(JobError::Lean)
}

/// Refuses a training that another build left behind.
pub async fn run(
    _jobs: &Jobs,
    _job: &JobRow,
    _watch: &Arc<Watch>,
) -> Result<Option<Value>, JobError> {
    Err(JobError::Lean)
}
