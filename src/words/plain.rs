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
    match plain_kind(error.kind()) {
        // An error with a text has more in it than its kind.
        Some(words) if error.get_ref().is_none() => words.into(),
        _ => in_plain_words(&error.to_string()),
    }
}

/// Returns a text in which an error of the operating system, such as "No such file or directory (os error 2)", has the
/// words of [`system_words`].
pub fn in_plain_words(text: &str) -> String {
    let numbered = text.split_once(" (os error ").and_then(|(before, rest)| {
        let (number, after) = rest.split_once(')')?;
        Some((before, number.parse::<i32>().ok()?, after))
    });
    let Some((before, number, after)) = numbered else { return text.into() };
    let error = io::Error::from_raw_os_error(number);
    let theirs = error.to_string();
    let theirs = theirs.split(" (os error ").next().unwrap_or_default();
    match plain_kind(error.kind()).zip(before.strip_suffix(theirs)) {
        Some((ours, before)) => format!("{before}{ours}{after}"),
        None => format!("{before}{after}"),
    }
}

fn plain_kind(kind: ErrorKind) -> Option<&'static str> {
    Some(match kind {
        ErrorKind::NotFound => "there is no such file or folder",
        ErrorKind::AlreadyExists => "there is a file or folder of this name already",
        ErrorKind::PermissionDenied => "this user has no right to it",
        ErrorKind::IsADirectory => "is a folder, not a file",
        ErrorKind::NotADirectory => "a part of the path is a file, not a folder",
        ErrorKind::StorageFull => "no space is left on this disk",
        ErrorKind::ReadOnlyFilesystem => "is on a disk that can only be read",
        _ => return None,
    })
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

/// Formats a count with separated thousands: `33,000`.
pub fn grouped(count: u64) -> String {
    let digits: Vec<char> = count.to_string().chars().collect();
    let groups = digits.rchunks(3).rev().map(|group| group.iter().collect::<String>());
    groups.collect::<Vec<_>>().join(",")
}

/// Formats a count with its noun: `1 retry`, `33,000 trials`.
pub fn counted(count: u64, one: &str, many: &str) -> String {
    format!("{} {}", grouped(count), if count == 1 { one } else { many })
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
        assert_eq!(counted(33_000, "trial", "trials"), "33,000 trials");
        let shown: Vec<String> = [0, 999, 1000, 1_234_567].map(grouped).into();
        assert_eq!(shown, ["0", "999", "1,000", "1,234,567"]);
    }

    #[test]
    fn an_error_of_the_system_is_shown_without_its_number() {
        let error = std::io::Error::from_raw_os_error(111);
        assert_eq!(system_words(&error), "Connection refused");
        let missing = io::Error::from_raw_os_error(2);
        assert_eq!(system_words(&missing), "there is no such file or folder");
        let there = system_words(&io::Error::from_raw_os_error(17));
        assert_eq!(there, "there is a file or folder of this name already");
        let error = std::io::Error::other("port: Connection refused (os error 111); again");
        assert_eq!(system_words(&error), "port: Connection refused; again");
        assert_eq!(system_words(&std::io::Error::other("none")), "none");
        let full = "writing a shard: No space left on device (os error 28); again";
        assert_eq!(in_plain_words(full), "writing a shard: no space is left on this disk; again");
    }

    #[test]
    fn names_are_short_and_without_control_characters() {
        assert_eq!(violated("Real-Hex, µ 3", 13), None);
        assert_eq!(violated("abc", 2).unwrap(), "must have at most 2 characters");
        assert_eq!(violated("a\u{7}", 2).unwrap(), "must have no control characters");
        assert_eq!(violated("a\n", 2).unwrap(), "must have no control characters");
    }
}
