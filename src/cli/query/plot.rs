//! `palpate plot`: the answer to a statement, or to a prepared question, as a picture.
//! Uses: `figure::series`, `picture`. Never: a number that is not in the answer.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use serde_json::{Value, json};

use super::prepared::{NAMES, Question, Trials, number};
use super::{Answer, ask};
use crate::cli::At;
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::output::note;
use crate::cli::picture::{self, figure_file};
use crate::figure::Heading;
use crate::figure::series::{Chart, Marks, Places, Series};
use crate::near::did_you_mean;
use crate::store::Condition;

/// Most whole numbers that are drawn as names.
const DRAWN_NAMES_MAX: usize = 40;

/// Options of `plot`.
#[derive(Debug, Clone, Args)]
pub struct PlotArgs {
    /// counts, force-depth, fvu-by-pair; a column, for its histogram; or a SELECT statement, whose
    /// first column is drawn over the others.
    #[arg(value_name = "NAME|COLUMN|SELECT ..")]
    pub what: String,
    /// A run (number, start of the id, or `last`), and conditions as of `palpate trials`.
    #[arg(value_name = "RUN|COLUMN__gt=VALUE")]
    pub of: Vec<String>,
    /// File of the picture; ends in .svg, .png or .pdf.
    #[arg(long, short, value_name = "FILE", default_value = "palpate-plot.svg",
        value_parser = figure_file)]
    pub out: PathBuf,
    /// How a statement is drawn [default: bars for names and few whole numbers, else lines].
    #[arg(long, value_parser = marks())]
    pub marks: Option<Marks>,
    /// Title of the figure [default: that of the question].
    #[arg(long, value_name = "TEXT")]
    pub title: Option<String>,
    #[command(flatten)]
    pub at: At,
}

/// Parser of how series are drawn.
fn marks() -> impl TypedValueParser<Value = Marks> {
    PossibleValuesParser::new(["bars", "lines", "dots"]).map(|name| match name.as_str() {
        "bars" => Marks::Bars,
        "lines" => Marks::Lines,
        _ => Marks::Dots,
    })
}

/// Runs `palpate plot`.
///
/// # Errors
/// As [`ask`] and [`find_run`]; `CliError::Problems` if the question is unknown, others if the picture cannot be
/// written.
pub async fn plot(client: &Client, args: &PlotArgs) -> CliResult<()> {
    let trials = trials(client, &args.of).await?;
    let is_statement = args.what.contains(char::is_whitespace);
    let (question, answer, heading) = if is_statement {
        let answer: Answer = ask(client, &args.what).await?;
        let title = args.title.clone().unwrap_or_else(|| title_of(&answer));
        let labels: Answer = ask(client, &Trials::default().labels()).await?;
        let heading = Heading::new(&title, answer.count, "rows", &origin(&labels));
        let heading = heading.with_note(&args.what);
        let question = of_statement(&args.what, &title, &answer);
        (question, answer, heading)
    } else {
        let question = question(client, &trials, &args.what).await?;
        let answer: Answer = ask(client, &question.sql).await?;
        let labels: Answer = ask(client, &trials.labels()).await?;
        let (label, count) = label(&labels);
        let title = args.title.as_ref().unwrap_or(&question.title);
        let mut heading = Heading::new(title, count, "trials", &label);
        if !args.of.is_empty() {
            let run = trials.run.map(|scan_id| format!("run {scan_id}"));
            let conditions = args.of.iter().filter(|text| text.contains('=')).cloned();
            let of: Vec<String> = run.into_iter().chain(conditions).collect();
            heading = heading.with_note(of.join(", "));
        }
        note(format_args!("palpate query \"{}\"", question.sql.replace('"', "\\\"")));
        (question, answer, heading)
    };
    let marks = args.marks.unwrap_or(question.marks);
    let svg = chart(&question, marks, &answer)
        .and_then(|chart| chart.draw(&heading))
        .map_err(|limit| CliError::argument("the answer", &args.what, limit))?;
    picture::write(&args.out, &svg).await?;
    let drawn = json!({ "sql": question.sql, "rows": answer.count, "file": args.out });
    args.at.output().say(&drawn, args.out.display());
    Ok(())
}

/// The selected trials.
async fn trials(client: &Client, of: &[String]) -> CliResult<Trials> {
    let mut trials = Trials::default();
    for text in of {
        if text.contains('=') {
            let condition = Condition::parse(text).and_then(Condition::of_stored);
            let condition = condition.map_err(|limit| CliError::argument("WHERE", text, limit))?;
            trials.conditions.push(condition);
        } else if trials.run.is_none() {
            trials.run = Some(find_run(client, text).await?.scan_id);
        } else {
            let limit = "must be a condition such as tips=4, or the only run";
            return Err(CliError::argument("RUN", text, limit));
        }
    }
    Ok(trials)
}

/// The prepared question of a name, or the histogram of a column.
async fn question(client: &Client, trials: &Trials, name: &str) -> CliResult<Question> {
    let refused = |limit: String| CliError::argument("NAME", name, limit);
    if let Some(question) = trials.named(name).map_err(refused)? {
        return Ok(question);
    }
    let Some(column) = number(name) else {
        let columns = crate::store::table::TABLE.iter().map(|column| column.name);
        let meant = did_you_mean(name, NAMES.into_iter().chain(columns));
        let known = NAMES.join(", ");
        return Err(refused(format!(
            "must be {known}, a column of numbers, or a SELECT statement{meant}"
        )));
    };
    let ends: Answer = ask(client, &trials.ends(column)).await?;
    let end = |key: &str| ends.rows.first().and_then(|row| row.get(key)).and_then(Value::as_f64);
    let (Some(low), Some(high)) = (end("low"), end("high")) else {
        let limit = "has no value in the selected trials";
        return Err(CliError::argument("COLUMN", name, limit));
    };
    trials.histogram(column, [low, high]).map_err(refused)
}

/// A statement as a question: what is not known of it follows from its answer.
fn of_statement(sql: &str, title: &str, answer: &Answer) -> Question {
    let names: Vec<&str> = answer.columns.iter().map(|column| column.name.as_str()).collect();
    let x_name = names.first().copied().unwrap_or_default();
    let first = answer.columns.first().map(|column| column.kind.as_str()).unwrap_or_default();
    let few = answer.rows.len() <= 40;
    let bars = first == "string" || first == "bool" || few && first.contains("int");
    Question {
        sql: sql.to_owned(),
        title: title.to_owned(),
        axes: [x_name.to_owned(), names[1.min(names.len())..].join(", ")],
        marks: if bars { Marks::Bars } else { Marks::Lines },
        width: None,
    }
}

fn title_of(answer: &Answer) -> String {
    let names: Vec<&str> = answer.columns.iter().map(|column| column.name.as_str()).collect();
    match names.split_first() {
        Some((x, values)) if !values.is_empty() => format!("{} over {x}", values.join(", ")),
        _ => "Result of a query".into(),
    }
}

/// The label of trials, and their number.
fn label(labels: &Answer) -> (String, u64) {
    let text = |row: &serde_json::Map<String, Value>| {
        row.get("label").and_then(Value::as_str).unwrap_or("no label").to_owned()
    };
    let names: Vec<String> = labels.rows.iter().map(text).collect();
    let count = labels.rows.iter().filter_map(|row| row.get("trials")?.as_u64()).sum();
    (names.join(" and "), count)
}

/// The origin of an answer to a statement, which may read any table: the label of all stored trials.
fn origin(labels: &Answer) -> String {
    match label(labels).0 {
        none if none.is_empty() => "query".into(),
        stored => format!("query, stored trials {stored}"),
    }
}

/// The first column as places, the other columns of numbers as series.
fn chart(question: &Question, marks: Marks, answer: &Answer) -> Result<Chart, String> {
    let (first, values) = answer.columns.split_first().ok_or("has no columns")?;
    if answer.rows.is_empty() {
        return Err("has no row to draw: no trial or row fits the conditions".into());
    }
    // A row without a place is not drawn.
    let rows: Vec<_> = answer.rows.iter().filter(|row| row.contains_key(&first.name)).collect();
    let numbers: Vec<f64> = rows.iter().filter_map(|row| row.get(&first.name)?.as_f64()).collect();
    let whole = numbers.iter().all(|n| n.fract() == 0.0) && numbers.len() <= DRAWN_NAMES_MAX;
    // Bars of few whole numbers, such as counts, are parted like names.
    let as_names = whole && marks == Marks::Bars && question.width.is_none();
    let places = if numbers.len() == rows.len() && !as_names {
        Places::Numbers(numbers)
    } else {
        let name = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        Places::Names(rows.iter().filter_map(|row| row.get(&first.name).map(name)).collect())
    };
    let series: Vec<Series> = values
        .iter()
        .map(|column| Series {
            name: column.name.clone(),
            values: rows.iter().map(|row| row.get(&column.name)?.as_f64()).collect(),
        })
        .filter(|series| series.values.iter().any(Option::is_some))
        .collect();
    if series.is_empty() {
        return Err("has no second column of numbers to draw over the first one".into());
    }
    let [x_name, y_name] = question.axes.clone();
    Ok(Chart { x_name, y_name, places, width: question.width, series, marks })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(columns: &[(&str, &str)], rows: Value) -> Answer {
        let columns: Vec<Value> =
            columns.iter().map(|(name, kind)| json!({ "name": name, "type": kind })).collect();
        let count = rows.as_array().map_or(0, Vec::len);
        serde_json::from_value(json!({ "columns": columns, "count": count, "rows": rows })).unwrap()
    }

    #[test]
    fn the_first_column_is_drawn_over_the_others() {
        let rows = json!([{ "tips": 1, "n": 3, "who": "a" }, { "tips": 2 }, { "n": 4 }]);
        let answer = answer(&[("tips", "uint8"), ("n", "uint32"), ("who", "string")], rows);
        let question = of_statement("SELECT", "Title", &answer);
        assert_eq!((question.marks, question.axes[0].as_str()), (Marks::Bars, "tips"));
        let lines = chart(&question, Marks::Lines, &answer).unwrap();
        assert_eq!(lines.places, Places::Numbers(vec![1.0, 2.0]));
        let chart = chart(&question, question.marks, &answer).unwrap();
        assert_eq!(chart.places, Places::Names(vec!["1".into(), "2".into()]));
        assert_eq!(chart.series, [Series { name: "n".into(), values: vec![Some(3.0), None] }]);
        assert_eq!(title_of(&answer), "n, who over tips");
    }

    #[test]
    fn an_answer_without_numbers_is_refused() {
        let one = answer(&[("label", "string")], json!([{ "label": "virtual" }]));
        let question = of_statement("SELECT", "", &one);
        assert!(chart(&question, Marks::Bars, &one).unwrap_err().contains("second column"));
        let none = answer(&[("tips", "uint8"), ("n", "uint32")], json!([]));
        assert!(chart(&question, Marks::Bars, &none).unwrap_err().contains("no row to draw"));
        let labels = answer(
            &[("label", "string"), ("trials", "uint32")],
            json!([{ "label": "measured", "trials": 2 }, { "label": "virtual", "trials": 5 }]),
        );
        assert_eq!(label(&labels), ("measured and virtual".into(), 7));
        assert_eq!(origin(&labels), "query, stored trials measured and virtual");
        assert_eq!(origin(&Answer { count: 0, rows: Vec::new(), ..labels }), "query");
    }
}
