//! Text for people: what other people entered, of which not everything may reach a terminal, what a name may contain,
//! and numbers with their nouns and units.
//! PURE. Uses: nothing. Never: a text that is refused and shown as it is.

use std::borrow::Cow;
use std::io::{self, ErrorKind};

/// Whether a character controls a terminal (C0, DEL, C1) or the direction of the text after it.
fn is_control(c: char) -> bool {
    c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Returns the text with its control characters as `\u{1b}`.
pub fn escaped(text: &str) -> Cow<'_, str> {
    escape(text, is_control)
}

/// As [`escaped`], but ends of lines and tabs stay.
pub fn escaped_lines(text: &str) -> Cow<'_, str> {
    escape(text, |c| is_control(c) && !matches!(c, '\n' | '\t'))
}

fn escape(text: &str, of: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&of) {
        return text.into();
    }
    let shown = |c: char| if of(c) { c.escape_unicode().to_string() } else { c.into() };
    text.chars().map(shown).collect()
}

/// Returns the words of an error of the operating system, without its number: plain ones where its meaning is
/// plain.
pub fn system_words(error: &io::Error) -> String {
    // An error with a text has more in it than its kind.
    if error.get_ref().is_none() {
        match error.kind() {
            ErrorKind::NotFound => return "there is no such file or folder".into(),
            ErrorKind::PermissionDenied => return "this user has no right to it".into(),
            ErrorKind::IsADirectory => return "is a folder, not a file".into(),
            ErrorKind::NotADirectory => return "a part of the path is a file, not a folder".into(),
            ErrorKind::StorageFull => return "no space is left on this disk".into(),
            ErrorKind::ReadOnlyFilesystem => return "is on a disk that can only be read".into(),
            _ => {}
        }
    }
    let words = error.to_string();
    match words.split_once(" (os error ") {
        Some((words, rest)) => {
            format!("{words}{}", rest.split_once(')').map_or("", |(_, rest)| rest))
        }
        None => words,
    }
}

/// Returns the limit that a name or note of at most `max_chars` characters violates.
pub fn violated(text: &str, max_chars: usize) -> Option<String> {
    if text.chars().count() > max_chars {
        return Some(format!("must have at most {max_chars} characters"));
    }
    text.contains(is_control).then(|| "must have no control characters".into())
}

/// Formats a duration: `25 h 12 min`, `12 min 5 s`, `4.2 s`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => {
            let minutes = (seconds / 60.0).round() as u64;
            format!("{} h {} min", minutes / 60, minutes % 60)
        }
    }
}

/// Formats a size: `0.21 GB`, `3.4 MB`, `12 kB`.
pub fn bytes(count: f64) -> String {
    match count {
        1e8.. => format!("{:.2} GB", count / 1e9),
        1e6.. => format!("{:.1} MB", count / 1e6),
        _ => format!("{:.0} kB", count / 1e3),
    }
}

/// Formats a count with its noun: `1 retry`, `3 retries`.
pub fn counted(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_controls_a_terminal_is_shown() {
        let text = "a\u{1b}[31m\u{0}\u{7f}\u{9b}1m\u{202e}\u{2066}\r\n\tµ";
        let whole = r"a\u{1b}[31m\u{0}\u{7f}\u{9b}1m\u{202e}\u{2066}\u{d}\u{a}\u{9}µ";
        assert_eq!(escaped(text), whole);
        assert_eq!(escaped_lines(text), whole.replace(r"\u{a}\u{9}", "\n\t"));
        assert!(matches!(escaped("Ölfleck – 3"), Cow::Borrowed("Ölfleck – 3")));
    }

    #[test]
    fn durations_sizes_and_counts_read_well() {
        assert_eq!(duration(4.21), "4.2 s");
        assert_eq!(duration(59.9), "1 min 0 s");
        assert_eq!(duration(725.0), "12 min 5 s");
        assert_eq!(duration(90_720.0), "25 h 12 min");
        assert_eq!(bytes(12_345.0), "12 kB");
        assert_eq!(bytes(2.1e8), "0.21 GB");
        assert_eq!(counted(1, "retry", "retries"), "1 retry");
        assert_eq!(counted(0, "retry", "retries"), "0 retries");
    }

    #[test]
    fn an_error_of_the_system_is_shown_without_its_number() {
        let error = std::io::Error::from_raw_os_error(111);
        assert_eq!(system_words(&error), "Connection refused");
        let missing = io::Error::from_raw_os_error(2);
        assert_eq!(system_words(&missing), "there is no such file or folder");
        let error = std::io::Error::other("port: Connection refused (os error 111); again");
        assert_eq!(system_words(&error), "port: Connection refused; again");
        assert_eq!(system_words(&std::io::Error::other("none")), "none");
    }

    #[test]
    fn names_are_short_and_without_control_characters() {
        assert_eq!(violated("Real-Hex, µ 3", 13), None);
        assert_eq!(violated("abc", 2).unwrap(), "must have at most 2 characters");
        assert_eq!(violated("a\u{7}", 2).unwrap(), "must have no control characters");
        assert_eq!(violated("a\n", 2).unwrap(), "must have no control characters");
    }
}
