//! `palpate simulate`: frames from contacts, without a rig.
//! Uses: `simulate`. Never: the network.

use std::process::ExitCode;

use clap::{Args, Subcommand};

use super::error::CliError;

mod random;

/// Options of `simulate`.
#[derive(Debug, Clone, Args)]
pub struct SimulateArgs {
    #[command(subcommand)]
    command: SimulateCommand,
}

/// What is simulated.
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
        SimulateCommand::Random(args) => random::random(args).await,
    }
}
