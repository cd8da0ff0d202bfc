//! Rows and notes of an evaluation report, common to several tables.
//! PURE. Uses: `evaluate::table`. Never: a number that is not in the report.

use crate::evaluate::request::EvaluationReport;
use crate::evaluate::table::{Uncertainty, score_row};
use crate::ids::{CalibrationId, ModelId};

/// Rows of a method: over all frames, then by the number of contacts. Columns:
/// `evaluate::table::SCORE_COLUMNS`, means with 95 % intervals.
pub fn by_contacts(name: &str, report: &EvaluationReport) -> Vec<Vec<String>> {
    let Some(scores) = &report.contacts else { return Vec::new() };
    let mut rows = vec![score_row(name, &scores.all, Uncertainty::Interval)];
    for count in &scores.by_contacts {
        rows.push(score_row(
            &format!("  of {}", count.contacts),
            &count.score,
            Uncertainty::Interval,
        ));
    }
    rows
}

/// The row of a perfect map under the same rule, if the report has one.
pub fn perfect(report: &EvaluationReport) -> Option<Vec<String>> {
    let scores = report.perfect.as_ref()?;
    let map = report.map.as_deref().unwrap_or_default();
    let name = format!("perfect map {map}, {} N rule", report.threshold_n);
    Some(score_row(&name, &scores.all, Uncertainty::Interval))
}

/// Rows of the perfect maps of these reports, equal ones once.
pub fn perfects<'a>(reports: impl Iterator<Item = &'a EvaluationReport>) -> Vec<Vec<String>> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for row in reports.filter_map(perfect) {
        if !rows.contains(&row) {
            rows.push(row);
        }
    }
    rows
}

/// Models of a report, and the restrictions of its scores, one per line.
pub fn read_by(report: &EvaluationReport) -> String {
    let models = report.models.iter().map(ModelId::as_str);
    let by = models.chain(report.calibration.as_ref().map(CalibrationId::as_str));
    let by = by.collect::<Vec<_>>();
    let by = if by.is_empty() { "the nominal model".into() } else { by.join(", ") };
    let notes = report.notes.iter().map(|note| format!("Note: {note}.\n"));
    format!("By {by}.\n{}", notes.collect::<String>())
}
