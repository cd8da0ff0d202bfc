//! What is shown of a run that is followed: a progress bar and notable events for people, a line per event for
//! scripts.
//! Uses: indicatif. Never: a request.

use indicatif::ProgressBar;
use serde_json::json;
use tokio::time::Instant;

use crate::campaign::shown::status::{Eta, RunStatus};
use crate::cli::output::{columns, counted, duration, error_width, grouped, note, say_json, shown};
use crate::cli::progress::{PROGRESS_LINES, bar};
use crate::cli::view::StatusView;
use crate::state::StoredState;

/// Width of the bar, characters.
const BAR_COLUMNS: usize = 24;
/// Text between two parts of the progress.
const BETWEEN: &str = " | ";

/// Output: standard error for people, standard output for scripts.
pub(super) struct Screen {
    /// Hidden without a terminal.
    bar: ProgressBar,
    json: bool,
    /// Address of the service, for the commands that are named.
    url: String,
    /// Time of the last progress line, and the words for what the run waited for then.
    told: Option<(Instant, Option<String>)>,
    stored: Option<u64>,
}

impl Screen {
    pub(super) fn new(json: bool, url: &str) -> Self {
        let bar = bar(&format!("{{bar:{BAR_COLUMNS}}} {{human_pos}}/{{human_len}} {{wide_msg}}"));
        Self { bar, json, url: url.to_owned(), told: None, stored: None }
    }

    pub(super) fn progress(&mut self, run: &RunStatus, status: &StatusView) {
        self.bar.set_length(run.trials_planned);
        self.bar.set_position(run.trials_stored + run.trials_skipped);
        let wait = wait_words(run, &self.url);
        let done = grouped(run.trials_stored + run.trials_skipped);
        let counts = format!("{done}/{}", grouped(run.trials_planned));
        let room = error_width().map(|width| width.saturating_sub(BAR_COLUMNS + counts.len() + 2));
        let parts = |band| progress_parts(run, status, wait.as_deref(), band);
        let words = shown(fitting(room, parts(true).join(BETWEEN), || parts(false)));
        if self.bar.is_hidden() && self.is_due(wait.as_deref()) {
            self.told = Some((Instant::now(), wait));
            note(format_args!("{counts} {words}"));
        }
        self.bar.set_message(words);
        if self.json && self.stored != Some(run.trials_stored) {
            self.stored = Some(run.trials_stored);
            say_json(&progress_line(run, status));
        }
    }

    /// Whether a progress line is due; the same wait is not repeated.
    fn is_due(&self, wait: Option<&str>) -> bool {
        self.told.as_ref().is_none_or(|(at, waited_for)| {
            let same_wait = wait.is_some() && waited_for.as_deref() == wait;
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

fn progress_line(run: &RunStatus, status: &StatusView) -> serde_json::Value {
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

/// What the run waits for, or the command that continues a run which a person paused; `None` if it waits for nothing.
fn wait_words(run: &RunStatus, url: &str) -> Option<String> {
    match (&run.waiting_for, run.state) {
        (Some(words), _) => Some(format!("waits: {words}")),
        (None, StoredState::Paused) => {
            Some(format!("paused: palpate resume {} --url {url}", run.scan_id))
        }
        (None, _) => None,
    }
}

/// The words, or those of the short `parts` that a terminal has room for, the first ones: a cut number could be read as
/// another one.
fn fitting(room: Option<usize>, words: String, parts: impl FnOnce() -> Vec<String>) -> String {
    let has_room = |words: &str| room.is_none_or(|room| columns(words) <= room);
    if has_room(&words) {
        return words;
    }
    let mut parts = parts();
    while parts.len() > 1 && !has_room(&parts.join(BETWEEN)) {
        parts.pop();
    }
    parts.join(BETWEEN)
}

/// Progress as text, the most important part first; `wait`: the words for what the run waits for; `band`: whether the
/// estimate has its band.
fn progress_parts(
    run: &RunStatus,
    status: &StatusView,
    wait: Option<&str>,
    band: bool,
) -> Vec<String> {
    let mut parts = vec![match (wait, run.state) {
        (Some(wait), _) => wait.to_owned(),
        (None, StoredState::Running) => run.phase.as_str().replace('_', "-"),
        (None, state) => state.as_str().into(),
    }];
    if let Some(asked) = &run.requested_state {
        parts.push(format!("-> {asked}"));
    }
    parts.extend(run.eta.map(|eta| eta_words(&eta, band)));
    if run.trials_skipped > 0 {
        parts.push(format!("{} skipped", grouped(run.trials_skipped)));
    }
    if run.retries > 0 {
        parts.push(counted(run.retries, "retry", "retries"));
    }
    if let Some(force_n) = status.rig.max_force_n() {
        parts.push(force_words(force_n));
    }
    parts
}

/// When the run ends. At its very end a time would remain zero while the last work takes longer.
fn eta_words(eta: &Eta, band: bool) -> String {
    if eta.remaining_s < 1.0 {
        return "nearly done".into();
    }
    let (low, high) = (duration(eta.low_s), duration(eta.high_s));
    let band = if band { format!(" ({low} .. {high})") } else { String::new() };
    format!("done in {}{band}", duration(eta.remaining_s))
}

/// Largest force, N. Zero has no sign.
fn force_words(force_n: f64) -> String {
    format!("max {:.1} N", (force_n * 10.0).round() / 10.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[test]
    fn a_run_that_a_person_paused_is_shown_once_with_the_command_that_continues_it() {
        let run = json!({
            "uid": "01a208ed-3612-760c-9dff-1d5fb515cdf8", "scan_id": 3, "experiment": "night",
            "is_manual": false, "state": "paused", "phase": "next", "trials_planned": 40,
            "trials_stored": 12, "trials_skipped": 0, "retries": 0, "needed_bytes": 0,
        });
        let mut run = RunStatus::deserialize(&run).unwrap();
        let url = "http://rig:8080";
        let paused = wait_words(&run, url);
        assert_eq!(paused.as_deref(), Some("paused: palpate resume 3 --url http://rig:8080"));
        let mut screen = Screen::new(false, url);
        assert!(screen.is_due(paused.as_deref()));
        let earlier = Instant::now().checked_sub(PROGRESS_LINES).unwrap();
        screen.told = Some((earlier, paused.clone()));
        assert!(!screen.is_due(paused.as_deref()), "the same wait is not repeated");
        run.waiting_for = Some("mount 1 tip".into());
        assert_eq!(wait_words(&run, url).as_deref(), Some("waits: mount 1 tip"));
        assert!(screen.is_due(wait_words(&run, url).as_deref()));
        (run.waiting_for, run.state) = (None, StoredState::Running);
        assert_eq!(wait_words(&run, url), None);
        assert!(screen.is_due(None));
    }

    #[test]
    fn a_force_of_zero_has_no_sign() {
        let shown = [-0.04, 0.04, -0.06, 21.14].map(force_words);
        assert_eq!(shown, ["max 0.0 N", "max 0.0 N", "max -0.1 N", "max 21.1 N"]);
    }

    #[test]
    fn an_estimate_shows_its_band_where_a_terminal_has_room_for_it() {
        let eta = Eta { remaining_s: 130.0, low_s: 110.0, high_s: 160.0 };
        let shown = "done in 2 min 10 s (1 min 50 s .. 2 min 40 s)";
        assert_eq!(eta_words(&eta, true), shown);
        let short = || vec![eta_words(&eta, false), force_words(21.14)];
        let words = |room| fitting(room, eta_words(&eta, true), short);
        assert_eq!(words(None), shown);
        assert_eq!(words(Some(shown.len())), shown);
        assert_eq!(words(Some(shown.len() - 1)), "done in 2 min 10 s | max 21.1 N");
        assert_eq!(words(Some(30)), "done in 2 min 10 s", "no part of the force");
        assert_eq!(words(Some(5)), "done in 2 min 10 s");
        assert_eq!(eta_words(&Eta { remaining_s: 0.0, low_s: 0.0, ..eta }, true), "nearly done");
    }
}
