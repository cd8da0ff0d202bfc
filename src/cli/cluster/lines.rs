//! `palpate cluster make --lines`: a chunk for each line of standard input, as a worker requests them.
//! Uses: `makers`, a thread that reads standard input. Never: a queue.
//!
//! One line of JSON is answered by one line of JSON, in order. An error that another machine may not have (another
//! version, no kernel of the order, a folder that cannot be read) also has `"machine": true`. The model of the last work
//! order is kept. The command ends when standard input ends, or on a request to stop after the chunk in progress.

use std::io::{self, BufRead, Read};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use serde::Deserialize;
use serde_json::{Value, json};

use super::makers::{Makers, StopRequest};
use crate::chunk::error::ChunkError;
use crate::chunk::folder::OrderFolder;
use crate::cli::error::{CliError, CliResult};
use crate::cli::output::say_json;

/// Longest line, bytes.
const CHUNK_LINE_MAX_BYTES: u64 = 65_536;
/// Interval at which a request to stop is noticed while no line arrives.
const STOP_POLL: Duration = Duration::from_millis(100);

/// A line: the chunk to make.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    folder: PathBuf,
    index: u64,
}

/// Answers the lines of standard input.
///
/// # Errors
/// `CliError::System` if standard input cannot be read.
pub fn answer(makers: &mut Makers, stop: &StopRequest) -> CliResult<ExitCode> {
    let lines = read();
    loop {
        if stop.is_after_chunk() {
            return Ok(ExitCode::SUCCESS);
        }
        match lines.recv_timeout(STOP_POLL) {
            Ok(Ok(line)) if line.trim().is_empty() => {}
            Ok(Ok(line)) => say_json(&made(&line, makers, stop)),
            Ok(Err(source)) => {
                return Err(CliError::System { operation: "reading standard input", source });
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(ExitCode::SUCCESS),
        }
    }
}

/// The answer to a line.
fn made(line: &str, makers: &mut Makers, stop: &StopRequest) -> Value {
    let Asked { folder, index } = match serde_json::from_str(line) {
        Ok(asked) => asked,
        Err(error) => {
            let words = format!("a line must be {{\"folder\": DIR, \"index\": N}}: {error}");
            return json!({ "index": null, "error": words });
        }
    };
    let mut make = || -> CliResult<_> {
        let folder = OrderFolder::open(&folder)?;
        let _at_work = folder.at_work()?;
        makers.make(&folder, index, stop)
    };
    match make() {
        Ok(Some(made)) => {
            let row = made.row;
            json!({ "key": row.key, "index": row.index, "sha256": row.sha256, "bytes": row.bytes,
                "rows": row.rows, "wall_ms": row.wall_ms })
        }
        Ok(None) => json!({ "index": index, "error": "stopped within the chunk" }),
        Err(error) => {
            let mut answer = json!({ "index": index, "error": error.to_string() });
            if !is_of_chunk(&error) {
                answer["machine"] = true.into();
            }
            answer
        }
    }
}

/// Whether an error is that of a chunk on every machine.
fn is_of_chunk(error: &CliError) -> bool {
    use ChunkError::{Index, Make, NotReproduced};
    matches!(error, CliError::Chunk(Index { .. } | Make { .. } | NotReproduced { .. }))
}

/// The lines of standard input, read by a thread that ends with the process: a read cannot be interrupted.
fn read() -> Receiver<io::Result<String>> {
    let (give, take) = sync_channel(1);
    std::thread::spawn(move || {
        let mut input = io::stdin().lock();
        loop {
            let mut line = String::new();
            let read = input.by_ref().take(CHUNK_LINE_MAX_BYTES).read_line(&mut line);
            let line = match read {
                Ok(0) => return,
                Ok(count) if count as u64 == CHUNK_LINE_MAX_BYTES && !line.ends_with('\n') => {
                    let words = format!("a line has at most {CHUNK_LINE_MAX_BYTES} bytes");
                    Err(io::Error::new(io::ErrorKind::InvalidData, words))
                }
                read => read.map(|_| line),
            };
            let is_last = line.is_err();
            if give.send(line).is_err() || is_last {
                return;
            }
        }
    });
    take
}
