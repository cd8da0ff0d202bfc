//! The trainer as a process: what it refuses, one at a time on a folder, its end with its service.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use palpate_touch::learn::order::{Event, ORDER};

/// A trainer on a folder, with its standard input open.
fn start(folder: &Path) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate-trainer"));
    command.arg(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
    command.spawn().unwrap()
}

/// The last event of a trainer, and its exit status.
fn end(mut trainer: Child) -> (Event, Option<i32>) {
    let lines = BufReader::new(trainer.stdout.take().unwrap()).lines();
    let last = lines.last().expect("an event").unwrap();
    (serde_json::from_str(&last).unwrap(), trainer.wait().unwrap().code())
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("trainer-{name}"));
    fs::remove_dir_all(&folder).ok();
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn failed(folder: &Path) -> String {
    let (event, status) = end(start(folder));
    assert_eq!(status, Some(1));
    let Event::Failed { error } = event else { panic!("{event:?}") };
    error
}

#[test]
fn an_order_of_another_version_and_a_missing_one_are_refused() {
    let folder = folder("refused");
    let error = failed(&folder);
    assert!(error.contains(ORDER), "{error}");
    fs::write(folder.join(ORDER), r#"{"version": "0.0.1, order 0", "net": 3}"#).unwrap();
    let error = failed(&folder);
    assert!(error.contains("0.0.1, order 0") && error.contains("same version"), "{error}");
    // A result that is there belongs to another order.
    fs::write(folder.join("manifest.toml"), "").unwrap();
    failed(&folder);
    assert!(!folder.join("manifest.toml").exists());
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_second_trainer_waits_for_the_first_and_ends_with_its_service() {
    let folder = folder("second");
    fs::write(folder.join(ORDER), "{}").unwrap();
    let first = File::open(&folder).unwrap();
    first.try_lock().unwrap();
    let mut waits = start(&folder);
    std::thread::sleep(Duration::from_millis(300));
    assert!(waits.try_wait().unwrap().is_none());
    drop(first);
    assert!(matches!(end(waits).0, Event::Failed { .. }));
    let first = File::open(&folder).unwrap();
    first.try_lock().unwrap();
    let mut orphan = start(&folder);
    drop(orphan.stdin.take());
    assert_eq!(end(orphan), (Event::Stopped, Some(0)));
    fs::remove_dir_all(folder).unwrap();
}
