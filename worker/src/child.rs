//! The program that makes chunks: `palpate cluster make --lines` as a child process.
//! Uses: tokio's processes. Never: an address or a secret in the environment of the child.
//!
//! It reads one line `{"folder":..,"index":n}` for a chunk and answers one line. It ends when its standard
//! input is closed, also because this process was killed.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use serde::Deserialize;
use serde_json::json;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::time::timeout;

use crate::order::Done;

/// Longest line of an answer, bytes.
const LINE_BYTES_MAX: u64 = 1 << 20;
/// Last lines of standard error that an error shows.
const TAIL_LINES: usize = 5;
/// Time in which a child ends after its standard input was closed.
const END: Duration = Duration::from_secs(10);
/// Exit code of a program that does not know its options: that of another version.
const REFUSED: i32 = 2;
/// Variables that a child must not see.
const SECRET: [&str; 4] = ["PALPATE_QUEUE", "PALPATE_STORE", "AWS_", "PG"];

/// Answer to one chunk.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Answer {
    Failed {
        error: String,
        /// Whether another machine may not have the error.
        #[serde(default)]
        machine: bool,
    },
    Done(Done),
}

/// Why a chunk was not made.
#[derive(Debug, thiserror::Error)]
pub enum MakeError {
    /// The program reported an error of this chunk, died while it made it, or took too long.
    #[error("{0}")]
    Chunk(String),
    /// Program, store or disk of this machine cannot be used; another machine may make the chunk.
    #[error("{0}")]
    Machine(String),
    /// The program of this machine refuses the order, or the store does not have it. If every machine does, the
    /// order is the cause.
    #[error("{0}")]
    Refused(String),
}

/// The program, started when a chunk needs it and again after it has ended.
#[derive(Debug)]
pub struct Maker {
    program: PathBuf,
    threads: usize,
    limit: Duration,
    running: Option<Running>,
}

#[derive(Debug)]
struct Running {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    tail: Arc<Mutex<VecDeque<String>>>,
}

impl Maker {
    /// A program with a number of threads, which gets `limit` for a chunk.
    pub fn new(program: PathBuf, threads: usize, limit: Duration) -> Self {
        Self { program, threads, limit, running: None }
    }

    /// Has the program make a chunk of the order in `folder`. If the future is dropped, the program still makes the
    /// chunk: `kill` must follow.
    ///
    /// # Errors
    /// `MakeError::Machine` if the program cannot be started, or refuses its options; `Refused` if it refuses the
    /// order; `Chunk` otherwise.
    pub async fn make(&mut self, folder: &Path, index: u64) -> Result<Done, MakeError> {
        let running = match self.running.take() {
            Some(running) => running,
            None => self.start()?,
        };
        // It stays here meanwhile, where `kill` finds it.
        let running = self.running.insert(running);
        let line = match timeout(self.limit, running.ask(folder, index)).await {
            Ok(Ok(line)) => line,
            Ok(Err(error)) => {
                let died = running.died(&error).await;
                self.running = None;
                return Err(died);
            }
            Err(_) => {
                self.kill().await;
                let seconds = self.limit.as_secs();
                return Err(MakeError::Chunk(format!(
                    "no answer within {seconds} s: killed; --limit-s may be larger"
                )));
            }
        };
        let answer = match serde_json::from_str::<Answer>(&line) {
            Ok(answer) => answer,
            Err(error) => {
                self.kill().await;
                let text = format!("unknown answer {}: {error}", clipped(&line));
                return Err(MakeError::Chunk(text));
            }
        };
        match answer {
            Answer::Done(done) => Ok(done),
            Answer::Failed { error, machine } => {
                Err(if machine { MakeError::Refused(error) } else { MakeError::Chunk(error) })
            }
        }
    }

    fn start(&self) -> Result<Running, MakeError> {
        let failed = |what: &str| MakeError::Machine(format!("{}: {what}", self.program.display()));
        let mut command = Command::new(&self.program);
        command.args(["cluster", "make", "--lines", "--threads", &self.threads.to_string()]);
        for (name, _) in std::env::vars_os() {
            if name.to_str().is_some_and(|name| SECRET.iter().any(|start| name.starts_with(start)))
            {
                command.env_remove(name);
            }
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C in a terminal is for the worker, which lets the chunk end.
        command.process_group(0).kill_on_drop(true);
        let mut child = command.spawn().map_err(|error| failed(&error.to_string()))?;
        let (Some(input), Some(output), Some(errors)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(failed("no pipes"));
        };
        let tail = Arc::new(Mutex::new(VecDeque::new()));
        tokio::spawn(read_errors(errors, tail.clone()));
        Ok(Running { child, input, output: BufReader::new(output), tail })
    }

    /// Ends the program.
    pub async fn end(&mut self) {
        let Some(Running { mut child, input, .. }) = self.running.take() else { return };
        drop(input);
        if timeout(END, child.wait()).await.is_err() {
            drop(child.kill().await);
        }
    }

    /// Kills the program, and waits until it has ended: afterwards it writes no file.
    pub async fn kill(&mut self) {
        let Some(Running { mut child, .. }) = self.running.take() else { return };
        if timeout(END, child.kill()).await.is_err() {
            tracing::warn!("the program still runs, although it was killed");
        }
    }
}

impl Running {
    /// Sends one line and returns the next one.
    async fn ask(&mut self, folder: &Path, index: u64) -> std::io::Result<String> {
        let request = format!("{}\n", json!({ "folder": folder, "index": index }));
        self.input.write_all(request.as_bytes()).await?;
        self.input.flush().await?;
        let mut line = String::new();
        (&mut self.output).take(LINE_BYTES_MAX).read_line(&mut line).await?;
        if line.ends_with('\n') { Ok(line) } else { Err(std::io::ErrorKind::UnexpectedEof.into()) }
    }

    /// How the program ended, with its last lines.
    async fn died(&mut self, error: &std::io::Error) -> MakeError {
        let mut refuses = false;
        let how = match timeout(END, self.child.wait()).await {
            Ok(Ok(status)) => {
                refuses = status.code() == Some(REFUSED);
                status.to_string()
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => {
                drop(self.child.kill().await);
                error.to_string()
            }
        };
        // Its last lines may still be in the pipe.
        tokio::time::sleep(Duration::from_millis(50)).await;
        let tail = self.tail.lock();
        let last: Vec<&str> = tail.iter().map(String::as_str).collect();
        let text =
            format!("the program ended while it made this chunk ({how}): {}", last.join(" | "));
        if refuses { MakeError::Machine(text) } else { MakeError::Chunk(text) }
    }
}

/// Passes on what the program writes to standard error, and keeps its last lines.
async fn read_errors(errors: impl AsyncRead + Unpin, tail: Arc<Mutex<VecDeque<String>>>) {
    let mut errors = BufReader::new(errors);
    loop {
        let mut line = Vec::new();
        match (&mut errors).take(LINE_BYTES_MAX).read_until(b'\n', &mut line).await {
            Ok(1..) => (),
            Ok(0) | Err(_) => return,
        }
        let line = clipped(&String::from_utf8_lossy(&line));
        tracing::info!("palpate: {line}");
        let mut tail = tail.lock();
        tail.push_back(line);
        if tail.len() > TAIL_LINES {
            tail.pop_front();
        }
    }
}

/// The first part of a text, on one line.
pub fn clipped(text: &str) -> String {
    const CHARACTERS: usize = 500;
    text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }).take(CHARACTERS).collect()
}

/// The program that makes chunks: the stated one, that of PALPATE_PROGRAM, `palpate` next to this program, or
/// `palpate` in PATH.
pub fn program(stated: Option<PathBuf>) -> PathBuf {
    let of_environment =
        || std::env::var_os("PALPATE_PROGRAM").filter(|path| !path.is_empty()).map(PathBuf::from);
    let next_to_this = || {
        let path = std::env::current_exe().ok()?.with_file_name("palpate");
        path.exists().then_some(path)
    };
    stated.or_else(of_environment).or_else(next_to_this).unwrap_or_else(|| "palpate".into())
}
