//! A run as it is passed to the engine, with everything decided.
//! PURE. Uses: `schedule`, `ids`. Never: files, storage.

use crate::ids::RunUid;
use crate::schedule::plan::Plan;

/// A run that is ready to be armed.
#[derive(Debug, Clone)]
pub struct Job {
    /// Id of the run.
    pub run: RunUid,
    /// Number of the run, for people.
    pub scan_id: i64,
    /// All steps of the run.
    pub plan: Plan,
    /// Predicted process time of one trial, s.
    pub predicted_trial_s: f64,
    /// Whether the run may resume without a person after a restart or a transient fault.
    pub auto_resume: bool,
    /// Whether the run begins by itself, after it has waited for its turn.
    pub has_waited: bool,
    /// Disk space that one further trial needs, bytes.
    pub bytes_per_trial: u64,
}
