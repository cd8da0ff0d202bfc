//! Prepared questions: groups of trials that `palpate plot` draws by a name.
//! PURE. Uses: conditions of the store, `query::groups`. Never: a request.

use crate::figure::series::Marks;
use crate::query::groups::{Grouping, conditions, filter};
use crate::store::table::{Column, Kind};
use crate::store::{Condition, MAX_PAGE, TrialQuery};

/// Names of the prepared questions.
pub const NAMES: [&str; 3] = ["counts", "force-depth", "fvu-by-pair"];
/// Ranges of a histogram, about.
const HISTOGRAM_RANGES: f64 = 40.0;

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
    /// Number of the only run.
    pub run: Option<i64>,
    /// Conditions on columns; a trial meets all of them.
    pub conditions: Vec<Condition>,
}

impl Trials {
    /// The conditions of a statement.
    fn all(&self) -> Vec<String> {
        let run = self.run.map(|scan_id| format!("scan_id = {scan_id}"));
        let filters = self.conditions.clone();
        let others = conditions(&TrialQuery { filters, ..TrialQuery::default() });
        run.into_iter().chain(others).collect()
    }

    /// The statement for groups of these trials, by the parameters of `/api/v1/trials/groups`.
    fn groups(&self, key: (&str, &str), agg: &str) -> Result<String, String> {
        let mut groups = Grouping::default();
        for (name, value) in [key, ("agg", agg)] {
            groups.apply(name, value)?;
        }
        groups.sql("trials", &self.all(), MAX_PAGE)
    }

    /// The statement for the number of these trials by label.
    pub fn labels(&self) -> String {
        let filter = filter(&self.all());
        format!(
            "SELECT label, COUNT(*) AS trials FROM trials{filter} GROUP BY label ORDER BY label"
        )
    }

    /// The statement for the ends of a column.
    pub fn ends(&self, column: &Column) -> String {
        let (name, filter) = (column.name, filter(&self.all()));
        format!("SELECT MIN({name}) AS low, MAX({name}) AS high FROM trials{filter}")
    }

    /// The prepared question of this name; `None` if there is none.
    ///
    /// # Errors
    /// As [`Grouping::sql`].
    pub fn named(&self, name: &str) -> Result<Option<Question>, String> {
        let (key, agg, title, [x, y], marks) = match name {
            "counts" => (
                ("group_by", "contact_count"),
                "count",
                "Trials by number of contacts",
                ["contacts at or above the deadband", "trials"],
                Marks::Bars,
            ),
            "force-depth" => (
                ("bin", "depth_mm:0.1"),
                "median(max_force_n),q10(max_force_n),q90(max_force_n)",
                "Largest force of a trial over depth",
                ["depth, mm", "force, N"],
                Marks::Lines,
            ),
            "fvu-by-pair" => (
                ("group_by", "pair"),
                "fvu",
                "Variance unexplained by the twins, by pair of electrodes",
                ["first electrode of the pair", "FVU"],
                Marks::Bars,
            ),
            _ => return Ok(None),
        };
        let sql = self.groups(key, agg)?;
        let axes = [x.to_owned(), y.to_owned()];
        Ok(Some(Question { sql, title: title.to_owned(), axes, marks, width: None }))
    }

    /// The histogram of a column from its least to its largest value.
    ///
    /// # Errors
    /// As [`Grouping::sql`].
    pub fn histogram(&self, column: &Column, [low, high]: [f64; 2]) -> Result<Question, String> {
        let width = nice((high - low) / HISTOGRAM_RANGES);
        let name = column.name;
        let unit =
            if column.unit.is_empty() { String::new() } else { format!(", {}", column.unit) };
        Ok(Question {
            sql: self.groups(("bin", &format!("{name}:{width}")), "count")?,
            title: format!("Trials by {name}"),
            axes: [format!("{name}{unit}"), "trials".into()],
            marks: Marks::Bars,
            width: Some(width),
        })
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
        for name in NAMES {
            let question = trials.named(name).unwrap().unwrap();
            assert!(question.sql.contains("tips = 4"), "{}", question.sql);
        }
        assert_eq!(trials.named("colour"), Ok(None));
        let of_run = Trials { run: Some(2), ..trials.clone() }.labels();
        assert!(of_run.contains("WHERE scan_id = 2 AND tips = 4 GROUP BY label"), "{of_run}");
        assert!(trials.labels().contains("WHERE tips = 4 GROUP BY label"));
        let column = number("fvu").unwrap();
        let question = trials.histogram(column, [0.0, 1.7]).unwrap();
        assert_eq!(question.width, Some(0.05));
        assert!(question.sql.contains("/ 0.05, 6)) * 0.05, 9) AS from_fvu"), "{}", question.sql);
        assert!(number("label").is_none() && number("seed").is_none());
        assert_eq!([nice(0.043), nice(0.05), nice(7.0), nice(0.0)], [0.05, 0.05, 10.0, 1.0]);
    }
}
