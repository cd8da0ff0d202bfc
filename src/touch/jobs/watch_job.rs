//! Progress of a running job, and requests to stop it.
//! Uses: std. Never: its own clock (times are passed in).

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
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
}

/// Shared state of a running job.
#[derive(Debug, Default)]
pub struct Watch {
    stop: AtomicBool,
    progress: Mutex<Progress>,
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
        self.progress.lock().clone()
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
