//! `palpate plan`: preflight and ordered schedule of an experiment; nothing moves, no service is
//! used.
//! Uses: `files`, `schedule`, `plan_plot`, `next`. Never: the network, the clock: the same files give the same bytes.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::error::{CliError, CliResult};
use super::files::{ExperimentFiles, RigFiles};
use super::next::{Next, word};
use super::output::{say, say_json};
use super::picture::figure_file;
use super::plan_plot;
use crate::schedule::configuration::Stand;
use crate::schedule::plan::Step;

/// Options of `plan`.
#[derive(Debug, Clone, Args)]
pub struct PlanArgs {
    /// Experiment file, or the name of a carried experiment.
    #[arg(value_name = "EXPERIMENT.toml")]
    pub experiment: PathBuf,
    /// Rig file to plan for, or the name of a carried one [default: the virtual rig].
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Show the ordered schedule as well.
    #[arg(long)]
    pub steps: bool,
    /// Draw the plan on the skin: tips in their order, way of the indenter, electrodes. The ending
    /// of the name decides: .svg, .png or .pdf.
    #[arg(long, value_name = "FILE.svg", value_parser = figure_file)]
    pub plot: Option<PathBuf>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// Runs `palpate plan`.
///
/// # Errors
/// `CliError::Problems` if a file is invalid; others if the figure cannot be written.
pub async fn plan(args: &PlanArgs) -> CliResult<()> {
    let read = ExperimentFiles::read(&args.experiment)
        .and_then(|files| RigFiles::read(args.rig.as_deref()).map(|rig| (files, rig)));
    let (files, rig) = match read {
        Err(CliError::Problems(problems)) if args.json => {
            say_json(&json!({ "problems": problems }));
            return Err(CliError::Problems(problems));
        }
        read => read?,
    };
    let preflight = files.preflight(&rig);
    if let Some(file) = &args.plot {
        plan_plot::plot(file, &files, &rig, &preflight).await?;
    }
    let steps = args.steps.then_some(&files.plan.steps);
    if args.json {
        let mut object = json!(preflight);
        if let Some(steps) = steps {
            object["steps"] = json!(steps);
        }
        say_json(&object);
    } else {
        say(preflight.to_string().trim_end());
        for (n, step) in steps.into_iter().flatten().enumerate() {
            say(format_args!("{:>7}  {}", n + 1, step_words(step)));
        }
    }
    match preflight.problems {
        problems if problems.is_empty() => {
            if !args.json {
                next(args).say();
            }
            Ok(())
        }
        problems => Err(CliError::Problems(problems)),
    }
}

/// The command that runs the plan.
fn next(args: &PlanArgs) -> Next {
    let typed = |path: &Path| word(&path.display().to_string());
    let experiment = typed(&args.experiment);
    match &args.rig {
        None => Next::default().suggest(
            format_args!("palpate run {experiment}"),
            "runs it with the running service, or else on a virtual rig",
        ),
        Some(rig) => Next::default().suggest(
            format_args!("palpate run {experiment} --rig {}", typed(rig)),
            "runs it on this rig, if no service runs",
        ),
    }
}

fn step_words(step: &Step) -> String {
    match step {
        Step::TipChange { tips, .. } => format!("mount {tips} tips on arms 1 to {tips}"),
        Step::TouchOff { places, .. } => format!("touch-off at {} places", places.len()),
        Step::Reference(press) => {
            format!("reference press, {} mm deep, {}", press.depth_mm, stand_words(&press.stand))
        }
        Step::Configuration(c) => {
            let (index, tips) = (c.index, c.tips);
            let repeat = if c.group == index { String::new() } else { format!(", as {}", c.group) };
            format!("configuration {index}, {tips} tips, {}{repeat}", stand_words(&c.stand))
        }
        Step::Manual(placement) => {
            let weights: Vec<String> = placement
                .contacts
                .iter()
                .map(|c| format!("{} N at ({:.1}, {:.1})", c.force_n, c.x_mm, c.y_mm))
                .collect();
            format!("manual trial {}: {}", placement.index, weights.join(", "))
        }
    }
}

fn stand_words(stand: &Stand) -> String {
    let [x_mm, y_mm] = stand.centre_mm;
    format!("centre ({x_mm:.2}, {y_mm:.2}) mm, radius {:.2} mm", stand.radius_mm)
}
