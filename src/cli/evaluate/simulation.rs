//! `palpate evaluate simulation`: the fit of a run's twins, once all are made.
//! Uses: `client`, `studies::simulation`. Never: computed scores (the service reports them).

use std::time::Duration;

use clap::Args;
use serde_json::{Value, json};

use crate::cli::At;
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::morning::{TrialFacts, all_trials};
use crate::cli::next::Next;
use crate::cli::output::counted;
use crate::cli::picture::Pictures;
use crate::cli::twins::wait_for_twins;
use crate::evaluate::frame_pairs::FramePair;
use crate::evaluate::simulation::SimulationReport;
use crate::store::{RunKind, RunRow, TrialRow};
use crate::studies::simulation::{files, text};

/// Longest wait without a new twin.
const STALLED: Duration = Duration::from_secs(120);

/// Options of `evaluate simulation`.
#[derive(Debug, Args)]
pub struct SimulationArgs {
    /// Run: number, start of the id, or `last` [default: the run of the newest trial].
    #[arg(long, value_name = "RUN")]
    run: Option<String>,
    #[command(flatten)]
    pictures: Pictures,
    #[command(flatten)]
    pub at: At,
}

/// Runs `palpate evaluate simulation`.
///
/// # Errors
/// `CliError` if there are no trials, twins are missing, or a file cannot be written.
pub async fn simulation(client: &Client, args: &SimulationArgs) -> CliResult<()> {
    let run = find_run(client, &run_of(client, args.run.clone()).await?).await?;
    let count = wait_for_twins(client, run.uid, STALLED).await?;
    let path = format!("/api/v1/runs/{}/evaluation/simulation", run.uid);
    let report: SimulationReport = client.showing("scoring the twins").get(&path).await?;
    let (mut words, mut next) = (text(&run, &report), Next::of(&args.at));
    let number = run.scan_id;
    match &args.pictures.out {
        Some(folder) => {
            let pairs = pairs(client, &run, report.trials).await?;
            args.pictures.write_all(folder, &files(&run, &report, &pairs)?).await?;
            words += &format!("\nnumbers, tables and figures in {}", folder.display());
        }
        None => {
            next = next.suggest(
                format_args!("palpate evaluate simulation --run {number} --out fit"),
                "writes numbers, tables and figures",
            );
        }
    }
    let numbers = json!({ "run": run.uid, "label": run.label, "twins": count, "report": report });
    args.at.output().say(&numbers, words);
    // Placed weights are for the evaluation of a calibration, which needs presses of other forces.
    if run.kind != RunKind::RealRandom {
        next = next.suggest(
            format_args!("palpate calibrate skin --run {number} --out skin.toml"),
            "fits the model to this skin",
        );
    }
    next.say();
    Ok(())
}

async fn run_of(client: &Client, named: Option<String>) -> CliResult<String> {
    if let Some(run) = named {
        return Ok(run);
    }
    let page: Value = client.get("/api/v1/trials?limit=1&sort=-trial_id").await?;
    let newest = page["items"][0]["run"].as_str().map(str::to_owned);
    newest.ok_or_else(|| CliError::argument("--run", "none", "there are no trials yet"))
}

/// Frames of the trials with the best, the median and the worst twin.
async fn pairs(client: &Client, run: &RunRow, trials: u64) -> CliResult<Vec<FramePair>> {
    let all = all_trials(client, run.uid, trials).await?;
    let mut pairs = Vec::new();
    for (name, trial) in shown(&all) {
        let path = format!("/api/v1/trials?trial_id={}&voltages=true&limit=1", trial.trial_id);
        let page: Value = client.get(&path).await?;
        let row: Option<TrialRow> = serde_json::from_value(page["items"][0].clone()).ok();
        let frames = row.and_then(|row| Some((row.voltages_v?, row.sim_voltages_v?)));
        let Some((measured_v, simulated_v)) = frames else { continue };
        let name = format!("{name}: {}", words(trial));
        pairs.push(FramePair { name, measured_v, simulated_v });
    }
    Ok(pairs)
}

/// The best, the median and the worst fit of the trials with contacts and without flags.
fn shown(trials: &[TrialFacts]) -> Vec<(&'static str, &TrialFacts)> {
    let sound = trials.iter().filter(|trial| trial.contact_count > 0 && trial.flags.is_empty());
    let mut sound: Vec<(f64, &TrialFacts)> =
        sound.filter_map(|trial| Some((trial.fvu?, trial))).collect();
    sound.sort_by(|a, b| a.0.total_cmp(&b.0));
    let last = sound.len().saturating_sub(1);
    let mut places = vec![("best fit", 0), ("median fit", last / 2), ("worst fit", last)];
    places.dedup_by_key(|place| place.1);
    places.into_iter().filter_map(|(name, at)| Some((name, sound.get(at)?.1))).collect()
}

fn words(trial: &TrialFacts) -> String {
    let contacts = counted(trial.contact_count.into(), "contact", "contacts");
    let force = trial.max_force_n.map_or_else(String::new, |n| format!(", up to {n:.1} N"));
    let fvu = trial.fvu.map_or_else(String::new, |fvu| format!(", FVU {fvu:.3}"));
    format!("trial t{}, {contacts}{force}{fvu}", trial.trial_id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn best_median_and_worst_are_chosen_once_each() {
        let trial = |trial_id: i64, fvu: f64| TrialFacts {
            trial_id,
            contact_count: 1,
            max_force_n: Some(12.34),
            fvu: Some(fvu),
            ..TrialFacts::default()
        };
        let all = [trial(1, 0.4), trial(2, 0.1), trial(3, 0.9), trial(4, 0.2), trial(5, 0.3)];
        let chosen: Vec<i64> = shown(&all).iter().map(|(_, trial)| trial.trial_id).collect();
        assert_eq!(chosen, [2, 5, 3]);
        assert_eq!(shown(&all[..1]).len(), 1);
        assert_eq!(words(&all[0]), "trial t1, 1 contact, up to 12.3 N, FVU 0.400");
        let flagged = TrialFacts { flags: vec!["unsettled".into()], ..trial(6, 0.1) };
        assert!(shown(&[flagged]).is_empty());
    }
}
