//! A method scored on a dataset, with its confidence intervals.
//! Uses: `lab`. Never: computed numbers (the service has them).

use clap::Args;
use serde_json::json;

use super::lab::{Lab, LabArgs, Sheet, with_lab};
use crate::cli::error::CliError;
use crate::evaluate::request::{EvaluationReport, FramesRead, Scored};
use crate::evaluate::table::{Beside, COLUMNS, markdown, score_row};

/// Options of `evaluate method`.
#[derive(Debug, Clone, Args)]
pub struct MethodArgs {
    /// Method: paper, fast, exact, tikhonov or noser.
    #[arg(value_name = "METHOD", value_parser = scored)]
    method: Scored,
    /// Name or id of a dataset.
    #[arg(long, value_name = "NAME", default_value = "real-unseen")]
    dataset: String,
    /// Part: train, validation or test; all rows if absent.
    #[arg(long, value_name = "PART")]
    part: Option<String>,
    /// A condition on its rows; may be repeated.
    #[arg(long = "where", value_name = "CONDITION")]
    conditions: Vec<String>,
    /// Id or name of a Transfer-Net.
    #[arg(long, value_name = "MODEL")]
    with_transfer: Option<String>,
    /// Id or name of a net for maps.
    #[arg(long, value_name = "MODEL")]
    map: Option<String>,
    /// Id or name of a Point-Net.
    #[arg(long, value_name = "MODEL")]
    points: Option<String>,
    /// Id of a calibration stored in the service.
    #[arg(long, value_name = "CAL")]
    skin: Option<String>,
    /// Read only the first frame of each trial, instead of the mean of all.
    #[arg(long)]
    first_frame: bool,
    /// Least force of a peak, N.
    #[arg(long, value_name = "N", default_value_t = 5.0)]
    threshold_n: f64,
    /// Skip contacts of exact whose position has a larger standard deviation than this, mm.
    #[arg(long, value_name = "MM")]
    place_sd_mm: Option<f64>,
    #[command(flatten)]
    lab: LabArgs,
}

fn scored(name: &str) -> Result<Scored, String> {
    let found = Scored::METHODS.into_iter().find(|(known, _)| *known == name);
    let names = || Scored::METHODS.map(|(name, _)| name).join(", ");
    found.map(|(_, scored)| scored).ok_or_else(|| format!("must be {}", names()))
}

/// Runs `palpate evaluate method`.
///
/// # Errors
/// `CliError` if the evaluation fails or a file cannot be written.
pub async fn method(args: MethodArgs) -> Result<(), CliError> {
    with_lab(args.lab.clone(), move |lab| score(lab, args)).await
}

async fn score(lab: Lab, args: MethodArgs) -> Result<Sheet, CliError> {
    let mut wish = lab.wish(args.method, &args.dataset, args.part.as_deref());
    wish.limit = lab.args.scored;
    wish.conditions = args.conditions;
    wish.transfer = args.with_transfer;
    wish.map = args.map;
    wish.points = args.points;
    wish.skin = args.skin;
    wish.threshold_n = args.threshold_n;
    wish.place_sd_mm = args.place_sd_mm;
    wish.frames = if args.first_frame { FramesRead::First } else { FramesRead::Mean };
    let report = lab.scored(&wish).await?;
    let name = serde_json::to_value(args.method).unwrap_or_default();
    let name = name.as_str().unwrap_or_default();
    let mut rows = rows(name, &report);
    rows.extend(perfect(&report));
    let text = format!(
        "# {name} on {} ({}), mean [95 % interval]\n\n{}\n{}{}",
        args.dataset,
        report.label,
        markdown(&COLUMNS, &rows),
        latency(&report),
        left_out(&report) + &read_by(&report)
    );
    let numbers = json!({ "method": name, "report": report });
    Ok(Sheet { name: "method".into(), text, numbers, pictures: Vec::new() })
}

/// Rows of a method: over all frames, and by the number of contacts.
pub fn rows(name: &str, report: &EvaluationReport) -> Vec<Vec<String>> {
    let Some(scores) = &report.contacts else { return Vec::new() };
    let mut rows = vec![score_row(name, &scores.all, Beside::Interval)];
    for count in &scores.by_contacts {
        rows.push(score_row(&format!("  of {}", count.contacts), &count.score, Beside::Interval));
    }
    rows
}

/// The row of a perfect map under the same rule.
fn perfect(report: &EvaluationReport) -> Option<Vec<String>> {
    let scores = report.perfect.as_ref()?;
    let map = report.map.as_deref().unwrap_or_default();
    let name = format!("perfect map {map}, {} N rule", report.threshold_n);
    Some(score_row(&name, &scores.all, Beside::Interval))
}

/// One row for each map of these reports.
pub fn perfects<'a>(reports: impl Iterator<Item = &'a EvaluationReport>) -> Vec<Vec<String>> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for row in reports.filter_map(perfect) {
        if !rows.contains(&row) {
            rows.push(row);
        }
    }
    rows
}

/// Models of a report, and its restrictions.
pub fn read_by(report: &EvaluationReport) -> String {
    let by = report.models.iter().chain(&report.calibration).cloned().collect::<Vec<_>>();
    let by = if by.is_empty() { "the nominal model".into() } else { by.join(", ") };
    let notes = report.notes.iter().map(|note| format!("Note: {note}.\n"));
    format!("By {by}.\n{}", notes.collect::<String>())
}

fn left_out(report: &EvaluationReport) -> String {
    let Some(limit_mm) = report.place_sd_mm else { return String::new() };
    format!("Without contacts whose position has a standard deviation above {limit_mm} mm.\n")
}

fn latency(report: &EvaluationReport) -> String {
    let Some([p50, p99]) = report.latency_ms else { return String::new() };
    format!("Time to an answer: {p50:.2} ms (median), {p99:.2} ms (99th percentile).\n")
}
