//! Standard error in the journal of systemd, which reads the priority at the beginning of each line.
//! Uses: a file in place of the journal. Never: systemd.

use std::io::{Read, Seek};
use std::os::unix::fs::MetadataExt;

use crate::support::command;

/// What a command that fails prints on standard error; `is_journal`: the environment names it as that of the journal.
fn error(is_journal: bool) -> String {
    let mut file = tempfile::tempfile().unwrap();
    let of = file.metadata().unwrap();
    let mut train = command(&["train", "no-such-recipe", "--show"]);
    if is_journal {
        train.env("JOURNAL_STREAM", format!("{}:{}", of.dev(), of.ino()));
    }
    assert!(!train.stderr(file.try_clone().unwrap()).status().unwrap().success());
    file.rewind().unwrap();
    let mut text = String::new();
    file.read_to_string(&mut text).unwrap();
    text
}

#[test]
fn an_error_has_its_priority_in_the_journal_and_none_elsewhere() {
    let text = error(true);
    assert!(text.starts_with("<3>error: "), "{text}");
    assert_eq!(text.replace("<3>", ""), error(false));
}
