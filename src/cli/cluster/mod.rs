//! `palpate cluster`: bulk work in chunks, in a folder that several machines share.
//! Uses: `chunk`, the kinds of chunks. Never: Slurm itself (it starts this program); the service and the network, except
//! for what a work order of a table needs (`table`), for the trials and the twins of a run (`twins`), and for the frames
//! and the scores of an evaluation (`evaluation`).

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};

use super::At;
use super::error::CliResult;

mod evaluation;
mod gather;
mod job;
mod kind;
mod lines;
mod make;
mod makers;
mod sbatch;
mod status;
mod table;
mod twins;

/// Options of `cluster`.
#[derive(Debug, Clone, Args)]
pub struct ClusterArgs {
    #[command(subcommand)]
    command: ClusterCommand,
}

/// Steps of bulk work.
#[derive(Debug, Clone, Subcommand)]
pub enum ClusterCommand {
    /// Write a work order and the array job that makes its chunks.
    ///
    /// Nothing is made or submitted. The same command on the same folder changes nothing; a folder of
    /// another order is refused, with the first value that differs.
    Sbatch(sbatch::SbatchArgs),
    /// Make chunks of a work order.
    ///
    /// A chunk that is done and whole stays as it is. Ctrl-C and SIGTERM end the command after the
    /// present chunk, or within it after 20 s; a second one ends it within the chunk. Exit code: 0 all
    /// of these chunks are done, 1 failed or stopped, 2 bad input.
    Make(make::MakeArgs),
    /// Show what is done, failed and missing, and how to submit what is missing.
    Status(status::StatusArgs),
    /// Verify all chunks, and write them as one process would have.
    ///
    /// The folder of Sim-Random has the same files, byte for byte, as if `palpate simulate random` had
    /// made it; that of trainings has a folder for each net, for `palpate evaluate .. --trained`. Twins are
    /// sent to the service with their run, which compares and stores them. Exit code 1 if a chunk is missing
    /// or damaged: each is named.
    Gather(gather::GatherArgs),
}

/// The service that prepares a work order, and the data folder of the nodes.
#[derive(Debug, Clone, Args)]
pub struct OrderPlace {
    /// URL of the service whose runs, datasets and calibrations are used [env: PALPATE_URL] [default:
    /// http://127.0.0.1:8080]; its key is in PALPATE_KEY, or in the file of PALPATE_KEY_FILE.
    #[arg(long, value_name = "URL")]
    url: Option<String>,
    /// Certificate of an https service or of its authority, PEM [env: PALPATE_CA] [default: the
    /// authorities of the system].
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Data folder of a service that this command starts; on the nodes its `cache` contains solved unit
    /// responses, or the frames of a net while it trains [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

impl OrderPlace {
    /// The service of these options, and the form of the output.
    pub fn at(&self, json: bool) -> At {
        let Self { url, ca, data } = self.clone();
        At { url, ca, data, json }
    }
}

/// Runs `palpate cluster`.
///
/// # Errors
/// `CliError` if an input is invalid, or a file cannot be read or written.
pub async fn cluster(args: ClusterArgs) -> CliResult<ExitCode> {
    match args.command {
        ClusterCommand::Sbatch(args) => sbatch::sbatch(&args).await.map(|()| ExitCode::SUCCESS),
        ClusterCommand::Make(args) => make::make(args).await,
        ClusterCommand::Status(args) => status::status(&args).map(|()| ExitCode::SUCCESS),
        ClusterCommand::Gather(args) => gather::gather(&args).await.map(|()| ExitCode::SUCCESS),
    }
}
