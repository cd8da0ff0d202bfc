//! `palpate simulate`: frames from contacts, without a rig.
//! Uses: `simulate`. Never: the network.

use std::process::ExitCode;

use clap::{Args, Subcommand};

use super::error::CliError;

mod random;
mod trials;

/// Options of `simulate`.
#[derive(Debug, Clone, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct SimulateArgs {
    #[command(subcommand)]
    command: Option<SimulateCommand>,
    #[command(flatten)]
    trials: trials::TrialArgs,
}

/// Kinds of simulation other than trials from a file.
#[derive(Debug, Clone, Subcommand)]
pub enum SimulateCommand {
    /// Make Sim-Random: trials with random contacts, as Parquet shards.
    ///
    /// The same seed and options give the same bytes, with any number of threads. After a stop or a
    /// kill, the same command resumes.
    Random(random::RandomArgs),
}

/// Runs `palpate simulate`.
///
/// # Errors
/// `CliError` if an input is invalid, or a file cannot be written.
pub async fn simulate(args: SimulateArgs) -> Result<ExitCode, CliError> {
    match args.command {
        None => trials::trials(&args.trials),
        Some(SimulateCommand::Random(args)) => random::random(args).await,
    }
}
