//! `palpate dataset`: lists, shows, makes and exports datasets.
//! Uses: `client`, `import`, `federate`, `making`, `dataset::definition`. Never: rows in this process (the service reads
//! and writes them).

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::{Value, json};

use super::client::{Client, text_of};
use super::download::DATASET_WAIT;
use super::embed::Purpose::{Computes, Reads, Stores};
use super::error::{CliError, CliResult};
use super::export::{self, ExportArgs};
use super::federate::{FederateArgs, federate};
use super::files::read_as;
use super::import::{ImportArgs, import};
use super::making;
use super::next::Next;
use super::output::bytes;
use super::table::{Table, count_or_dash, or_dash};
use super::times::local;
use super::view::rows;
use super::{At, DEFAULT_URL, embed};
use crate::dataset::definition::Definition;
use crate::file_kind::FileKind;
use crate::syntax::parse_toml;

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
    /// Print the card of a dataset: content, units, quality, origin, citation.
    Card(CardArgs),
    /// Make a dataset from the trials stored now, by its definition file or its name.
    Make(MakeArgs),
    /// Write a dataset to a file.
    ///
    /// The service writes it first, resumes after a restart and reports its progress; then the file
    /// is downloaded, resumed if a connection breaks, and its sha256 checked.
    Export(ExportArgs),
    /// Show the exports, newest first.
    Exports(At),
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
    /// Fetch the datasets of several rigs, and join them in a folder.
    ///
    /// Each rig has its own service. All are asked at once; one that does not answer within 5 s is
    /// shown, and what was fetched of it before is used. A dataset is fetched once, and its sha256
    /// is checked. The folder has a table for each rig and label, with an id for each trial, and a
    /// manifest. Exit code 1 if a rig did not answer, 2 if the sensors of the rigs differ.
    Federate(FederateArgs),
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// Id or name; `run-N` is all trials of a run.
    name: String,
    /// Show the lineage: runs, models, calibrations, shards, code, files, and the nets trained on it.
    #[arg(long)]
    lineage: bool,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct CardArgs {
    /// Id or name; `run-N` is all trials of a run.
    name: String,
    /// Print the description as a Data Package instead, JSON.
    #[arg(long)]
    datapackage: bool,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct MakeArgs {
    /// Definition file (see experiments/datasets), or a name: of a built-in definition, of an
    /// existing dataset, or `run-N`.
    #[arg(value_name = "DATASET.toml|NAME")]
    what: PathBuf,
    /// Make a dataset NAME-RUN for each entry of `runs` in the file, with it as the test part.
    ///
    /// Leave-one-batch-out: the file has `by = "run"` in its section `[split]`, and no `test_runs`.
    #[arg(long)]
    each_run: bool,
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

/// Runs `palpate dataset`.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses, or a file cannot be read or written.
pub async fn dataset(args: DatasetArgs) -> CliResult<()> {
    match args.what {
        What::List(at) => embed::command(&at, Reads, &at, list).await,
        What::Show(args) => embed::command(&args.at, Reads, &args, show).await,
        What::Card(args) => embed::command(&args.at, Reads, &args, card).await,
        What::Exports(at) => embed::command(&at, Reads, &at, export::list).await,
        What::Prune(args) => {
            let purpose = if args.dry_run { Reads } else { Stores };
            embed::command(&args.at, purpose, &args, prune).await
        }
        What::Make(args) => embed::command(&args.at, Stores, &args, make).await,
        What::Export(args) => embed::command(&args.at, Computes, &args, export::export).await,
        What::Import(args) => import(args).await,
        What::Federate(args) => federate(args).await,
    }
}

async fn list(client: &Client, at: &At) -> CliResult<()> {
    let found: Value = client.get("/api/v1/datasets?limit=1").await?;
    let made: Vec<Value> = client.all("/api/v1/datasets?").await?;
    let mut table =
        Table::new("dataset | name | rows> | size> | made | last used", "there are no datasets");
    for row in &made {
        let time = |key: &str| row[key].as_str().and_then(|at| at.parse().ok()).map(local);
        table.push([
            text_of(&row["id"]),
            text_of(&row["name"]),
            count_or_dash(&row["rows"]),
            bytes(row["bytes"].as_f64().unwrap_or_default()),
            or_dash(time("created_at")),
            or_dash(time("last_used_at")),
        ]);
    }
    let names: Vec<&str> = rows(&found, "definitions").iter().filter_map(Value::as_str).collect();
    let names = names.join(", ");
    at.output().say(
        &json!({ "items": made, "definitions": found["definitions"] }),
        format_args!("{table}\npalpate dataset make NAME, of: {names}, run-N"),
    );
    Ok(())
}

async fn prune(client: &Client, args: &PruneArgs) -> CliResult<()> {
    let body = json!({ "keep": args.keep, "dry_run": args.dry_run });
    let pruned: Value = client
        .patient(DATASET_WAIT)
        .showing("removing datasets")
        .post("/api/v1/datasets/prune", &body)
        .await?;
    let mut table =
        Table::new("dataset | name | size> | last used | result", "there are no datasets");
    for row in rows(&pruned, "datasets") {
        let used = row["last_used_at"].as_str().and_then(|at| at.parse().ok());
        let gone = if args.dry_run { "would be removed" } else { "removed" };
        let stays = row["stays"].as_str().map(|why| format!("stays: {why}"));
        table.push([
            text_of(&row["id"]),
            text_of(&row["name"]),
            bytes(row["bytes"].as_f64().unwrap_or_default()),
            or_dash(used.map(local)),
            stays.unwrap_or_else(|| gone.to_owned()),
        ]);
    }
    let freed = bytes(pruned["freed_bytes"].as_f64().unwrap_or_default());
    let is_any_gone = rows(&pruned, "datasets").iter().any(|row| row["stays"].is_null());
    let freed = match (is_any_gone, args.dry_run) {
        (false, _) => "no dataset is removed".to_owned(),
        (true, true) => format!("{freed} would be freed; without --dry-run it is removed"),
        (true, false) => format!("{freed} freed"),
    };
    args.at.output().say(&pruned, format_args!("{table}\n{freed}"));
    let next = Next::of(&args.at);
    match is_any_gone && args.dry_run {
        true => next.same_command("without --dry-run", "removes them"),
        false => next.suggest("palpate dataset list", "shows what stays"),
    }
    .say();
    Ok(())
}

async fn show(client: &Client, args: &ShowArgs) -> CliResult<()> {
    let more = if args.lineage { "/lineage" } else { "" };
    let path = format!("/api/v1/datasets/{}{more}", args.name);
    let found: Value = client.get(&path).await?;
    let words = match args.lineage {
        true => format!("{found:#}"),
        false => described(&found, client.lasting_url()),
    };
    args.at.output().say(&found, words);
    Ok(())
}

async fn card(client: &Client, args: &CardArgs) -> CliResult<()> {
    let path = format!("/api/v1/datasets/{}", args.name);
    if args.datapackage {
        let package: Value = client.get(&format!("{path}/datapackage.json")).await?;
        args.at.output().say_whole(&package, format_args!("{package:#}"));
        return Ok(());
    }
    let card = client.text(&format!("{path}/card")).await?;
    args.at.output().say_whole(&json!({ "card": card }), card.trim_end());
    Ok(())
}

async fn make(client: &Client, args: &MakeArgs) -> CliResult<()> {
    if args.each_run {
        return make_each(client, args).await;
    }
    let what = args.what.display().to_string();
    let is_file = args.what.extension().is_some() || args.what.is_file();
    let body = match is_file {
        true => json!({ "toml": read_as(FileKind::Dataset, &args.what)?, "file": what }),
        false => json!({ "name": what }),
    };
    let made = made(client, &body).await?;
    args.at.output().say(&made, described(&made, client.lasting_url()));
    let id = text_of(&made["id"]);
    Next::of(&args.at)
        .suggest(format_args!("palpate dataset card {id}"), "its content, units and citation")
        .suggest(format_args!("palpate dataset export {id} --format csv"), "writes a file")
        .say();
    Ok(())
}

/// Makes the datasets that leave out each run of a definition in turn.
async fn make_each(client: &Client, args: &MakeArgs) -> CliResult<()> {
    let file = args.what.display().to_string();
    let definition: Definition = parse_toml(&file, &read_as(FileKind::Dataset, &args.what)?)?;
    let definitions = definition.each_run_left_out(&file)?;
    let names: Vec<&str> = definitions.iter().map(|one| one.name.as_str()).collect();
    let datasets = names.join(" --dataset ");
    let (mut items, mut words) = (Vec::new(), Vec::new());
    for definition in &definitions {
        let body = json!({ "definition": definition, "file": file });
        let row = match made(client, &body).await {
            Ok(row) => row,
            Err(error) => return Err(after(&items, &definition.name, error)),
        };
        words.push(described(&row, client.lasting_url()));
        items.push(row);
    }
    args.at.output().say(&json!({ "items": items }), words.join("\n\n"));
    Next::of(&args.at)
        .suggest(
            format_args!("palpate evaluate quantity force --dataset {datasets}"),
            "trains nets without each run, and scores them on it",
        )
        .say();
    Ok(())
}

/// The error of a dataset, with those that were made before it from the same file.
fn after(made: &[Value], name: &str, error: CliError) -> CliError {
    if made.is_empty() {
        return error;
    }
    let named = |row: &Value| format!("{} {}", text_of(&row["name"]), text_of(&row["id"]));
    let made: Vec<String> = made.iter().map(named).collect();
    CliError::NotAllMade { name: name.into(), made, error: Box::new(error) }
}

/// The dataset that the service has made as requested.
async fn made(client: &Client, body: &Value) -> CliResult<Value> {
    let patient = client.patient(DATASET_WAIT).quiet();
    making::dataset(client, patient.post("/api/v1/datasets", body)).await
}

/// A dataset, as text. `url`: that of a service that runs after the command, if there is one.
fn described(row: &Value, url: Option<&str>) -> String {
    let (name, id) = (text_of(&row["name"]), text_of(&row["id"]));
    let rows = count_or_dash(&row["rows"]);
    let length = bytes(row["bytes"].as_f64().unwrap_or_default());
    let mut words = format!("{name} {id}: {rows} rows, {length}");
    if row["is_current"] == false {
        words += &format!("\n  trials were stored since: palpate dataset make {name}");
    }
    let counts = [("part", "parts"), ("contacts", "contact_counts"), ("excluded", "left_out")];
    for (heading, key) in counts {
        for (what, rows) in row["report"][key].as_object().into_iter().flatten() {
            let rows = count_or_dash(rows);
            words += &format!("\n  {heading:<9} {what:<44} {rows:>9}");
        }
    }
    words += "\n  pandas.read_parquet(..), polars.scan_parquet(..) or DuckDB's read_parquet(..) of";
    let serves = if url.is_some() { "" } else { ", while `palpate serve` runs" };
    words + &format!("\n  {}{}{serves}", url.unwrap_or(DEFAULT_URL), text_of(&row["url"]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_of_a_dataset_is_that_of_a_service_which_outlives_the_command() {
        let row = json!({ "name": "real", "id": "ds-1", "rows": 12, "bytes": 1000,
            "url": "/api/v1/data/ds-1.parquet" });
        let last = |url| described(&row, url).lines().next_back().map(str::to_owned).unwrap();
        assert_eq!(last(Some("http://rig:8081")), "  http://rig:8081/api/v1/data/ds-1.parquet");
        let own = "  http://127.0.0.1:8080/api/v1/data/ds-1.parquet, while `palpate serve` runs";
        assert_eq!(last(None), own);
    }
}
