//! The engine's process: built when first needed, started for a query, killed with it.
//! Uses: `words::{program, query_lines}`, tokio's processes. Never: rows (`rows` reads them).

use std::fs::File;
use std::io::{Cursor, Read};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::task::JoinHandle;

use super::error::QueryError;
use crate::program::{Known, Lines, Program, withhold};
use crate::query_lines::{Answer, LINES_VERSION, Order, Table};

/// The program of the engine.
pub static QUERY: Known = Known {
    name: "palpate-query",
    variable: "PALPATE_QUERY",
    folder: "query",
    workspace: "query",
    about: "the query engine",
};
/// Largest memory of an engine, bytes.
pub const MEMORY_MAX_BYTES: u64 = 2 << 30;
/// Threads of an engine, unless a run is driven.
pub const ENGINE_THREADS: usize = 2;
/// The signals of a failed allocation, and of a stack that is too small.
const ABORT: i32 = 6;
const SEGV: i32 = 11;

/// Finds the engine, or builds it in the background.
#[derive(Debug, Default)]
pub struct Starter {
    /// What cargo does; absent unless it runs.
    building: Arc<Mutex<Option<String>>>,
    failed: Arc<Mutex<Option<String>>>,
}

impl Starter {
    /// Returns the path of the engine. Starts building it if it must be built.
    ///
    /// # Errors
    /// `QueryError::Building` while it is built; `Program` if it is missing, or once after a build has
    /// failed.
    pub fn program(&self) -> Result<PathBuf, QueryError> {
        if let Some(failed) = self.failed.lock().take() {
            return Err(QueryError::Program(failed));
        }
        let mut building = self.building.lock();
        if let Some(line) = building.as_ref() {
            return Err(QueryError::Building(line.clone()));
        }
        match QUERY.find() {
            Program::Ready(program) => return Ok(program),
            Program::Missing => return Err(QUERY.missing().into()),
            Program::Source(_) => *building = Some("starting".into()),
        }
        let (shown, failed) = (self.building.clone(), self.failed.clone());
        tokio::spawn(async move {
            let seen = |line: &str| *shown.lock() = Some(line.to_owned());
            if let Err(error) = QUERY.path(seen, || false).await {
                *failed.lock() = Some(error.to_string());
            }
            *shown.lock() = None;
        });
        Err(QueryError::Building("starting".into()))
    }
}

/// A refusal of the engine; the key that it names is that of the statement.
fn refused(words: &str) -> QueryError {
    QueryError::Refused(words.strip_prefix("sql: ").unwrap_or(words).to_owned())
}

/// A running engine; it is killed when this is dropped.
pub struct Engine {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    said: JoinHandle<String>,
}

impl Engine {
    /// Starts an engine with this number of threads on a statement; returns it with the tables that the statement reads.
    ///
    /// # Errors
    /// `QueryError::Refused` if the statement is invalid, `Talk` or `Ended` if the engine fails.
    pub async fn start(
        program: &Path,
        sql: &str,
        rows_max: u64,
        threads: usize,
    ) -> Result<(Self, Vec<String>), QueryError> {
        let mut command = Command::new(program);
        withhold(command.as_std_mut());
        command.env("POLARS_MAX_THREADS", threads.to_string());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C in a terminal is for the service.
        command.process_group(0).kill_on_drop(true);
        let mut child = command.spawn()?;
        let gone = || std::io::Error::other("it has no input or output");
        let input = child.stdin.take().ok_or_else(gone)?;
        let output = BufReader::new(child.stdout.take().ok_or_else(gone)?);
        let said = tokio::spawn(Lines::of(child.stderr.take()).last());
        let mut engine = Self { child, input, output, said };
        let order = Order {
            version: LINES_VERSION,
            sql: sql.to_owned(),
            rows_max,
            memory_max_bytes: MEMORY_MAX_BYTES,
        };
        engine.say(&order).await?;
        match engine.hear().await? {
            Answer::Tables(tables) => Ok((engine, tables)),
            Answer::Refused(words) => Err(refused(&words)),
            Answer::Rows(_) => Err(QueryError::Ended("sent rows before it had tables".into())),
        }
    }

    /// Evaluates the statement over its tables; returns the engine, which sends the rows next, and
    /// their number.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn evaluate(mut self, tables: &[Table]) -> Result<(Self, u64), QueryError> {
        self.say(&tables).await?;
        match self.hear().await? {
            Answer::Rows(count) => Ok((self, count)),
            Answer::Refused(words) => Err(refused(&words)),
            Answer::Tables(_) => Err(QueryError::Ended("named its tables again".into())),
        }
    }

    /// Takes the output, for a thread that waits, and what keeps the engine alive.
    ///
    /// # Errors
    /// `QueryError::Talk` if the output cannot be read by a thread.
    pub fn into_output(self) -> Result<(impl Read + Send, (Child, ChildStdin)), QueryError> {
        let read = self.output.buffer().to_vec();
        let rest = File::from(self.output.into_inner().into_owned_fd()?);
        Ok((Cursor::new(read).chain(rest), (self.child, self.input)))
    }

    async fn say<T: serde::Serialize + ?Sized>(&mut self, line: &T) -> Result<(), QueryError> {
        let mut line = serde_json::to_vec(line).map_err(std::io::Error::from)?;
        line.push(b'\n');
        // If the engine has ended, `hear` returns the cause.
        let _ = self.input.write_all(&line).await;
        Ok(())
    }

    async fn hear(&mut self) -> Result<Answer, QueryError> {
        let mut line = String::new();
        self.output.read_line(&mut line).await?;
        match serde_json::from_str(&line) {
            Ok(answer) => Ok(answer),
            Err(_) if line.is_empty() => Err(self.end().await),
            Err(error) => Err(QueryError::Ended(format!("sent an unknown line: {error}"))),
        }
    }

    /// Why it ended without an answer.
    async fn end(&mut self) -> QueryError {
        let status = match self.child.wait().await {
            Ok(status) => status,
            Err(error) => return error.into(),
        };
        let said = (&mut self.said).await.unwrap_or_default();
        // With its memory exhausted, the engine may not be able to begin a panic.
        let memory = ["memory allocation", "failed to initiate panic"];
        match status.signal() {
            Some(ABORT) if memory.iter().any(|words| said.contains(words)) => {
                QueryError::Refused(format!(
                    "needs more than {} MiB of memory: select fewer rows or columns",
                    MEMORY_MAX_BYTES >> 20
                ))
            }
            Some(SEGV | ABORT) if said.contains("overflowed its stack") => {
                QueryError::Refused("the statement is nested too deeply".into())
            }
            _ => QueryError::Ended(format!("ended ({status}) without an answer: {said}")),
        }
    }
}
