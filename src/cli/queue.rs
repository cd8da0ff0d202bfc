//! `palpate queue`: the runs that wait.
//! Uses: `client`, `files`, `start_time`. Never: starting anything.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use reqwest::Method;
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliError;
use super::files::ExperimentFiles;
use super::output::{say, say_json};
use super::run::submission;
use super::start_time::{StartTime, local};
use super::table::{Align, Table, or_dash};
use super::{At, embed};
use crate::api::Page;
use crate::store::RunRow;

/// Options of `queue`.
#[derive(Debug, Clone, Args)]
pub struct QueueArgs {
    /// Action on the queue; lists it if absent.
    #[command(subcommand)]
    pub command: Option<QueueCommand>,
    /// Service, or data folder.
    #[command(flatten)]
    pub at: At,
}

/// Actions on the queue.
#[derive(Debug, Clone, Subcommand)]
pub enum QueueCommand {
    /// Show the waiting runs, the next one first.
    List,
    /// Queue an experiment; nothing starts.
    Add {
        /// Experiment file.
        #[arg(value_name = "EXPERIMENT.toml")]
        experiment: PathBuf,
        /// Earliest start: 22:00 (the next one), 2026-11-24T22:00 (local time), or with an offset.
        #[arg(long, value_name = "TIME")]
        at: Option<StartTime>,
    },
    /// Replace the files and the start time of a queued run, which keeps its place.
    Edit {
        /// Uid or number of the run.
        run: String,
        /// Experiment file.
        #[arg(value_name = "EXPERIMENT.toml")]
        experiment: PathBuf,
        /// Earliest start, as for `add`; without it any time.
        #[arg(long, value_name = "TIME")]
        at: Option<StartTime>,
    },
    /// Move a run to a position in the queue, from 1.
    Move {
        /// Uid or number of the run.
        run: String,
        /// New position, from 1.
        position: u32,
    },
    /// Remove a run from the queue.
    Remove {
        /// Uid or number of the run.
        run: String,
    },
}

/// Runs `palpate queue`.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, refuses, or a file is invalid.
pub async fn queue(args: QueueArgs) -> Result<(), CliError> {
    let (json, command) = (args.at.json, args.command.unwrap_or(QueueCommand::List));
    embed::with_server(&args.at, move |client| async move {
        match command {
            QueueCommand::List => {}
            QueueCommand::Add { experiment, at } => {
                let run: RunRow =
                    client.post("/api/v1/queue", &body(&client, &experiment, at)?).await?;
                if json {
                    say_json(&run);
                    return Ok(());
                }
            }
            QueueCommand::Edit { run, experiment, at } => {
                let body = body(&client, &experiment, at)?;
                let path = format!("/api/v1/queue/{run}");
                let run: RunRow = client.ask(Method::PUT, &path, Some(&body)).await?;
                if json {
                    say_json(&run);
                    return Ok(());
                }
            }
            QueueCommand::Move { run, position } => {
                let body = json!({ "position": position, "who": client.who() });
                client.post::<Value>(&format!("/api/v1/queue/{run}/move"), &body).await?;
            }
            QueueCommand::Remove { run } => {
                client.delete(&format!("/api/v1/queue/{run}")).await?;
            }
        }
        list(&client, json).await
    })
    .await
}

/// Body of a request that queues an experiment or edits a queued one.
fn body(client: &Client, experiment: &Path, at: Option<StartTime>) -> Result<Value, CliError> {
    let mut body = submission(client, &ExperimentFiles::read(experiment)?);
    body["not_before"] = json!(at.map(|StartTime(at)| at));
    Ok(body)
}

async fn list(client: &Client, json: bool) -> Result<(), CliError> {
    let queue: Page<RunRow> = client.get("/api/v1/queue").await?;
    if json {
        say_json(&queue);
        return Ok(());
    }
    let heads = [
        ("place", Align::Right),
        ("run", Align::Right),
        ("experiment", Align::Left),
        ("trials", Align::Right),
        ("submitted by", Align::Left),
        ("starts from", Align::Left),
    ];
    let mut table = Table::new(&heads, "the queue is empty");
    for run in queue.items {
        table.push([
            or_dash(run.queue_position),
            run.scan_id.to_string(),
            run.experiment,
            run.trials_planned.to_string(),
            run.submitted_by,
            run.not_before.map_or_else(String::new, local),
        ]);
    }
    say(&table);
    Ok(())
}
