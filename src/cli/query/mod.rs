//! Questions in SQL: `palpate query` as a table or a file, `palpate plot` as a picture.
//! Uses: `client`, `table`, `figure::series`. Never: rows in this process but those that it shows.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use futures::StreamExt;
use reqwest::Method;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::At;
use super::client::Client;
use super::download::keep;
use super::error::{CliError, CliResult};
use super::output::{Output, bytes, counted, grouped, note, say, say_json, written};
use super::progress::Working;
use super::table::{Align, Table};
use crate::dataset::format::Format;
use crate::query::TIME_MAX;

mod plot;
mod prepared;

pub use plot::{PlotArgs, plot};

/// Longest time for which a question is asked again: twice the build of the engine on two cores.
const ENGINE_WAIT: Duration = Duration::from_secs(1200);
/// Interval of polling while the engine is built.
const ENGINE_POLL: Duration = Duration::from_secs(2);
/// Time for sending a result, in addition to that of the query.
const SENDING: Duration = Duration::from_secs(600);
/// Longest cell of a table, characters.
const CELL_MAX: usize = 60;

/// Options of `query`.
#[derive(Debug, Clone, Args)]
pub struct QueryArgs {
    /// One SELECT statement, in quotes; `-` reads it from standard input. Without it: the tables.
    #[arg(value_name = "SELECT ..")]
    pub sql: Option<String>,
    /// Format of the file, or of standard output; default: by the ending of --out, else a table.
    #[arg(long, value_parser = formats())]
    pub format: Option<Format>,
    /// Write the rows to this file.
    #[arg(long, short, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Largest number of rows of a table.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub limit: usize,
    #[command(flatten)]
    pub at: At,
}

fn formats() -> impl TypedValueParser<Value = Format> {
    let names = Format::ALL.into_iter().filter(|format| format.streams()).map(Format::name);
    PossibleValuesParser::new(names).map(|name| name.parse().unwrap_or(Format::Csv))
}

/// A column of an answer.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct AnswerColumn {
    /// Name of the column, as the statement states it.
    pub name: String,
    /// Type, for people.
    #[serde(rename = "type")]
    pub kind: String,
}

/// The rows that answer a statement.
#[derive(Debug, Clone, Deserialize)]
pub struct Answer {
    /// Columns, in their order.
    pub columns: Vec<AnswerColumn>,
    /// Number of rows.
    pub count: u64,
    /// Rows; absent values are missing.
    pub rows: Vec<Map<String, Value>>,
}

/// Runs `palpate query`.
///
/// # Errors
/// As [`ask`]; `CliError::Problems` if the format does not fit, `File` if the file cannot be written.
pub async fn query(client: &Client, args: &QueryArgs) -> CliResult<()> {
    let Some(sql) = args.sql.as_deref().map(statement).transpose()? else {
        return tables(client, args.at.output()).await;
    };
    match (args.format.or(args.out.as_deref().and_then(by_ending)), &args.out) {
        (Some(format), out) => write(client, &sql, format, out.clone()).await,
        (None, Some(out)) => {
            let rows = Format::ALL.into_iter().filter(|format| format.streams());
            let endings: Vec<&str> = rows.map(Format::extension).collect();
            let limit = format!("must end in {}, or name a --format", endings.join(", "));
            Err(CliError::argument("--out", out.display(), limit))
        }
        (None, None) if args.at.json => {
            let answer: Value = ask(client, &sql).await?;
            say_json(&answer);
            Ok(())
        }
        (None, None) => {
            let answer: Answer = ask(client, &sql).await?;
            show(&answer, args.limit);
            Ok(())
        }
    }
}

/// The statement of an argument, or of standard input for `-`.
fn statement(text: &str) -> CliResult<String> {
    if text != "-" {
        return Ok(text.to_owned());
    }
    let failed = |source| CliError::File { path: "standard input".into(), source };
    std::io::read_to_string(std::io::stdin()).map_err(failed)
}

async fn tables(client: &Client, output: Output) -> CliResult<()> {
    let tables: Vec<Map<String, Value>> = client.get("/api/v1/query/tables").await?;
    let text = |table: &Map<String, Value>, key: &str| {
        table.get(key).and_then(Value::as_str).unwrap_or_default().replace('`', "")
    };
    let mut shown = Table::new("table | a row is", "no tables");
    for table in &tables {
        let about = text(table, "about");
        shown.push([text(table, "name"), about.trim_start_matches("a row: ").to_owned()]);
    }
    let advice = "Write a name with a hyphen in double quotes: palpate query 'SELECT * FROM \"run-1\" LIMIT 5'";
    output.say(&tables, format_args!("{shown}\n{advice}"));
    Ok(())
}

/// Asks a statement; waits while the engine is built, or other queries are in progress.
///
/// # Errors
/// `CliError` if the service refuses the statement, or cannot be reached.
pub async fn ask<T: serde::de::DeserializeOwned>(client: &Client, sql: &str) -> CliResult<T> {
    Ok(send(client, &json!({ "sql": sql })).await?.json().await?)
}

async fn send(client: &Client, body: &Value) -> CliResult<reqwest::Response> {
    let client = client.patient(TIME_MAX + SENDING).showing("evaluating the query");
    let mut building = None;
    let until = Instant::now() + ENGINE_WAIT;
    loop {
        match client.send(Method::POST, "/api/v1/query", Some(body)).await {
            // Without an engine the service does not say so: to ask again is in vain.
            Err(CliError::Refused { status: 503, detail, again: true })
                if Instant::now() < until =>
            {
                if building.is_none() {
                    building = Some(Working::on(&detail));
                }
                tokio::time::sleep(ENGINE_POLL).await;
            }
            answered => return answered,
        }
    }
}

/// The format of rows that the ending of a file names.
pub fn by_ending(out: &Path) -> Option<Format> {
    let name = out.file_name()?.to_str()?.to_lowercase();
    let (_, format) = Format::of_file(&name)?;
    format.streams().then_some(format)
}

async fn write(client: &Client, sql: &str, format: Format, out: Option<PathBuf>) -> CliResult<()> {
    if out.is_none() && std::io::stdout().is_terminal() && !format.is_text() {
        let limit = "must go to a file: add --out FILE, or redirect standard output";
        return Err(CliError::argument("--format", format, limit));
    }
    let answer = send(client, &json!({ "sql": sql, "format": format.name() })).await?;
    if let Some(path) = out {
        let length = keep(answer, &path, "receiving the rows", CliError::Http).await?;
        note(format_args!("{}: {format}, {}", path.display(), bytes(length as f64)));
        return Ok(());
    }
    let (mut pieces, mut output) = (answer.bytes_stream(), std::io::stdout());
    while let Some(piece) = pieces.next().await {
        let piece = piece?;
        if !written(output.write_all(&piece).and_then(|()| output.flush())) {
            break;
        }
    }
    Ok(())
}

fn show(answer: &Answer, limit: usize) {
    let align = |kind: &str| match kind.contains("int") || kind.contains("float") {
        true if !kind.contains(['[', ' ']) => Align::Right,
        _ => Align::Left,
    };
    let heads = answer.columns.iter().map(|column| (column.name.clone(), align(&column.kind)));
    let mut table = Table::of_columns(heads.collect(), "no row");
    for row in answer.rows.iter().take(limit) {
        table.push(answer.columns.iter().map(|column| cell(row.get(&column.name))));
    }
    say(table);
    let shown = answer.rows.len().min(limit) as u64;
    if shown < answer.count {
        say(format_args!(
            "{} of {}; --limit N shows more, --out FILE.csv writes all",
            grouped(shown),
            counted(answer.count, "row", "rows")
        ));
    }
}

/// A value as text: numbers with at most seven digits, lists cut.
fn cell(value: Option<&Value>) -> String {
    let text = match value {
        None | Some(Value::Null) => return "-".into(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(number)) if number.is_f64() => {
            let number = number.as_f64().unwrap_or_default();
            return match number.abs() {
                size if size == 0.0 || (1e-3..1e7).contains(&size) => {
                    let digits = (6 - size.max(1.0).log10().floor() as i32).max(0) as usize;
                    let text = format!("{number:.digits$}");
                    match text.contains('.') {
                        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
                        false => text,
                    }
                }
                _ => format!("{number:.4e}"),
            };
        }
        Some(other) => other.to_string(),
    };
    match text.char_indices().nth(CELL_MAX) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::repeat::tests::answers;

    /// A refusal with status 503, with a further header.
    fn refused(header: &str, detail: &str) -> String {
        let body = json!({ "detail": detail }).to_string();
        let head = "HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-type: application/json";
        format!("{head}\r\n{header}content-length: {}\r\n\r\n{body}", body.len())
    }

    #[tokio::test]
    async fn a_missing_engine_is_an_error_at_once_and_one_that_is_built_is_waited_for() {
        let building = refused("retry-after: 5\r\n", "the query engine is built first");
        let missing = refused("", "no palpate-query");
        let (url, heard) = answers(vec![building, missing]).await;
        let client = Client::new(&url, None, None).unwrap();
        let error = ask::<Value>(&client, "SELECT 1").await.unwrap_err();
        assert_eq!(error.to_string(), "no palpate-query");
        assert_eq!(heard.await.unwrap().len(), 2);
    }

    #[test]
    fn the_ending_of_a_file_names_a_format_of_rows() {
        let of = |name: &str| by_ending(Path::new(name));
        assert_eq!(of("out/a.b.CSV"), Some(Format::Csv));
        assert_eq!((of("a.arrows"), of("a.arrow")), (Some(Format::Arrow), Some(Format::Feather)));
        assert_eq!((of("a.npz"), of("a.xls"), of("csv")), (None, None, None));
    }

    #[test]
    fn cells_are_short_and_keep_seven_digits() {
        let of = |value: Value| cell(Some(&value));
        assert_eq!(cell(None), "-");
        assert_eq!(of(json!(3)), "3");
        assert_eq!(of(json!(0.30000000000000004)), "0.3");
        assert_eq!(of(json!(1234567.89)), "1234568");
        assert_eq!(of(json!(12.5)), "12.5");
        assert_eq!(of(json!(0.000012345)), "1.2345e-5");
        assert_eq!(of(json!("text")), "text");
        assert_eq!(of(json!([1, 2])), "[1,2]");
        assert_eq!(of(json!("x".repeat(100))).chars().count(), CELL_MAX + 1);
    }
}
