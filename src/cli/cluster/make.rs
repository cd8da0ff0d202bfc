//! `palpate cluster make`: makes chunks, one after the other, with Ctrl-C and SIGTERM as requests.
//! Uses: `makers`, `kind`, `lines`. Never: a decision about a byte of a chunk.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::Args;
use serde_json::json;
use tokio::time::{Instant, sleep_until};

use super::job::chunks_of;
use super::kind::ChunkMeans;
use super::lines;
use super::makers::{MadeChunk, Makers, StopRequest};
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::WorkOrder;
use crate::cli::data_or_default;
use crate::cli::error::{CliError, CliResult};
use crate::cli::next::{Next, word};
use crate::cli::output::{bytes, counted, duration, grouped, note, say, say_json};
use crate::cli::progress::Counted;
use crate::cli::signals::Signals;
use crate::cli::simulate::request::threads;

/// Time that a chunk may still take after a request to stop; Slurm kills a task 30 s after its SIGTERM.
const CHUNK_GRACE: Duration = Duration::from_secs(20);

/// Options of `cluster make`.
#[derive(Debug, Clone, Args)]
pub struct MakeArgs {
    /// Folder of the work order.
    #[arg(value_name = "FOLDER", required_unless_present = "lines")]
    folder: Option<PathBuf>,
    /// Indexes of the chunks, from 0.
    #[arg(value_name = "INDEX", required_unless_present_any = ["task", "lines"])]
    indexes: Vec<u64>,
    /// Make the chunks I, I + T, I + 2 T, .. of the array task I, from 0.
    #[arg(long, value_name = "I", requires = "tasks", conflicts_with = "indexes")]
    task: Option<u64>,
    /// Number T of tasks of the array.
    #[arg(long, value_name = "T", requires = "task")]
    tasks: Option<u64>,
    /// Make the chunk of each line of standard input, {"folder": DIR, "index": N}, and answer each line with one of
    /// JSON: key, index, sha256, bytes, rows and wall_ms, or index and error.
    #[arg(long, conflicts_with_all = ["folder", "task", "tasks", "json"])]
    lines: bool,
    /// Number of threads that make a chunk [default: the machine's cores]; they change no byte.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder whose `cache` contains solved unit responses, and the frames of a net while it trains
    /// [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Print one line of JSON per chunk, and a last one with totals, on standard output.
    #[arg(long)]
    json: bool,
}

/// Runs the command. Exit code: 0 all of these chunks are done, 1 failed or stopped, 2 bad input.
///
/// # Errors
/// `CliError` if an option is invalid, or the work order cannot be opened.
pub async fn make(args: MakeArgs) -> CliResult<ExitCode> {
    let mut signals = Signals::catch()?;
    let stop = Arc::new(StopRequest::default());
    let mut work = tokio::task::spawn_blocking({
        let stop = stop.clone();
        move || work(&args, &stop)
    });
    let mut grace_until: Option<Instant> = None;
    loop {
        let grace = sleep_until(grace_until.unwrap_or_else(Instant::now));
        tokio::select! {
            made = &mut work => {
                return made.unwrap_or_else(|e| std::panic::resume_unwind(e.into_panic()));
            }
            () = grace, if grace_until.is_some() => {
                stop.within_chunk.store(true, Ordering::Relaxed);
                grace_until = None;
            }
            _ = signals.next() => match stop.after_chunk.swap(true, Ordering::Relaxed) {
                true => stop.within_chunk.store(true, Ordering::Relaxed),
                false => {
                    note("stopping after this chunk; Ctrl-C again stops within it");
                    grace_until = Some(Instant::now() + CHUNK_GRACE);
                }
            },
        }
    }
}

fn work(args: &MakeArgs, stop: &StopRequest) -> CliResult<ExitCode> {
    let data = data_or_default(args.data.clone());
    let mut makers = Makers::new(ChunkMeans { threads: threads(args.threads)?, data });
    match &args.folder {
        Some(folder) => all(folder, args, &mut makers, stop),
        None => lines::answer(&mut makers, stop),
    }
}

/// Makes the chunks that the options name.
fn all(
    folder: &Path,
    args: &MakeArgs,
    makers: &mut Makers,
    stop: &StopRequest,
) -> CliResult<ExitCode> {
    let folder = OrderFolder::open(folder)?;
    let indexes = indexes(args, folder.order())?;
    let _at_work = folder.at_work()?;
    let mut screen = Screen::new(indexes.len() as u64, args.json);
    for index in indexes {
        if stop.is_after_chunk() {
            break;
        }
        match makers.make(&folder, index, stop) {
            Ok(Some(made)) => screen.made(&made),
            Ok(None) => break,
            Err(CliError::Chunk(error)) if error.is_of_one_chunk() => {
                screen.failed(index, &error.to_string());
            }
            Err(error) => return Err(error),
        }
    }
    Ok(screen.end(&folder))
}

/// Indexes of the chunks that the options name.
fn indexes(args: &MakeArgs, order: &WorkOrder) -> CliResult<Vec<u64>> {
    let (Some(task), Some(tasks)) = (args.task, args.tasks) else {
        let last = order.chunks - 1;
        return match args.indexes.iter().find(|index| **index > last) {
            Some(index) => {
                Err(CliError::argument("index", index, format!("must be from 0 to {last}")))
            }
            None => Ok(args.indexes.clone()),
        };
    };
    if tasks == 0 {
        return Err(CliError::argument("tasks", tasks, "must be at least 1"));
    }
    if task >= tasks {
        return Err(CliError::argument("task", task, format!("must be from 0 to {}", tasks - 1)));
    }
    Ok(chunks_of(task, tasks, order.chunks).collect())
}

/// Output: standard error for people, standard output for scripts.
struct Screen {
    shown: Counted,
    json: bool,
    chunks: u64,
    done: u64,
    made: u64,
    failed: u64,
    rows: u64,
    bytes: u64,
    started: std::time::Instant,
}

impl Screen {
    fn new(chunks: u64, json: bool) -> Self {
        let (shown, started) = (Counted::of("chunks", chunks), std::time::Instant::now());
        Self { shown, json, chunks, done: 0, made: 0, failed: 0, rows: 0, bytes: 0, started }
    }

    fn made(&mut self, chunk: &MadeChunk) {
        self.done += 1;
        if chunk.is_new {
            self.made += 1;
            self.rows += chunk.row.rows;
            self.bytes += chunk.row.bytes;
        }
        self.shown.add(1);
        if self.json {
            let mut line = json!(chunk.row);
            line["event"] = "chunk".into();
            line["made"] = chunk.is_new.into();
            say_json(&line);
        }
    }

    fn failed(&mut self, index: u64, error: &str) {
        self.failed += 1;
        self.shown.add(1);
        self.shown.bar.suspend(|| note(error));
        if self.json {
            say_json(&json!({ "event": "failed", "index": index, "error": error }));
        }
    }

    /// Reports the end; returns the exit code.
    fn end(&self, folder: &OrderFolder) -> ExitCode {
        self.shown.bar.finish_and_clear();
        let wall_s = self.started.elapsed().as_secs_f64();
        let (code, status, end) = match (self.done == self.chunks, self.failed) {
            (true, _) => (ExitCode::SUCCESS, "success", String::new()),
            (false, 0) => (ExitCode::FAILURE, "abort", "stopped: ".into()),
            (false, failed) => (ExitCode::FAILURE, "fail", format!("{failed} failed: ")),
        };
        if self.json {
            say_json(&json!({
                "event": "finished",
                "exit_status": status,
                "chunks": self.chunks,
                "done": self.done,
                "made": self.made,
                "failed": self.failed,
                "rows": self.rows,
                "bytes": self.bytes,
                "duration_s": wall_s,
                "folder": folder.path(),
            }));
            return code;
        }
        say(format_args!(
            "{end}{} of {} done; {} made in {}: {} rows, {}",
            self.done,
            counted(self.chunks, "chunk", "chunks"),
            self.made,
            duration(wall_s),
            grouped(self.rows),
            bytes(self.bytes as f64),
        ));
        let folder = word(&folder.path().display().to_string());
        Next::default()
            .suggest(format_args!("palpate cluster status {folder}"), "shows what is done")
            .say();
        code
    }
}
