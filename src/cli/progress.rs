//! A progress bar for counted work, and log lines without a terminal.
//! Uses: indicatif. Never: standard output.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::output::{Output, note};

/// Interval of progress lines without a terminal.
pub const PROGRESS_LINES: Duration = Duration::from_secs(10);

/// A bar on standard error, in units of this name; hidden if that is not a terminal.
pub fn progress_bar(unit: &str) -> ProgressBar {
    bar(&format!(
        "{{bar:30}} {{human_pos}} / {{human_len}} {unit}, {{per_sec}}, {{eta}} to go {{msg}}"
    ))
}

/// A bar of this template on standard error; hidden if that is not a terminal.
pub fn bar(template: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template(template);
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// A sign of life on standard error while something works, with the time since it began; hidden for JSON, or if
/// that is not a terminal.
pub fn spinner(output: Output, words: &str) -> ProgressBar {
    if output == Output::Json {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
    let style = style.unwrap_or_else(|_| ProgressStyle::default_spinner());
    let spinner = ProgressBar::new_spinner().with_style(style).with_message(words.to_owned());
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}

/// Time after which a wait is shown.
const UNSHOWN_WAIT: Duration = Duration::from_millis(1500);

/// Waits for `work`; what takes longer than a moment is named on standard error, on a terminal with the time
/// since it began.
pub async fn shown_wait<T>(words: &str, work: impl Future<Output = T>) -> T {
    let mut work = std::pin::pin!(work);
    tokio::select! {
        done = &mut work => return done,
        () = tokio::time::sleep(UNSHOWN_WAIT) => {}
    }
    let shown = Working::on(words);
    let done = work.await;
    drop(shown);
    done
}

/// A sign of life while something works; it disappears when it is dropped.
pub struct Working(ProgressBar);

impl Working {
    /// Names the work: a line without a terminal.
    pub fn on(words: &str) -> Self {
        if !std::io::stderr().is_terminal() {
            note(format_args!("{words} .."));
            return Self(ProgressBar::hidden());
        }
        Self::at_terminal(words)
    }

    /// Names the work on a terminal, and nowhere else.
    pub fn at_terminal(words: &str) -> Self {
        Self(spinner(Output::Text, words))
    }
}

impl Drop for Working {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

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
            && last.elapsed() >= PROGRESS_LINES
        {
            *last = Instant::now();
            note(words());
        }
    }
}
