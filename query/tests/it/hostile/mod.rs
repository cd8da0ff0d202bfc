//! Statements that no person should send: each is refused, answered, or ended, and changes nothing.
//! Uses: `common`, the built program; the statements of `forbidden`, `large` and `odd`. Never: a file or an
//! address outside of the test.

mod forbidden;
mod large;
mod odd;

use std::io::ErrorKind;
use std::net::TcpListener;
use std::os::unix::process::ExitStatusExt;
use std::time::Duration;

use polars::prelude::{Column, DataFrame};

use crate::common::{Bounds, Folder, Outcome, Trials, ask, tables, text};

/// Largest result, so that a longer one is refused.
const ROWS_MAX: u64 = 1000;
/// Longest time of a statement that may take any; then this test ends the program, as the service does.
const TIME_MAX: Duration = Duration::from_secs(3);
/// Longest time of another one: far more than it takes.
const PATIENCE: Duration = Duration::from_secs(60);
/// With the stack of a thread, 256 MiB.
const MEMORY_MAX_BYTES: u64 = 768 << 20;
const SIGABRT: i32 = 6;
/// Number in a file that no statement may read.
const SECRET: u64 = 271_828_182;

const GOOD: &str = "SELECT tips, count(*) AS n FROM trials GROUP BY tips ORDER BY tips";
const GOOD_ROWS: &str = "0 | 50\n1 | 50\n2 | 50\n3 | 50";

/// Required outcome of a statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    /// A refusal.
    Refused,
    /// Rows, at most `ROWS_MAX`.
    Answered,
    /// Any of them, or the end of the program for lack of memory, stack or time.
    Bounded,
}

use Expected::{Answered, Bounded, Refused};

/// Statements of one kind: its name, their required outcome, their texts.
type Kind = (&'static str, Expected, Vec<String>);

fn kind(name: &'static str, expected: Expected, statements: &[&str]) -> Kind {
    (name, expected, statements.iter().map(ToString::to_string).collect())
}

fn kinds(secret: &str, address: &str) -> Vec<Kind> {
    [forbidden::kinds(secret, address), large::kinds(), odd::kinds()].concat()
}

/// Why an outcome is not the expected one.
fn wrong(expected: Expected, outcome: &Outcome) -> Option<String> {
    let shown = || format!("{outcome:?}").chars().take(300).collect::<String>();
    let clean = |words: &str| {
        let debug = words.contains("Span(") || words.contains("Ident") || words.contains('\n');
        words.starts_with("sql: ") && words.chars().count() <= 300 && !debug
    };
    let fine = match outcome {
        Outcome::Refused(words) if !clean(words) => return Some(format!("unclear: {}", shown())),
        Outcome::Refused(_) => expected != Answered,
        Outcome::Rows(rows) => {
            let is_plain =
                |column: &Column| column.dtype().is_integer() || column.dtype().is_string();
            let plain = rows.columns().iter().filter(|column| is_plain(column)).cloned();
            let plain = DataFrame::new(rows.height(), plain.collect()).unwrap();
            let secret = text(&plain).contains(&SECRET.to_string());
            expected != Refused && rows.height() as u64 <= ROWS_MAX && !secret
        }
        Outcome::Ended(status, said) => {
            // As the service knows them.
            let memory = ["memory allocation", "failed to initiate panic"];
            let memory = memory.iter().any(|words| said.contains(words));
            let stack = said.contains("overflowed its stack");
            expected == Bounded && status.signal() == Some(SIGABRT) && (memory || stack)
        }
        Outcome::Killed => expected == Bounded,
    };
    (!fine).then(shown)
}

#[test]
fn hostile_statements_are_refused_or_bounded_and_change_nothing() {
    let folder = Folder::new("hostile");
    let [path, secret] = ["trials.parquet", "secret.parquet"].map(|name| folder.file(name));
    Trials { first: 0, count: 200, channels: 784, without_twin: 10 }.write(&path);
    Trials { first: SECRET, count: 1, channels: 0, without_twin: 10 }.write(&secret);
    let before = std::fs::read(&path).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let known = tables(std::slice::from_ref(&path), "run-3");
    let bounds = Bounds {
        rows_max: ROWS_MAX,
        memory_max_bytes: MEMORY_MAX_BYTES,
        time_max: PATIENCE,
        threads: 2,
    };

    let kinds = kinds(&secret.display().to_string(), &address);
    let count: usize = kinds.iter().map(|(_, _, statements)| statements.len()).sum();
    assert!(count >= 400, "{count} statements");
    let mut failures = Vec::new();
    for (name, expected, statements) in &kinds {
        let mut sums = [0; 5];
        for sql in statements {
            let time_max = if *expected == Bounded { TIME_MAX } else { PATIENCE };
            let outcome = ask(sql, &known, Bounds { time_max, ..bounds });
            sums[match &outcome {
                Outcome::Refused(_) => 0,
                Outcome::Rows(_) => 1,
                Outcome::Ended(_, said) if said.contains("overflowed its stack") => 3,
                Outcome::Ended(..) => 2,
                Outcome::Killed => 4,
            }] += 1;
            if let Some(found) = wrong(*expected, &outcome) {
                let start: String = sql.chars().take(150).collect();
                failures.push(format!("{name}: {start}: {expected:?}, but {found}"));
            }
        }
        let [refused, answered, memory, stack, killed] = sums;
        println!(
            "{name}: {} statements: {refused} refused, {answered} answered, {memory} out of memory, \
             {stack} out of stack, {killed} out of time",
            statements.len()
        );
        assert_eq!(text(&ask(GOOD, &known, bounds).rows()), GOOD_ROWS, "after {name}");
    }
    assert!(failures.is_empty(), "{} of {count}:\n{}", failures.len(), failures.join("\n"));
    assert_eq!(listener.accept().unwrap_err().kind(), ErrorKind::WouldBlock, "a connection");
    assert!(std::fs::read(&path).unwrap() == before, "the file has changed");
}
