//! A method scored on a dataset, with its confidence intervals.
//! Uses: `lab`, `rows`. Never: computed numbers (they are in the report).

use serde_json::json;

use crate::evaluate::request::{EvaluationReport, EvaluationRequest};
use crate::evaluate::table::{SCORE_COLUMNS, markdown};
use crate::lab::Lab;
use crate::rows::{coverage, perfect, read_by, reliability, score_rows, score_rows_note};
use crate::sheet::Sheet;

/// Scores a method: over all frames, by the number of contacts and the spacing, and a perfect map for comparison.
///
/// # Errors
/// Error of the lab if the evaluation fails.
pub async fn scores<L: Lab>(lab: &L, request: &EvaluationRequest) -> Result<Sheet, L::Error> {
    let report = lab.score(request).await?;
    let name = serde_json::to_value(request.scored).unwrap_or_default();
    let name = name.as_str().unwrap_or_default();
    let mut rows = score_rows(name, &report);
    rows.extend(perfect(&report));
    let text = format!(
        "# {name} on {} ({}), mean [95 % interval]\n\n{}\n{}{}{}{}{}{}",
        request.dataset,
        report.label.as_str(),
        markdown(&SCORE_COLUMNS, &rows),
        score_rows_note(&report),
        coverage([(name, &report)].into_iter()),
        reliability([(name, &report)].into_iter()),
        latency(&report),
        skipped(&report),
        read_by(&report)
    );
    let numbers = json!({ "method": name, "report": report });
    Ok(Sheet::new("method", text, numbers, Vec::new()))
}

/// Line on skipped contacts, if any were to be skipped.
fn skipped(report: &EvaluationReport) -> String {
    let Some(limit_mm) = report.place_sd_mm else { return String::new() };
    format!("Without contacts whose position has a standard deviation above {limit_mm} mm.\n")
}

/// Line on the time to an answer, if it was measured.
fn latency(report: &EvaluationReport) -> String {
    let Some([p50, p99]) = report.latency_ms else { return String::new() };
    format!("Time to an answer: {p50:.2} ms (median), {p99:.2} ms (99th percentile).\n")
}
