//! `palpate dataset`: lists, shows, makes and exports datasets.
//! Uses: `client`, `import`. Never: rows in this process (the service reads and writes them).

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use futures::StreamExt;
use reqwest::Method;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliError;
use super::files::read_as;
use super::import::{ImportArgs, import};
use super::output::{bytes, counted, say, say_json};
use super::progress::progress_bar;
use super::start_time::local;
use super::table::{Align, Table, or_dash};
use super::{At, embed};
use crate::dataset::export::ExportRequest;
use crate::dataset::format::Format;
use crate::digest::Hashing;
use crate::file_kind::FileKind;
use crate::ids::DatasetId;

/// Interval of polling an export's progress.
const LOOK: Duration = Duration::from_millis(200);
/// Longest wait until a dataset is made.
const MAKING: Duration = Duration::from_secs(3600);
/// Number of attempts of a download whose connection breaks.
const TRIES: u32 = 5;

/// Options of `dataset`.
#[derive(Debug, Args)]
pub struct DatasetArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Show the existing datasets, and the names that can be requested.
    List(At),
    /// Show a dataset: parts, contacts, excluded trials with reasons, columns.
    Show(ShowArgs),
    /// Make a dataset from the trials stored now, by its definition file or its name.
    Make(MakeArgs),
    /// Write a dataset to a file.
    ///
    /// The service writes it first, resumes after a restart and reports its progress; then the file
    /// is downloaded, resumed if a connection breaks, and its sha256 checked.
    Export(ExportArgs),
    /// Remove the older datasets of each name, except those that a model or a job needs.
    Prune(PruneArgs),
    /// Import trials measured elsewhere, as a separate run.
    ///
    /// FILE is Parquet with the columns of the trials table, of which `voltages_v` and `contacts`
    /// are required; or CSV (columns v0, v1, .., x_mm, y_mm, force_n), NPZ or MAT of version 5 to 7
    /// (arrays voltages_v, contacts_xy_mm, force_n). Contacts may lack force or position. Exit code
    /// 2 if a value cannot be used: each problem names row, column, value and limit, and nothing is
    /// stored.
    Import(ImportArgs),
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// Id or name; `run-N` is all trials of a run.
    name: String,
    /// Show the lineage: runs, models, calibrations, shards, code.
    #[arg(long)]
    lineage: bool,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct MakeArgs {
    /// Definition file (see experiments/datasets), or a name: of a built-in definition, of an
    /// existing dataset, or `run-N`.
    #[arg(value_name = "DATASET.toml|NAME")]
    what: PathBuf,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct PruneArgs {
    /// Number of datasets of each name that stay, the newest ones.
    #[arg(long, value_name = "N", default_value_t = std::num::NonZeroU32::MIN)]
    keep: std::num::NonZeroU32,
    /// Show what would be removed, and remove nothing.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct ExportArgs {
    /// Id or name; `run-N` is all trials of a run.
    name: String,
    /// Format of the file.
    #[arg(long, default_value = Format::Parquet.name(), value_parser = formats())]
    format: Format,
    /// A condition on rows, such as `contact_count__gte=3` or `split=train`; may be repeated.
    #[arg(long = "where", value_name = "COLUMN__gt=VALUE")]
    conditions: Vec<String>,
    /// Columns, in this order.
    #[arg(long, value_delimiter = ',', value_name = "NAME,..")]
    columns: Vec<String>,
    /// A force map for each row, as pixel x diameter in mm: 4x20.
    #[arg(long, value_name = "PIXELxDIAMETER")]
    map: Option<String>,
    /// Only these values of each frame, the end excluded: 0:28.
    #[arg(long, value_name = "FIRST:END")]
    slice: Option<String>,
    /// The file [default: NAME.FORMAT here].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    at: At,
}

/// Parser of the name of a format; the help lists the formats.
fn formats() -> impl TypedValueParser<Value = Format> {
    let of = |format: Format| PossibleValue::new(format.name()).help(format.about());
    PossibleValuesParser::new(Format::ALL.map(of)).try_map(|name| name.parse::<Format>())
}

/// Fields of an export that are read.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct ExportView {
    id: String,
    state: String,
    rows_done: u64,
    rows_total: u64,
    dataset: Option<DatasetId>,
    bytes: Option<u64>,
    sha256: Option<String>,
    error: Option<String>,
    url: Option<String>,
}

/// Runs `palpate dataset`.
///
/// # Errors
/// `CliError` if the server cannot be reached or refuses, or a file cannot be read or written.
pub async fn dataset(args: DatasetArgs) -> Result<(), CliError> {
    match args.what {
        What::List(at) => {
            let json = at.json;
            embed::reading(&at, move |client| async move { list(&client, json).await }).await
        }
        What::Show(args) => {
            let at = args.at.clone();
            embed::reading(&at, move |client| async move { show(&client, &args).await }).await
        }
        What::Prune(args) => {
            let at = args.at.clone();
            embed::reading(&at, move |client| async move { prune(&client, &args).await }).await
        }
        What::Make(args) => {
            let at = args.at.clone();
            embed::with_server(&at, move |client| async move { make(&client, &args).await }).await
        }
        What::Export(args) => {
            let at = args.at.clone();
            embed::with_server(&at, move |client| async move { export(&client, &args).await }).await
        }
        What::Import(args) => import(args).await,
    }
}

async fn list(client: &Client, json: bool) -> Result<(), CliError> {
    let found: Value = client.get("/api/v1/datasets?limit=1").await?;
    let made: Vec<Value> = client.all("/api/v1/datasets?").await?;
    if json {
        say_json(&json!({ "items": made, "definitions": found["definitions"] }));
        return Ok(());
    }
    let heads = [
        ("dataset", Align::Left),
        ("name", Align::Left),
        ("rows", Align::Right),
        ("size", Align::Right),
        ("made", Align::Left),
    ];
    let mut table = Table::new(&heads, "there are no datasets");
    for row in &made {
        let made_at = text(&row["created_at"]);
        table.push([
            text(&row["id"]).to_owned(),
            text(&row["name"]).to_owned(),
            row["rows"].to_string(),
            bytes(row["bytes"].as_f64().unwrap_or_default()),
            made_at.parse().map_or_else(|_| made_at.to_owned(), local),
        ]);
    }
    say(&table);
    let names: Vec<&str> =
        found["definitions"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    say(format_args!("palpate dataset make NAME, of: {}, run-N", names.join(", ")));
    Ok(())
}

async fn prune(client: &Client, args: &PruneArgs) -> Result<(), CliError> {
    let body = json!({ "keep": args.keep, "dry_run": args.dry_run });
    let pruned: Value = client.patient(MAKING).post("/api/v1/datasets/prune", &body).await?;
    if args.at.json {
        say_json(&pruned);
        return Ok(());
    }
    let heads = [
        ("dataset", Align::Left),
        ("name", Align::Left),
        ("size", Align::Right),
        ("last used", Align::Left),
        ("", Align::Left),
    ];
    let mut table = Table::new(&heads, "there are no datasets");
    for row in pruned["datasets"].as_array().into_iter().flatten() {
        let used = row["last_used_at"].as_str().and_then(|at| at.parse().ok());
        let gone = if args.dry_run { "would be removed" } else { "removed" };
        let stays = row["stays"].as_str().map(|why| format!("stays: {why}"));
        table.push([
            text(&row["id"]).to_owned(),
            text(&row["name"]).to_owned(),
            bytes(row["bytes"].as_f64().unwrap_or_default()),
            or_dash(used.map(local)),
            stays.unwrap_or_else(|| gone.to_owned()),
        ]);
    }
    say(&table);
    let freed = bytes(pruned["freed_bytes"].as_f64().unwrap_or_default());
    say(match args.dry_run {
        true => format!("{freed} would be freed; without --dry-run it is removed"),
        false => format!("{freed} freed"),
    });
    Ok(())
}

async fn show(client: &Client, args: &ShowArgs) -> Result<(), CliError> {
    let more = if args.lineage { "/lineage" } else { "" };
    let path = format!("/api/v1/datasets/{}{more}", args.name);
    let found: Value = client.patient(MAKING).get(&path).await?;
    if args.at.json {
        say_json(&found);
    } else if args.lineage {
        let pretty = serde_json::to_string_pretty(&found["lineage"]).unwrap_or_default();
        say(pretty);
    } else {
        describe(&found, client.url());
    }
    Ok(())
}

async fn make(client: &Client, args: &MakeArgs) -> Result<(), CliError> {
    let what = args.what.display().to_string();
    let is_file = args.what.extension().is_some() || args.what.is_file();
    let body = match is_file {
        true => json!({ "toml": read_as(FileKind::Dataset, &args.what)?, "file": what }),
        false => json!({ "name": what }),
    };
    let made: Value = client.patient(MAKING).post("/api/v1/datasets", &body).await?;
    if args.at.json {
        say_json(&made);
    } else {
        describe(&made, client.url());
    }
    Ok(())
}

/// Prints a dataset for people.
fn describe(row: &Value, url: &str) {
    let length = bytes(row["bytes"].as_f64().unwrap_or_default());
    say(format_args!(
        "{} {}: {} rows, {length}",
        text(&row["name"]),
        text(&row["id"]),
        row["rows"]
    ));
    if row["is_current"] == false {
        let name = text(&row["name"]);
        say(format_args!("  trials were stored since: palpate dataset make {name}"));
    }
    let report = &row["report"];
    part_lines("part", &report["parts"]);
    part_lines("contacts", &report["contact_counts"]);
    part_lines("excluded", &report["left_out"]);
    say("  pandas.read_parquet(..), polars.scan_parquet(..) or DuckDB's read_parquet(..) of");
    say(format_args!("  {url}{}", text(&row["url"])));
}

fn part_lines(heading: &str, counts: &Value) {
    for (what, rows) in counts.as_object().into_iter().flatten() {
        say(format_args!("  {heading:<9} {what:<44} {rows:>8}"));
    }
}

async fn export(client: &Client, args: &ExportArgs) -> Result<(), CliError> {
    let request = ExportRequest {
        dataset: args.name.clone(),
        format: args.format,
        columns: args.columns.clone(),
        conditions: args.conditions.clone(),
        map: args.map.clone(),
        slice: args.slice.clone(),
    };
    let asked: ExportView = client.post("/api/v1/exports", &request).await?;
    let done = follow(client, asked).await?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from(format!("{}.{}", args.name, args.format.extension())));
    fetch(client, &done, &out).await?;
    if args.at.json {
        say_json(&json!({ "file": out, "export": done }));
    } else {
        let rows = counted(done.rows_total, "row", "rows");
        let of = done.dataset.as_ref().map_or("", DatasetId::as_str);
        let length = bytes(done.bytes.unwrap_or_default() as f64);
        let rows = if done.rows_total > 0 { format!("{rows} of ") } else { String::new() };
        say(format_args!(
            "{}: {rows}{of}, {length}, sha256 {}",
            out.display(),
            done.sha256.clone().unwrap_or_default()
        ));
    }
    Ok(())
}

/// Shows the progress of an export until it has ended.
async fn follow(client: &Client, asked: ExportView) -> Result<ExportView, CliError> {
    let bar = progress_bar("rows");
    let (mut now, mut rows) = (asked, 0);
    loop {
        rows = rows.max(now.rows_total);
        bar.set_length(now.rows_total);
        bar.set_position(now.rows_done);
        match now.state.as_str() {
            "done" => {
                bar.finish_and_clear();
                now.rows_total = rows;
                return Ok(now);
            }
            "failed" | "stopped" => {
                bar.abandon();
                let operation = format!("export {}", now.id);
                let detail = now.error.unwrap_or_default();
                return Err(CliError::Refused { operation, status: 409, detail });
            }
            _ => tokio::time::sleep(LOOK).await,
        }
        now = client.get(&format!("/api/v1/exports/{}", now.id)).await?;
    }
}

/// Downloads the file of an export, and resumes if a connection breaks.
async fn fetch(client: &Client, done: &ExportView, out: &Path) -> Result<(), CliError> {
    let failed = |source| CliError::File { path: out.into(), source };
    let partial = out.with_extension("partial");
    let mut file = std::fs::File::create(&partial).map_err(failed)?;
    let url = done.url.clone().unwrap_or_else(|| format!("/api/v1/exports/{}/file", done.id));
    let (mut hash, mut have, mut tries) = (Hashing::default(), 0_u64, 0);
    let wanted = done.bytes.unwrap_or_default();
    let bar = progress_bar("bytes");
    bar.set_length(wanted);
    while have < wanted {
        let range = format!("bytes={have}-");
        let answer = client.patient(MAKING).send_ranged(Method::GET, &url, &range).await?;
        let mut pieces = answer.bytes_stream();
        while let Some(piece) = pieces.next().await {
            match piece {
                Ok(piece) => {
                    file.write_all(&piece).map_err(failed)?;
                    hash.update(&piece);
                    have += piece.len() as u64;
                    bar.set_position(have);
                }
                Err(_) if tries < TRIES => {
                    tries += 1;
                    break;
                }
                Err(source) => {
                    return Err(CliError::Http { operation: format!("GET {url}"), source });
                }
            }
        }
    }
    bar.finish_and_clear();
    let found = hash.finish();
    if Some(&found) != done.sha256.as_ref() {
        let detail = format!("the downloaded file has the sha256 {found}");
        return Err(CliError::Refused { operation: format!("GET {url}"), status: 500, detail });
    }
    file.seek(SeekFrom::End(0)).and_then(|_| file.sync_all()).map_err(failed)?;
    std::fs::rename(&partial, out).map_err(failed)
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}
