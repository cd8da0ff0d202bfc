//! The lines to and from the service: an order, the tables that it needs, the rows.
//! Uses: `words::query_lines`, standard input and output. Never: a result after a refusal.

use std::io::{self, BufRead, BufWriter, Write, stdin, stdout};
use std::panic;
use std::process::{self, ExitCode};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use palpate_words::query_lines::{Answer, LINES_VERSION, Order, Table};
use polars::frame::DataFrame;

use crate::{confine, evaluate, polars_errors, statement};

/// Stack of a thread that parses or evaluates: both recurse.
const STACK_BYTES: usize = 256 << 20;
/// Longest time of parsing: some nonsense takes a parser for ever.
const PARSE_MAX: Duration = Duration::from_secs(5);
/// Exit status if the service ended the input.
const INPUT_ENDED: i32 = 3;

/// Serves one query on standard input and output.
pub fn serve() -> ExitCode {
    // The message of a panic becomes the refusal.
    panic::set_hook(Box::new(|_| {}));
    let mut out = BufWriter::new(stdout().lock());
    let answered = match query(&mut out) {
        Ok(rows) => send(&mut out, &rows),
        Err(words) => say(&mut out, &Answer::Refused(words)),
    };
    match answered {
        Ok(()) => ExitCode::SUCCESS,
        // The service no longer reads.
        Err(_) => ExitCode::FAILURE,
    }
}

/// Reads the order and the tables; returns the rows, or why there are none.
fn query(out: &mut impl Write) -> Result<DataFrame, String> {
    let Order { version, sql, rows_max, memory_max_bytes } = line()?;
    if version != LINES_VERSION {
        return Err(format!(
            "palpate-query is of version {LINES_VERSION}, the service of version {version}: build it again"
        ));
    }
    confine::low_priority();
    confine::limits(memory_max_bytes)?;
    let statement = on_deep_stack(Some(PARSE_MAX), memory_max_bytes, move || {
        statement::read(&sql).map_err(|error| error.to_string())
    })?;
    say(out, &Answer::Tables(statement.tables.iter().cloned().collect()))
        .map_err(|error| error.to_string())?;
    let tables: Vec<Table> = line()?;
    // Before any thread starts: they are restricted, too.
    if !confine::files(tables.iter().flat_map(|table| &table.files))? {
        eprintln!("palpate-query: this kernel has no Landlock: no file is closed to this process");
    }
    let lifeline = thread::Builder::new().name("lifeline".into()).spawn(|| {
        // No message follows: the input ends with the service, or when the client has left.
        let _ = io::copy(&mut stdin().lock(), &mut io::sink());
        process::exit(INPUT_ENDED);
    });
    drop(lifeline.map_err(|error| error.to_string())?);
    on_deep_stack(None, memory_max_bytes, move || {
        evaluate::rows(&statement, &tables, rows_max)
            .map_err(|error| error.words(&statement, &tables, memory_max_bytes))
    })
}

/// Works on a thread with a deep stack; a panic, or too much time, becomes a refusal.
fn on_deep_stack<T: Send + 'static>(
    time_max: Option<Duration>,
    memory_max_bytes: u64,
    work: impl FnOnce() -> Result<T, String> + Send + 'static,
) -> Result<T, String> {
    let (sender, done) = mpsc::channel();
    let worker = thread::Builder::new().stack_size(STACK_BYTES).spawn(move || {
        // No receiver waits for a late result.
        let _ = sender.send(work());
    });
    let worker = worker.map_err(|error| error.to_string())?;
    let result = match time_max {
        Some(time_max) => done.recv_timeout(time_max),
        None => done.recv().map_err(RecvTimeoutError::from),
    };
    match (result, time_max) {
        // Its stack counts as memory until it has ended: two of them are most of a small bound.
        (Ok(result), _) => {
            let _ = worker.join();
            return result;
        }
        (Err(RecvTimeoutError::Timeout), Some(time_max)) => {
            return Err(format!("sql: cannot be read in {} s", time_max.as_secs()));
        }
        _ => {}
    }
    let cause = worker.join().err();
    let said = cause.as_ref().and_then(|cause| {
        let text = cause.downcast_ref::<String>().map(String::as_str);
        text.or_else(|| cause.downcast_ref::<&str>().copied())
    });
    Err(polars_errors::of_panic(said.unwrap_or_default(), memory_max_bytes))
}

fn line<T: serde::de::DeserializeOwned>() -> Result<T, String> {
    let mut line = String::new();
    stdin().lock().read_line(&mut line).map_err(|error| error.to_string())?;
    serde_json::from_str(&line).map_err(|error| error.to_string())
}

fn say(out: &mut impl Write, answer: &Answer) -> io::Result<()> {
    serde_json::to_writer(&mut *out, answer)?;
    out.write_all(b"\n")?;
    out.flush()
}

fn send(out: &mut impl Write, rows: &DataFrame) -> io::Result<()> {
    say(out, &Answer::Rows(rows.height() as u64))?;
    evaluate::write(rows, &mut *out)?;
    out.flush()
}
