//! `palpate simulate`: frames from contacts, without a rig.
//! Uses: `simulate`. Never: the network.

use std::process::ExitCode;

use clap::{Args, Subcommand};

use super::error::CliError;

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
pub enum SimulateCommand {}

/// Runs the command.
pub async fn simulate(args: SimulateArgs) -> Result<ExitCode, CliError> {
    match args.command {
        None => trials::trials(&args.trials),
        Some(command) => match command {},
    }
}
