//! What is shown of a run that is followed: a progress bar and notable events for people, a line per event for
//! scripts.
//! Uses: indicatif. Never: a request.

use std::io::IsTerminal;

use indicatif::ProgressBar;
use serde_json::json;
use tokio::time::Instant;

use crate::campaign::shown::status::Eta;
use crate::cli::output::{counted, duration, note, say_json, shown};
use crate::cli::progress::{PROGRESS_LINES, bar};
use crate::cli::view::{RunView, StatusView};
use crate::state::StoredState;

/// Output: standard error for people, standard output for scripts.
pub(super) struct Screen {
    bar: ProgressBar,
    terminal: bool,
    json: bool,
    /// Time of the last progress line, and what the run waited for then.
    told: Option<(Instant, Option<String>)>,
    stored: Option<u64>,
}

impl Screen {
    pub(super) fn new(json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = bar("{bar:24} {pos}/{len} {wide_msg}");
        Self { bar, terminal, json, told: None, stored: None }
    }

    pub(super) fn progress(&mut self, run: &RunView, status: &StatusView) {
        self.bar.set_length(run.trials_planned);
        self.bar.set_position(run.trials_stored + run.trials_skipped);
        let words = shown(progress_words(run, status));
        if !self.terminal && self.is_due(run) {
            self.told = Some((Instant::now(), run.waiting_for.clone()));
            note(format_args!("{}/{} {words}", run.trials_stored, run.trials_planned));
        }
        self.bar.set_message(words);
        if self.json && self.stored != Some(run.trials_stored) {
            self.stored = Some(run.trials_stored);
            say_json(&progress_line(run, status));
        }
    }

    /// Whether a progress line is due; the same wait is not repeated.
    fn is_due(&self, run: &RunView) -> bool {
        self.told.as_ref().is_none_or(|(at, waited_for)| {
            let same_wait = run.waiting_for.is_some() && *waited_for == run.waiting_for;
            at.elapsed() >= PROGRESS_LINES && !same_wait
        })
    }

    pub(super) fn waits_in_queue(&mut self, position: Option<u32>) {
        let place = position.map_or_else(String::new, |p| format!(", position {p}"));
        self.bar.set_message(format!("waits in the queue{place}"));
    }

    pub(super) fn note(&self, words: &str) {
        self.bar.suspend(|| note(words));
    }
}

fn progress_line(run: &RunView, status: &StatusView) -> serde_json::Value {
    json!({
        "event": "progress",
        "run": run.uid,
        "trials_planned": run.trials_planned,
        "trials_stored": run.trials_stored,
        "trials_skipped": run.trials_skipped,
        "retries": run.retries,
        "phase": run.phase,
        "max_force_n": status.rig.max_force_n(),
        "eta": run.eta,
    })
}

fn progress_words(run: &RunView, status: &StatusView) -> String {
    let mut parts = vec![match (&run.waiting_for, run.state) {
        (Some(words), _) => format!("waits: {words}"),
        (None, StoredState::Running) => run.phase.as_str().replace('_', "-"),
        (None, state) => state.as_str().into(),
    }];
    if let Some(asked) = &run.requested_state {
        parts.push(format!("-> {asked}"));
    }
    parts.extend(run.eta.map(|eta| eta_words(&eta)));
    if run.trials_skipped > 0 {
        parts.push(format!("{} skipped", run.trials_skipped));
    }
    if run.retries > 0 {
        parts.push(counted(run.retries, "retry", "retries"));
    }
    if let Some(force_n) = status.rig.max_force_n() {
        parts.push(force_words(force_n));
    }
    parts.join(" | ")
}

fn eta_words(eta: &Eta) -> String {
    let (low, high) = (duration(eta.low_s), duration(eta.high_s));
    format!("done in {} ({low} .. {high})", duration(eta.remaining_s))
}

/// Largest force, N. Zero has no sign.
fn force_words(force_n: f64) -> String {
    format!("max {:.1} N", (force_n * 10.0).round() / 10.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_force_of_zero_has_no_sign() {
        let shown = [-0.04, 0.04, -0.06, 21.14].map(force_words);
        assert_eq!(shown, ["max 0.0 N", "max 0.0 N", "max -0.1 N", "max 21.1 N"]);
    }

    #[test]
    fn an_estimate_shows_its_band() {
        let eta = Eta { remaining_s: 130.0, low_s: 110.0, high_s: 160.0 };
        let shown = "done in 2 min 10 s (1 min 50 s .. 2 min 40 s)";
        assert_eq!(eta_words(&eta), shown);
    }
}
