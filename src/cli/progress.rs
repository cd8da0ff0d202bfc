//! A progress bar for work that is counted, and lines for a log where nobody watches.
//! Uses: indicatif. Never: standard output.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on standard error, in units of this name; hidden where that is no terminal.
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

/// Shortest time between two lines of a log.
const LINES_APART: Duration = Duration::from_secs(30);

/// Says now and then, on standard error, how far long work is, where no bar is seen.
pub struct LogLines(Option<Instant>);

impl LogLines {
    /// For work that shows this bar.
    pub fn instead_of(bar: &ProgressBar) -> Self {
        Self(bar.is_hidden().then(Instant::now))
    }

    /// Says it, if the last line is old enough.
    pub fn say(&mut self, words: impl FnOnce() -> String) {
        if let Some(last) = &mut self.0
            && last.elapsed() >= LINES_APART
        {
            *last = Instant::now();
            eprintln!("{}", words());
        }
    }
}
