//! A progress bar for counted work, and log lines without a terminal.
//! Uses: indicatif. Never: standard output.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::output::note;

/// A bar on standard error, in units of this name; hidden if that is not a terminal.
pub fn progress_bar(unit: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let shape = format!(
        "{{bar:30}} {{human_pos}} / {{human_len}} {unit}, {{per_sec}}, {{eta}} to go {{msg}}"
    );
    let style =
        ProgressStyle::with_template(&shape).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(0).with_style(style)
}

/// Shortest interval between two lines of a log.
const LINES_APART: Duration = Duration::from_secs(30);

/// Prints the progress of long work on standard error at intervals, if no bar is visible.
pub struct LogLines(Option<Instant>);

impl LogLines {
    /// Log lines for the work of this bar.
    pub fn instead_of(bar: &ProgressBar) -> Self {
        Self(bar.is_hidden().then(Instant::now))
    }

    /// Prints a line, if the last one is old enough.
    pub fn say(&mut self, words: impl FnOnce() -> String) {
        if let Some(last) = &mut self.0
            && last.elapsed() >= LINES_APART
        {
            *last = Instant::now();
            note(words());
        }
    }
}
