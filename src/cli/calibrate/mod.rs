//! `palpate calibrate`: fits the model to measurements and writes a calibration file.
//! Uses: `calibrate`, `simulate` (the model that voltages are compared with), files; `skin` also
//! the service, for a run's trials. Never: the rig.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::json;
use sim_core::calibration::{Accuracy, Calibration, Fitted};
use sim_core::sensor::Sensor;

mod skin;

use super::error::{CliError, CliResult};
use super::files::{read_calibration, read_input, read_sensor, write};
use super::next::{Next, word};
use super::output::{counted, say, say_json};
use super::picture::{self, figure_file};
use super::progress::Working;
use super::{At, data_or_default, embed};
use crate::calibrate::{CalibrateError, foam, frames, piezo, plot};
use crate::cli::simulate::solved;

/// Options of `calibrate`.
#[derive(Debug, Clone, Args)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// Fit a, b and c of Eq. 1 to a compression test.
    ///
    /// The table has the columns displacement_mm and resistance_ohm.
    Piezo(Common),
    /// Fit the moduli of foam and fabrics to single-point indentations.
    ///
    /// The table has the columns point, or x_mm and y_mm; force_n; displacement_mm; and, where the
    /// displacement is not that of the tip, gauge_x_mm and gauge_y_mm.
    Foam(Common),
    /// Fit the fields of one skin to the trials of a run.
    ///
    /// Fields of a, b, c, compliance and sheet, positions and resistances of the electrodes, and
    /// the readout's offsets. Reports the fit of held-out trials before and after; a skin that does not explain them
    /// better is not written.
    Skin(skin::SkinArgs),
}

#[derive(Debug, Clone, Args)]
struct Common {
    /// Table of measurements.
    #[arg(value_name = "CSV")]
    measurements: PathBuf,
    /// Sensor file or the name of a carried one [default: ert-28].
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    /// Earlier calibration whose other part is kept.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Measured frames of single contacts (JSON lines of contacts and voltages_v), with which the
    /// calibrated model's voltages are compared.
    #[arg(long, value_name = "FILE")]
    frames: Option<PathBuf>,
    /// Write the calibration file.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Draw data, fit and band; the ending of the name decides: .svg, .png or .pdf.
    #[arg(long, value_name = "FILE.svg", value_parser = figure_file)]
    plot: Option<PathBuf>,
    /// Folder of the cache of solved skins [env: PALPATE_DATA] [default: palpate-data].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// Runs `palpate calibrate`.
///
/// # Errors
/// `CliError` if an input is invalid, the fit fails, or a file cannot be written.
pub async fn calibrate(args: CalibrateArgs) -> CliResult<()> {
    match &args.what {
        What::Skin(args) => {
            embed::command(&args.at, embed::Purpose::Computes, args, skin::skin).await
        }
        What::Piezo(common) => of_table(Law::Piezo, common).await,
        What::Foam(common) => of_table(Law::Foam, common).await,
    }
}

/// Kind of a table's fit.
#[derive(Debug, Clone, Copy)]
enum Law {
    Piezo,
    Foam,
}

/// Fits to a table of measurements.
async fn of_table(law: Law, common: &Common) -> CliResult<()> {
    let (sensor, _) = read_sensor(common.sensor.as_deref())?;
    let earlier = common.from.as_deref().map(|path| read_calibration(path, &sensor)).transpose()?;
    let file = common.measurements.display().to_string();
    let text = read_input(&common.measurements)?;
    let alone = Calibration { sensor: sensor.file.name.clone(), ..Calibration::default() };
    let (alone, drawn) = match law {
        Law::Piezo => {
            let fit = piezo::calibrate(&file, &text, &sensor.file.piezo)?;
            let drawn = common.plot.as_ref().map(|_| plot::piezo(&fit)).transpose()?;
            (Calibration { piezo: Some(fit.calibration), ..alone }, drawn)
        }
        Law::Foam => {
            let shown = Working::on("fitting the moduli");
            // How many there will be is not known before they converge.
            let mut tell = |n: usize| {
                shown.step(&format!("fitting the moduli: trial solution {n} (each takes seconds)"));
            };
            let fit = foam::calibrate(&file, &text, &sensor, &mut tell)?;
            drop(shown);
            let drawn = common.plot.as_ref().map(|_| plot::foam(&fit)).transpose()?;
            (Calibration { foam: Some(fit.calibration), ..alone }, drawn)
        }
    };
    let mut whole = match &earlier {
        Some(earlier) => alone.over(earlier)?,
        None => alone,
    };
    let left_out = judge_voltages(common, &sensor, &mut whole)?;
    if let Some(path) = &common.out {
        write(path, &whole.to_toml()?)?;
    }
    if let (Some(path), Some(svg)) = (&common.plot, &drawn) {
        picture::write(path, svg).await?;
    }
    answer(common, &whole, left_out)
}

/// Compares measured frames with the calibrated model; returns the number of skipped lines.
fn judge_voltages(
    common: &Common,
    sensor: &Sensor,
    calibration: &mut Calibration,
) -> CliResult<usize> {
    let Some(path) = &common.frames else { return Ok(0) };
    let file = path.display().to_string();
    let frames = frames::read(&file, &read_input(path)?, sensor.channels())?;
    let cache = data_or_default(common.data.clone()).join("cache");
    let model = solved(&calibration.apply(sensor)?, &cache)?;
    calibration.voltage = Some(frames::voltage_accuracy(&file, &frames, &model)?);
    Ok(frames.left_out)
}

fn answer(common: &Common, whole: &Calibration, left_out: usize) -> CliResult<()> {
    let id = whole.id()?;
    if common.json {
        let mut object = json!(whole);
        object["id"] = json!(id);
        say_json(&object);
        return Ok(());
    }
    say(&id);
    if let Some(p) = &whole.piezo {
        let [least, most] = p.compression_mm;
        say(format_args!("Eq. 1 from {} rows, {least} to {most} mm", p.rows));
        say_fitted("a", &p.a_ohm, "ohm");
        say_fitted("b", &p.b_per_mm, "1/mm");
        match &p.c_ohm {
            Some(c) => say_fitted("c", c, "ohm"),
            None => say("  c: not fitted; compress until the resistance levels off"),
        }
        let factor = p.residual_sd_ln.exp();
        say(format_args!("  scatter: a factor of {factor:.3} (one standard deviation)"));
    }
    if let Some(f) = &whole.foam {
        say(format_args!("moduli from {} rows, up to {} N", f.rows, f.force_n));
        say_fitted("foam", &f.foam_mpa, "MPa");
        match &f.fabric_factor {
            Some(factor) => say_fitted("fabrics, times the sensor file's", factor, ""),
            None => say("  fabrics: not fitted; only gauges distinguish them from the foam"),
        }
        say_accuracy("displacement", &f.displacement, 1.0, "mm", "24.1 %");
    }
    if let Some(v) = &whole.voltage {
        say_accuracy("voltage", v, 1e3, "mV", "28.3 %");
    }
    if left_out > 0 {
        let lines = counted(left_out as u64, "frame", "frames");
        say(format_args!("{lines} skipped: not exactly one contact"));
    }
    say_end(common.out.as_deref(), &At { data: common.data.clone(), ..At::default() });
    Ok(())
}

/// Prints the path of the written file, and the next command.
fn say_end(out: Option<&Path>, at: &At) {
    let next = Next::of(at);
    let next = match out.map(|path| path.display().to_string()) {
        None => {
            say("not written");
            next.same_command("with --out skin.toml", "writes the calibration")
        }
        Some(path) => {
            say(format_args!("written to {path}"));
            next.suggest(
                format_args!("palpate model add-calibration {}", word(&path)),
                "stores it in the service, to be promoted",
            )
        }
    };
    next.say();
}

fn say_fitted(name: &str, fitted: &Fitted, unit: &str) {
    let Fitted { value, low_95, high_95 } = fitted;
    let number = |v: &f64| if *v < 1e4 { format!("{v:.4}") } else { format!("{v:.3e}") };
    let [value, low, high] = [value, low_95, high_95].map(number);
    say(format_args!("  {name} = {value} {unit} (95 %: {low} to {high})"));
}

fn say_accuracy(name: &str, accuracy: &Accuracy, scale: f64, unit: &str, paper: &str) {
    say(format_args!(
        "{name}, single contacts: RMSE {:.3} {unit}; {:.1} % of the measurements' standard \
         deviation, {:.1} % of their range (paper: {paper}, normalisation not stated)",
        scale * accuracy.rmse,
        100.0 * accuracy.nrmse_by_sd,
        100.0 * accuracy.nrmse_by_range,
    ));
}

impl From<CalibrateError> for CliError {
    fn from(error: CalibrateError) -> Self {
        match error {
            CalibrateError::Measurements(problems) => Self::Problems(problems),
            other => Self::Calibrate(other),
        }
    }
}
