//! The rule of names: a constant with a general name has one meaning in `src/`.
//! PURE. Uses: `source`. Never: the disk.

use std::collections::BTreeSet;

use super::source::{File, code};

/// General names: a constant with one of them is defined in one file at most. Names with the use and the
/// unit (`STATUS_POLL`, `PAGE_ROWS`) take their place.
const GENERAL: [&str; 49] = [
    "AGAIN",
    "AHEAD",
    "ANSWER",
    "ARMS",
    "BACKOFF",
    "BATCH",
    "BEHIND",
    "BINS",
    "CHUNK",
    "COLUMNS",
    "CONTACTS_MAX",
    "DEADLINE",
    "DIGITS",
    "DOTS",
    "END",
    "EVENTS",
    "FEWEST",
    "FILLED",
    "FRAMES_AT_ONCE",
    "HEADER",
    "IDLE",
    "INTERVAL",
    "KEYS",
    "LIMIT",
    "LOOK",
    "NAMES_MAX",
    "PAGE",
    "PARTS",
    "PERIOD",
    "PIECE",
    "POLL",
    "QUEUE",
    "QUIET",
    "READS",
    "READY",
    "RETRY",
    "ROUNDS",
    "ROWS",
    "RUNS",
    "SEND",
    "SIZE",
    "STEPS",
    "STORING",
    "THREADS",
    "TRIALS_AT_ONCE",
    "TURN",
    "VERSION",
    "WAITING_MAX",
    "WITHIN",
];

/// A constant with a general name, private or public, is defined in more than one file of `src/`.
pub fn ambiguous_constants(files: &[File]) -> Vec<String> {
    let in_source = |f: &&File| f.is_rust() && f.path.starts_with("src/");
    let sources: Vec<(&str, String)> =
        files.iter().filter(in_source).map(|f| (f.path.as_str(), code(&f.text, false))).collect();
    let mut findings = Vec::new();
    for name in GENERAL {
        let definition = format!("const {name}:");
        let defining = sources.iter().filter(|(_, bare)| bare.contains(&definition));
        let paths: BTreeSet<&str> = defining.map(|(path, _)| *path).collect();
        if paths.len() > 1 {
            let paths: Vec<&str> = paths.into_iter().collect();
            findings
                .push(format!("{name} is defined in {}: name each by its use", paths.join(", ")));
        }
    }
    findings
}
