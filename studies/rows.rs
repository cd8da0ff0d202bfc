//! Rows, small tables and notes of an evaluation report, common to several tables.
//! PURE. Uses: `evaluate::{table, score, reliability, distances}`. Never: a number that is not in the report.

use crate::evaluate::distances::Distances;
use crate::evaluate::reliability::Reliability;
use crate::evaluate::request::EvaluationReport;
use crate::evaluate::score::{Score, Scores, SpacingScore};
use crate::evaluate::table::{Uncertainty, markdown, score_row, share_cell};
use crate::ids::{CalibrationId, ModelId};

/// Rows of a method: over all frames, by the number of contacts, then by the spacing. Columns:
/// `evaluate::table::SCORE_COLUMNS`, means with 95 % intervals.
pub fn score_rows(name: &str, report: &EvaluationReport) -> Vec<Vec<String>> {
    let Some(scores) = &report.contacts else { return Vec::new() };
    let row = |(name, score): (String, &Score)| score_row(&name, score, Uncertainty::Interval);
    groups(name, scores).map(row).collect()
}

/// All frames, those with each number of contacts, and those in each range of the spacing: their names in tables,
/// and their scores.
fn groups<'a>(name: &str, scores: &'a Scores) -> impl Iterator<Item = (String, &'a Score)> {
    let by_contacts = scores.by_contacts.iter();
    let by_contacts = by_contacts.map(|of| (format!("  of {}", of.contacts), &of.score));
    let by_spacing = scores.by_spacing.iter().map(|range| (spacing_words(range), &range.score));
    [(name.to_owned(), &scores.all)].into_iter().chain(by_contacts).chain(by_spacing)
}

fn spacing_words(range: &SpacingScore) -> String {
    match (range.from_mm, range.to_mm) {
        (from_mm, None) => format!("  spacing from {from_mm} mm"),
        (from_mm, Some(to_mm)) if from_mm > 0.0 => format!("  spacing {from_mm} to {to_mm} mm"),
        (_, Some(to_mm)) => format!("  spacing under {to_mm} mm"),
    }
}

/// The row of a perfect map under the same rule, if the report has one.
pub fn perfect(report: &EvaluationReport) -> Option<Vec<String>> {
    let scores = report.perfect.as_ref()?;
    let map = report.map.as_deref().unwrap_or_default();
    let name = format!("perfect map {map}, {} N rule", report.threshold_n);
    Some(score_row(&name, &scores.all, Uncertainty::Interval))
}

/// Cost of a net by the paper's rule for the best of many (V-D); `None` if the report has no scores.
pub fn paper_cost(report: &EvaluationReport) -> Option<f64> {
    Some(report.contacts.as_ref()?.all.paper_cost(report.distances.guess_mm))
}

/// Footnote of a table of scores: the distances by which contacts were judged. Empty if the report has no scores
/// of contacts.
pub fn distances_note(report: &EvaluationReport) -> String {
    if report.contacts.is_none() {
        return String::new();
    }
    let Distances { ghost_mm, guess_mm } = report.distances;
    format!(
        "Ghosts are estimates farther than {ghost_mm} mm from every true contact. If nets are compared, a contact of a \
         trial without estimates counts as {guess_mm} mm off.\n\n"
    )
}

/// Footnote of a table with [`score_rows`]: as [`distances_note`], and what the spacing is if a row has one.
pub fn score_rows_note(report: &EvaluationReport) -> String {
    let mut note = distances_note(report);
    if report.contacts.as_ref().is_some_and(|scores| !scores.by_spacing.is_empty()) {
        note += "The spacing is the distance between the two closest true contacts.\n\n";
    }
    note
}

/// Whether a net beats a regression by the paper's rule; `None` if one of the reports has no scores.
pub fn beats(net: &EvaluationReport, regression: &EvaluationReport) -> Option<bool> {
    Some(paper_cost(net)? < paper_cost(regression)?)
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

/// Table of the 95 % regions of methods that state standard deviations: how often they hold the true place
/// and force, over pairs. Empty if none states them.
pub fn coverage<'a>(reports: impl Iterator<Item = (&'a str, &'a EvaluationReport)>) -> String {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for (name, report) in reports {
        let Some(scores) = &report.contacts else { continue };
        for (name, score) in groups(name, scores) {
            let Some(place) = &score.place_in_95 else { continue };
            let shares = [&score.place_in_95, &score.force_in_95].map(share_cell);
            rows.push([&[name, place.n.to_string()][..], &shares[..]].concat());
        }
    }
    if rows.is_empty() {
        return String::new();
    }
    let head = ["95 % regions of", "pairs", "hold place %", "hold force %"];
    format!("{}\n", markdown(&head, &rows))
}

/// Tables of how often answers are right that state a probability; empty if none does.
pub fn reliability<'a>(reports: impl Iterator<Item = (&'a str, &'a EvaluationReport)>) -> String {
    reports
        .filter_map(|(name, report)| {
            let ghost_mm = report.distances.ghost_mm;
            Some(reliability_of(name, report.reliability.as_ref()?, ghost_mm))
        })
        .collect()
}

fn reliability_of(name: &str, found: &Reliability, ghost_mm: f64) -> String {
    let percent = |share: f64| format!("{:.0}", 100.0 * share);
    let mut rows: Vec<Vec<String>> = Vec::new();
    for range in &found.ranges {
        let ends = format!("{} to {} %", percent(range.from), percent(range.to));
        let right = share_cell(&Some(range.right));
        rows.push(vec![ends, range.right.n.to_string(), percent(range.stated), right]);
    }
    let (right, any) = (share_cell(&Some(found.right)), share_cell(&Some(found.any_right)));
    format!(
        "{name}, answers by their probability; right: the number, and each contact within {ghost_mm} mm:\n\n{}\n\
         Right are {right} % of the answers; these or an alternative: {any} %.\n\n",
        markdown(&["probability", "answers", "stated %", "right %"], &rows)
    )
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::evaluate::reliability::JudgedAnswer;
    use crate::evaluate::touch::Touch;
    use crate::infer::answer::FoundContact;
    use crate::store::Contact;

    /// A report of frames with a contact at 100 mm, estimated to 2 mm in each direction.
    fn report(off_mm: &[f64], sd_mm: Option<f64>) -> EvaluationReport {
        let truth = Contact {
            x_mm: Some(100.0),
            y_mm: Some(100.0),
            force_n: Some(10.0),
            ..Contact::default()
        };
        let found = |off: &f64| FoundContact {
            x_mm: 100.0 + off,
            y_mm: 100.0,
            force_n: Some(10.0),
            x_sd_mm: sd_mm,
            y_sd_mm: sd_mm,
            force_sd_n: sd_mm,
            ..FoundContact::default()
        };
        let ghost_mm = Distances::PAPER.ghost_mm;
        let touch = |off: &f64| Touch::of_found(&[truth], &[found(off)], ghost_mm).unwrap();
        let touches: Vec<Touch> = off_mm.iter().map(touch).collect();
        let scores = Scores::of(&touches, &Distances::PAPER, 1);
        let report = json!({ "scored": "exact", "dataset": "ds-1", "label": "virtual", "models": [],
            "rows": off_mm.len(), "threshold_n": 5.0, "contacts": scores });
        serde_json::from_value(report).unwrap()
    }

    #[test]
    fn coverage_is_a_row_of_each_method_that_states_standard_deviations() {
        let sure = report(&[0.0, 3.0, 4.0, 9.0], Some(2.0));
        let table = coverage([("exact", &sure), ("paper", &report(&[1.0], None))].into_iter());
        let rows: Vec<&str> = table.lines().skip(2).filter(|line| !line.is_empty()).collect();
        assert_eq!(rows.len(), 2, "{table}");
        assert!(rows[0].starts_with("| exact ") && rows[1].contains("  of 1"), "{table}");
        // 3 and 4 mm are within 4.9 mm, 9 mm is not.
        assert!(rows[0].contains("75 [") && rows[0].contains("100 [100, 100]"), "{table}");
        assert_eq!(coverage([("paper", &report(&[1.0], None))].into_iter()), "");
    }

    #[test]
    fn rows_are_split_by_the_number_of_contacts_and_by_their_spacing() {
        let at = |x_mm: f64| Contact { x_mm: Some(x_mm), y_mm: Some(100.0), ..Contact::default() };
        let touch = |spacing_mm: f64| {
            let truths = [at(100.0), at(100.0 + spacing_mm)];
            Touch::of(&truths, &truths, Distances::PAPER.ghost_mm).unwrap()
        };
        let touches = [30.0, 59.0, 60.0, 300.0].map(touch);
        let mut report = report(&[], None);
        report.contacts = Some(Scores::of(&touches, &Distances::PAPER, 1));
        let rows = score_rows("exact", &report);
        let trials: Vec<[&str; 2]> =
            rows.iter().map(|row| [row[0].as_str(), row[1].as_str()]).collect();
        let expected = [
            ["exact", "4"],
            ["  of 2", "4"],
            ["  spacing under 60 mm", "2"],
            ["  spacing 60 to 120 mm", "1"],
            ["  spacing from 120 mm", "1"],
        ];
        assert_eq!(trials, expected);
        assert!(score_rows_note(&report).contains("The spacing is"));
        assert!(!distances_note(&report).contains("spacing"), "a table without these rows");
    }

    #[test]
    fn a_net_beats_a_regression_only_if_its_cost_is_lower() {
        let [near, far] = [report(&[1.0], None), report(&[9.0], None)];
        assert_eq!((beats(&near, &far), beats(&far, &near)), (Some(true), Some(false)));
        assert_eq!(beats(&near, &near), Some(false));
        let unscored = EvaluationReport { contacts: None, ..near.clone() };
        assert_eq!(beats(&near, &unscored), None);
    }

    #[test]
    fn reliability_states_what_was_right_of_what_was_stated() {
        let mut report = report(&[0.0], Some(2.0));
        assert_eq!(reliability([("exact", &report)].into_iter()), "");
        let answer = |probability, right| JudgedAnswer { probability, right, any_right: true };
        report.reliability = Reliability::of(&[answer(0.7, true), answer(0.7, false)], 1);
        let text = reliability([("exact", &report)].into_iter());
        assert!(text.contains("60 to 80 %") && text.contains(" 70 |"), "{text}");
        assert!(text.contains("an alternative: 100 [100, 100] %."), "{text}");
        assert!(text.contains("each contact within 40 mm:"), "{text}");
        report.distances = Distances::on_skin([60.0, 100.0]);
        let text = reliability([("exact", &report)].into_iter());
        assert!(text.contains("each contact within 7.143 mm:"), "{text}");
    }

    #[test]
    fn a_table_states_the_distances_of_its_skin() {
        let mut report = report(&[], None);
        let note = distances_note(&report);
        assert!(note.contains("farther than 40 mm") && note.contains("as 287 mm off"), "{note}");
        report.contacts.as_mut().unwrap().all.contacts = 1;
        // Without an estimate: force and diameter cost 1 each.
        assert!((paper_cost(&report).unwrap() - 4.87).abs() < 1e-12);
        report.distances = Distances::on_skin([60.0, 100.0]);
        let note = distances_note(&report);
        assert!(note.contains("farther than 7.143 mm") && note.contains("51.25 mm off"), "{note}");
        assert!((paper_cost(&report).unwrap() - 2.5125).abs() < 1e-12);
        report.contacts = None;
        assert_eq!(distances_note(&report), "");
    }
}
