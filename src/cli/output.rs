//! Output lines for people and for scripts, and numbers with units. All text for people passes through
//! here: names and notes that other people entered must not control the terminal.
//! Uses: `plain`, `error`, `journal`, nix, ratatui (widths). Never: HTTP, decisions. A closed standard output is not an
//! error; another failure, such as a full disk, is kept until the end of the command: one that drives a rig continues.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

use nix::errno::Errno;
use parking_lot::Mutex;
use ratatui::text::Span;
use serde::Serialize;
use tracing::Level;

use super::error::{CliError, CliResult};
use super::journal::{is_behind_stderr, with_priority};
use crate::plain::escaped_lines;
pub use crate::plain::{bytes, counted, duration, grouped};

/// First error of standard output, except that of a closed pipe or terminal.
static UNWRITTEN: Mutex<Option<io::Error>> = Mutex::new(None);

/// Takes the outcome of a write on standard output; returns whether it succeeded. The command ends with its error, except
/// with that of a closed pipe or terminal: its reader has what it wanted, or the command is detached.
pub fn written(outcome: io::Result<()>) -> bool {
    let is_file = || std::fs::metadata("/proc/self/fd/1").is_ok_and(|found| found.is_file());
    kept(outcome, &UNWRITTEN, is_file)
}

fn kept(
    outcome: io::Result<()>,
    first: &Mutex<Option<io::Error>>,
    is_file: impl FnOnce() -> bool,
) -> bool {
    let Err(error) = outcome else { return true };
    let is_closed = match error.raw_os_error() {
        // A terminal that was closed answers so; but so does a disk that fails.
        Some(number) if number == Errno::EIO as i32 => !is_file(),
        _ => error.kind() == io::ErrorKind::BrokenPipe,
    };
    if !is_closed {
        first.lock().get_or_insert(error);
    }
    false
}

/// Checks, at the end of a command, that standard output has taken what was printed.
///
/// # Errors
/// `CliError::Unsaid` with the first error of a write, such as that of a full disk.
pub fn all_said() -> CliResult<()> {
    UNWRITTEN.lock().take().map_or(Ok(()), |error| Err(CliError::Unsaid(error)))
}

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

    /// Prints a value for scripts, or a text whose lines stay whole, as `say_whole` does.
    pub fn say_whole(self, value: &impl Serialize, text: impl Display) {
        match self {
            Self::Json => say_json(value),
            Self::Text => say_whole(text),
        }
    }
}

/// Prints one or several lines on standard output; on a terminal wrapped to its width.
pub fn say(text: impl Display) {
    written(writeln!(io::stdout().lock(), "{}", fitted(&shown(text), terminal_width())));
}

/// Prints a text that is copied or read by programs, such as a file, on standard output: its lines stay whole.
pub fn say_whole(text: impl Display) {
    written(writeln!(io::stdout().lock(), "{}", shown(text)));
}

/// Prints one or several lines on standard error; on a terminal wrapped to its width.
pub fn note(text: impl Display) {
    to_stderr(&fitted(&shown(text), error_width()), Level::INFO);
}

/// Prints lines on standard error, in the journal with their priority.
fn to_stderr(text: &str, level: Level) {
    let _ = writeln!(io::stderr().lock(), "{}", with_priority(text, level, is_behind_stderr()));
}

/// Wraps the lines that are longer than a terminal is wide, at spaces: further lines begin below the text that follows
/// the name of the line. Elsewhere lines stay whole, and rows of Markdown tables everywhere: they are copied, and wrapped
/// they would have no columns.
pub fn fitted(text: &str, width: Option<usize>) -> Cow<'_, str> {
    let is_long = |line: &str, width: usize| !line.starts_with('|') && columns(line) > width;
    let Some(width) = width.filter(|width| text.lines().any(|line| is_long(line, *width))) else {
        return text.into();
    };
    let lines = text.split('\n').map(|line| {
        let (name, rest) = line.split_at(begin_of_text(line, width / 2));
        let indent = columns(name);
        match is_long(line, width) {
            true => {
                let rest = wrapped(rest, width - indent);
                format!("{name}{}", rest.replace('\n', &format!("\n{:indent$}", "")))
            }
            false => line.to_owned(),
        }
    });
    lines.collect::<Vec<_>>().join("\n").into()
}

/// Where the text of a line begins, bytes: after its indentation, and after the names with two spaces or more behind
/// them, at most `most` bytes from the start of the line.
fn begin_of_text(line: &str, most: usize) -> usize {
    let is_begin = |at: &usize| {
        let (before, text) = line.split_at(*at);
        !text.starts_with(' ') && (before.ends_with("  ") || before.trim_matches(' ').is_empty())
    };
    let places = line.char_indices().map(|(at, _)| at).take_while(|at| *at <= most);
    places.filter(is_begin).last().unwrap_or(0)
}

/// Prints a text that is safe already on standard error.
pub fn note_drawn(text: impl Display) {
    to_stderr(&text.to_string(), Level::INFO);
}

/// Prints an error that is safe already, also one drawn with colours, on standard error.
pub fn error_drawn(text: impl Display) {
    to_stderr(&text.to_string(), Level::ERROR);
}

/// Prints a question on standard error; the answer is entered behind it.
pub fn ask(question: impl Display) {
    let mut out = io::stderr().lock();
    let _ = write!(out, "{}", shown(question)).and_then(|()| out.flush());
}

/// Prints what this program drew, with its colours, on standard output. Never foreign text: its control
/// characters reach the terminal.
pub fn say_drawn(picture: &str) {
    written(writeln!(io::stdout().lock(), "{picture}"));
}

/// Wraps every line of a text at spaces. A default or variable in brackets stays in one line.
pub fn wrapped(text: &str, width: usize) -> String {
    let lines = text.lines().map(|line| {
        let (mut wrapped, mut column) = (String::new(), 0);
        for word in words(line) {
            let length = columns(&word);
            if column > 0 && column + 1 + length > width {
                wrapped.push('\n');
                column = 0;
            } else if column > 0 {
                wrapped.push(' ');
                column += 1;
            }
            wrapped += &word;
            column += length;
        }
        wrapped
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Words of a line; `[env: X]` is one.
fn words(line: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut is_open = false;
    for word in line.split(' ').filter(|word| !word.is_empty()) {
        match words.last_mut().filter(|_| is_open) {
            Some(last) => *last += &format!(" {word}"),
            None => words.push(word.into()),
        }
        is_open |= word.starts_with("[env:") || word.starts_with("[default:");
        is_open &= !word.contains(']');
    }
    words
}

/// Columns of a text on a terminal: a wide character, such as one of Chinese, has two.
pub fn columns(text: &str) -> usize {
    Span::raw(text).width()
}

/// Width of the terminal behind standard output, columns; `None` if it is not a terminal.
pub fn terminal_width() -> Option<usize> {
    width_behind(&io::stdout())
}

/// Width of the terminal behind standard error, columns; `None` if it is not a terminal.
pub fn error_width() -> Option<usize> {
    width_behind(&io::stderr())
}

fn width_behind(stream: &impl IsTerminal) -> Option<usize> {
    if !stream.is_terminal() {
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
    has_text(std::env::var_os("NO_COLOR").as_deref())
}

/// Whether a variable of the environment is set, and not empty.
fn has_text(value: Option<&OsStr>) -> bool {
    value.is_some_and(|value| !value.is_empty())
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
            written(writeln!(out, "{line}").and_then(|()| out.flush()));
        }
        Err(error) => tracing::error!(%error, "an answer could not be written as JSON"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_standard_output_is_kept_unless_its_reader_has_gone() {
        let first = Mutex::new(None);
        assert!(kept(Ok(()), &first, || true));
        let closed = || io::Error::from_raw_os_error(Errno::EIO as i32);
        for gone in [io::ErrorKind::BrokenPipe.into(), closed()] {
            assert!(!kept(Err(gone), &first, || false));
        }
        assert!(first.lock().is_none());
        kept(Err(closed()), &first, || true);
        assert!(first.lock().take().is_some(), "a disk that fails");
        let full = writeln!(std::fs::File::create("/dev/full").unwrap(), "a line");
        assert!(!kept(full, &first, || false));
        kept(Err(io::ErrorKind::PermissionDenied.into()), &first, || true);
        let words = CliError::Unsaid(first.lock().take().unwrap()).to_string();
        assert!(words.starts_with("standard output: no space is left on this disk;"), "{words}");
    }

    #[test]
    fn any_text_of_no_color_switches_colours_off() {
        assert!(has_text(Some("1".as_ref())));
        assert!(!has_text(Some("".as_ref())) && !has_text(None));
    }

    #[test]
    fn a_name_cannot_control_the_terminal() {
        let name = "night\u{1b}[31m\u{0}";
        assert_eq!(shown(format_args!("run 3, {name}\n")), "run 3, night\\u{1b}[31m\\u{0}\n");
    }

    #[test]
    fn a_line_is_wrapped_at_spaces_below_its_text_on_a_terminal_only() {
        let text = "safe     No fault is known\n\n  run 3 waits for a person";
        assert_eq!(fitted(text, None), text);
        assert_eq!(fitted(text, Some(26)), text);
        let wrapped = "safe     No fault is\n         known\n\n  run 3 waits for a\n  person";
        assert_eq!(fitted(text, Some(20)), wrapped);
        assert_eq!(fitted("a long name  of a line", Some(16)), "a long name of a\nline");
        assert_eq!(fitted("µµµµµµµµ µ", Some(4)), "µµµµµµµµ\nµ");
        assert_eq!(fitted("µ  µ µ", Some(1)), "µ\nµ\nµ");
        assert_eq!(fitted("触覚触覚 触覚", Some(12)), "触覚触覚\n触覚", "two columns each");
        let event = "09:15  trip  limit of cell 3 was passed";
        let wrapped = "09:15  trip  limit of cell\n             3 was passed";
        assert_eq!(fitted(event, Some(26)), wrapped, "below the last column");
        let table = "| net | force, % |\n| a   |       12 |";
        assert_eq!(fitted(table, Some(10)), table);
    }

    #[test]
    fn a_text_is_wrapped_at_spaces_and_not_within_brackets() {
        assert_eq!(wrapped("one two three\n\nfour", 7), "one two\nthree\n\nfour");
        assert_eq!(wrapped("URL [env: A] [default: b]", 9), "URL\n[env: A]\n[default: b]");
    }

    #[test]
    fn a_bar_has_its_share_of_the_width() {
        assert_eq!(filled(0.5, 4), "██");
        assert_eq!(filled(0.0, 4), "");
        assert_eq!(filled(7.0, 2), "██");
        assert_eq!(filled(1.0 / 8.0, 1), "▏");
    }
}
