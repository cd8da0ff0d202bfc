//! `palpate simulate`: frames from contacts, without a rig.
//! Uses: `simulate`. Never: the network.

use std::path::Path;
use std::process::ExitCode;

use clap::{Args, Subcommand};

use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::ForwardModel;

use super::error::CliResult;
use super::progress::Working;
use crate::simulate::model::{ModelUnavailable, load_or_build};

pub mod request;
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

/// The model of a skin, with a sign of life: a skin that is not in the cache is solved first.
///
/// # Errors
/// As [`load_or_build`].
pub fn solved(
    sensor: impl Into<CalibratedSensor>,
    cache: &Path,
) -> Result<ForwardModel, ModelUnavailable> {
    let _shown = solving();
    load_or_build(sensor, cache)
}

/// A sign of life while the responses of a skin are read or solved.
pub fn solving() -> Working {
    Working::on("the skin's responses (solved once, then cached)")
}

/// Runs `palpate simulate`.
///
/// # Errors
/// `CliError` if an input is invalid, or a file cannot be written.
pub async fn simulate(args: SimulateArgs) -> CliResult<ExitCode> {
    match args.command {
        None => trials::trials(&args.trials).await.map(|()| ExitCode::SUCCESS),
        Some(SimulateCommand::Random(args)) => random::random(args).await,
    }
}
