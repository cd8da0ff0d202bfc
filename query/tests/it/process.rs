//! The process: its rights, its priority, its memory, its end.
//! Uses: `common`, `/proc`. Never: what a statement may contain.

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::thread::sleep;
use std::time::Duration;

use palpate_words::query_lines::Answer;

use crate::common::{BOUNDS, Bounds, Engine, Folder, Outcome, Trials, ask, tables};

const SIGABRT: i32 = 6;
/// Far more than the test takes.
const PATIENCE: Duration = Duration::from_secs(60);
/// It computes for hours in little memory: polars holds the left side of each product, 1000 trials.
const ENDLESS: &str = "SELECT sum(fvu * c) FROM trials CROSS JOIN (SELECT fvu * b AS c FROM trials CROSS JOIN \
     (SELECT fvu * a AS b FROM trials CROSS JOIN (SELECT fvu AS a FROM trials) AS p) AS q) AS r";

/// Starts a statement that does not end over 1000 trials, with its tables.
fn started(name: &str) -> (Engine, Folder) {
    let folder = Folder::new(name);
    let path = folder.file("a.parquet");
    Trials { first: 0, count: 1000, channels: 0, without_twin: 10 }.write(&path);
    let mut engine = Engine::start(ENDLESS, BOUNDS);
    assert_eq!(engine.hear(), Some(Answer::Tables(vec!["trials".into()])));
    engine.say(&tables(&[path], "run-3")[..1].to_vec());
    (engine, folder)
}

/// A line of `/proc/../status` of each thread.
fn of_threads(process: u32, name: &str) -> Vec<String> {
    let tasks = fs::read_dir(format!("/proc/{process}/task")).unwrap();
    let status = tasks.map(|task| fs::read_to_string(task.unwrap().path().join("status")));
    let lines = status.filter_map(Result::ok).filter_map(|status| {
        let line = status.lines().find(|line| line.starts_with(name))?;
        Some(line.trim_start_matches(name).trim().to_owned())
    });
    lines.collect()
}

/// Waits until the program computes with several threads.
fn computes(process: u32) {
    let mut waited = Duration::ZERO;
    while of_threads(process, "Threads:")
        .first()
        .is_none_or(|count| count.parse::<u32>().unwrap() < 4)
    {
        sleep(Duration::from_millis(10));
        waited += Duration::from_millis(10);
        assert!(waited < PATIENCE, "no threads");
    }
}

#[test]
fn every_thread_is_confined_and_of_low_priority() {
    let (mut engine, _folder) = started("confined");
    let process = engine.child.id();
    computes(process);
    // Set together with the rules for files; without Landlock on this kernel, too.
    let confined = of_threads(process, "NoNewPrivs:");
    assert!(confined.len() >= 4 && confined.iter().all(|flag| flag == "1"), "{confined:?}");
    for task in fs::read_dir(format!("/proc/{process}/task")).unwrap() {
        let stat = fs::read_to_string(task.unwrap().path().join("stat")).unwrap_or_default();
        let Some((_, fields)) = stat.rsplit_once(") ") else { continue };
        assert_eq!(fields.split(' ').nth(16), Some("19"), "{stat}");
    }
    engine.child.kill().unwrap();
    engine.child.wait().unwrap();
}

#[test]
fn it_ends_with_its_input_while_it_computes() {
    let (mut engine, _folder) = started("input-ends");
    computes(engine.child.id());
    sleep(Duration::from_secs(1));
    assert!(engine.child.try_wait().unwrap().is_none(), "it computes");
    drop(engine.child.stdin.take());
    let mut waited = Duration::ZERO;
    let status = loop {
        if let Some(status) = engine.child.try_wait().unwrap() {
            break status;
        }
        sleep(Duration::from_millis(10));
        waited += Duration::from_millis(10);
        assert!(waited < PATIENCE, "it still runs");
    };
    assert_eq!(status.code(), Some(3));
}

#[test]
fn too_much_memory_ends_it_with_the_words_that_the_service_knows() {
    let folder = Folder::new("memory");
    let path = folder.file("a.parquet");
    Trials { first: 0, count: 2000, channels: 784, without_twin: 10 }.write(&path);
    let known = tables(&[path], "run-3");
    let bounds = Bounds { memory_max_bytes: 600 << 20, ..BOUNDS };
    let refusal = "sql: needs more than 600 MiB of memory: select fewer rows or columns";
    for sql in [
        "SELECT array_agg(a.label || b.label) AS l FROM trials a CROSS JOIN trials b CROSS JOIN trials c",
        "SELECT a.fvu * b.fvu AS f FROM trials a CROSS JOIN trials b CROSS JOIN trials c ORDER BY f",
        "SELECT a.voltages_v FROM frames a CROSS JOIN frames b ORDER BY a.trial_id, b.trial_id",
        "SELECT lpad(label, 1000000, 'x') AS l FROM trials",
        "SELECT DISTINCT a.fvu * b.fvu * c.fvu AS f FROM trials a, trials b, trials c",
    ] {
        match ask(sql, &known, bounds) {
            Outcome::Ended(status, said) => {
                // The service makes its refusal of these.
                assert_eq!(status.signal(), Some(SIGABRT), "{sql}: {said}");
                let last: Vec<&str> = said.lines().rev().take(8).collect();
                assert!(
                    last.iter().any(|line| {
                        line.contains("memory allocation")
                            || line.contains("failed to initiate panic")
                    }),
                    "{sql}: {said}"
                );
            }
            Outcome::Refused(words) => assert_eq!(words, refusal, "{sql}"),
            other => panic!("{sql}: {other:?}"),
        }
    }
    // The bound is not in the way of a small result. With the stack of a parser that has ended, or with
    // two, half of these failed.
    for _ in 0..5 {
        let bounds = Bounds { memory_max_bytes: 500 << 20, ..BOUNDS };
        assert_eq!(ask("SELECT count(*) FROM voltages", &known, bounds).rows().height(), 1);
    }
}
