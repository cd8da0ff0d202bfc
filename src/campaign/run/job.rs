//! A run as it is handed to the engine: everything decided, nothing left to look up.
//! PURE. Uses: `schedule`, `ids`. Never: files, storage.

use crate::ids::RunUid;
use crate::schedule::plan::Plan;

/// An armed run.
#[derive(Debug, Clone)]
pub struct Job {
    /// Its id.
    pub run: RunUid,
    /// Its number for people.
    pub scan_id: i64,
    /// Everything decided.
    pub plan: Plan,
    /// Predicted process time of one trial, s.
    pub predicted_trial_s: f64,
    /// Its arming allows it to go on by itself after a restart or a passing fault.
    pub auto_resume: bool,
    /// Bytes that the rest of the run needs on disk, for one trial.
    pub bytes_per_trial: u64,
}
