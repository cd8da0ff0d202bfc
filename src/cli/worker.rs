//! `palpate worker`: becomes the program `palpate-worker`, which makes chunks of bulk work over PostgreSQL.
//! Uses: `program`, which finds or builds it. Never: queue or store, which that program alone knows.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

use clap::Args;

use super::error::{CliError, CliResult};
use super::progress::Working;
use crate::api::WORKER;

/// Variable by which the worker finds this program, which makes the bytes of a chunk.
const MAKER: &str = "PALPATE_PROGRAM";

/// Options of `worker`: those of the program.
#[derive(Debug, Clone, Args)]
#[command(disable_help_flag = true)]
pub struct WorkerArgs {
    /// setup, submit, work, status, cancel or fetch, with its options; --help shows them.
    #[arg(value_name = "COMMAND", trailing_var_arg = true, allow_hyphen_values = true)]
    words: Vec<OsString>,
}

/// Runs `palpate worker`; returns only if the program could not be started.
///
/// # Errors
/// `CliError` if there is no such program, and it cannot be built or started.
pub async fn worker(args: WorkerArgs) -> CliResult<()> {
    let shown = Working::on("building the worker: once, some minutes");
    let found = WORKER.path(|line| shown.step(line), || false).await;
    drop(shown);
    // A path is absent only if a build was stopped, which nothing requests here.
    let program = found?.ok_or_else(|| WORKER.missing())?;
    let mut command = Command::new(&program);
    if std::env::var_os(MAKER).is_none()
        && let Ok(own) = std::env::current_exe()
    {
        command.env(MAKER, own);
    }
    let source = command.args(args.words).exec();
    Err(CliError::File { path: program, source })
}
