//! Estimates of the end of a run: stored as events of the kind `estimate`, at the start of a run
//! and every ten minutes of it, so that a prediction can be compared with what happened.
//! Uses: `campaign` (its status), `store`. Never: a wait of the campaign.

use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tokio::time::MissedTickBehavior;

use super::Conductor;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::state::StoredState;

/// Kind of the events.
pub const ESTIMATE: &str = "estimate";
/// Time between two estimates of a run.
const ESTIMATE_PERIOD: Duration = Duration::from_secs(600);
/// Interval of reading the status.
const ESTIMATE_POLL: Duration = Duration::from_secs(1);

/// The last estimate that was stored.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Noted {
    run: RunUid,
    at: Timestamp,
}

impl Conductor {
    /// Stores the estimates of active runs until the future is dropped.
    pub async fn note_estimates(self) {
        let mut noted = None;
        let mut tick = tokio::time::interval(ESTIMATE_POLL);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tick.tick().await;
            let Some(run) = self.inner.campaign.status().run else { continue };
            let (Some(eta), now) = (run.eta, Timestamp::now()) else { continue };
            if !is_due(noted, run.uid, run.state, now) {
                continue;
            }
            let data = json!({ "remaining_s": eta.remaining_s, "low_s": eta.low_s,
                "high_s": eta.high_s, "trials_stored": run.trials_stored });
            match self.inner.store.append_event(Some(run.uid), ESTIMATE, data).await {
                Ok(_) => noted = Some(Noted { run: run.uid, at: now }),
                // Tried again at the next tick.
                Err(error) => {
                    tracing::warn!(error = error_chain(&error), "an estimate was not stored");
                }
            }
        }
    }
}

/// Whether an estimate is stored now: at once for a run that has just started or resumed after a restart,
/// then periodically while it runs.
fn is_due(noted: Option<Noted>, run: RunUid, state: StoredState, now: Timestamp) -> bool {
    match noted.filter(|noted| noted.run == run) {
        None => true,
        Some(noted) => {
            let since = now.duration_since(noted.at);
            state == StoredState::Running && since.as_secs_f64() >= ESTIMATE_PERIOD.as_secs_f64()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_is_due_at_the_start_of_a_run_and_every_ten_minutes_while_it_runs() {
        let (run, other) = (RunUid::new(), RunUid::new());
        let at = |s| Timestamp::from_second(s).unwrap();
        let noted = Some(Noted { run, at: at(0) });
        assert!(is_due(None, run, StoredState::Running, at(0)));
        assert!(!is_due(noted, run, StoredState::Running, at(599)));
        assert!(is_due(noted, run, StoredState::Running, at(600)));
        assert!(!is_due(noted, run, StoredState::Paused, at(6000)));
        assert!(is_due(noted, other, StoredState::Paused, at(1)));
    }
}
