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

/// What is simulated, besides trials from a file.
#[derive(Debug, Clone, Subcommand)]
pub enum SimulateCommand {
    /// Make Sim-Random: trials with random contacts, as Parquet shards.
    ///
    /// The same seed and options give the same bytes, whatever the number of threads. Killed or
    /// stopped, the same command goes on.
    Random(random::RandomArgs),
}

/// Runs the command.
pub async fn simulate(args: SimulateArgs) -> Result<ExitCode, CliError> {
    match args.command {
        None => trials::trials(&args.trials),
        Some(SimulateCommand::Random(args)) => random::random(args).await,
    }
}
