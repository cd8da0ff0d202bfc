//! The twins of a run as a work order, and their way into the run's database.
//! Uses: `client` (a service states the contacts and stores the twins), `simulate::twins::chunks`. Never: a frame that
//! is computed or compared here.

use clap::Args;

use super::OrderPlace;
use crate::chunk::folder::{ChunkState, OrderFolder};
use crate::chunk::order::{ChunkRow, WorkOrder};
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::progress::Counted;
use crate::cli::{At, embed};
use crate::ids::RunUid;
use crate::new_file::Look;
use crate::simulate::twins::chunks::{TwinSkin, work_order};
use crate::simulate::twins::file::CHUNK_TRIALS_MAX;
use crate::twins::elsewhere::{StoredTwins, TwinInputs};

/// Largest number of trials of an order, whose file contains the contacts of all.
const ORDERED_TRIALS_MAX: u64 = 1_000_000;

/// Options that determine the chunks of a run's twins.
#[derive(Debug, Clone, Args)]
pub struct TwinsRequest {
    /// Run: number, start of the id, or `last`.
    #[arg(value_name = "RUN")]
    run: String,
    /// Number of trials of a chunk.
    #[arg(long, value_name = "N", default_value_t = 1000)]
    chunk_trials: u64,
    #[command(flatten)]
    pub place: OrderPlace,
}

impl TwinsRequest {
    /// The work order of the run's stored trials, and their number.
    ///
    /// # Errors
    /// `CliError` if an option is invalid, the service cannot be reached or started, or the run has no trials or no
    /// model.
    pub async fn order(&self, json: bool) -> CliResult<(WorkOrder, u64)> {
        if !(1..=CHUNK_TRIALS_MAX).contains(&self.chunk_trials) {
            let limit = format!("must be from 1 to {CHUNK_TRIALS_MAX}");
            return Err(CliError::argument("chunk-trials", self.chunk_trials, limit));
        }
        let at = self.place.at(json);
        embed::with_purpose(&at, embed::Purpose::Reads, async |client| {
            ordered(client, &self.run, self.chunk_trials).await
        })
        .await
    }
}

async fn ordered(client: &Client, run: &str, chunk_trials: u64) -> CliResult<(WorkOrder, u64)> {
    let uid = find_run(client, run).await?.uid;
    // The skin is solved for the first answer.
    let client = client.showing("the contacts of the run");
    let (mut skin, mut contacts, mut trials) = (None, Vec::new(), 0);
    let mut after = 0;
    loop {
        let path = format!("/api/v1/runs/{uid}/twins/inputs?after={after}&limit={chunk_trials}");
        let inputs: TwinInputs = client.get(&path).await?;
        if inputs.trials > 0 {
            trials += inputs.trials;
            contacts.push(inputs.contacts);
        }
        if trials > ORDERED_TRIALS_MAX {
            let limit = format!("has more than {ORDERED_TRIALS_MAX} trials, the most of an order");
            return Err(CliError::argument("run", run, limit));
        }
        skin.get_or_insert(TwinSkin {
            run: inputs.run,
            model: inputs.simulation,
            kernel: inputs.kernel,
            sensor: inputs.sensor,
            calibration: inputs.calibration,
        });
        let Some(next) = inputs.next else { break };
        after = next.0;
    }
    match skin.filter(|_| trials > 0) {
        Some(skin) => Ok((work_order(skin, contacts), trials)),
        None => Err(CliError::argument("run", run, "must have trials")),
    }
}

/// What a service has stored of the chunks of an order.
#[derive(Debug, Clone, Default)]
pub struct Stored {
    /// Number of twins that are stored now.
    pub stored: u64,
    /// Number of twins that were stored before, and are the same.
    pub present: u64,
    /// Indexes of the chunks whose bytes do not have the sha256 of their row, ascending.
    pub damaged: Vec<u64>,
}

/// Sends the chunks of an order of a run's twins, which have these rows, to the service with the run.
///
/// # Errors
/// `CliError` if a chunk cannot be read, the service cannot be reached or started, or it refuses a chunk: those before
/// it are stored.
pub async fn store(
    run: RunUid,
    folder: OrderFolder,
    rows: Vec<ChunkRow>,
    at: &At,
    mut verified: Counted,
) -> CliResult<Stored> {
    embed::with_purpose(at, embed::Purpose::Stores, async move |client| {
        let path = format!("/api/v1/runs/{run}/twins");
        let mut stored = Stored::default();
        for row in rows {
            let ChunkState::Done(row) = folder.state(row.index, Look::Sha256)? else {
                stored.damaged.push(row.index);
                continue;
            };
            let file = folder.result(&row.key);
            let answer = client.upload(&path, &file, []).await;
            let made: StoredTwins = answer.map_err(|error| of_chunk(row.index, error))?;
            stored.stored += made.stored;
            stored.present += made.present;
            verified.add(1);
        }
        Ok(stored)
    })
    .await
}

/// A refusal, with the chunk that it concerns.
fn of_chunk(index: u64, error: CliError) -> CliError {
    match error {
        CliError::Refused { status, detail, again } => {
            CliError::Refused { status, detail: format!("chunk {index}: {detail}"), again }
        }
        other => other,
    }
}
