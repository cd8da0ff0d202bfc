//! Scores as rows of a plain-text (Markdown) table, with the published ones for comparison.
//! PURE. Uses: `score`, `published`, `anova`. Never: a number for what is absent (it is a dash).

use super::anova::Anova;
use super::published::{Printed, Published};
use super::score::{Mean, Score};

/// Columns of a table of scores. The paper's one location error is in both columns of location; the
/// reason is in `published`.
pub const SCORE_COLUMNS: [&str; 10] = [
    "method",
    "trials",
    "number %",
    "location mm",
    "closest mm",
    "force %",
    "median abs. force %",
    "diameter %",
    "exact %",
    "ghosts/trial",
];

/// Text of a cell without a value.
const EMPTY_CELL: &str = "-";
/// Smaller p-values are printed as `<` this, as in the paper.
const SMALLEST_P: f64 = 1e-4;

/// Addition to a mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Uncertainty {
    /// The standard deviation of the values, as in the paper: `-22 ± 23`.
    Spread,
    /// The 95 % interval of the mean: `-22 [-24, -20]`.
    Interval,
}

/// A score as a row under [`SCORE_COLUMNS`].
pub fn score_row(method: &str, score: &Score, shown: Uncertainty) -> Vec<String> {
    let cell = |mean: &Option<Mean>, scale: f64| match mean {
        Some(mean) => mean_cell(mean, scale, shown),
        None => EMPTY_CELL.into(),
    };
    let force_median = score.force_median_percent;
    vec![
        method.into(),
        score.trials.to_string(),
        cell(&score.number_percent, 1.0),
        cell(&score.location_mm, 1.0),
        closest(score, &cell),
        cell(&score.force_percent, 1.0),
        force_median.map_or(EMPTY_CELL.into(), |median| figure(median, decimals(median))),
        cell(&score.diameter_percent, 1.0),
        // The standard deviation of a yes/no value follows from its mean.
        match (shown, &score.exact_rate) {
            (Uncertainty::Spread, Some(rate)) => figure(100.0 * rate.mean, 0),
            (Uncertainty::Spread, None) | (Uncertainty::Interval, _) => {
                cell(&score.exact_rate, 100.0)
            }
        },
        cell(&score.ghosts_per_trial, 1.0),
    ]
}

/// The distance to the closest estimate; if frames without any estimate have none, with the share
/// of the true contacts that it covers.
fn closest(score: &Score, cell: &impl Fn(&Option<Mean>, f64) -> String) -> String {
    let words = cell(&score.closest_mm, 1.0);
    match score.closest_mm {
        Some(mean) if mean.n < score.contacts => {
            // Rounded down: a missing part must stay visible.
            format!("{words} of {} %", 100 * mean.n / score.contacts)
        }
        _ => words,
    }
}

/// A share as a cell, %, with its 95 % interval.
pub fn share_cell(share: &Option<Mean>) -> String {
    let cell = |share: &Mean| mean_cell(share, 100.0, Uncertainty::Interval);
    share.as_ref().map_or(EMPTY_CELL.into(), cell)
}

/// A published score as a row under [`SCORE_COLUMNS`], in the paper's digits.
pub fn published_row(method: &str, published: &Published) -> Vec<String> {
    let cell = |printed: &Printed| match printed.sd {
        Some(sd) => format!("{} ± {sd}", printed.mean),
        None => printed.mean.to_string(),
    };
    let absent = || EMPTY_CELL.to_owned();
    vec![
        method.into(),
        absent(),
        cell(&published.number_percent),
        cell(&published.location_mm),
        cell(&published.location_mm),
        cell(&published.force_percent),
        absent(),
        cell(&published.diameter_percent),
        absent(),
        absent(),
    ]
}

/// Formats an analysis of variance: one row per effect, and one for the error.
pub fn anova(anova: &Anova) -> String {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for effect in &anova.effects {
        let names = effect.factors.iter().map(|factor| anova.factors[*factor].name.as_str());
        rows.push(vec![
            names.collect::<Vec<&str>>().join(" x "),
            format!("{:.4e}", effect.sum_of_squares),
            effect.df.to_string(),
            effect.f.map_or(EMPTY_CELL.into(), |f| format!("{f:.2}")),
            match effect.p {
                Some(p) if p < SMALLEST_P => format!("< {SMALLEST_P}"),
                Some(p) => format!("{p:.4}"),
                None => EMPTY_CELL.into(),
            },
        ]);
    }
    rows.push(vec![
        "error".into(),
        format!("{:.4e}", anova.error_sum_of_squares),
        anova.error_df.to_string(),
        EMPTY_CELL.into(),
        EMPTY_CELL.into(),
    ]);
    markdown(&["effect", "sum of squares", "df", "F", "p"], &rows)
}

/// A Markdown table that is also aligned as plain text: the first column to the left, the others to
/// the right. Rows must be as long as the head.
pub fn markdown(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().map(|row| row[column].chars().count());
        cells.max().unwrap_or(0).max(head[column].chars().count())
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let mut table = line(head.iter().copied(), &widths);
    let rules = widths.iter().enumerate().map(|(column, width)| match column {
        0 => format!(":{}", "-".repeat(width - 1)),
        _ => format!("{}:", "-".repeat(width - 1)),
    });
    let rules: Vec<String> = rules.collect();
    table.push_str(&line(rules.iter().map(String::as_str), &widths));
    for row in rows {
        table.push_str(&line(row.iter().map(String::as_str), &widths));
    }
    table
}

fn line<'a>(cells: impl Iterator<Item = &'a str>, widths: &[usize]) -> String {
    let cells = cells.zip(widths).enumerate().map(|(column, (cell, width))| match column {
        0 => format!("{cell:<width$}"),
        _ => format!("{cell:>width$}"),
    });
    format!("| {} |\n", cells.collect::<Vec<String>>().join(" | "))
}

fn mean_cell(mean: &Mean, scale: f64, shown: Uncertainty) -> String {
    let digits = decimals(scale * mean.mean);
    let figure = |value: f64| figure(scale * value, digits);
    let ends = mean.low_95.zip(mean.high_95);
    match (shown, mean.sd, ends) {
        (Uncertainty::Spread, Some(sd), _) => format!("{} ± {}", figure(mean.mean), figure(sd)),
        (Uncertainty::Interval, _, Some((low, high))) => {
            format!("{} [{}, {}]", figure(mean.mean), figure(low), figure(high))
        }
        (Uncertainty::Spread, None, _) | (Uncertainty::Interval, _, None) => figure(mean.mean),
    }
}

/// Number of decimals: none, as in the paper, and one below 10.
fn decimals(value: f64) -> usize {
    usize::from(value.abs() < 9.95)
}

/// Formats a number, without a minus sign before zero.
fn figure(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.into(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::published::{REAL_UNSEEN, TABLE_IV};

    fn mean(mean: f64, sd: f64, half: f64) -> Option<Mean> {
        let (low_95, high_95) = (Some(mean - half), Some(mean + half));
        Some(Mean { mean, sd: Some(sd), n: 9, low_95, high_95 })
    }

    #[test]
    fn a_score_stands_beside_the_published_one_and_what_is_absent_is_a_dash() {
        let score = Score {
            trials: 500,
            number_percent: mean(-22.4, 23.4, 2.0),
            location_mm: mean(9.94, 12.0, 0.55),
            force_median_percent: Some(10.4),
            exact_rate: mean(0.713, 0.4, 0.04),
            ghosts_per_trial: mean(-0.001, 0.2, 0.01),
            ..Score::default()
        };
        let rows = [
            score_row("ours", &score, Uncertainty::Spread),
            score_row("ours, interval", &score, Uncertainty::Interval),
            published_row("paper, Map 1", &TABLE_IV[0]),
            published_row("paper, V-D", &REAL_UNSEEN),
        ];
        let table = markdown(&SCORE_COLUMNS[..4], &rows.clone().map(|row| row[..4].to_vec()));
        let expected = "\
| method         | trials |       number % |     location mm |
| :------------- | -----: | -------------: | --------------: |
| ours           |    500 |       -22 ± 23 |      9.9 ± 12.0 |
| ours, interval |    500 | -22 [-24, -20] | 9.9 [9.4, 10.5] |
| paper, Map 1   |      - |       -22 ± 23 |         11 ± 22 |
| paper, V-D     |      - |          -58.3 |            74.4 |
";
        assert_eq!(table, expected);
        let silent = Score { closest_mm: mean(50.0, 9.0, 2.0), contacts: 12, ..Score::default() };
        assert_eq!(score_row("ours", &silent, Uncertainty::Interval)[4], "50 [48, 52] of 75 %");
        assert_eq!(rows[0][4..], ["-", "-", "10", "-", "71", "0.0 ± 0.2"]);
        assert_eq!(rows[1][8..], ["71 [67, 75]", "0.0 [0.0, 0.0]"]);
        assert_eq!(rows[2][7], "-31 ± 12");
        assert!(rows.iter().all(|row| row.len() == SCORE_COLUMNS.len()));
    }
}
