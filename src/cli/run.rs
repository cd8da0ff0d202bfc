//! `palpate run`: one experiment from its file to its closing summary, as a client of the service;
//! without a server it starts one, with a virtual rig if needed.
//! Uses: `embed`, `virtual_bench`, `follow`, `summary`. Never: the rig (the service has it).

use std::io::{BufRead, IsTerminal};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::bench_args::BenchArgs;
use super::client::Client;
use super::error::CliError;
use super::files::{ExperimentFiles, RigFiles};
use super::follow::{Follower, Left, Signals, Watch};
use super::output::{self, bytes, duration, say, say_json};
use super::rig::{HOMING, until_rig};
use super::summary::Closing;
use super::twins::wait_for_twins;
use super::view::{PreflightView, StatusView};
use super::virtual_bench::VirtualBench;
use super::{At, embed};
use crate::campaign::bench::rig_state::RigState;
use crate::evaluate::simulation::SimulationReport;
use crate::ids::RunUid;
use crate::rig::setup::RigSetup;
use crate::state::StoredState;
use crate::store::RunRow;

/// Longest wait for another simulated twin after the run's end.
const TWINS_STALLED: Duration = Duration::from_secs(30);
/// Longest wait for the wires of a rig.
const CONNECTING: Duration = Duration::from_secs(60);

/// Options of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    /// Experiment file.
    #[arg(value_name = "EXPERIMENT.toml")]
    pub experiment: PathBuf,
    /// Start a new run, even if an interrupted one of the same files could be resumed.
    #[arg(long)]
    pub new: bool,
    /// Abort when the run has waited for a person for this duration, s [default: wait].
    #[arg(long, value_name = "SECONDS")]
    pub patience: Option<u32>,
    /// Move a real rig without asking at the terminal.
    #[arg(long, short)]
    pub yes: bool,
    /// Bench to run on.
    #[command(flatten)]
    pub bench: BenchArgs,
    /// Server, and data folder.
    #[command(flatten)]
    pub at: At,
}

impl RunArgs {
    /// Checks for options that contradict each other, or that a running server does not support.
    fn check(&self, server: Option<&Client>) -> Result<(), CliError> {
        if let Some(client) = server
            && (self.bench.rig.is_some() || self.bench.names_virtual())
        {
            let limit = format!(
                "the server at {} has its own rig: stop it, or omit this option",
                client.url()
            );
            return Err(CliError::argument(
                "--rig or an option of the virtual rig",
                "given",
                limit,
            ));
        }
        self.bench.check()
    }
}

/// Inputs of the client, wherever the service runs.
struct Order {
    files: ExperimentFiles,
    new: bool,
    yes: bool,
    json: bool,
    /// Whether the virtual operator works.
    by_itself: bool,
    patience: Option<Duration>,
}

/// Runs `palpate run`.
///
/// # Errors
/// `CliError` if an input is invalid, the rig or a server is not available, or the run cannot
/// start.
pub async fn run(args: RunArgs) -> Result<ExitCode, CliError> {
    let files = ExperimentFiles::read(&args.experiment)?;
    // With --virtual this command has its own bench and server.
    let server = if args.bench.on_virtual { None } else { embed::find(&args.at).await? };
    args.check(server.as_ref())?;
    let rig = RigFiles::read(args.bench.rig.as_deref())?;
    let (json, data) = (args.at.json, args.at.data());
    let on_virtual_rig = server.is_none() && args.bench.is_virtual();
    let order = Order {
        files,
        new: args.new,
        yes: args.yes,
        json,
        by_itself: on_virtual_rig,
        patience: args.patience.map(|s| Duration::from_secs(s.into())),
    };
    let closing = match server {
        Some(client) => {
            let url = client.url().to_owned();
            drive(client, order).await?.with_next(&data, Some(&url))
        }
        None => {
            sound(&order.files, &rig)?;
            let closing = if on_virtual_rig {
                with_virtual_rig(&args, rig, order).await
            } else {
                embed::host(embed::options(data.clone(), &rig)?, |client| drive(client, order))
                    .await
            };
            closing?.with_next(&data, None)
        }
    };
    if json {
        say_json(&closing.finished);
    } else {
        say(&closing);
    }
    Ok(if closing.is_success() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Rejects an experiment that the rig cannot run, before anything is started.
fn sound(files: &ExperimentFiles, rig: &RigFiles) -> Result<(), CliError> {
    let problems = files.preflight(rig).problems;
    if problems.is_empty() { Ok(()) } else { Err(CliError::Problems(problems)) }
}

async fn with_virtual_rig(
    args: &RunArgs,
    rig: RigFiles,
    order: Order,
) -> Result<Closing, CliError> {
    let data = args.at.data();
    let options = args.bench.bench(&data, rig, order.files.sensor_text.clone(), order.json);
    let mut bench = VirtualBench::switch_on(&options).await?;
    let service = embed::options(data, &bench.rig)?;
    let closing = embed::host(service, |client| {
        let sent = bench.send_operator(client.url(), None);
        async move {
            sent?;
            drive(client, order).await
        }
    })
    .await;
    bench.switch_off().await;
    closing
}

/// Brings the rig up, starts the run and follows it, like any client.
async fn drive(client: Client, order: Order) -> Result<Closing, CliError> {
    let mut signals = Signals::catch()?;
    let started = tokio::select! {
        started = begin(&client, &order) => started?,
        _ = signals.next() => return Err(CliError::Interrupted),
    };
    let Begun { run, since, waiting } = started;
    let uid = run.uid;
    if !order.json && waiting {
        say(format!("run {} starts when the active run has ended", run.scan_id));
    }
    let watch = Watch {
        run: uid,
        since,
        waiting,
        json: order.json,
        by_itself: order.by_itself,
        patience: order.patience,
    };
    let left = Follower::new(client.clone(), watch).follow(&mut signals).await?;
    let why = match left {
        Left::Ended => None,
        Left::Open(why) => Some(why),
    };
    let (summary, status) = (client.summary(uid).await?, client.status().await?);
    let fit = if left == Left::Ended { fit(&client, uid).await } else { None };
    Ok(Closing::of(summary, status.service.database, status.rig.clock_rate, why).with_fit(fit))
}

/// Fit of the simulated twins, once all are made. The trials are what counts: if twins are late,
/// the run has ended nevertheless.
async fn fit(client: &Client, run: RunUid) -> Option<SimulationReport> {
    let waited = wait_for_twins(client, run, TWINS_STALLED).await;
    waited.inspect_err(|error| tracing::warn!(%error, "twins are missing")).ok()?;
    let report = client.get(&format!("/api/v1/runs/{run}/evaluation/simulation")).await;
    report.inspect_err(|error| tracing::warn!(%error, "the fit of the twins is unknown")).ok()
}

/// A run that was started.
struct Begun {
    run: RunRow,
    since: i64,
    waiting: bool,
}

async fn begin(client: &Client, order: &Order) -> Result<Begun, CliError> {
    let status = bring_up(client, order).await?;
    let (run, fresh) = match resumable(client, order, &status).await? {
        Some(run) => {
            note(order, &format!("run {} resumes where it stopped", run.scan_id));
            (run, false)
        }
        None => (enqueue(client, &order.files).await?, true),
    };
    match start(client, order, &run, &status).await {
        Ok((since, waiting)) => Ok(Begun { run, since, waiting }),
        Err(error) => {
            // A queued run that could not start would surprise the next person.
            if fresh && let Err(left) = client.delete(&format!("/api/v1/queue/{}", run.uid)).await {
                tracing::warn!(error = %left, "the run stays in the queue");
            }
            Err(error)
        }
    }
}

/// Connects and homes the rig, if it is not connected or homed. A skin alone has nothing to home.
async fn bring_up(client: &Client, order: &Order) -> Result<StatusView, CliError> {
    let mut status = client.status().await?;
    if status.run.is_some() {
        return Ok(status);
    }
    if status.rig.state == RigState::Disconnected {
        client.act_on_rig("connect", json!({})).await?;
        status = until_rig(client, "connecting the rig", CONNECTING, |s| {
            s.rig.state != RigState::Disconnected
        })
        .await?;
    }
    if status.rig.state == RigState::Tripped {
        return Err(CliError::Tripped { detail: status.rig.trip_words() });
    }
    if !status.rig.has_stage {
        return Ok(status);
    }
    if status.rig.state == RigState::Disarmed {
        confirm_motion(order, &status).await?;
        client.act_on_rig("home", json!({})).await?;
        status = until_rig(client, "homing", HOMING, |s| s.rig.state != RigState::Disarmed).await?;
    } else {
        confirm_motion(order, &status).await?;
    }
    Ok(status)
}

/// Asks for the confirmation that a real rig may move.
async fn confirm_motion(order: &Order, status: &StatusView) -> Result<(), CliError> {
    if order.yes || status.rig.label == "virtual" {
        return Ok(());
    }
    let rig = status.rig.name.clone();
    if !std::io::stdin().is_terminal() {
        return Err(CliError::NotConfirmed { rig });
    }
    output::ask(format_args!("rig {rig} ({}) will move. Is it clear? [y/N] ", status.rig.label));
    // A separate thread, so that Ctrl-C is handled meanwhile.
    let answer = tokio::task::spawn_blocking(|| {
        let mut answer = String::new();
        std::io::stdin().lock().read_line(&mut answer).map(|_| answer)
    });
    match answer.await {
        Ok(Ok(answer)) if matches!(answer.trim(), "y" | "yes") => Ok(()),
        _ => Err(CliError::NotConfirmed { rig }),
    }
}

/// An interrupted run of the same files on the same rig. The addresses of a virtual rig change, so
/// rig files are compared by name and label.
async fn resumable(
    client: &Client,
    order: &Order,
    status: &StatusView,
) -> Result<Option<RunRow>, CliError> {
    if order.new {
        return Ok(None);
    }
    let (definition, sensor) = (order.files.definition_sha256(), order.files.sensor_sha256());
    client
        .find_run(|run| {
            run.state == StoredState::Interrupted
                && run.definition_sha256 == definition
                && run.sensor_sha256 == sensor
                && run
                    .rig
                    .as_deref()
                    .and_then(|text| RigSetup::from_toml("", text).ok())
                    .is_some_and(|rig| {
                        rig.name() == status.rig.name && rig.label().as_str() == status.rig.label
                    })
        })
        .await
}

async fn enqueue(client: &Client, files: &ExperimentFiles) -> Result<RunRow, CliError> {
    client.post("/api/v1/queue", &submission(client, files)).await
}

/// Body of the request that queues an experiment.
pub fn submission(client: &Client, files: &ExperimentFiles) -> serde_json::Value {
    json!({
        "file": files.file,
        "definition": files.definition,
        "sensor": files.sensor_text,
        "who": client.who(),
    })
}

/// Arms and starts; returns the number of the last event before it, and whether it waits.
async fn start(
    client: &Client,
    order: &Order,
    run: &RunRow,
    status: &StatusView,
) -> Result<(i64, bool), CliError> {
    let mut since = 0;
    loop {
        let page = client.events(run.uid, since).await?;
        let Some(last) = page.items.last() else { break };
        since = last.seq;
    }
    let armed = client.arm(run.uid).await?;
    note(order, &preflight_words(run, &armed.preflight, status));
    let taken = client.start(run.uid, &armed.code).await?;
    Ok((since, taken.started.as_deref() == Some("waiting")))
}

fn preflight_words(run: &RunRow, preflight: &PreflightView, status: &StatusView) -> String {
    let (low, high) = (duration(preflight.duration_low_s), duration(preflight.duration_high_s));
    format!(
        "run {}, {} on rig {} ({}): {} trials, predicted {} ({low} .. {high}), {}",
        run.scan_id,
        run.experiment,
        status.rig.name,
        status.rig.label,
        preflight.trials,
        duration(preflight.duration_s),
        bytes(preflight.disk_bytes as f64),
    )
}

/// Prints a line for people, in addition to the output for scripts.
fn note(order: &Order, words: &str) {
    if order.json {
        tracing::info!("{words}");
    } else {
        output::note(words);
    }
}
