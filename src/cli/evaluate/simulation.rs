//! `palpate evaluate simulation`: accuracy of the simulation as numbers, tables and figures.
//! Uses: `client`, `evaluate`. Never: computed scores (the service reports them).

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Deserialize;
use serde_json::{Value, json};
use sim_core::sensor::Sensor;
use tokio::time::Instant;

use crate::cli::client::Client;
use crate::cli::error::CliError;
use crate::cli::files::write;
use crate::cli::output::{counted, say, say_json};
use crate::cli::progress::progress_bar;
use crate::cli::{At, embed};
use crate::evaluate::figures::{Outline, Quantity, boxes, by_force, frames, map};
use crate::evaluate::simulation::{BoxPlot, FORCE_BIN_N, SimulationReport};
use crate::ids::RunUid;
use crate::store::{RunRow, TrialRow, TwinCount};

/// Interval of polling the twins' progress.
const LOOK: Duration = Duration::from_millis(200);
/// Longest wait without a new twin.
const STALLED: Duration = Duration::from_secs(120);

/// Options of `evaluate simulation`.
#[derive(Debug, Args)]
pub struct SimulationArgs {
    /// Id of the run: uid or scan_id [default: the run of the newest trial].
    #[arg(long, value_name = "RUN")]
    run: Option<String>,
    /// Folder for numbers, tables and figures.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    at: At,
}

/// Fields of `GET /api/v1/runs/{run}/twins` that are read.
#[derive(Debug, Deserialize)]
struct RunTwinsView {
    #[serde(flatten)]
    count: TwinCount,
    pending: u64,
}

/// Runs `palpate evaluate simulation`.
///
/// # Errors
/// `CliError` if there are no trials, twins are missing, or a file cannot be written.
pub async fn simulation(args: SimulationArgs) -> Result<(), CliError> {
    let at = args.at.clone();
    embed::with_server(&at, move |client| report(client, args)).await
}

async fn report(client: Client, args: SimulationArgs) -> Result<(), CliError> {
    let run = client.run(run_of(&client, args.run).await?).await?;
    let count = wait_for_twins(&client, run.uid, STALLED).await?;
    let path = format!("/api/v1/runs/{}/evaluation/simulation", run.uid);
    let report: SimulationReport = client.get(&path).await?;
    if let Some(folder) = &args.out {
        leave(&client, &run, &report, folder).await?;
    }
    if args.at.json {
        say_json(&json!({ "run": run.uid, "label": run.label, "twins": count, "report": report }));
    } else {
        say(words(&run, &report));
        if let Some(folder) = &args.out {
            say(format_args!("numbers, tables and figures in {}", folder.display()));
        }
    }
    Ok(())
}

async fn run_of(client: &Client, named: Option<String>) -> Result<String, CliError> {
    if let Some(run) = named {
        return Ok(run);
    }
    let page: Value = client.get("/api/v1/trials?limit=1&sort=-trial_id").await?;
    let newest = page["trials"][0]["run"].as_str().map(str::to_owned);
    newest.ok_or_else(|| CliError::argument("--run", "none", "there are no trials yet"))
}

/// Waits until every trial of a run has its twin, with a progress bar on a terminal. `patience`:
/// the longest time without a new one.
///
/// # Errors
/// `CliError::Late` if no twin is made for `patience`; other variants if a request fails.
pub async fn wait_for_twins(
    client: &Client,
    run: RunUid,
    patience: Duration,
) -> Result<TwinCount, CliError> {
    let path = format!("/api/v1/runs/{run}/twins");
    let bar = progress_bar("twins");
    let mut least = (u64::MAX, Instant::now());
    loop {
        let RunTwinsView { count, pending } = client.get(&path).await?;
        bar.set_length(count.trials);
        bar.set_position(count.trials - pending);
        if pending == 0 {
            bar.finish_and_clear();
            return Ok(count);
        }
        if pending < least.0 {
            least = (pending, Instant::now());
        }
        if least.1.elapsed() > patience {
            bar.finish_and_clear();
            return Err(stalled(client, pending, patience).await?);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Error for missing twins, with its cause.
async fn stalled(client: &Client, pending: u64, patience: Duration) -> Result<CliError, CliError> {
    let twins: Value = client.get("/api/v1/twins").await?;
    let why = match (twins["pool"]["workers"].as_u64(), twins["pool"]["last_error"].as_str()) {
        (Some(0), _) => "; the server has no --twin-workers".into(),
        (_, Some(error)) => format!("; {error}"),
        (_, None) => String::new(),
    };
    let what = format!("a twin for one of {}{why}", counted(pending, "trial", "trials"));
    Ok(CliError::Late { what, after_s: patience.as_secs() })
}

/// Writes numbers, tables and figures to files.
async fn leave(
    client: &Client,
    run: &RunRow,
    report: &SimulationReport,
    folder: &Path,
) -> Result<(), CliError> {
    let with = json!({
        "run": run.uid, "scan_id": run.scan_id, "experiment": run.experiment, "label": run.label,
        "report": report,
    });
    let save = |name: &str, text: &str| write(&folder.join(name), text);
    save("simulation.json", &format!("{with:#}\n"))?;
    save("by_force.csv", &by_force_csv(report))?;
    save("by_contacts.csv", &by_contacts_csv(report))?;
    save("by_point.csv", &by_point_csv(report))?;
    save("rmse_by_force.svg", &by_force(report, Quantity::Rmse)?)?;
    save("rmse_by_contacts.svg", &boxes(report, Quantity::Rmse)?)?;
    save("fvu_by_force.svg", &by_force(report, Quantity::Fvu)?)?;
    save("fvu_by_contacts.svg", &boxes(report, Quantity::Fvu)?)?;
    if let Ok(sensor) = Sensor::from_toml(&run.sensor) {
        save("fvu_map.svg", &map(&report.by_point, &outline(&sensor))?)?;
    }
    let example: Value = client
        .get(&format!(
            "/api/v1/runs/{}/trials?contact_count__eq=1&max_force_n__gte=15&voltages=true&limit=1",
            run.uid
        ))
        .await?;
    let trial: Option<TrialRow> = serde_json::from_value(example["trials"][0].clone()).ok();
    if let Some((measured, simulated)) = trial.and_then(|t| t.voltages_v.zip(t.sim_voltages_v)) {
        save("frames.svg", &frames(&measured, &simulated)?)?;
    }
    Ok(())
}

fn outline(sensor: &Sensor) -> Outline {
    Outline {
        size_mm: [sensor.file.width_mm, sensor.file.height_mm],
        electrodes_mm: sensor.electrodes_mm().to_vec(),
        pitch_mm: sensor.pitch_mm(),
    }
}

fn by_force_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("contacts,from_n,to_n,trials,mean_rmse_v,mean_fvu\n");
    for b in &report.by_force {
        let contacts = b.contacts.map_or_else(|| "all".into(), |n| n.to_string());
        let (from, to) = (b.from_n, b.from_n + FORCE_BIN_N);
        let _ =
            writeln!(csv, "{contacts},{from},{to},{},{},{}", b.trials, b.mean_rmse_v, b.mean_fvu);
    }
    csv
}

fn by_contacts_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("contacts,trials,quantity,low,q1,median,q3,high,outliers\n");
    for b in &report.by_contacts {
        for (name, BoxPlot { low, q1, median, q3, high, outliers }) in
            [("rmse_v", b.rmse_v), ("fvu", b.fvu)]
        {
            let (n, trials) = (b.contacts, b.trials);
            let _ = writeln!(csv, "{n},{trials},{name},{low},{q1},{median},{q3},{high},{outliers}");
        }
    }
    csv
}

fn by_point_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("x_mm,y_mm,trials,mean_fvu\n");
    for p in &report.by_point {
        let _ = writeln!(csv, "{},{},{},{}", p.x_mm, p.y_mm, p.trials, p.mean_fvu);
    }
    csv
}

/// Formats the report for people.
fn words(run: &RunRow, report: &SimulationReport) -> String {
    let number = |v: Option<f64>, scale: f64, unit: &str| {
        v.map_or_else(|| "not known".into(), |v| format!("{:.3}{unit}", scale * v))
    };
    let mut text = format!(
        "run {} ({}): simulation against {} ({} excluded by flags)\n\
         contact trials: median FVU {}, median RMSE {}; deadband {}\n",
        run.scan_id,
        run.label.as_str(),
        counted(report.trials, "trial", "trials"),
        report.flagged,
        number(report.median_fvu, 1.0, ""),
        number(report.median_rmse_v, 1e3, " mV"),
        number(report.deadband_n, 1.0, " N"),
    );
    let _ = writeln!(text, "contacts   trials   FVU q1   median   q3      RMSE median, mV");
    let _ = writeln!(text, "{:>8} {:>8}", 0, report.contact_counts[0]);
    for b in &report.by_contacts {
        let _ = writeln!(
            text,
            "{:>8} {:>8} {:>8.3} {:>8.3} {:>8.3} {:>12.2}",
            b.contacts,
            b.trials,
            b.fvu.q1,
            b.fvu.median,
            b.fvu.q3,
            1e3 * b.rmse_v.median
        );
    }
    text.pop();
    text
}
