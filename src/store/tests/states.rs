//! States in SQL: each is one that its enum has.
//! Uses: the source files of this crate, when tests run. Never: a database.

use std::path::Path;

use strum::VariantArray;

use crate::TaskState;
use crate::state::StoredState;

/// The quoted words after each `state =`, `state <>`, `state IN` or `state NOT IN` of a text.
fn states(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (at, _) in text.match_indices("state ") {
        let rest = text[at + "state ".len()..].trim_start();
        let listed = ["IN (", "NOT IN ("].iter().find_map(|start| rest.strip_prefix(start));
        let one = ["= ", "<> "].iter().find_map(|start| rest.strip_prefix(start));
        let quoted = match (listed, one) {
            (Some(list), _) => list.split(')').next(),
            (None, Some(value)) => value.split([' ', '\n', ',', ')']).next(),
            (None, None) => None,
        };
        let words = quoted.unwrap_or_default().split('\'').skip(1).step_by(2);
        found.extend(words.map(str::to_owned));
    }
    found
}

fn check(folder: &Path, seen: &mut usize) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            if !path.ends_with("tests") {
                check(&path, seen);
            }
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            for state in states(&std::fs::read_to_string(&path).unwrap()) {
                *seen += 1;
                let known = StoredState::ALL.iter().any(|known| known.as_str() == state)
                    || TaskState::VARIANTS.iter().any(|known| known.to_string() == state);
                assert!(known, "{}: no state is called {state:?}", path.display());
            }
        }
    }
}

#[test]
fn every_state_in_sql_is_one_of_its_enum() {
    let mut seen = 0;
    check(Path::new(env!("CARGO_MANIFEST_DIR")), &mut seen);
    assert!(seen > 20, "{seen}");
}

#[test]
fn states_are_found_in_each_form() {
    let sql = "WHERE state = 'queued' AND state NOT IN ('ended', 'removed') OR state <> 'runing')";
    assert_eq!(states(sql), ["queued", "ended", "removed", "runing"]);
}
