//! Prepared questions: statements that `palpate plot` draws by a name.
//! PURE. Uses: conditions of the store. Never: a request.

use crate::figure::series::Marks;
use crate::ids::RunUid;
use crate::query::groups;
use crate::store::table::{Column, Kind};
use crate::store::{Condition, TrialQuery};

/// Names of the prepared questions, with what they show.
pub const NAMES: [(&str, &str); 3] = [
    ("counts", "trials by number of contacts (Table I)"),
    ("force-depth", "largest force over depth: median, 10 % and 90 % quantiles"),
    ("fvu-by-pair", "fraction of variance unexplained by the twin, by pair of electrodes"),
];
/// Ranges of a histogram, about.
const HISTOGRAM_RANGES: f64 = 40.0;
/// Width of the ranges of depth, mm.
const DEPTH_MM: f64 = 0.1;

/// A statement and how its rows are drawn: the first column over the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// SELECT statement, in the dialect of polars.
    pub sql: String,
    /// Title of the figure.
    pub title: String,
    /// Name of the horizontal axis; of the vertical one.
    pub axes: [String; 2],
    /// How the series are drawn.
    pub marks: Marks,
    /// Width of a range on the horizontal axis.
    pub width: Option<f64>,
}

/// Which trials a question is about.
#[derive(Debug, Clone, Default)]
pub struct Trials {
    /// Only this run.
    pub run: Option<RunUid>,
    /// Conditions on columns; a trial meets all of them.
    pub conditions: Vec<Condition>,
}

impl Trials {
    /// ` WHERE ..` with one more condition, or nothing.
    fn filter(&self, more: &str) -> String {
        let query =
            TrialQuery { run: self.run, filters: self.conditions.clone(), ..TrialQuery::default() };
        let mut all = groups::conditions(&query);
        all.extend((!more.is_empty()).then(|| more.to_owned()));
        if all.is_empty() { String::new() } else { format!(" WHERE {}", all.join(" AND ")) }
    }

    /// The statement for the number of these trials by label.
    pub fn labels(&self) -> String {
        let filter = self.filter("");
        format!(
            "SELECT label, COUNT(*) AS trials FROM trials{filter} GROUP BY label ORDER BY label"
        )
    }

    /// The statement for the ends of a column.
    pub fn ends(&self, column: &Column) -> String {
        let (name, filter) = (column.name, self.filter(""));
        format!("SELECT MIN({name}) AS low, MAX({name}) AS high FROM trials{filter}")
    }

    /// The prepared question of this name.
    pub fn named(&self, name: &str) -> Option<Question> {
        Some(match name {
            "counts" => Question {
                sql: format!(
                    "SELECT contact_count, COUNT(*) AS trials FROM trials{} \
                     GROUP BY contact_count ORDER BY contact_count",
                    self.filter("")
                ),
                title: "Trials by number of contacts".into(),
                axes: ["contacts at or above the deadband".into(), "trials".into()],
                marks: Marks::Bars,
                width: None,
            },
            "force-depth" => Question {
                sql: format!(
                    "SELECT ROUND(FLOOR(depth_mm / {DEPTH_MM} + 0.5) * {DEPTH_MM}, 3) AS depth, \
                     MEDIAN(max_force_n) AS median, QUANTILE_CONT(max_force_n, 0.1) AS \"10 %\", \
                     QUANTILE_CONT(max_force_n, 0.9) AS \"90 %\" FROM trials{} \
                     GROUP BY depth ORDER BY depth",
                    self.filter("depth_mm IS NOT NULL")
                ),
                title: "Largest force of a trial over depth".into(),
                axes: ["depth, mm".into(), "force, N".into()],
                marks: Marks::Lines,
                width: None,
            },
            "fvu-by-pair" => Question {
                sql: format!(
                    "SELECT pair, AVG(POWER(CAST(voltage_v AS DOUBLE) - sim_voltage_v, 2)) / \
                     (AVG(POWER(CAST(voltage_v AS DOUBLE), 2)) - POWER(AVG(CAST(voltage_v AS DOUBLE)), 2)) \
                     AS fvu FROM voltages \
                     WHERE sim_voltage_v IS NOT NULL AND trial_id IN \
                     (SELECT trial_id FROM trials{}) GROUP BY pair ORDER BY pair",
                    self.filter("")
                ),
                title: "Variance unexplained by the twins, by pair of electrodes".into(),
                axes: ["first electrode of the pair".into(), "FVU".into()],
                marks: Marks::Bars,
                width: None,
            },
            _ => return None,
        })
    }

    /// The histogram of a column from its least to its largest value.
    pub fn histogram(&self, column: &Column, [low, high]: [f64; 2]) -> Question {
        let width = nice((high - low) / HISTOGRAM_RANGES);
        let name = column.name;
        let unit =
            if column.unit.is_empty() { String::new() } else { format!(", {}", column.unit) };
        Question {
            sql: format!(
                "SELECT ROUND(FLOOR(CAST({name} AS DOUBLE) / {width}) * {width}, 9) AS low, \
                 COUNT(*) AS trials FROM trials{} GROUP BY low ORDER BY low",
                self.filter(&format!("{name} IS NOT NULL"))
            ),
            title: format!("Trials by {name}"),
            axes: [format!("{name}{unit}"), "trials".into()],
            marks: Marks::Bars,
            width: Some(width),
        }
    }
}

/// Returns the column of a histogram.
pub fn number(name: &str) -> Option<&'static Column> {
    Column::find(name).filter(|column| column.is_of_stored() && column.kind() == Kind::Number)
}

/// The least of 1, 2 and 5 times a power of ten that is not below `value`; 1 for none.
fn nice(value: f64) -> f64 {
    if !value.is_finite() || value <= 0.0 {
        return 1.0;
    }
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|step| step * decade);
    steps.into_iter().find(|step| *step >= value * (1.0 - 1e-9)).unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_a_question_about_the_selected_trials() {
        let trials = Trials { run: None, conditions: vec![Condition::parse("tips=4").unwrap()] };
        for (name, _) in NAMES {
            let question = trials.named(name).unwrap();
            assert!(question.sql.contains("tips = 4"), "{}", question.sql);
        }
        assert!(trials.named("colour").is_none());
        assert!(trials.labels().contains("WHERE tips = 4 GROUP BY label"));
        let column = number("fvu").unwrap();
        let question = trials.histogram(column, [0.0, 1.7]);
        assert_eq!(question.width, Some(0.05));
        assert!(question.sql.contains("WHERE tips = 4 AND fvu IS NOT NULL"), "{}", question.sql);
        assert!(number("label").is_none() && number("seed").is_none());
        assert_eq!([nice(0.043), nice(0.05), nice(7.0), nice(0.0)], [0.05, 0.05, 10.0, 1.0]);
    }
}
