//! `palpate simulate`: from lines of contacts to frames of voltages; and one trial as a netlist, a
//! finite element deck or a figure.
//! Uses: `simulate`, sim-core. Never: more of the input in memory than a line; the network.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::{Contact, ForwardModel, Workspace};

use crate::cli::data_or_default;
use crate::cli::error::{CliError, CliResult};
use crate::cli::files::{read_calibration, read_sensor, write};
use crate::cli::picture::{self, figure_file};
use crate::cli::simulate::solved;
use crate::problem::Problem;
use crate::simulate::contacts::{ContactLines, Limits};
use crate::simulate::export::{self, ExportError};

/// Options for trials from a file.
#[derive(Debug, Clone, Args)]
pub struct TrialArgs {
    /// Contacts, one line of JSON per trial: {"contacts":[{"x_mm":270,"y_mm":280,"force_n":20}]}.
    ///
    /// `-` is standard input. An empty list is an untouched skin. The answer to each line is a line
    /// {"voltages_v":[784 numbers]}, in order, written before the next one is read.
    #[arg(long, value_name = "FILE|-", default_value = "-")]
    contacts: PathBuf,
    /// Sensor file, or the name of a carried one: the skin's geometry and materials [default: ert-28].
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    /// Calibration file, whose values replace those of the sensor file [default: none].
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Largest number of contacts in a trial.
    #[arg(long, value_name = "N", default_value_t = 6)]
    max_contacts: usize,
    /// Write the trial's circuit as a netlist for ngspice; the input must be one line.
    #[arg(long, value_name = "FILE")]
    spice: Option<PathBuf>,
    /// Index of the netlist's sink electrode, from 0.
    #[arg(long, value_name = "K", default_value_t = 0, requires = "spice")]
    inject: usize,
    /// Write the trial's deformation as an input deck for CalculiX; the input must be one line.
    #[arg(long, value_name = "FILE")]
    calculix: Option<PathBuf>,
    /// Draw the trial's deformed mesh; the input must be one line. The ending of the name decides:
    /// .svg, .png or .pdf.
    #[arg(long, value_name = "FILE.svg", value_parser = figure_file)]
    picture: Option<PathBuf>,
    /// Folder whose `cache` keeps the solved unit responses of the skin, and nothing else; created if
    /// it is missing [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Accepted for scripts: answers are always lines of JSON.
    #[arg(long)]
    json: bool,
}

/// Answer to a line.
#[derive(Serialize)]
struct Answer<'a> {
    voltages_v: &'a [f64],
}

/// Runs the command. Exit code: 0 all lines are answered, 2 bad input.
///
/// # Errors
/// `CliError::Problems` if an option or a line is invalid; other variants if a file cannot be
/// written.
pub async fn trials(args: &TrialArgs) -> CliResult<()> {
    let mut sensor = CalibratedSensor::from(read_sensor(args.sensor.as_deref())?.0);
    if let Some(path) = &args.calibration {
        sensor = read_calibration(path, &sensor)?.apply(&sensor)?;
    }
    let last = sensor.electrodes_mm().len() - 1;
    if args.inject > last {
        return Err(CliError::argument("inject", args.inject, format!("must be from 0 to {last}")));
    }
    let (input, name) = open(&args.contacts)?;
    let mut lines = ContactLines::new(input, &name, Limits::of(&sensor, args.max_contacts));
    // The first line is read before the model is built: an input error is reported at once.
    let mut next = lines.next_trial()?;
    if args.exports() {
        let only = "must hold one line for --spice, --calculix and --picture";
        if next.is_none() || lines.next_trial()?.is_some() {
            return Err(Problem::whole(&name, only).into());
        }
    }
    let model = solved(&sensor, &data_or_default(args.data.clone()).join("cache"))?;
    let mut work = Workspace::default();
    while let Some(contacts) = next {
        let file = lines.place();
        args.export(&model, &contacts, &file).await?;
        let voltages_v = model.voltages(&contacts, &mut work).map_err(|e| refused(&file, &e))?;
        if !answer(voltages_v)? {
            break;
        }
        next = lines.next_trial()?;
    }
    Ok(())
}

impl TrialArgs {
    /// Whether a trial is written for another tool.
    fn exports(&self) -> bool {
        self.spice.is_some() || self.calculix.is_some() || self.picture.is_some()
    }

    /// Writes the requested files.
    async fn export(
        &self,
        model: &ForwardModel,
        contacts: &[Contact],
        file: &str,
    ) -> CliResult<()> {
        let written = |path: &Path, text: Result<String, ExportError>| {
            text.map_err(|e| refused(file, &e)).and_then(|text| write(path, &text))
        };
        if let Some(path) = &self.spice {
            written(path, export::netlist(model, contacts, self.inject))?;
        }
        if let Some(path) = &self.calculix {
            written(path, export::deck(model, contacts))?;
        }
        if let Some(path) = &self.picture {
            let svg = export::picture(model, contacts).map_err(|e| refused(file, &e))?;
            picture::write(path, &svg).await?;
        }
        Ok(())
    }
}

/// Opens the input; returns it with its name in problems.
fn open(path: &Path) -> CliResult<(Box<dyn BufRead>, String)> {
    if path == Path::new("-") {
        return Ok((Box::new(io::stdin().lock()), "standard input".into()));
    }
    let name = path.display().to_string();
    let file = File::open(path).map_err(CliError::input(path))?;
    Ok((Box::new(BufReader::new(file)), name))
}

/// Writes a line and flushes it; returns `false` if standard output is closed.
fn answer(voltages_v: &[f64]) -> CliResult<bool> {
    let mut out = io::stdout().lock();
    let line = serde_json::to_string(&Answer { voltages_v }).map_err(io::Error::from);
    match line.and_then(|line| writeln!(out, "{line}")).and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        Err(source) => Err(CliError::System { operation: "writing an answer", source }),
    }
}

fn refused(file: &str, error: &dyn std::error::Error) -> CliError {
    Problem::whole(file, error.to_string()).into()
}
