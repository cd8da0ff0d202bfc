//! `palpate calibrate skin`: the fields of one skin, from the trials of a run.
//! Uses: `client`, `calibrate::skin`, `calibrate::judgement`, `simulate` (contacts of a trial, the elastic solve).
//! Never: trials except through the API, a fit on the threads that answer.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread;

use clap::Args;
use serde_json::{Value, json};
use sim_core::calibration::Calibration;
use sim_core::inverse::skin::{MeasuredTrial, SkinFitOptions, noise_v};
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

use super::super::At;
use super::super::client::Client;
use super::super::error::CliResult;
use super::super::files::{calibration_problem, parse_calibration, write};
use super::super::find::find_run;
use super::super::output::{counted, note, say, say_json};
use super::super::picture::{self, figure_file};
use super::super::progress::{Counted, LogLines, progress_bar};
use super::super::simulate::solving;
use crate::api::Page;
use crate::calibrate::CalibrateError;
use crate::calibrate::judgement::limitation;
use crate::calibrate::skin::{CalibratedSkin, Candidate, Choice, Source, calibrate, choose};
use crate::calibrate::skin_plot;
use crate::dataset::pressed::{contacts, tips_mm};
use crate::problem::Problem;
use crate::rig::setup::RigSetup;
use crate::simulate::model::{ModelUnavailable, unit_responses};
use crate::store::{RunKind, RunRow, TrialRow};

/// Trials per page, without frames.
const PAGE_TRIALS: usize = 5000;
/// Trials per page with frames, requested by their ids.
const FIT_PAGE_TRIALS: usize = 200;
/// Largest default number of threads of a fit: a campaign may be active.
const FIT_THREADS_MAX: usize = 8;

/// Options of `calibrate skin`.
#[derive(Debug, Clone, Args)]
pub struct SkinArgs {
    /// Run: number, start of the id, or `last`.
    #[arg(long, value_name = "RUN")]
    run: String,
    /// Largest number of trials to fit; a quarter of that number is held out in addition.
    #[arg(long, value_name = "N", default_value_t = 1200)]
    trials: usize,
    /// Earlier calibration of Eq. 1 and moduli, on top of which the skin is fitted.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Write the calibration file.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Draw the fitted fields, and held-out trials before and after.
    #[arg(long, value_name = "FILE.svg", value_parser = figure_file)]
    plot: Option<PathBuf>,
    /// Threads; the result does not depend on them [default: the processors, 8 at most].
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    #[command(flatten)]
    pub at: At,
}

/// Runs `palpate calibrate skin`.
///
/// # Errors
/// `CliError` if the run or an input is invalid, the fit fails or is not better than its start, or a file cannot be
/// written.
pub async fn skin(client: &Client, args: &SkinArgs) -> CliResult<()> {
    let run = find_run(client, &args.run).await?;
    let (sensor, earlier) = start(&run, args)?;
    let candidates = candidates(&client.showing("reading the trials"), &run, &sensor).await?;
    let least_n = if run.kind == RunKind::RealHex { run.deadband_n } else { 0.0 };
    let choice = choose(&candidates, args.trials, least_n);
    let trials = frames(client, &run, &candidates, &choice, sensor.channels()).await?;
    let cache = args.at.data().join("cache");
    let source = Source { run: run.uid, label: run.label };
    let (threads, on) = (threads(args.threads), sensor.clone());
    let work = move || fit(&on, &cache, trials, source, threads);
    let fitted = tokio::task::spawn_blocking(work)
        .await
        .unwrap_or_else(|failed| std::panic::resume_unwind(failed.into_panic()))?;
    let alone = Calibration {
        sensor: sensor.file.name.clone(),
        skin: Some(fitted.skin.clone()),
        ..Calibration::default()
    };
    let whole = match &earlier {
        Some(earlier) => alone.over(earlier)?,
        None => alone,
    };
    if let Some(path) = &args.plot {
        picture::write(path, &skin_plot::skin(&sensor, &fitted)?).await?;
    }
    if !fitted.judgement.better {
        if args.at.json {
            say_json(&facts(&run, &fitted));
        }
        return Err(CalibrateError::NoBetter(fitted.judgement).into());
    }
    if let Some(path) = &args.out {
        write(path, &whole.to_toml()?)?;
    }
    answer(args, &run, &whole, &fitted)
}

/// The sensor that the fit starts from: that of the run with an earlier calibration of Eq. 1 and
/// moduli; and that calibration without its skin.
fn start(run: &RunRow, args: &SkinArgs) -> CliResult<(Sensor, Option<Calibration>)> {
    let sensor = Sensor::from_toml(&run.sensor).map_err(|e| {
        let file = format!("sensor file of run {}", run.scan_id);
        Problem::whole(&file, e.to_string())
    })?;
    let Some(path) = &args.from else { return Ok((sensor, None)) };
    let earlier = Calibration { skin: None, ..parse_calibration(path)? };
    if earlier.piezo.is_none() && earlier.foam.is_none() {
        return Ok((sensor, None));
    }
    let applied = earlier.apply(&sensor).map_err(|e| calibration_problem(path, e))?;
    Ok((applied.into_sensor(), Some(earlier)))
}

/// The trials of a run without a flag whose contacts are wholly on the skin: an import may have others, which the model
/// cannot take. Positions of the tips, contacts.
async fn candidates(client: &Client, run: &RunRow, sensor: &Sensor) -> CliResult<Vec<Candidate>> {
    let force_noise_n = match &run.rig {
        Some(rig) => RigSetup::from_toml("rig", rig)?.force_noise_n(),
        None => None,
    };
    let force_noise_n = force_noise_n.unwrap_or(0.0);
    let path = format!("/api/v1/runs/{}/trials?flagged=false&limit={PAGE_TRIALS}", run.uid);
    let (mut candidates, mut beyond, mut cursor) = (Vec::new(), 0u64, String::new());
    loop {
        let page: Page<TrialRow> = client.get(&format!("{path}{cursor}")).await?;
        for trial in &page.items {
            let Some(contacts) = contacts(trial, run.kind, force_noise_n) else { continue };
            if contacts.iter().any(|contact| !sensor.holds_tip([contact.x_mm, contact.y_mm])) {
                beyond += 1;
                continue;
            }
            let tips_mm = tips_mm(trial, run.kind, &contacts);
            candidates.push(Candidate { trial: trial.trial_id.0, tips_mm, contacts });
        }
        let Some(next) = page.next else { break };
        cursor = format!("&cursor={next}");
    }
    if beyond > 0 {
        let trials = counted(beyond, "trial", "trials");
        note(format_args!("{trials} with a tip that is not wholly on the skin left out"));
    }
    Ok(candidates)
}

/// The chosen trials with their frames: fitted ones, held-out ones.
async fn frames(
    client: &Client,
    run: &RunRow,
    candidates: &[Candidate],
    choice: &Choice,
    channels: usize,
) -> CliResult<[Vec<MeasuredTrial>; 2]> {
    let count = choice.fitted.len() + choice.held_out.len();
    let client = client.quiet();
    let mut shown = Counted::of("trials read", count as u64);
    let mut sides = [Vec::new(), Vec::new()];
    for (side, chosen) in sides.iter_mut().zip([&choice.fitted, &choice.held_out]) {
        for some in chosen.chunks(FIT_PAGE_TRIALS) {
            let ids: Vec<String> = some.iter().map(|&i| candidates[i].trial.to_string()).collect();
            let path = format!(
                "/api/v1/runs/{}/trials?voltages=true&limit={FIT_PAGE_TRIALS}&trial_id__in={}",
                run.uid,
                ids.join(",")
            );
            let page: Page<TrialRow> = client.get(&path).await?;
            for &i in some {
                let candidate = &candidates[i];
                let row = page.items.iter().find(|row| row.trial_id.0 == candidate.trial);
                let frame_v = row.and_then(|row| row.voltages_v.clone()).unwrap_or_default();
                // A frame of another length is not of this skin.
                if frame_v.len() == channels && frame_v.iter().all(|v| v.is_finite()) {
                    let contacts = candidate.contacts.clone();
                    side.push(MeasuredTrial { contacts, frame_v });
                }
            }
            shown.add(some.len() as u64);
        }
    }
    Ok(sides)
}

fn threads(asked: Option<usize>) -> usize {
    let here = || thread::available_parallelism().map_or(1, |n| n.get().min(FIT_THREADS_MAX));
    asked.unwrap_or_else(here).max(1)
}

/// Runs the fit, with a progress bar on a terminal.
fn fit(
    sensor: &Sensor,
    cache: &std::path::Path,
    [fitted, held_out]: [Vec<MeasuredTrial>; 2],
    source: Source,
    threads: usize,
) -> CliResult<CalibratedSkin> {
    let shown = solving();
    let responses: Arc<UnitResponses> =
        Arc::new(unit_responses(sensor, cache).map_err(ModelUnavailable::from)?);
    drop(shown);
    let mut options = SkinFitOptions::for_trials(fitted.len(), threads);
    options.errors.noise_v = noise_v(&fitted).unwrap_or(options.errors.noise_v);
    let bar = progress_bar("evaluations");
    let mut lines = LogLines::instead_of(&bar);
    let both = [fitted.as_slice(), held_out.as_slice()];
    let outcome = calibrate(sensor, &responses, both, source, &options, &mut |p| {
        bar.set_length(p.total as u64);
        bar.set_position(p.done as u64);
        let cost = p.cost.map_or(String::new(), |cost| format!(", cost {cost:.4e}"));
        let words = format!("step {} of at most {}{cost}", p.step, p.steps);
        lines.say(|| format!("{words}, {} % of all steps", 100 * p.done / p.total.max(1)));
        bar.set_message(format!("at most, {words}"));
    });
    Ok(outcome?)
}

/// What a fit yielded, for scripts; without the id of its file, which a fit that is not better does not have.
fn facts(run: &RunRow, fitted: &CalibratedSkin) -> Value {
    let CalibratedSkin { skin, judgement, parameters, costs, .. } = fitted;
    json!({
        "run": run.uid, "label": run.label, "parameters": parameters, "costs": costs,
        "evidence": skin.evidence, "judgement": judgement,
        "limitation": limitation(&skin.evidence),
    })
}

fn answer(
    args: &SkinArgs,
    run: &RunRow,
    whole: &Calibration,
    fitted: &CalibratedSkin,
) -> CliResult<()> {
    let id = whole.id()?;
    if args.at.json {
        let mut object = facts(run, fitted);
        object["id"] = json!(id);
        say_json(&object);
        return Ok(());
    }
    let CalibratedSkin { skin, judgement, parameters, .. } = fitted;
    let evidence = &skin.evidence;
    say(&id);
    let [trials, held_out] = [evidence.trials, evidence.held_out].map(|n| n as u64);
    say(format_args!(
        "skin of run {} ({}): {parameters} parameters from {}; {} of other configurations held out",
        run.scan_id,
        evidence.label,
        counted(trials, "trial", "trials"),
        counted(held_out, "trial", "trials"),
    ));
    let (before, after) = (&evidence.before, &evidence.after);
    say(format_args!("  FVU held out, median: {:.4} -> {:.4}", before.median, after.median));
    say(format_args!("  FVU held out, mean:   {:.4} -> {:.4}", before.mean, after.mean));
    if judgement.outliers > 0 {
        let (name, mean) = (judgement.mean_name(), &judgement.mean);
        say(format_args!("  FVU held out, {name}: {:.4} -> {:.4}", mean.before, mean.after));
    }
    let along = skin.fields.ln_sheet_anisotropy.exp();
    say(format_args!(
        "  sheet:                conducts {along:.2} times as well along x as along y"
    ));
    if evidence.doubted > 0 {
        let doubted = counted(evidence.doubted as u64, "trial", "trials");
        say(format_args!("  {doubted} with a weight below one half: outliers"));
    }
    if let Some(words) = limitation(evidence) {
        note(format_args!("note: {words}"));
    }
    super::say_end(args.out.as_deref(), &args.at);
    Ok(())
}
