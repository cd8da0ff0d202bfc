//! The scripts of `web/` compare states, ends, kinds and labels with texts that the service sends: those of its enums.
//! Uses: the enums, the files of `web/`. Never: a browser, a copy of a list.

use std::fs;
use std::path::{Path, PathBuf};

use palpate::campaign::bench::rig_state::RigState;
use palpate::journal::ExitStatus;
use palpate::state::{PausedWhy, StoredState};
use palpate::store::{Label, RunKind, TaskState};
use serde::de::DeserializeOwned;

/// Fields whose values are texts of enums.
const FIELDS: [&str; 5] = ["state", "exit_status", "paused_why", "kind", "label"];

/// A text with which a script compares a field of an object.
#[derive(Debug)]
struct Compared<'a> {
    object: &'a str,
    field: &'static str,
    text: &'a str,
}

impl Compared<'_> {
    /// Whether the field can have this text.
    fn is_sent(&self) -> bool {
        let text = self.text;
        match (self.object, self.field) {
            ("rig", "state") => is::<RigState>(text),
            ("run" | "r", "state") => is::<StoredState>(text),
            ("job", "state") => is::<TaskState>(text),
            (_, "state") => is::<StoredState>(text) || is::<TaskState>(text),
            (_, "exit_status") => is::<ExitStatus>(text),
            (_, "paused_why") => is::<PausedWhy>(text),
            ("run" | "row" | "tour", "kind") => is::<RunKind>(text),
            // Kinds of events, verdicts and others, which are not listed here.
            (_, "kind") => true,
            _ => is::<Label>(text),
        }
    }
}

fn is<T: DeserializeOwned>(text: &str) -> bool {
    serde_json::from_value::<T>(text.into()).is_ok()
}

fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

/// Comparisons of a script: `object.field === 'text'`, `!==`, and `['text', ..].includes(object.field)`.
fn compared(script: &str) -> Vec<Compared<'_>> {
    let mut found = Vec::new();
    for field in FIELDS {
        for (at, access) in script.match_indices(&format!(".{field}")) {
            let (before, after) = (&script[..at], &script[at + access.len()..]);
            let object = before.trim_end_matches('?').rsplit(|c: char| !is_word(c)).next();
            let object = object.unwrap_or_default();
            let equals = after.strip_prefix(" === '").or_else(|| after.strip_prefix(" !== '"));
            let list = before
                .trim_end_matches(|c: char| is_word(c) || c == '.' || c == '?')
                .strip_suffix("].includes(")
                .filter(|_| after.starts_with(')'))
                .and_then(|list| Some(list.rsplit_once('[')?.1));
            let texts: Vec<&str> = match (equals, list) {
                (Some(rest), _) => rest.split('\'').take(1).collect(),
                (None, Some(list)) => {
                    list.split(',').map(|t| t.trim().trim_matches('\'')).collect()
                }
                (None, None) => Vec::new(),
            };
            found.extend(texts.into_iter().map(|text| Compared { object, field, text }));
        }
    }
    found
}

fn scripts(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| match path.is_dir() {
            true if path.ends_with("vendor") => Vec::new(),
            true => scripts(&path),
            false => vec![path],
        })
        .filter(|path| path.extension().is_some_and(|end| end == "js"))
        .collect()
}

#[test]
fn pages_compare_with_texts_that_the_service_sends() {
    let (mut count, mut wrong) = (0, Vec::new());
    for path in scripts(&Path::new(env!("CARGO_MANIFEST_DIR")).join("web")) {
        let script = fs::read_to_string(&path).unwrap();
        let found = compared(&script);
        count += found.len();
        let unknown = found.iter().filter(|compared| !compared.is_sent());
        wrong.extend(unknown.map(|compared| format!("{}: {compared:?}", path.display())));
    }
    assert!(wrong.is_empty(), "\n{}\n", wrong.join("\n"));
    assert!(count > 60, "{count} comparisons: the scripts are no longer understood");
}

#[test]
fn a_comparison_with_an_unknown_text_is_found() {
    let script = "run?.state === 'runing' && ['homed', 'queued'].includes(status.rig.state) \
        && job.state !== 'paused' && row.kind === 'real-hex' && run.label === names[0] && x.kinds === 'a'";
    let unknown: Vec<&str> = compared(script)
        .into_iter()
        .filter(|compared| !compared.is_sent())
        .map(|compared| compared.text)
        .collect();
    assert_eq!(unknown, ["runing", "queued", "paused"]);
}
