//! `palpate attach`: follows a run that a service drives, to its closing summary or until it is left.
//! Uses: `client`, `follow`, `summary`. Never: starting a run.

use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::begin::last_event;
use super::client::Client;
use super::error::{CliError, CliResult};
use super::find::find_run;
use super::follow::{Follower, Left, Watch};
use super::next::Next;
use super::output::{Output, say, say_json};
use super::signals::Signals;
use super::summary::Closing;
use super::twins::wait_for_twins;
use super::{At, embed};
use crate::api::History;
use crate::evaluate::simulation::SimulationReport;
use crate::ids::RunUid;
use crate::state::StoredState;

/// Longest wait for the state of a run that is left: no signal ends it.
const ROW_WAIT: Duration = Duration::from_secs(2);
/// Longest wait for another simulated twin after the run's end.
const TWINS_STALLED: Duration = Duration::from_secs(30);

/// Options of `attach`.
#[derive(Debug, Clone, Args)]
pub struct AttachArgs {
    /// Run: number, start of the id, or `last`; without it the active one.
    pub run: Option<String>,
    /// Abort when the run has waited for a person for this duration, s [default: wait].
    #[arg(long, value_name = "SECONDS")]
    pub patience: Option<u32>,
    #[command(flatten)]
    pub at: At,
}

/// Runs `palpate attach`.
///
/// # Errors
/// `CliError::Idle` without an active run; others if the service cannot be reached.
pub async fn attach(args: AttachArgs) -> CliResult<ExitCode> {
    let client = embed::server(&args.at).await?;
    let run = match &args.run {
        Some(run) => find_run(&client, run).await?,
        None => {
            let active = client.status().await?.run.ok_or(CliError::Idle)?;
            client.run(active.uid).await?
        }
    };
    let mut signals = Signals::catch()?;
    let watch = Watch {
        run: run.uid,
        since: last_event(&client, &run).await?,
        waiting: run.waiting_since.is_some(),
        json: args.at.json,
        by_itself: false,
        own_service: false,
        patience: args.patience.map(|s| Duration::from_secs(s.into())),
    };
    let Some(closing) = to_its_end(&client, watch, &mut signals).await? else {
        detached(&client, run.scan_id, run.uid, None, args.at.output()).await;
        return Ok(ExitCode::SUCCESS);
    };
    let next = closing.next_commands(&args.at.data(), Some(client.url()), false);
    Ok(closed(&closing, &next, args.at.output()))
}

/// Follows a run to its end; none if it was left to the service.
///
/// # Errors
/// As [`Follower::follow`].
pub async fn to_its_end(
    client: &Client,
    watch: Watch,
    signals: &mut Signals,
) -> CliResult<Option<Closing>> {
    let uid = watch.run;
    let why = match Follower::new(client.clone(), watch).follow(signals).await? {
        Left::Ended => None,
        Left::Detached => return Ok(None),
        Left::Open(why) => Some(why),
    };
    let (summary, status) = (client.summary(uid).await?, client.status().await?);
    let fit = match why {
        // A signal ends the wait for the twins; the service makes them, or the next one.
        None => tokio::select! {
            found = fit(client, uid) => found,
            _ = signals.next() => None,
        },
        Some(_) => None,
    };
    let history = history(client, uid).await;
    let (database, clock_rate) = (status.service.database, status.rig.clock_rate);
    Ok(Some(Closing::of(summary, database, clock_rate, why, fit, history.as_ref())))
}

/// History of a run, with all its trials in one interval: its states and events are what counts.
async fn history(client: &Client, run: RunUid) -> Option<History> {
    let history = client.get(&format!("/api/v1/runs/{run}/history?bins=1")).await;
    history.inspect_err(|error| tracing::warn!(%error, "the history of the run is unknown")).ok()
}

/// Fit of the simulated twins, once all are made. The trials are what counts: if twins are late,
/// the run has ended nevertheless.
async fn fit(client: &Client, run: RunUid) -> Option<SimulationReport> {
    let waited = wait_for_twins(client, run, TWINS_STALLED).await;
    waited.inspect_err(|error| tracing::warn!(%error, "twins are missing")).ok()?;
    let report = client.get(&format!("/api/v1/runs/{run}/evaluation/simulation")).await;
    report.inspect_err(|error| tracing::warn!(%error, "the fit of the twins is unknown")).ok()
}

/// Prints the closing summary with the next commands; returns the exit code.
pub fn closed(closing: &Closing, next: &Next, output: Output) -> ExitCode {
    match output {
        Output::Json => say_json(&closing.finished()),
        Output::Text => {
            say(closing.to_string().trim_end());
            next.say();
        }
    }
    if closing.is_success() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Prints how to come back to a run that was left to the service. `process`: the service's, if it outlives the
/// command that started it.
pub async fn detached(
    client: &Client,
    scan_id: i64,
    uid: RunUid,
    process: Option<u32>,
    output: Output,
) {
    let url = client.url();
    if output == Output::Json {
        let left = json!({ "event": "detached", "run": uid, "scan_id": scan_id, "url": url,
            "process": process });
        return say_json(&left);
    }
    // If the service does not answer, the run is taken for an active one: a stop names it, and stops no other.
    let row = client.quiet().patient(ROW_WAIT).run(uid).await.ok();
    let waits = row.filter(|row| row.waiting_since.is_some()).map(|row| row.state);
    let does = if waits.is_some() { "waits for its turn" } else { "continues" };
    say(format_args!("run {scan_id} {does} without this terminal; its page is {url}/"));
    let at = At { url: Some(url.into()), ..At::default() };
    let mut next = after_detaching(&at, scan_id, waits);
    if let Some(process) = process {
        next =
            next.line(format_args!("kill {process}"), "ends the service; its run can be resumed");
    }
    next.say();
}

/// The commands for a run that was left to the service; each names the run, as another one may be active. `waits`: its
/// state if it waits for its turn.
fn after_detaching(at: &At, scan_id: i64, waits: Option<StoredState>) -> Next {
    let next = Next::of(at).suggest(format_args!("palpate attach {scan_id}"), "follows it");
    match waits {
        None => next.suggest(format_args!("palpate stop {scan_id}"), "stops it after its trial"),
        Some(StoredState::Queued) => {
            let what = "removes it from the queue";
            next.suggest(format_args!("palpate queue remove {scan_id}"), what)
        }
        Some(StoredState::Ended) => {
            next.suggest(format_args!("palpate abort {scan_id}"), "takes its start back")
        }
        Some(_) => next.suggest(format_args!("palpate abort {scan_id}"), "ends it"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_was_left_is_named_in_the_commands_for_it() {
        let second = |waits| after_detaching(&At::default(), 2, waits).text(None);
        let follows = "\nnext:\n  palpate attach 2";
        for (waits, ends) in [
            (None, "\n  palpate stop 2     stops it after its trial"),
            (Some(StoredState::Queued), "\n  palpate queue remove 2   removes it from the queue"),
            (Some(StoredState::Ended), "\n  palpate abort 2    takes its start back"),
            (Some(StoredState::Interrupted), "\n  palpate abort 2    ends it"),
        ] {
            let words = second(waits);
            assert!(words.starts_with(follows) && words.ends_with(ends), "{words}");
        }
    }
}
