//! `palpate evaluate simulation`: the fit of a run's twins, once all are made.
//! Uses: `client`, `studies::simulation`. Never: computed scores (the service reports them).

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use serde_json::{Value, json};

use super::write_all;
use crate::cli::client::Client;
use crate::cli::error::CliError;
use crate::cli::output::{say, say_json};
use crate::cli::twins::wait_for_twins;
use crate::cli::{At, embed};
use crate::evaluate::simulation::SimulationReport;
use crate::store::{RunRow, TrialRow};
use crate::studies::simulation::{files, text};

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
        let example = example(&client, &run).await?;
        let example = example.as_ref().map(|[v, sim_v]| (v.as_slice(), sim_v.as_slice()));
        write_all(folder, &files(&run, &report, example)?)?;
    }
    if args.at.json {
        say_json(&json!({ "run": run.uid, "label": run.label, "twins": count, "report": report }));
    } else {
        say(text(&run, &report));
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
    let newest = page["items"][0]["run"].as_str().map(str::to_owned);
    newest.ok_or_else(|| CliError::argument("--run", "none", "there are no trials yet"))
}

/// Measured and simulated frame of one trial with a single contact of 15 N or more, V.
async fn example(client: &Client, run: &RunRow) -> Result<Option<[Vec<f32>; 2]>, CliError> {
    let page: Value = client
        .get(&format!(
            "/api/v1/runs/{}/trials?contact_count__eq=1&max_force_n__gte=15&voltages=true&limit=1",
            run.uid
        ))
        .await?;
    let trial: Option<TrialRow> = serde_json::from_value(page["items"][0].clone()).ok();
    Ok(trial.and_then(|t| Some([t.voltages_v?, t.sim_voltages_v?])))
}
