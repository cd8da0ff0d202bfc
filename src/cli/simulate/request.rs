//! The options that determine the bytes of Sim-Random, and their definition with its solved model.
//! Uses: `simulate::random`. Never: a folder of shards.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::Args;
use sim_core::batch::Kernel;
use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::ForwardModel;

use crate::cli::data_or_default;
use crate::cli::error::{CliError, CliResult};
use crate::cli::files::{read_calibration, read_sensor};
use crate::cli::simulate::solved;
use crate::simulate::random::draw::Draws;
use crate::simulate::random::manifest::{Definition, Order, kernel};

/// Largest number of threads.
pub const THREADS_MAX: usize = 256;

/// Options that determine the bytes of Sim-Random.
#[derive(Debug, Clone, Args)]
pub struct RandomRequest {
    /// Number of trials.
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    pub trials: u64,
    /// Seed: with the other options it determines every byte.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Vector instructions of the simulation [default: the fastest of this processor]; the last
    /// digits of a frame depend on them.
    #[arg(long, value_name = "KERNEL", value_parser = kernel)]
    kernel: Option<Kernel>,
    /// Sensor file, or the name of a carried one: the skin's geometry and materials [default: ert-28].
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    /// Calibration file, whose values replace those of the sensor file [default: none].
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Number of contacts of a trial, A..B, each number equally likely.
    #[arg(long, value_name = "A..B", default_value = "1..6", value_parser = contacts)]
    contacts: [u8; 2],
    /// Smallest and largest force of a contact, N, uniform in between.
    #[arg(long, value_names = ["MIN", "MAX"], num_args = 2, default_values_t = [5.0, 40.0])]
    force_n: Vec<f64>,
    /// Number of trials of a shard.
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    shard_trials: u64,
    /// Folder whose `cache` keeps the solved unit responses of the skin, and nothing else; created if
    /// it is missing [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

/// A request with its model.
pub struct SolvedRequest {
    /// Definition of the shards.
    pub definition: Definition,
    /// Model of the skin.
    pub model: ForwardModel,
    /// Kernel of the simulation.
    pub kernel: Kernel,
    /// Text of the sensor file.
    pub sensor_text: String,
    /// Text of the calibration, if one is applied.
    pub calibration_text: Option<String>,
}

impl RandomRequest {
    /// Checks the options and solves the model.
    ///
    /// # Errors
    /// `CliError::Problems` with the options or files that are invalid, `Model` if the model is not available.
    pub fn solve(&self) -> CliResult<SolvedRequest> {
        let (sensor, sensor_text) = read_sensor(self.sensor.as_deref())?;
        let mut sensor = CalibratedSensor::from(sensor);
        let mut calibration_text = None;
        if let Some(path) = &self.calibration {
            let calibration = read_calibration(path, &sensor)?;
            calibration_text = Some(calibration.to_toml()?);
            sensor = calibration.apply(&sensor)?;
        }
        let [least, largest] = self.force_n[..] else {
            return Err(CliError::argument(
                "force-n",
                format!("{:?}", self.force_n),
                "two numbers",
            ));
        };
        let draws = Draws { seed: self.seed, contacts: self.contacts, force_n: [least, largest] };
        let order = Order::new(draws, self.trials, self.shard_trials, sensor.points().len())?;
        let model = solved(&sensor, &data_or_default(self.data.clone()).join("cache"))?;
        let kernel = self.kernel.unwrap_or_else(Kernel::detect);
        let definition = Definition::new(order, &model, kernel);
        Ok(SolvedRequest { definition, model, kernel, sensor_text, calibration_text })
    }
}

/// Parses `A..B`, or `A` for a fixed number.
fn contacts(text: &str) -> Result<[u8; 2], String> {
    let (fewest, most) = text.split_once("..").unwrap_or((text, text));
    match (fewest.parse(), most.parse()) {
        (Ok(fewest), Ok(most)) => Ok([fewest, most]),
        _ => Err("must be a number, or two as in 1..6".into()),
    }
}

/// The requested number of threads, or one for each core of this machine.
///
/// # Errors
/// `CliError::Problems` if it is outside its limits.
pub fn threads(asked: Option<usize>) -> CliResult<NonZeroUsize> {
    match asked {
        None => Ok(std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)),
        Some(n) => NonZeroUsize::new(n).filter(|n| n.get() <= THREADS_MAX).ok_or_else(|| {
            CliError::argument("threads", n, format!("must be from 1 to {THREADS_MAX}"))
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_contacts_are_read() {
        assert_eq!(contacts("1..6"), Ok([1, 6]));
        assert_eq!(contacts("3"), Ok([3, 3]));
        assert!(contacts("1..").is_err() && contacts("-1..2").is_err() && contacts("").is_err());
    }
}
