//! The trainer's process: found or built, started on a job's folder, followed to its end.
//! Uses: `learn::order`, processes. Never: what is trained (`training`); a secret in the trainer's environment.
//!
//! ```text
//! service                      palpate-trainer FOLDER
//!   order.json             ->    reads it, locks the folder
//!   Watch               <-  stdout, one JSON line per event
//!   closes stdin           ->    checkpoint.bin, then ends (also if the service died)
//! ```

mod end;

use std::io;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::process::{ChildStdin, Command};
use tokio::time::Instant;

use self::end::end_of;
pub use self::end::{Ended, TrainerEnd};
use crate::jobs::Watch;
use crate::learn::order::{Event, STOP_LINE};
use crate::program::{Known, Lines, ProgramError, STOP_POLL, withhold};

static TRAINER: Known = Known {
    name: "palpate-trainer",
    variable: "PALPATE_TRAINER",
    folder: "trainer",
    workspace: "",
    about: "the trainer",
};
/// Phase of a job while the trainer is built.
const BUILDING: &str = "building the trainer: once, some minutes";

/// Settings of glibc's allocator, by which the trainer keeps the memory that a step frees. By default the kernel
/// gets it back, and clears it again for the next step (docs/figures.md, "Where the time of a step goes").
const KEEPS_MEMORY: [(&str, &str); 3] = [
    // Blocks over 64 MB do not fit into the arenas of other threads, and would be returned at once.
    ("MALLOC_ARENA_MAX", "1"),
    ("MALLOC_MMAP_MAX_", "0"),
    // Bytes: 1 TiB, never.
    ("MALLOC_TRIM_THRESHOLD_", "1099511627776"),
];

/// Time from a request to stop to the end by force: one batch and a checkpoint take less.
const STOP_MAX: Duration = Duration::from_secs(20);

/// Why a trainer did not train.
#[derive(Debug, thiserror::Error)]
pub enum TrainerError {
    /// There is no trainer, and it cannot be built.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// The process could not be started.
    #[error(
        "starting the trainer {}: {source}; {} may name another one", program.display(), TRAINER.variable
    )]
    Start { program: PathBuf, source: io::Error },
    /// The process ended without a result.
    #[error("the trainer {0}")]
    Ended(TrainerEnd),
    /// The trainer reported why it failed.
    #[error("{0}")]
    Failed(String),
}

/// Path of the trainer, which is built if it must be; `None` if the job was stopped meanwhile.
///
/// # Errors
/// `TrainerError` if there is none and it cannot be built.
pub async fn path(watch: &Watch) -> Result<Option<PathBuf>, TrainerError> {
    let seen = |line: &str| watch.phase(&format!("{BUILDING}: {line}"), 0);
    Ok(TRAINER.path(seen, || watch.is_stopped()).await?)
}

/// Runs the trainer on a job's folder; `seen` receives its events. If this future is dropped, or this
/// process ends, the trainer writes a checkpoint and ends.
///
/// # Errors
/// `TrainerError` if it cannot be started, fails, or ends without a result.
pub async fn run(
    program: &Path,
    folder: &Path,
    watch: &Watch,
    mut seen: impl FnMut(Event),
) -> Result<Ended, TrainerError> {
    let mut command = Command::new(program);
    command.arg(folder).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.envs(KEEPS_MEMORY);
    withhold(command.as_std_mut());
    // Ctrl-C in a terminal is for the service, which then stops its trainer in order.
    command.process_group(0);
    let failed = |source| TrainerError::Start { program: program.into(), source };
    let mut child = command.spawn().map_err(failed)?;
    let mut input = child.stdin.take();
    let mut lines = Lines::of(child.stdout.take());
    let errors = tokio::spawn(Lines::of(child.stderr.take()).last());
    let mut reported = None;
    let mut look = tokio::time::interval(STOP_POLL);
    let mut kill_at = None;
    loop {
        tokio::select! {
            line = lines.next() => {
                let Some(line) = line else { break };
                match serde_json::from_str(&line) {
                    Ok(event @ (Event::Done | Event::Stopped | Event::Failed { .. })) => {
                        reported = Some(event);
                    }
                    Ok(event) => seen(event),
                    Err(error) => tracing::warn!(%error, line, "the trainer wrote an unknown line"),
                }
            }
            _ = look.tick() => {
                if watch.is_stopped() && let Some(input) = input.take() {
                    request_stop(input).await;
                    kill_at = Some(Instant::now() + STOP_MAX);
                }
                if kill_at.is_some_and(|at| Instant::now() >= at) {
                    kill_at = None;
                    tracing::warn!("the trainer did not stop within 20 s, and is killed");
                    child.start_kill().map_err(failed)?;
                }
            }
        }
    }
    let status = child.wait().await.map_err(failed)?;
    let said = errors.await.unwrap_or_default();
    end_of(reported, status, watch.is_stopped(), said)
}

/// Requests the end; the input is closed even if the line cannot be written.
async fn request_stop(mut input: ChildStdin) {
    // A trainer that has already ended reads nothing.
    let _ = input.write_all(format!("{STOP_LINE}\n").as_bytes()).await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_trainer_that_cannot_be_started_is_named() {
        let watch = Watch::default();
        let none = Path::new("/none/palpate-trainer");
        let error = run(none, Path::new("/tmp"), &watch, |_| {}).await.unwrap_err().to_string();
        for words in ["/none/palpate-trainer", "PALPATE_TRAINER"] {
            assert!(error.contains(words), "{error}");
        }
    }

    #[tokio::test]
    async fn a_trainer_keeps_the_memory_that_it_frees() {
        let folder = tempfile::tempdir().unwrap();
        let script = folder.path().join("script");
        let set = "$MALLOC_ARENA_MAX $MALLOC_MMAP_MAX_ $MALLOC_TRIM_THRESHOLD_";
        let line = format!(r#"echo "{{\"event\":\"failed\",\"error\":\"{set}\"}}""#);
        // As if `sh` were a trainer, and its script the folder.
        std::fs::write(&script, line).unwrap();
        let ended = run(Path::new("/bin/sh"), &script, &Watch::default(), |_| {}).await;
        assert_eq!(ended.unwrap_err().to_string(), "1 0 1099511627776");
    }
}
