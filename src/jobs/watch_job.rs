//! How far a job is, seen from outside while it runs; and the wish that it end.
//! Uses: std. Never: a clock of its own (times are handed in).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How far a job is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Progress {
    /// What it is doing, in a word or two.
    pub phase: String,
    /// Samples (or trials) that are done in this phase.
    pub done: u64,
    /// Of how many; 0 while that is not known.
    pub total: u64,
    /// Of them in a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub per_second: Option<f64>,
    /// Seconds that are left of this phase at that rate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_s: Option<f64>,
    /// Epoch that is under way, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epoch: Option<u64>,
    /// Mean loss of the last training epoch, or since the last report.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub train_loss: Option<f64>,
    /// Loss of the last validation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub validation_loss: Option<f64>,
}

/// A job that runs.
#[derive(Debug, Default)]
pub struct Watch {
    stop: AtomicBool,
    progress: Mutex<Progress>,
}

impl Watch {
    /// Wishes that it end.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether somebody wishes that it end.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// How far it is.
    pub fn progress(&self) -> Progress {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Begins a phase.
    pub fn phase(&self, phase: &str, total: u64) {
        self.change(|p| *p = Progress { phase: phase.into(), total, ..Progress::default() });
    }

    /// Changes what is known.
    pub fn change(&self, change: impl FnOnce(&mut Progress)) {
        change(&mut self.progress.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// So many are done, `new` of them since the phase began `elapsed` ago.
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
