//! Output lines for people and for scripts, and numbers with units.
//! Uses: nothing. Never: HTTP, decisions. A closed standard output is not an error.

use std::io::{self, Write};

use serde::Serialize;

/// Prints one or several lines on standard output.
pub fn say(text: impl std::fmt::Display) {
    let _ = writeln!(io::stdout().lock(), "{text}");
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
    fn durations_and_bytes_read_well() {
        assert_eq!(duration(4.21), "4.2 s");
        assert_eq!(duration(59.9), "1 min 0 s");
        assert_eq!(duration(725.0), "12 min 5 s");
        assert_eq!(duration(90_720.0), "25 h 12 min");
        assert_eq!(bytes(12_345.0), "12 kB");
        assert_eq!(bytes(2.1e8), "0.21 GB");
        assert_eq!(counted(1, "retry", "retries"), "1 retry");
    }
}
