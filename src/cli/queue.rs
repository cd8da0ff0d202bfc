//! `palpate queue`: the runs that wait.
//! Uses: `client`, `files`. Never: starting anything.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliError;
use super::files::ExperimentFiles;
use super::output::{say, say_json};
use super::run::submission;
use super::{At, embed};
use crate::api::Page;
use crate::store::RunRow;

/// Options of `queue`.
#[derive(Debug, Clone, Args)]
pub struct QueueArgs {
    /// Action on the queue; lists it if absent.
    #[command(subcommand)]
    pub command: Option<QueueCommand>,
    /// Server, or data folder.
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
            QueueCommand::Add { experiment } => {
                let files = ExperimentFiles::read(&experiment)?;
                let run: RunRow =
                    client.post("/api/v1/queue", &submission(&client, &files)).await?;
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

async fn list(client: &Client, json: bool) -> Result<(), CliError> {
    let queue: Page<RunRow> = client.get("/api/v1/queue").await?;
    if json {
        say_json(&queue);
        return Ok(());
    }
    if queue.items.is_empty() {
        say("the queue is empty");
    }
    for run in queue.items {
        let place = run.queue_position.map_or("-".into(), |p| p.to_string());
        let (id, name, trials) = (run.scan_id, &run.experiment, run.trials_planned);
        say(format_args!(
            "{place:>3}  run {id:<6} {name:<20} {trials:>7} trials  {}",
            run.submitted_by
        ));
    }
    Ok(())
}
