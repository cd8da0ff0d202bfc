//! Output lines for people and for scripts, and numbers with units. All text for people passes through
//! here: names and notes that other people entered must not control the terminal.
//! Uses: `plain`. Never: HTTP, decisions. A closed standard output is not an error.

use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

use serde::Serialize;

use crate::plain::escaped_lines;
pub use crate::plain::{bytes, counted, duration, grouped};

/// Form of what a command prints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Text for people, with progress on a terminal.
    Text,
    /// JSON for scripts; standard error may name long work.
    Json,
}

impl Output {
    /// Prints a value for scripts, or what it means for people.
    pub fn say(self, value: &impl Serialize, words: impl Display) {
        match self {
            Self::Json => say_json(value),
            Self::Text => say(words),
        }
    }
}

/// Prints one or several lines on standard output.
pub fn say(text: impl Display) {
    let _ = writeln!(io::stdout().lock(), "{}", shown(text));
}

/// Prints one or several lines on standard error.
pub fn note(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{}", shown(text));
}

/// Prints a text that is safe already, such as a drawn error with colours, on standard error.
pub fn note_drawn(text: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Prints a question on standard error; the answer is entered behind it.
pub fn ask(question: impl Display) {
    let mut out = io::stderr().lock();
    let _ = write!(out, "{}", shown(question)).and_then(|()| out.flush());
}

/// Prints what this program drew, with its colours, on standard output. Never foreign text: its control
/// characters reach the terminal.
pub fn say_drawn(picture: &str) {
    let _ = writeln!(io::stdout().lock(), "{picture}");
}

/// Width of the terminal behind standard output, characters; `None` if it is not a terminal.
pub fn terminal_width() -> Option<usize> {
    if !io::stdout().is_terminal() {
        return None;
    }
    let (columns, _) = ratatui::crossterm::terminal::size().ok()?;
    (columns > 0).then_some(columns.into())
}

/// Whether standard output shows colours: it is a terminal, and they are wanted.
pub fn is_coloured() -> bool {
    !no_color() && io::stdout().is_terminal()
}

/// Whether `NO_COLOR` is set, and not empty.
pub fn no_color() -> bool {
    std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty())
}

/// Returns a text as it may reach the terminal: control characters are escaped, except ends of lines and
/// tabs.
pub fn shown(text: impl Display) -> String {
    escaped_lines(&text.to_string()).into()
}

/// A bar of `share` of `width` characters, in eighths of a character.
pub fn filled(share: f64, width: usize) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let eighths = (share.clamp(0.0, 1.0) * width as f64 * 8.0).round() as usize;
    format!("{}{}", "█".repeat(eighths / 8), EIGHTHS[eighths % 8])
}

/// Prints one JSON object as a line on standard output.
pub fn say_json(value: &impl Serialize) {
    match serde_json::to_string(value) {
        Ok(line) => {
            let mut out = io::stdout().lock();
            let _ = writeln!(out, "{line}").and_then(|()| out.flush());
        }
        Err(error) => tracing::error!(%error, "an answer could not be written as JSON"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_cannot_control_the_terminal() {
        let name = "night\u{1b}[31m\u{0}";
        assert_eq!(shown(format_args!("run 3, {name}\n")), "run 3, night\\u{1b}[31m\\u{0}\n");
    }

    #[test]
    fn a_bar_has_its_share_of_the_width() {
        assert_eq!(filled(0.5, 4), "██");
        assert_eq!(filled(0.0, 4), "");
        assert_eq!(filled(7.0, 2), "██");
        assert_eq!(filled(1.0 / 8.0, 1), "▏");
    }
}
