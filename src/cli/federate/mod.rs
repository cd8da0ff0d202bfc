//! `palpate dataset federate`: fetches the datasets of several rigs, what is new of them, and joins them in a folder.
//! Uses: `client`, `download`, `dataset::federate`. Never: a change at a service; a wait for one that does not answer;
//! a file with another sha256 than its service states.

mod rigs;

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use futures::future::join_all;
use jiff::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};

use super::At;
use super::download::{download, finish};
use super::error::{CliError, CliResult};
use super::making;
use super::next::{Next, word};
use super::output::{counted, grouped, say, say_json};
use super::progress::shown_wait;
use super::table::{Table, or_dash};
use super::times::local;
use crate::dataset::build::Progress;
use crate::dataset::federate::{
    FETCHED, Federation, Fetched, LabelFile, MANIFEST, RigPart, TRIALS, Tables, join, prepare,
};
use crate::ids::DatasetId;
use rigs::{Rig, rigs};

/// Longest wait for what a service states of a dataset.
const ASK_WAIT: Duration = Duration::from_secs(5);

/// Options of `dataset federate`.
#[derive(Debug, Args)]
pub struct FederateArgs {
    /// Services of the rigs, asked without a key; a rig without a name has that of its host.
    #[arg(value_name = "RIG=URL", required_unless_present = "rigs")]
    urls: Vec<String>,
    /// File with a table for each rig: url, and if needed key_file and ca, the files with its key
    /// and its certificate.
    #[arg(long, value_name = "RIGS.toml")]
    rigs: Option<PathBuf>,
    /// Name of the dataset at each service: the newest one that was made with it.
    #[arg(long, value_name = "NAME", default_value = "real")]
    dataset: String,
    /// Folder of the result, the same in each call [default: NAME-rigs here].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Accept rigs whose sensors, columns or definitions differ; read each of their tables alone.
    #[arg(long)]
    apart: bool,
    /// Print JSON on standard output, for scripts.
    #[arg(long)]
    json: bool,
}

/// Fields of a dataset that are read.
#[derive(Debug, Deserialize)]
struct Stated {
    id: DatasetId,
    rows: u64,
    bytes: u64,
    sha256: String,
    created_at: Timestamp,
    definition: Value,
    is_current: Option<bool>,
}

/// What became of a rig in this call.
#[derive(Debug)]
enum Outcome {
    /// Its dataset was fetched; `bool`: whether trials were stored since it was made.
    New(bool),
    /// Its dataset is the kept one; `bool` likewise.
    Unchanged(bool),
    /// It was not reached, or has no such dataset. Holds the cause as text.
    Missed(String),
}

/// A rig with its dataset; none if it was never fetched.
#[derive(Debug)]
struct Part {
    rig: String,
    url: String,
    fetched: Option<Fetched>,
    outcome: Outcome,
}

/// Runs `palpate dataset federate`.
///
/// # Errors
/// `CliError::Problems` if an option, a file of a rig or a kept dataset is invalid, a file does not have its sha256,
/// or rigs differ; `Missed` if a rig did not answer: the others are joined; `File` if a file cannot be written.
pub async fn federate(args: FederateArgs) -> CliResult<()> {
    let rigs = rigs(&args.urls, args.rigs.as_deref())?;
    let name = args.dataset.as_str();
    if !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
        let limit = "must have letters, digits and hyphens only";
        return Err(CliError::argument("--dataset", name, limit));
    }
    let folder = args.out.clone().unwrap_or_else(|| PathBuf::from(format!("{name}-rigs")));
    let kept = kept(&folder, name, &rigs)?;
    let asked = join_all(rigs.iter().map(|rig| ask(rig, name)));
    let answers = shown_wait("asking the services", asked).await;
    let mut parts = Vec::new();
    for ((rig, kept), answer) in rigs.iter().zip(kept).zip(answers) {
        let (fetched, outcome) = match answer {
            Ok(stated) => current(rig, name, stated, kept, &folder).await?,
            Err(why) => (kept, Outcome::Missed(why)),
        };
        let (rig, url) = (rig.name.clone(), rig.client.url().to_owned());
        parts.push(Part { rig, url, fetched, outcome });
    }
    let used: Vec<Fetched> = parts.iter().filter_map(|part| part.fetched.clone()).collect();
    let tables = if args.apart { Tables::Apart } else { Tables::Joint };
    let joined = match used.is_empty() {
        true => None,
        false => Some(join_in(&folder, name, used, tables).await?),
    };
    match args.json {
        true => say_json(&answer(&folder, &parts, joined.as_ref())),
        false => show(&folder, &parts, joined.as_ref()),
    }
    let is_missed = |part: &&Part| matches!(part.outcome, Outcome::Missed(_));
    let missed: Vec<String> = parts.iter().filter(is_missed).map(|part| part.rig.clone()).collect();
    match missed.is_empty() {
        true => Ok(()),
        false => Err(CliError::Missed { missed, all: parts.len() }),
    }
}

/// The kept datasets of the rigs, in a folder that this command may use.
fn kept(folder: &Path, name: &str, rigs: &[Rig]) -> CliResult<Vec<Option<Fetched>>> {
    let refused = |limit: String| CliError::argument("--out", folder.display(), limit);
    let is_other = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => false,
        Err(source) => return Err(CliError::File { path: folder.into(), source }),
        Ok(mut entries) => !folder.join(FETCHED).is_dir() && entries.next().is_some(),
    };
    if is_other {
        return Err(refused("must be a folder of an earlier call, an empty one, or none".into()));
    }
    let mut all = Vec::new();
    for rig in rigs {
        let kept = Fetched::read(folder, &rig.name)?;
        if let Some(other) = kept.as_ref().filter(|kept| kept.requested != name) {
            let limit = format!("has the dataset {} already: name another folder", other.requested);
            return Err(refused(limit));
        }
        all.push(kept);
    }
    Ok(all)
}

/// What the service of a rig states of its dataset, or why it does not.
async fn ask(rig: &Rig, name: &str) -> Result<Stated, String> {
    let client = rig.client.patient(ASK_WAIT);
    let stated: Stated =
        client.get(&format!("/api/v1/datasets/{name}")).await.map_err(|error| cause(&error))?;
    let id = stated.id.as_str();
    // It becomes the name of a file.
    match id.starts_with("ds-") && id.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
        true => Ok(stated),
        false => Err(format!("the service states {id}, which is not the id of a dataset")),
    }
}

/// Why a rig has no answer, without the options of other commands.
fn cause(error: &CliError) -> String {
    match error {
        CliError::NoServer { url } => format!("no service answers at {url}"),
        CliError::Untrusted { why, .. } => {
            format!(
                "its certificate is not trusted: {why}; name its file as ca in the file of --rigs"
            )
        }
        CliError::Refused { status: 401, detail, .. } => {
            format!("{detail} (key_file in the file of --rigs)")
        }
        other => other.to_string(),
    }
}

/// The dataset that a service states: the kept one, if it is the same, or else fetched.
async fn current(
    rig: &Rig,
    name: &str,
    stated: Stated,
    kept: Option<Fetched>,
    folder: &Path,
) -> CliResult<(Option<Fetched>, Outcome)> {
    let is_outdated = stated.is_current == Some(false);
    let is_same = |kept: &&Fetched| kept.dataset == stated.id && kept.sha256 == stated.sha256;
    if let Some(same) = kept.as_ref().filter(is_same) {
        let same = Fetched { url: rig.client.url().to_owned(), ..same.clone() };
        if kept.as_ref() != Some(&same) {
            same.keep(folder)?;
        }
        return Ok((Some(same), Outcome::Unchanged(is_outdated)));
    }
    match fetch(rig, name, stated, folder).await {
        Ok(fetched) => Ok((Some(fetched), Outcome::New(is_outdated))),
        Err(error @ (CliError::Problems(_) | CliError::File { .. })) => Err(error),
        // It went down meanwhile.
        Err(why) => Ok((kept, Outcome::Missed(cause(&why)))),
    }
}

async fn fetch(rig: &Rig, name: &str, stated: Stated, folder: &Path) -> CliResult<Fetched> {
    let Stated { id, rows, bytes, sha256, created_at, definition, .. } = stated;
    let client = rig.client.patient(ASK_WAIT).showing("asking the service");
    let lineage: Value = client.get(&format!("/api/v1/datasets/{id}/lineage")).await?;
    let fetched = Fetched {
        rig: rig.name.clone(),
        url: rig.client.url().to_owned(),
        requested: name.to_owned(),
        dataset: id,
        rows,
        bytes,
        sha256,
        made_at: created_at,
        fetched_at: Timestamp::now(),
        definition,
        lineage: lineage["lineage"].clone(),
    };
    prepare(folder, &rig.name)?;
    let out = fetched.file(folder);
    let url = format!("/api/v1/data/{}.parquet", fetched.dataset);
    let file = download(&rig.client, &url, fetched.bytes, &out).await?;
    let found = file.sha256();
    if found != fetched.sha256 {
        let advice = "the file that the service sends is not the one that it states";
        return Err(fetched.mismatch(&found, advice).into());
    }
    finish(file, &out)?;
    fetched.keep(folder)?;
    Ok(fetched)
}

async fn join_in(
    folder: &Path,
    name: &str,
    used: Vec<Fetched>,
    tables: Tables,
) -> CliResult<Federation> {
    let (folder, name) = (folder.to_owned(), name.to_owned());
    let joining = move |rows: &Progress| join(&folder, &name, &used, tables, rows);
    Ok(making::here("joining the datasets", "rows", joining).await?)
}

impl Part {
    /// State for scripts: `fetched`, `unchanged`, `kept` (not reached, an earlier dataset is used) or `absent`.
    fn state(&self) -> &'static str {
        match (&self.outcome, &self.fetched) {
            (Outcome::New(_), _) => "fetched",
            (Outcome::Unchanged(_), _) => "unchanged",
            (Outcome::Missed(_), Some(_)) => "kept",
            (Outcome::Missed(_), None) => "absent",
        }
    }

    /// What a person must know of it.
    fn note(&self) -> Option<String> {
        match &self.outcome {
            Outcome::New(true) | Outcome::Unchanged(true) => {
                Some("trials were stored since it was made".into())
            }
            Outcome::New(false) | Outcome::Unchanged(false) => None,
            Outcome::Missed(why) => Some(why.clone()),
        }
    }
}

fn answer(folder: &Path, parts: &[Part], joined: Option<&Federation>) -> Value {
    let rigs = parts.iter().map(|part| {
        let of_rig = |own: &&RigPart| own.fetched.rig == part.rig;
        let own = joined.and_then(|joined| joined.rigs.iter().find(of_rig));
        let fetched = part.fetched.as_ref();
        json!({
            "rig": part.rig, "url": part.url, "state": part.state(), "note": part.note(),
            "dataset": fetched.map(|fetched| &fetched.dataset),
            "rows": fetched.map(|fetched| fetched.rows),
            "fetched_at": fetched.map(|fetched| fetched.fetched_at),
            "files": own.map(|own| &own.files),
        })
    });
    json!({
        "folder": folder, "manifest": joined.map(|_| folder.join(MANIFEST)),
        "rows": joined.map(|joined| joined.rows), "rigs": rigs.collect::<Vec<_>>(),
    })
}

/// Prints the rigs and the result for people.
fn show(folder: &Path, parts: &[Part], joined: Option<&Federation>) {
    let mut table =
        Table::new("rig | dataset | rows> | fetched | state | note", "there are no rigs");
    for part in parts {
        let fetched = part.fetched.as_ref();
        table.push([
            part.rig.clone(),
            or_dash(fetched.map(|fetched| &fetched.dataset)),
            or_dash(fetched.map(|fetched| grouped(fetched.rows))),
            or_dash(fetched.map(|fetched| local(fetched.fetched_at))),
            part.state().to_owned(),
            part.note().unwrap_or_default(),
        ]);
    }
    say(&table);
    let mut next = Next::of(&At::default());
    if let Some(joined) = joined {
        let (rows, rigs) = (counted(joined.rows, "row", "rows"), joined.rigs.len() as u64);
        let tables = folder.join(TRIALS);
        let rigs = counted(rigs, "rig", "rigs");
        let manifest = folder.join(MANIFEST);
        say(format_args!("{rows} of {rigs} in {}; {}", tables.display(), manifest.display()));
        for part in &joined.rigs {
            next = part.files.iter().fold(next, |next, table| import(next, folder, part, table));
        }
    }
    if parts.iter().any(|part| matches!(part.outcome, Outcome::Missed(_))) {
        next = next.same_command("later", "fetches what is missing");
    }
    next.say();
}

/// Adds the command that imports a table: as a run with the name of its rig and its dataset.
fn import(next: Next, folder: &Path, part: &RigPart, table: &LabelFile) -> Next {
    let Some(toml) = &part.sensor_file else { return next };
    // Its rows have no measured frame, which an import needs.
    if part.fetched.definition["task"] == "s2s-recon" {
        return next;
    }
    let path = |inside: &str| word(&folder.join(inside).display().to_string());
    let (file, toml, label) = (path(&table.file), path(toml), table.label);
    let name = format!("{}-{}", part.fetched.rig, part.fetched.dataset);
    next.suggest(
        format_args!("palpate dataset import {file} --sensor {toml} --label {label} --name {name}"),
        "its rows as a run, for trainings and questions",
    )
}
