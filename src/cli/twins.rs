//! The simulated twins: their status, and the wait for those of a run.
//! Uses: `client`. Never: simulation (the service makes the twins).

use std::time::Duration;

use serde_json::Value;
use tokio::time::Instant;

use super::client::{Client, text_of};
use super::error::{CliError, CliResult};
use super::output::{counted, say, say_json};
use super::progress::Counted;
use super::table::{Table, count_or_dash};
use super::view::rows;
use super::{At, embed};
use crate::ids::RunUid;
use crate::store::TwinCount;

/// Interval of polling the twins' progress.
const TWINS_POLL: Duration = Duration::from_millis(200);

/// Runs `palpate status --twins`.
///
/// # Errors
/// `CliError` if the service cannot be reached.
pub async fn status(at: &At) -> CliResult<()> {
    let client = embed::server(at).await?;
    let twins: Value = client.get("/api/v1/twins").await?;
    if at.json {
        say_json(&twins);
        return Ok(());
    }
    let pool = &twins["pool"];
    let threads = counted(pool["workers"].as_u64().unwrap_or_default(), "thread", "threads");
    let rate = pool["per_s"].as_f64().map(|per_s| format!(", {per_s:.1} per second"));
    let made = count_or_dash(&pool["made"]);
    say(format_args!("{threads}, {made} made since the start{}", rate.unwrap_or_default()));
    if let Some(fvu) = pool["rolling"]["median_fvu"].as_f64() {
        let trials = count_or_dash(&pool["rolling"]["trials"]);
        say(format_args!("median FVU {fvu:.3} of the last {trials} trials with a force"));
    }
    if let Some(why) = pool["last_error"].as_str() {
        say(format_args!("last failure: {why}"));
    }
    let numbers = ["trials", "twins", "failures", "pending"];
    let mut table =
        Table::new("run> | trials> | twins> | failures> | pending>", "no run has trials");
    for run in rows(&twins, "runs") {
        let scan_id = client.run(text_of(&run["run"])).await?.scan_id.to_string();
        table.push([scan_id].into_iter().chain(numbers.map(|key| count_or_dash(&run[key]))));
    }
    say(&table);
    Ok(())
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
) -> CliResult<TwinCount> {
    let path = format!("/api/v1/runs/{run}/twins");
    let client = &client.quiet();
    let mut shown = Counted::of("twins", 0);
    let mut least = (u64::MAX, Instant::now());
    loop {
        let count: TwinCount = client.get(&path).await?;
        let pending = count.pending();
        shown.show(count.trials - pending, count.trials);
        if pending == 0 {
            return Ok(count);
        }
        if pending < least.0 {
            least = (pending, Instant::now());
        }
        if least.1.elapsed() > patience {
            return Err(stalled(client, pending, patience).await?);
        }
        tokio::time::sleep(TWINS_POLL).await;
    }
}

/// Error for missing twins, with its cause.
async fn stalled(client: &Client, pending: u64, patience: Duration) -> CliResult<CliError> {
    let twins: Value = client.get("/api/v1/twins").await?;
    let why = match (twins["pool"]["workers"].as_u64(), twins["pool"]["last_error"].as_str()) {
        (Some(0), _) => "; the service has no --twin-workers".into(),
        (_, Some(error)) => format!("; {error}"),
        (_, None) => String::new(),
    };
    let what = format!("a twin for one of {}{why}", counted(pending, "trial", "trials"));
    Ok(CliError::Late { what, after_s: patience.as_secs() })
}
