//! The spans of the log: run, configuration, trial. One set of names for every part that logs.
//! Uses: tracing. Never: a span per frame or per poll; a field that needs much formatting.
//!
//! Spans have the level `error`, so that a warning names its run at every level of the log.

use tracing::{Span, error_span};

use crate::ids::{RunUid, TrialKey};

/// Span of work for a run.
pub fn run_span(run: RunUid, scan_id: i64) -> Span {
    error_span!("run", %run, scan_id)
}

/// Span of a configuration: its index in the plan, and its number of tips.
pub fn configuration_span(index: u32, tips: u8) -> Span {
    error_span!("configuration", index, tips)
}

/// Span of a trial.
pub fn trial_span(key: TrialKey) -> Span {
    error_span!("trial", configuration = key.configuration, depth_index = key.depth_index)
}
