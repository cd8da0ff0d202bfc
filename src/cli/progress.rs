//! A progress bar for work that is counted.
//! Uses: indicatif. Never: an output where nobody watches.

use std::io::IsTerminal;

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
