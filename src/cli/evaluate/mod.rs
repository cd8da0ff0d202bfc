//! `palpate evaluate`: scores of simulation, nets and methods, compared with the paper's.
//! Uses: `client`, `evaluate`. Never: computed scores (the service trains and scores).

use clap::{Args, Subcommand};

use super::error::CliError;

mod factorial;
mod lab;
mod maps;
mod method;
mod noise;
mod simulation;
mod transfer;
mod unseen;

pub use simulation::wait_for_twins;

/// Options of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Table or figure to compute.
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Compare simulated twins with a run's trials: RMSE, FVU, deadband, as in the paper's Fig. 7.
    ///
    /// Waits until every trial has its twin. With --out it writes simulation.json, one CSV per
    /// table and one SVG per figure.
    Simulation(simulation::SimulationArgs),
    /// Score a method on a dataset: estimated compared with true contacts, by their number.
    Method(method::MethodArgs),
    /// Table III: Transfer-Nets trained on 1, 1 to 2, .. 1 to 6 contacts, tested on each number.
    Transfer(transfer::TransferArgs),
    /// Table IV and Fig. 9: Recon-Nets of twelve force maps, on simulated voltages.
    Maps(lab::LabArgs),
    /// Fig. 10: residuals of the Transfer-Net, and one trial's maps at three levels of noise.
    Noise(lab::LabArgs),
    /// Fig. 11: pixel size x diameter x noise, with a three-factor analysis of variance.
    Factorial(lab::LabArgs),
    /// Fig. 12 and V-D: the paper's pipeline, both baselines and our methods on Real-Unseen.
    Unseen(unseen::UnseenArgs),
}

/// Runs `palpate evaluate`.
///
/// # Errors
/// `CliError` if a training or an evaluation fails, or a file cannot be written.
pub async fn evaluate(args: EvaluateArgs) -> Result<(), CliError> {
    match args.what {
        What::Simulation(args) => simulation::simulation(args).await,
        What::Method(args) => method::method(args).await,
        What::Transfer(args) => transfer::transfer(args).await,
        What::Maps(args) => lab::with_lab(args, maps::maps).await,
        What::Noise(args) => lab::with_lab(args, noise::noise).await,
        What::Factorial(args) => lab::with_lab(args, factorial::factorial).await,
        What::Unseen(args) => unseen::unseen(args).await,
    }
}
