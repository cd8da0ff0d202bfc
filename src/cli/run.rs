//! `palpate run`: one experiment from its file to its closing summary, as a client of the service;
//! without a service it starts one, with a virtual rig if needed, which a detached run outlives.
//! Uses: `begin`, `attach`, `own_server`. Never: the rig (the service has it).

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::attach::{closed, detached, to_its_end};
use super::begin::{Begun, MotionArgs, arm_and_start, bring_up, goes_on, last_event};
use super::bench_args::BenchArgs;
use super::client::Client;
use super::error::{CliError, CliResult};
use super::files::{ExperimentFiles, RigFiles, write};
use super::follow::Watch;
use super::output::{self, bytes, counted, duration, grouped};
use super::own_server::OwnServer;
use super::rig::end_motion;
use super::signals::Signals;
use super::summary::Closing;
use super::view::{PreflightView, StatusView};
use super::{At, embed};
use crate::api::ServeError;
use crate::digest::sha256_hex;
use crate::ids::RunUid;
use crate::journal::ExitStatus;
use crate::new_file::make_folder;
use crate::rig::setup::RigSetup;
use crate::state::StoredState;
use crate::store::RunRow;

/// Options of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    /// Experiment file, or the name of a carried experiment: quickstart, real-hex, real-random, ..
    #[arg(value_name = "EXPERIMENT.toml")]
    pub experiment: PathBuf,
    /// Start a new run, even if a stopped or interrupted one of the same files could be resumed.
    #[arg(long)]
    pub new: bool,
    /// Start the run and leave it to the service; `palpate attach` follows it.
    #[arg(long)]
    pub detach: bool,
    /// Abort when the run has waited for a person for this duration, s [default: wait].
    #[arg(long, value_name = "SECONDS")]
    pub patience: Option<u32>,
    #[command(flatten)]
    pub motion: MotionArgs,
    #[command(flatten)]
    pub bench: BenchArgs,
    #[command(flatten)]
    pub at: At,
}

impl RunArgs {
    /// Checks for options that contradict each other, or that a running service does not support.
    fn check(&self, server: Option<&Client>) -> CliResult<()> {
        if let Some(client) = server {
            let limit = format!(
                "the service at {} has its own rig: stop it, or omit this option",
                client.url()
            );
            let problems = self.bench.refused(&limit);
            if !problems.is_empty() {
                return Err(problems.into());
            }
        }
        self.bench.check()
    }
}

/// Inputs of the client, wherever the service runs.
struct Order<'a> {
    args: &'a RunArgs,
    files: ExperimentFiles,
    /// Whether this command started the service.
    own_service: bool,
}

/// Runs `palpate run`.
///
/// # Errors
/// `CliError` if an input is invalid, the rig or a service is not available, or the run cannot
/// start.
pub async fn run(args: RunArgs) -> CliResult<ExitCode> {
    let files = ExperimentFiles::read(&args.experiment)?;
    // With --virtual this command has its own bench and service.
    let server = if args.bench.on_virtual { None } else { embed::find(&args.at).await? };
    args.check(server.as_ref())?;
    let rig = RigFiles::read(args.bench.rig.as_deref())?;
    let (output, data) = (args.at.output(), args.at.data());
    let order = Order { args: &args, files, own_service: server.is_none() };
    let mut signals = Signals::catch()?;
    let ((run, closing), client, process) = match server {
        Some(client) => (drive(&client, &order, &mut signals).await?, client, None),
        None => {
            // An experiment that the rig cannot run is rejected before anything is started.
            let problems = order.files.preflight(&rig).problems;
            if !problems.is_empty() {
                return Err(problems.into());
            }
            // The skin on the bench is that of the experiment.
            make_folder(&data).map_err(|source| ServeError::Data { path: data.clone(), source })?;
            let sensor = data.join("sensor.toml");
            write(&sensor, &order.files.sensor_text)?;
            let starting = OwnServer::on_bench(&args.bench, &data, &sensor, output);
            let own = signals.during(starting).await?;
            let (client, process) = (own.client.clone(), own.process());
            let driven = drive(&client, &order, &mut signals).await;
            if !matches!(driven, Ok((_, None))) {
                own.end().await?;
            }
            (driven?, client, process)
        }
    };
    let Some(closing) = closing else {
        detached(&client, run.scan_id, run.uid, process, output).await;
        return Ok(ExitCode::SUCCESS);
    };
    let url = process.is_none().then(|| client.url());
    Ok(closed(&closing, &closing.next_commands(&data, url, args.new), output))
}

/// Brings the rig up, starts the run and follows it, like any client. No summary: the run was left to the service.
async fn drive(
    client: &Client,
    order: &Order<'_>,
    signals: &mut Signals,
) -> CliResult<(RunRow, Option<Closing>)> {
    let (mut starting, mut homes) = (None, false);
    let begun = signals.during(begin(client, order, &mut starting, &mut homes)).await;
    end_motion(client, homes, &begun).await;
    if let (Err(error), Some(start)) = (&begun, starting) {
        take_back(client, start, error).await;
    }
    let (run, since, waiting) = begun?;
    note(order, &format!("its page: {}/", client.url()));
    if waiting {
        note(order, &format!("run {} starts when the active run has ended", run.scan_id));
    }
    let args = order.args;
    if args.detach || signals.hung_up() {
        return Ok((run, None));
    }
    let watch = Watch {
        run: run.uid,
        since,
        waiting,
        json: args.at.json,
        by_itself: order.own_service && args.bench.is_virtual(),
        own_service: order.own_service,
        patience: args.patience.map(|s| Duration::from_secs(s.into())),
    };
    Ok((run, to_its_end(client, watch, signals).await?))
}

/// A run that this command starts.
#[derive(Debug, Clone, Copy)]
enum Start {
    /// It was queued for this.
    Queued(RunUid),
    /// It was stopped or interrupted.
    Resumed(RunUid),
}

/// Takes back a start that failed, or that was left: the service may have received it nevertheless. The start of a run
/// that resumes only if it was left: if it failed, another person may have started the run.
async fn take_back(client: &Client, start: Start, error: &CliError) {
    let run = match start {
        Start::Queued(run) => run,
        Start::Resumed(run) if matches!(error, CliError::Interrupted) => run,
        Start::Resumed(_) => return,
    };
    // A queued run that was not started would surprise the next person. The service answers once the start that it has
    // received is decided; it refuses if the run has begun, or is one that resumes.
    let Err(left) = client.delete(&format!("/api/v1/queue/{run}")).await else { return };
    let why = json!({ "why": "left as it began" });
    if client.act(run, "stop", why.clone()).await.is_ok() {
        return;
    }
    // A stopped run waits for its turn.
    let row = client.run(run).await;
    let waits = row.is_ok_and(|row| row.state == StoredState::Ended && row.waiting_since.is_some());
    if !waits || client.act(run, "abort", why).await.is_err() {
        tracing::warn!(error = %left, "the start of the run was not taken back");
    }
}

/// Starts the run, or finds it: returns it, the number of the last event before, and whether it waits. `starting`: the run
/// that it starts; `homes`: as in `bring_up`.
async fn begin(
    client: &Client,
    order: &Order<'_>,
    starting: &mut Option<Start>,
    homes: &mut bool,
) -> CliResult<(RunRow, i64, bool)> {
    let status = bring_up(client, order.args.motion, homes).await?;
    if let Some(active) = status.run.as_ref().filter(|_| !order.args.new) {
        let run = client.run(active.uid).await?;
        if order.is_of(&run, &status) {
            note(order, &format!("run {} is active: following it", run.scan_id));
            let since = last_event(client, &run).await?;
            return Ok((run, since, false));
        }
    }
    let run = match resumable(client, order, &status).await? {
        Some(run) => {
            note(order, &format!("run {} resumes where it stopped", run.scan_id));
            *starting = Some(Start::Resumed(run.uid));
            run
        }
        None => {
            // Without these words the run starts nevertheless.
            if let Ok(Some(words)) = earlier_words(client, order, &status).await {
                note(order, &words);
            }
            let body = submission(client, &order.files);
            let run: RunRow = client.post("/api/v1/queue", &body).await?;
            *starting = Some(Start::Queued(run.uid));
            run
        }
    };
    let Begun { since, waiting, preflight } = arm_and_start(client, &run).await?;
    note(order, &preflight_words(&run, &preflight, &status));
    Ok((run, since, waiting))
}

impl Order<'_> {
    /// Whether a run is of the same files on the same rig. The addresses of a virtual rig change, so rig
    /// files are compared by name and label.
    fn is_of(&self, run: &RunRow, status: &StatusView) -> bool {
        let rig = run.rig.as_deref().and_then(|text| RigSetup::from_toml("", text).ok());
        run.definition_sha256 == sha256_hex(&self.files.definition)
            && run.sensor_sha256 == sha256_hex(&self.files.sensor_text)
            && rig
                .is_some_and(|rig| rig.name() == status.rig.name && rig.label() == status.rig.label)
    }
}

/// A stopped or interrupted run of the same files on the same rig. One that was aborted or has failed is
/// resumed only by its number: `palpate resume RUN`.
async fn resumable(
    client: &Client,
    order: &Order<'_>,
    status: &StatusView,
) -> CliResult<Option<RunRow>> {
    if order.args.new {
        return Ok(None);
    }
    client.find_run(|run| goes_on(run) && order.is_of(run, status)).await
}

/// What a person must know of the newest ended run of the same files on the same rig, if it could be resumed and is
/// not.
async fn earlier_words(
    client: &Client,
    order: &Order<'_>,
    status: &StatusView,
) -> CliResult<Option<String>> {
    if order.args.new {
        return Ok(None);
    }
    let is_earlier = |run: &RunRow| run.state == StoredState::Ended && order.is_of(run, status);
    let newest = client.find_run(is_earlier).await?;
    let Some(run) = newest.filter(|run| run.is_resumable) else { return Ok(None) };
    let stored = client.summary(run.uid).await?.trials_stored;
    Ok(Some(not_resumed(run.scan_id, run.exit_status, [stored, run.trials_planned])))
}

/// Why a run is not resumed by itself, and how it is. `trials`: stored, planned.
fn not_resumed(scan_id: i64, ended: Option<ExitStatus>, trials: [u64; 2]) -> String {
    let ended = if ended == Some(ExitStatus::Abort) { "was aborted" } else { "failed" };
    let [stored, planned] = trials.map(grouped);
    format!(
        "run {scan_id} of the same files {ended} at {stored} of {planned} trials and is not resumed: a new run starts; \
         to continue it instead: palpate resume {scan_id}"
    )
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

fn preflight_words(run: &RunRow, preflight: &PreflightView, status: &StatusView) -> String {
    let (low, high) = (duration(preflight.duration_low_s), duration(preflight.duration_high_s));
    format!(
        "run {}, {} on rig {} ({}): {}, predicted {} ({low} .. {high}), {}",
        run.scan_id,
        run.experiment,
        status.rig.name,
        status.rig.label.as_str(),
        counted(preflight.trials, "trial", "trials"),
        duration(preflight.duration_s),
        bytes(preflight.disk_bytes as f64),
    )
}

/// Prints a line for people, in addition to the output for scripts.
fn note(order: &Order<'_>, words: &str) {
    if order.args.at.json {
        tracing::info!("{words}");
    } else {
        output::note(words);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_is_not_resumed_by_its_files_is_named() {
        let aborted = not_resumed(1, Some(ExitStatus::Abort), [80, 33_000]);
        let words = "run 1 of the same files was aborted at 80 of 33,000 trials and is not resumed: a new run starts; \
                     to continue it instead: palpate resume 1";
        assert_eq!(aborted, words);
        assert!(not_resumed(1, Some(ExitStatus::Fail), [80, 264]).contains(" failed at 80 of 264"));
    }
}
