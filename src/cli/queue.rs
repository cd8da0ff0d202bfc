//! `palpate queue`: the runs that wait.
//! Uses: `client`, `files`, `times`. Never: starting anything.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use jiff::Timestamp;
use reqwest::Method;
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliResult;
use super::files::ExperimentFiles;
use super::find::find_run;
use super::output::{duration, grouped, say, say_json};
use super::run::submission;
use super::table::{Table, or_dash};
use super::times::{local, start_time};
use super::{At, embed};
use crate::api::{Page, QueueTime};
use crate::store::RunRow;

/// Options of `queue`.
#[derive(Debug, Clone, Args)]
pub struct QueueArgs {
    /// Action on the queue; lists it if absent.
    #[command(subcommand)]
    pub command: Option<QueueCommand>,
    #[command(flatten)]
    pub at: At,
}

/// Actions on the queue.
#[derive(Debug, Clone, Subcommand)]
pub enum QueueCommand {
    /// Show the waiting runs, the next one first, with their predicted times.
    List,
    /// Queue an experiment; nothing starts.
    Add {
        /// Experiment file, or the name of a carried experiment.
        #[arg(value_name = "EXPERIMENT.toml")]
        experiment: PathBuf,
        /// Earliest start: 22:00 (the next one), 2026-11-24T22:00 (local time), or with an offset.
        #[arg(long, value_name = "TIME", value_parser = start_time)]
        at: Option<Timestamp>,
    },
    /// Replace the files and the start time of a queued run, which keeps its place.
    Edit {
        /// Run: number, start of the id, or `last`.
        run: String,
        /// Experiment file, or the name of a carried experiment.
        #[arg(value_name = "EXPERIMENT.toml")]
        experiment: PathBuf,
        /// Earliest start, as for `add`; without it any time.
        #[arg(long, value_name = "TIME", value_parser = start_time)]
        at: Option<Timestamp>,
    },
    /// Move a run to a position in the queue, from 1.
    Move {
        /// Run: number, start of the id, or `last`.
        run: String,
        /// New position, from 1.
        position: u32,
    },
    /// Remove a run from the queue.
    Remove {
        /// Run: number, start of the id, or `last`.
        run: String,
    },
}

/// Runs `palpate queue`.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, refuses, or a file is invalid.
pub async fn queue(args: QueueArgs) -> CliResult<()> {
    let (json, command) = (args.at.json, args.command.unwrap_or(QueueCommand::List));
    let purpose = match command {
        QueueCommand::List => embed::Purpose::Reads,
        _ => embed::Purpose::Stores,
    };
    embed::with_purpose(&args.at, purpose, async |client| {
        let queued: Option<RunRow> = match command {
            QueueCommand::List => None,
            QueueCommand::Add { experiment, at } => {
                let body = body(client, &experiment, at)?;
                Some(client.post("/api/v1/queue", &body).await?)
            }
            QueueCommand::Edit { run, experiment, at } => {
                let body = body(client, &experiment, at)?;
                Some(client.ask(Method::PUT, &path_of(client, &run).await?, Some(&body)).await?)
            }
            QueueCommand::Move { run, position } => {
                let body = json!({ "position": position, "who": client.who() });
                let path = path_of(client, &run).await?;
                client.post::<Value>(&format!("{path}/move"), &body).await?;
                None
            }
            QueueCommand::Remove { run } => {
                client.delete(&path_of(client, &run).await?).await?;
                None
            }
        };
        match queued.filter(|_| json) {
            Some(run) => say_json(&run),
            None => list(client, json).await?,
        }
        Ok(())
    })
    .await
}

/// Path of the run that a person named, in the queue.
async fn path_of(client: &Client, run: &str) -> CliResult<String> {
    Ok(format!("/api/v1/queue/{}", find_run(client, run).await?.uid))
}

/// Body of a request that queues an experiment or edits a queued one.
fn body(client: &Client, experiment: &Path, at: Option<Timestamp>) -> CliResult<Value> {
    let mut body = submission(client, &ExperimentFiles::read(experiment)?);
    body["not_before"] = json!(at);
    Ok(body)
}

async fn list(client: &Client, json: bool) -> CliResult<()> {
    if json {
        let mut queue: Value = client.get("/api/v1/queue").await?;
        let times: Value = client.get("/api/v1/queue/times").await?;
        queue["times"] = times["items"].clone();
        say_json(&queue);
        return Ok(());
    }
    let queue: Page<RunRow> = client.get("/api/v1/queue").await?;
    let times: Page<QueueTime> = client.get("/api/v1/queue/times").await?;
    let mut table = Table::new(
        "place> | run> | experiment | trials> | takes> | begins | ends | starts from | submitted by",
        "the queue is empty",
    );
    let (mut notes, mut refused) = (Vec::new(), BTreeMap::<&str, Vec<String>>::new());
    for run in queue.items {
        let time = times.items.iter().find(|time| time.run == run.uid);
        if let Some(problem) = time.and_then(|time| time.problem.as_ref()) {
            refused.entry(problem).or_default().push(run.scan_id.to_string());
        }
        if let Some(why) = time.and_then(|time| time.not_begun.as_ref()) {
            notes.push(format!("run {} does not begin by itself: {why}", run.scan_id));
        }
        let at = |of: fn(&QueueTime) -> Option<Timestamp>| or_dash(time.and_then(of).map(local));
        table.push([
            or_dash(run.queue_position),
            run.scan_id.to_string(),
            run.experiment,
            grouped(run.trials_planned),
            or_dash(time.and_then(|time| time.duration_s).map(duration)),
            at(|time| time.begin),
            at(|time| time.end),
            run.not_before.map_or_else(String::new, local),
            run.submitted_by,
        ]);
    }
    say(&table);
    let refused = refused
        .into_iter()
        .map(|(problem, runs)| format!("run {} would be refused: {problem}", runs.join(", ")));
    for words in refused.chain(notes) {
        say(words);
    }
    Ok(())
}
