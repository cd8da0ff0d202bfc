//! The wait for the simulated twins of a run.
//! Uses: `client`. Never: simulation (the service makes the twins).

use std::time::Duration;

use serde::Deserialize;
use serde_json::Value;
use tokio::time::Instant;

use super::client::Client;
use super::error::CliError;
use super::output::counted;
use super::progress::progress_bar;
use crate::ids::RunUid;
use crate::store::TwinCount;

/// Interval of polling the twins' progress.
const LOOK: Duration = Duration::from_millis(200);

/// Fields of `GET /api/v1/runs/{run}/twins` that are read.
#[derive(Debug, Deserialize)]
struct RunTwinsView {
    #[serde(flatten)]
    count: TwinCount,
    pending: u64,
}

/// Waits until every trial of a run has its twin, with a progress bar on a terminal. `patience`:
/// the longest time without a new one.
///
/// # Errors
/// `CliError::Late` if no twin is made for `patience`; other variants if a request fails.
pub async fn wait_for_twins(
    client: &Client,
    run: RunUid,
    patience: Duration,
) -> Result<TwinCount, CliError> {
    let path = format!("/api/v1/runs/{run}/twins");
    let bar = progress_bar("twins");
    let mut least = (u64::MAX, Instant::now());
    loop {
        let RunTwinsView { count, pending } = client.get(&path).await?;
        bar.set_length(count.trials);
        bar.set_position(count.trials - pending);
        if pending == 0 {
            bar.finish_and_clear();
            return Ok(count);
        }
        if pending < least.0 {
            least = (pending, Instant::now());
        }
        if least.1.elapsed() > patience {
            bar.finish_and_clear();
            return Err(stalled(client, pending, patience).await?);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Error for missing twins, with its cause.
async fn stalled(client: &Client, pending: u64, patience: Duration) -> Result<CliError, CliError> {
    let twins: Value = client.get("/api/v1/twins").await?;
    let why = match (twins["pool"]["workers"].as_u64(), twins["pool"]["last_error"].as_str()) {
        (Some(0), _) => "; the server has no --twin-workers".into(),
        (_, Some(error)) => format!("; {error}"),
        (_, None) => String::new(),
    };
    let what = format!("a twin for one of {}{why}", counted(pending, "trial", "trials"));
    Ok(CliError::Late { what, after_s: patience.as_secs() })
}
