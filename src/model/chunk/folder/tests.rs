//! Tests of the folder of a work order, with chunks of a few bytes.
//! Uses: the folder. Never: a simulation.

use std::collections::BTreeMap;
use std::io::Write;
use std::ops::ControlFlow;

use serde_json::json;
use tempfile::TempDir;

use super::*;
use crate::chunk::WrittenChunk;

/// Makes chunks of text: that of chunk 2 fails, and one that is told to break off is not made.
struct Texts {
    salt: &'static str,
}

impl MakeChunks for Texts {
    fn write(&mut self, index: u64, mut out: NewFile, tell: &mut Tell<'_>) -> WrittenChunk {
        if index == 2 {
            return Err("two is too many".into());
        }
        write!(out, "chunk {index}{}", self.salt)?;
        Ok(tell(1).is_continue().then_some((out, 1)))
    }
}

fn plain() -> Texts {
    Texts { salt: "" }
}

fn order(number: u64) -> WorkOrder {
    WorkOrder::new("texts", &json!({ "number": number }), BTreeMap::new(), 4)
}

fn folder() -> (TempDir, OrderFolder) {
    let temporary = tempfile::tempdir().unwrap();
    let folder = OrderFolder::write(&temporary.path().join("order"), order(1)).unwrap().0;
    (temporary, folder)
}

fn made(folder: &OrderFolder, index: u64) -> ChunkRow {
    folder.make(index, &mut plain(), &mut |_| ControlFlow::Continue(())).unwrap().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn an_order_is_written_once_and_another_one_is_refused() {
    let (_temporary, folder) = folder();
    let path = folder.path().to_owned();
    let (again, is_new) = OrderFolder::write(&path, order(1)).unwrap();
    assert!(!is_new);
    assert_eq!(again.order(), folder.order());
    let error = OrderFolder::write(&path, order(2)).unwrap_err().to_string();
    assert!(error.contains("definition.number = 1, requested 2"), "{error}");
    let none = OrderFolder::open(&path.join("none")).unwrap_err();
    assert!(matches!(none, ChunkError::NoOrder { .. }));
    fs::write(path.join(ORDER_FILE), "{").unwrap();
    assert!(matches!(OrderFolder::open(&path), Err(ChunkError::Order { .. })));
}

#[test]
fn a_chunk_is_done_when_its_row_is_there_and_its_bytes_match() {
    let (_temporary, folder) = folder();
    assert_eq!(folder.state(0, Look::Sha256).unwrap(), ChunkState::Missing);
    let row = made(&folder, 0);
    assert_eq!((row.index, row.bytes, row.rows), (0, 7, 1));
    assert_eq!(row.sha256, crate::digest::sha256_hex("chunk 0"));
    assert_eq!(folder.state(0, Look::Sha256).unwrap(), ChunkState::Done(row.clone()));
    assert!(folder.done_at(&row.key).is_some() && folder.done_at("none").is_none());
    // Other bytes of the same length, fewer bytes, none.
    let bytes = folder.result(&row.key);
    fs::write(&bytes, "chunk 9").unwrap();
    assert_eq!(folder.state(0, Look::Length).unwrap(), ChunkState::Done(row.clone()));
    for damage in ["chunk 9", "chunk", ""] {
        fs::write(&bytes, damage).unwrap();
        assert!(matches!(folder.state(0, Look::Sha256).unwrap(), ChunkState::Damaged(_)));
    }
    fs::remove_file(&bytes).unwrap();
    assert!(matches!(folder.state(0, Look::Length).unwrap(), ChunkState::Damaged(_)));
    assert_eq!(made(&folder, 0).sha256, row.sha256);
    // The row of another chunk, and one that is no JSON.
    let results = folder.path().join(RESULTS);
    let other = made(&folder, 1);
    fs::copy(results.join(json_name(&other.key)), results.join(json_name(&row.key))).unwrap();
    let ChunkState::Damaged(why) = folder.state(0, Look::Length).unwrap() else { panic!() };
    assert!(why.contains(&other.key), "{why}");
    fs::write(results.join(json_name(&row.key)), "{").unwrap();
    assert!(matches!(folder.state(0, Look::Length).unwrap(), ChunkState::Damaged(_)));
    let error = folder.state(4, Look::Length).unwrap_err().to_string();
    assert_eq!(error, "index = 4: must be from 0 to 3");
}

#[test]
fn a_chunk_that_fails_is_set_aside_with_its_error_and_one_that_is_broken_off_is_not() {
    let (_temporary, folder) = folder();
    for attempts in 1..3 {
        let error = folder.make(2, &mut plain(), &mut |_| ControlFlow::Continue(())).unwrap_err();
        assert_eq!(error.to_string(), "chunk 2: two is too many");
        let ChunkState::Failed(failed) = folder.state(2, Look::Length).unwrap() else { panic!() };
        assert_eq!(failed.attempts, attempts);
        assert_eq!(failed.error, "chunk 2: two is too many");
    }
    let none = folder.make(3, &mut plain(), &mut |_| ControlFlow::Break(())).unwrap();
    assert_eq!(none, None);
    assert_eq!(folder.state(3, Look::Length).unwrap(), ChunkState::Missing);
    assert_eq!(names(&folder.path().join(RESULTS)), Vec::<String>::new());
    // A failure is forgotten when the chunk is made.
    let failure = folder.path().join(FAILED_CHUNKS).join(json_name(&folder.order().key(0)));
    fs::write(&failure, "{").unwrap();
    made(&folder, 0);
    assert!(!failure.exists());
}

#[test]
fn a_repeated_chunk_with_other_bytes_is_refused() {
    let (_temporary, folder) = folder();
    let row = made(&folder, 0);
    let mut salted = Texts { salt: "!" };
    let error = folder.make(0, &mut salted, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert!(matches!(error, ChunkError::NotReproduced { index: 0, .. }), "{error}");
    assert_eq!(folder.state(0, Look::Sha256).unwrap(), ChunkState::Done(row));
}

#[test]
fn what_is_missing_damaged_or_foreign_is_named() {
    let (_temporary, folder) = folder();
    let rows: Vec<ChunkRow> = [0, 1, 3].map(|index| made(&folder, index)).into();
    fs::write(folder.result(&rows[1].key), "").unwrap();
    let stranger = format!("{}.json", order(2).key(0));
    fs::write(folder.path().join(RESULTS).join(&stranger), "{}").unwrap();
    let Err(ChunkError::Incomplete { gaps, .. }) = folder.rows() else { panic!() };
    assert_eq!(gaps.missing, [2]);
    assert_eq!(gaps.damaged.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [1]);
    assert_eq!(gaps.foreign, [format!("results/{stranger}")]);
}

#[test]
fn what_killed_processes_left_is_removed_when_no_other_one_is_at_work() {
    let (_temporary, folder) = folder();
    let left = |name: &str| {
        let path = folder.path().join(RESULTS).join(name);
        fs::write(&path, "half").unwrap();
        path
    };
    let (first, kept) = (left("_partial-1"), left("notes"));
    let at_work = folder.at_work().unwrap();
    assert!(!first.exists() && kept.exists());
    let second = left("_partial-2");
    let also = folder.at_work().unwrap();
    assert!(second.exists(), "it may be of the other process");
    drop((at_work, also));
    folder.at_work().unwrap();
    assert!(!second.exists());
}
