//! Progress of a running job, and requests to stop it.
//! Uses: std, serde. Never: its own clock (times are passed in).

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

/// Progress of a job.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Progress {
    /// Current phase, in one or two words.
    pub phase: String,
    /// Number of samples (or trials) processed in this phase.
    pub done: u64,
    /// Number of samples of this phase; 0 while it is unknown.
    pub total: u64,
    /// Samples per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub per_second: Option<f64>,
    /// Remaining time of this phase at that rate, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_s: Option<f64>,
    /// Current epoch, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epoch: Option<u64>,
    /// Mean loss of the last training epoch, or since the last report.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub train_loss: Option<f64>,
    /// Loss of the last validation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub validation_loss: Option<f64>,
    /// Warnings of the job, oldest first, of all phases.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// Returns the warnings in the result of a job, oldest first.
pub fn warnings_of(result: &Value) -> Vec<String> {
    Vec::deserialize(&result["warnings"]).unwrap_or_default()
}

/// Shared state of a running job.
#[derive(Debug, Default)]
pub struct Watch {
    stop: AtomicBool,
    progress: Mutex<Progress>,
    warnings: Mutex<Vec<String>>,
}

impl Watch {
    /// Requests that the job stops.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether a stop was requested.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Returns the newest progress of the job.
    pub fn progress(&self) -> Progress {
        let progress = self.progress.lock().clone();
        Progress { warnings: self.warnings(), ..progress }
    }

    /// Adds a warning, once.
    pub fn warn(&self, message: String) {
        let mut warnings = self.warnings.lock();
        if !warnings.contains(&message) {
            warnings.push(message);
        }
    }

    /// Returns the warnings of the job, oldest first.
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.lock().clone()
    }

    /// Begins a phase.
    pub fn phase(&self, phase: &str, total: u64) {
        self.change(|p| *p = Progress { phase: phase.into(), total, ..Progress::default() });
    }

    /// Changes the progress.
    pub fn change(&self, change: impl FnOnce(&mut Progress)) {
        change(&mut self.progress.lock());
    }

    /// Sets the number of processed samples; `new` of them since the phase began `elapsed` ago.
    pub fn done(&self, done: u64, new: u64, elapsed: Duration) {
        self.change(|p| {
            p.done = done;
            let rate = new as f64 / elapsed.as_secs_f64();
            p.per_second = (new > 0 && rate.is_finite()).then_some(rate);
            let left = p.total.saturating_sub(done) as f64;
            p.left_s = p.per_second.filter(|_| p.total > 0).map(|rate| left / rate);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_stay_in_later_phases_and_are_not_repeated() {
        let watch = Watch::default();
        watch.phase("gathering frames", 0);
        for message in ["a channel is constant", "the map is large", "a channel is constant"] {
            watch.warn(message.into());
        }
        watch.phase("training", 0);
        let warnings = watch.progress().warnings;
        assert_eq!(warnings, ["a channel is constant", "the map is large"]);
        assert_eq!(warnings_of(&serde_json::json!({ "warnings": warnings })), warnings);
        assert!(warnings_of(&serde_json::json!({ "model": "mdl-1" })).is_empty());
    }

    #[test]
    fn what_is_left_follows_from_what_this_run_did() {
        let watch = Watch::default();
        watch.phase("training", 1000);
        // 600 were done before a restart.
        watch.done(700, 100, Duration::from_secs(2));
        let progress = watch.progress();
        assert_eq!((progress.per_second, progress.left_s), (Some(50.0), Some(6.0)));
        watch.phase("counting", 0);
        watch.done(5, 5, Duration::from_secs(1));
        assert_eq!(watch.progress().left_s, None);
        assert!(!watch.is_stopped());
        watch.stop();
        assert!(watch.is_stopped());
    }
}
