//! The command line: commands and their execution.
//! It is a client of a running service; without one it starts a service for the duration of the
//! command.
//! Uses: every stage through `api`, and the pure ones. Never: the virtual rig's code (`main` starts
//! it), decisions about motion.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand};

use crate::campaign::STOPS;
use crate::carried::{self, GAPS, RIGS, SENSORS};
use crate::file_kind::FileKind;

mod access;
mod ask;
mod asking;
mod attach;
mod begin;
mod bench_args;
mod browser;
mod calibrate;
mod care;
mod client;
mod cluster;
mod dataset;
mod download;
mod drawn;
mod embed;
mod error;
mod estop;
mod evaluate;
mod export;
mod federate;
mod files;
mod find;
mod follow;
pub mod help;
pub mod import;
mod infer;
mod init;
mod job;
mod job_losses;
mod job_words;
mod journal;
mod key;
mod leave;
pub mod log;
mod making;
mod model;
mod morning;
mod next;
mod output;
mod own_server;
mod placement;
mod picture;
mod plan;
mod plan_plot;
mod print;
mod progress;
mod query;
mod queue;
mod read_only;
mod recording;
mod repeat;
mod rig;
mod rig_facts;
mod run;
mod running;
mod sensor;
mod serve;
mod signals;
mod simulate;
mod summary;
mod table;
mod times;
mod train;
pub mod trust;
mod twins;
mod view;
mod virtual_bench;
mod vocabulary;
mod watch;
mod worker;
mod workers;

pub use drawn::{report, report_usage};
use embed::Purpose::Reads;
pub use error::CliError;
use error::CliResult;
use files::{DEFAULT_GAP, DEFAULT_RIG, DEFAULT_SENSOR};
pub use files::{DEFAULT_SKIN_SEED, fault_script, named_sensor};
pub use output::{Output, error_drawn, written};

pub use crate::plain::in_plain_words;

/// Default URL of the service.
pub const DEFAULT_URL: &str = "http://127.0.0.1:8080";
/// Default folder of the database.
const DEFAULT_DATA: &str = "palpate-data";

/// Service, data folder and form of the output.
#[derive(Debug, Clone, Default, Args)]
pub struct At {
    /// URL of the service [env: PALPATE_URL] [default: http://127.0.0.1:8080]; its key is in
    /// PALPATE_KEY, or in the file of PALPATE_KEY_FILE.
    #[arg(long, value_name = "URL", global = true)]
    pub url: Option<String>,
    /// Certificate of an https service or of its authority, PEM [env: PALPATE_CA] [default: the
    /// authorities of the system].
    #[arg(long, value_name = "FILE", global = true)]
    pub ca: Option<PathBuf>,
    /// Folder of the database for a service that this command starts [env: PALPATE_DATA] [default:
    /// palpate-data].
    #[arg(long, value_name = "DIR", global = true)]
    pub data: Option<PathBuf>,
    /// Print JSON on standard output, for scripts.
    #[arg(long, global = true)]
    pub json: bool,
}

impl At {
    /// URL of the service, if one was named.
    pub fn url(&self) -> Option<String> {
        let from_env = || std::env::var("PALPATE_URL").ok().filter(|u| !u.is_empty());
        self.url.clone().or_else(from_env)
    }

    /// File with the certificate to trust, if one was named.
    pub fn ca(&self) -> Option<PathBuf> {
        let from_env = || std::env::var_os("PALPATE_CA").filter(|file| !file.is_empty());
        self.ca.clone().or_else(|| from_env().map(PathBuf::from))
    }

    /// Whether the option or the environment names a data folder.
    pub fn names_data(&self) -> bool {
        self.data.is_some() || std::env::var_os("PALPATE_DATA").is_some_and(|d| !d.is_empty())
    }

    /// Form of the output.
    pub fn output(&self) -> Output {
        if self.json { Output::Json } else { Output::Text }
    }

    /// Path of the data folder.
    pub fn data(&self) -> PathBuf {
        data_or_default(self.data.clone())
    }
}

/// Data folder: the named one, that of the environment, or the default one.
pub fn data_or_default(named: Option<PathBuf>) -> PathBuf {
    let from_env = || std::env::var_os("PALPATE_DATA").filter(|d| !d.is_empty());
    named.or_else(|| from_env().map(PathBuf::from)).unwrap_or_else(|| PathBuf::from(DEFAULT_DATA))
}

/// Options of `status`.
#[derive(Debug, Clone, Args)]
pub struct StatusArgs {
    /// Show the state on the whole terminal, and keep it up to date. Keys: q quits, p pauses, r
    /// resumes, E is the emergency stop.
    #[arg(long)]
    pub watch: bool,
    /// Show the simulated twins: made and pending by run, and the fit of the last trials.
    #[arg(long, conflicts_with = "watch")]
    pub twins: bool,
    /// Show the workers of bulk work and their queue: orders, rates, time to go, failed chunks.
    #[arg(long, conflicts_with_all = ["watch", "twins"])]
    pub workers: bool,
    /// Check that the service can store trials; if not, the exit code is 1.
    #[arg(long, conflicts_with_all = ["watch", "twins", "workers"])]
    pub ready: bool,
    /// Service of the rig.
    #[command(flatten)]
    pub at: At,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the service and its page until Ctrl-C or SIGTERM.
    ///
    /// Without --rig it starts a virtual rig and a virtual operator, which end with it. To listen on
    /// an address beyond this machine, create a key first: palpate key create NAME.
    Serve(serve::ServeArgs),
    /// Queue, arm and run an experiment to its end.
    ///
    /// The rig of a running service runs the experiment. Without a service one is started: with the
    /// rig of --rig, or else with a virtual rig and a virtual operator. A stopped or interrupted run
    /// of the same files is resumed. Ctrl-C offers to detach, pause or stop; a second one aborts.
    /// Without a terminal it stops after the trial. A closed terminal detaches. Exit code: 0 success,
    /// or detached; 1 stopped, aborted or failed; 2 bad input.
    Run(run::RunArgs),
    /// Follow the active run, or another one, from this terminal.
    ///
    /// Ctrl-C asks what to do, as for `run`.
    Attach(attach::AttachArgs),
    /// Show the plan of an experiment, and whether the rig can run it; nothing moves.
    ///
    /// Exit code 2 if something forbids it: each problem names file, key, value and limit.
    Plan(plan::PlanArgs),
    /// Write the carried experiments, rigs, gaps, sensors, datasets, recipes and faults into a folder.
    ///
    /// They are to be edited. Files that are there stay as they are. With --list or --schema nothing
    /// is written.
    Init(init::InitArgs),
    /// Fit the model to measurements of a skin, and write a calibration file.
    ///
    /// Exit code 2 if a table contains an invalid value: each problem names line, column, value and
    /// limit.
    Calibrate(calibrate::CalibrateArgs),
    /// Simulate frames of contacts; nothing moves.
    Simulate(simulate::SimulateArgs),
    /// Make Sim-Random, twins and nets in chunks on a cluster, in a folder that its nodes share.
    Cluster(cluster::ClusterArgs),
    /// Make chunks of bulk work on any machine, over PostgreSQL and an object store.
    ///
    /// Starts the program palpate-worker, which is built when it is first needed. Addresses and
    /// passwords come from files or the environment: palpate worker --help.
    Worker(worker::WorkerArgs),
    /// Show the state of rig, run and service.
    Status(StatusArgs),
    /// Print counters and gauges of the service, in the text format of Prometheus.
    Metrics(At),
    /// Show the names that requests use, with what they mean: methods, formats, flags, events, trips.
    Vocabulary(vocabulary::VocabularyArgs),
    /// Show and change the queue of runs.
    Queue(queue::QueueArgs),
    /// Pause the active run, after its trial.
    #[command(after_help = STOPS)]
    Pause(ask::PauseArgs),
    /// Resume the paused run, or one that was stopped or interrupted.
    Resume(begin::ResumeArgs),
    /// End the active run after its trial; it can be resumed later.
    Stop(ask::StopArgs),
    /// Raise the tips now and end the active run, or end an interrupted one.
    #[command(after_help = STOPS)]
    Abort(ask::AbortArgs),
    /// Confirm that the requested work is done.
    ///
    /// A placement of weights that the skin contradicts is refused with the reasons, unless --anyway.
    Confirm(placement::ConfirmArgs),
    /// Repeat a manual trial that was faulty, the last one by default; its data is kept as an attempt.
    Repeat(placement::RepeatArgs),
    /// Show the weights that a run requests, and the contacts estimated from the skin.
    Placement(At),
    /// Print the overlay of a sensor.
    Sensor(sensor::SensorArgs),
    /// List the runs, newest first.
    Runs(morning::RunsArgs),
    /// List stored trials, newest first.
    Trials(morning::TrialsArgs),
    /// Ask a question in SQL about trials, runs, events and datasets.
    ///
    /// Prints a table, or writes CSV, NDJSON, Parquet or Arrow. Without a statement it lists the
    /// tables. Nothing can be written by a statement.
    Query(query::QueryArgs),
    /// Draw the answer to a question: counts, force over depth, FVU, a histogram, or a statement.
    Plot(query::PlotArgs),
    /// List what happened, or follow it.
    Events(morning::EventsArgs),
    /// List who requested what and why, newest first: stops, jogs, edits, promotions, refusals.
    Actions(morning::ActionsArgs),
    /// Draw a run or a trial: facts, map, forces, frame.
    Show(morning::ShowArgs),
    /// Write the report of a run as HTML and PDF.
    Report(morning::ReportArgs),
    /// Compare two runs: files, counts, forces, frames.
    Diff(morning::DiffArgs),
    /// Emergency stop: every axis stops at once, until a reset.
    #[command(after_help = STOPS)]
    Estop(ask::ActArgs),
    /// Show the operator lock, take it with a NOTE, or release it with --clear.
    ///
    /// It blocks starting and editing, never stopping.
    Lock(access::LockArgs),
    /// Create, show and revoke keys of the API.
    Key(access::KeyArgs),
    /// Check the rig and move it manually.
    Rig(rig::RigArgs),
    /// List, show, make and export datasets; import trials.
    Dataset(dataset::DatasetArgs),
    /// Train a net by a recipe, on a dataset; the model is stored in the service.
    ///
    /// The service trains, and resumes after a restart. Ctrl-C offers to detach or stop; without a
    /// terminal it stops at a checkpoint, from which the same command resumes. A closed terminal
    /// detaches. Exit code 2 if the recipe contains an invalid value: each problem names key, value
    /// and limit.
    Train(train::TrainArgs),
    /// List, show and stop trainings and evaluations.
    Job(job::JobArgs),
    /// List, show, add and promote models.
    Model(model::ModelArgs),
    /// Estimate contacts from frames in a file.
    Infer(infer::InferArgs),
    /// Estimate contacts on the rig's skin, frame by frame.
    Live(infer::LiveArgs),
    /// Score simulation, nets and methods.
    Evaluate(evaluate::EvaluateArgs),
}

/// Runs a command. Errors are printed on standard error in this form; the exit code is 0, 1, or 2 for bad
/// input.
pub fn main(command: Command, output: Output) -> ExitCode {
    match on_runtime(command) {
        Ok(code) => said(code, output),
        Err(error) => failed(&error, output),
    }
}

/// The exit code of a command that has printed its answer: another one, with an error, if standard output did not take
/// it. A closed pipe is no error.
pub fn said(code: ExitCode, output: Output) -> ExitCode {
    output::all_said().map_or_else(|error| failed(&error, output), |()| code)
}

fn failed(error: &CliError, output: Output) -> ExitCode {
    drawn::report(error, output);
    error.exit_code()
}

fn on_runtime(command: Command) -> CliResult<ExitCode> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(CliError::system("starting the runtime"))?;
    let outcome = runtime.block_on(answer(command));
    // A thread may still wait for input at the terminal that is no longer needed.
    runtime.shutdown_background();
    outcome
}

async fn answer(command: Command) -> CliResult<ExitCode> {
    match command {
        Command::Plan(args) => plan::plan(&args).await?,
        Command::Init(args) => init::init(&args)?,
        Command::Calibrate(args) => calibrate::calibrate(args).await?,
        Command::Run(args) => return run::run(args).await,
        Command::Attach(args) => return attach::attach(args).await,
        Command::Simulate(args) => return simulate::simulate(args).await,
        Command::Cluster(args) => return cluster::cluster(args).await,
        Command::Worker(args) => worker::worker(args).await?,
        Command::Rig(args) => return rig::rig(args).await,
        Command::Serve(args) => serve::serve(args).await?,
        Command::Status(args) if args.watch => watch::watch(&args.at).await?,
        Command::Status(args) if args.twins => twins::status(&args.at).await?,
        Command::Status(args) if args.workers => workers::status(&args.at).await?,
        Command::Status(args) if args.ready => ask::ready(&args.at).await?,
        Command::Metrics(at) => ask::metrics(&at).await?,
        Command::Status(args) => ask::status(&args.at).await?,
        Command::Vocabulary(args) => vocabulary::vocabulary(args).await?,
        Command::Queue(args) => queue::queue(args).await?,
        Command::Pause(args) => ask::pause(&args).await?,
        Command::Resume(args) => begin::resume(&args).await?,
        Command::Stop(args) => ask::stop(&args).await?,
        Command::Abort(args) => ask::abort(&args).await?,
        Command::Confirm(args) => placement::confirm(&args).await?,
        Command::Repeat(args) => placement::repeat(&args).await?,
        Command::Placement(at) => placement::placement(&at).await?,
        Command::Sensor(args) => sensor::sensor(&args)?,
        Command::Runs(args) => embed::command(&args.at, Reads, &args, morning::runs).await?,
        Command::Trials(args) => morning::trials(args).await?,
        Command::Query(args) => embed::command(&args.at, Reads, &args, query::query).await?,
        Command::Plot(args) => embed::command(&args.at, Reads, &args, query::plot).await?,
        Command::Events(args) => morning::events(args).await?,
        Command::Actions(args) => embed::command(&args.at, Reads, &args, morning::actions).await?,
        Command::Show(args) => embed::command(&args.at, Reads, &args, morning::show).await?,
        Command::Report(args) => embed::command(&args.at, Reads, &args, morning::report).await?,
        Command::Diff(args) => embed::command(&args.at, Reads, &args, morning::diff).await?,
        Command::Estop(args) => estop::estop(&args).await?,
        Command::Lock(args) => access::lock(args).await?,
        Command::Key(args) => access::key(args).await?,
        Command::Dataset(args) => dataset::dataset(args).await?,
        Command::Train(args) => train::train(args).await?,
        Command::Job(args) => job::job(args).await?,
        Command::Model(args) => model::model(args).await?,
        Command::Infer(args) => infer::infer(args).await?,
        Command::Live(args) => infer::live(args).await?,
        Command::Evaluate(args) => evaluate::evaluate(args).await?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns the named files of a virtual rig: rig, gap and sensor. A name without a file is that of a carried one; it,
/// and the default of what is not named, are written to a folder.
///
/// # Errors
/// `CliError::Problems` if a named file cannot be read, `File` if a carried one cannot be written.
pub fn virtual_rig_files(folder: &Path, named: [Option<PathBuf>; 3]) -> CliResult<[PathBuf; 3]> {
    let [rig, gap, sensor] = named;
    let file = |kind, carried, named: Option<PathBuf>, [name, default]: [&str; 2]| match named {
        Some(path) => files::on_disk(kind, &path, carried, folder, name),
        None => files::write_in(folder, name, default),
    };
    let gap_text = carried::text(GAPS, DEFAULT_GAP).unwrap_or_default();
    Ok([
        file(FileKind::Rig, RIGS, rig, ["rig.toml", DEFAULT_RIG])?,
        file(FileKind::Gap, GAPS, gap, ["gap.toml", gap_text])?,
        file(FileKind::Sensor, SENSORS, sensor, ["sensor.toml", DEFAULT_SENSOR])?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_a_virtual_rig_may_be_named_like_carried_ones() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("virtual-rig");
        let own = temporary.path().join("own.toml");
        std::fs::write(&own, DEFAULT_SENSOR).unwrap();
        let named = [None, Some("gap-b".into()), Some(own.clone())];
        let [rig, gap, sensor] = virtual_rig_files(&folder, named).unwrap();
        let text = |path: &Path| std::fs::read_to_string(path).unwrap();
        assert_eq!(text(&rig), DEFAULT_RIG);
        assert_eq!(Some(&*text(&gap)), carried::text(GAPS, "gap-b"));
        assert_eq!(sensor, own);
        let unknown = virtual_rig_files(&folder, [None, Some("gap-z".into()), None]);
        assert!(unknown.unwrap_err().to_string().contains("gap-a, gap-b"));
        let script = |name: &str| fault_script(&folder, Path::new(name));
        let carried = carried::text(carried::FAULTS, "each-kind");
        assert_eq!(Some(&*text(&script("each-kind").unwrap())), carried);
        let kept = script("each-kind").unwrap().display().to_string();
        assert_eq!(script(&kept).unwrap().display().to_string(), kept);
        let of_sensor = script(&own.display().to_string()).unwrap_err().to_string();
        assert!(of_sensor.contains("a sensor file, not a script of faults"), "{of_sensor}");
    }
}
