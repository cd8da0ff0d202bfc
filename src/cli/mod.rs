//! The command line: what can be asked, and who answers.
//! With a server up it is that server's client; otherwise it starts one for as long as it lasts.
//! Uses: every stage through `api`, and the pure ones. Never: the virtual rig's code (`main` starts
//! it), decisions about motion.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand};

use crate::campaign::STOPS;
use serde_json::json;

mod access;
mod ask;
mod calibrate;
mod client;
mod dataset;
mod embed;
mod error;
mod evaluate;
mod files;
mod follow;
mod infer;
mod model;
mod output;
mod plan;
mod progress;
mod queue;
mod rig;
mod run;
mod serve;
mod simulate;
mod summary;
mod train;
mod view;
mod virtual_bench;

pub use error::CliError;
pub use files::DEFAULT_SKIN_SEED;
use files::{DEFAULT_GAP, DEFAULT_RIG, DEFAULT_SENSOR};

/// Where a server is looked for.
pub const DEFAULT_URL: &str = "http://127.0.0.1:8080";
/// Folder of the database, unless said otherwise.
const DEFAULT_DATA: &str = "palpate-data";

/// Where the server is, where the data are, and who reads the answer.
#[derive(Debug, Clone, Default, Args)]
pub struct At {
    /// The server [env: PALPATE_URL] [default: http://127.0.0.1:8080]; its key is in PALPATE_KEY.
    #[arg(long, value_name = "URL", global = true)]
    pub url: Option<String>,
    /// Folder of the database for a server of this command's own [env: PALPATE_DATA] [default:
    /// palpate-data].
    #[arg(long, value_name = "DIR", global = true)]
    pub data: Option<PathBuf>,
    /// JSON on standard output, for scripts.
    #[arg(long, global = true)]
    pub json: bool,
}

impl At {
    /// The server's URL, where one was named.
    pub fn url(&self) -> Option<String> {
        let from_env = || std::env::var("PALPATE_URL").ok().filter(|u| !u.is_empty());
        self.url.clone().or_else(from_env)
    }

    /// The data folder.
    pub fn data(&self) -> PathBuf {
        data_or_default(self.data.clone())
    }
}

/// The data folder that was named, of the environment, or the default one.
pub fn data_or_default(named: Option<PathBuf>) -> PathBuf {
    let from_env = || std::env::var_os("PALPATE_DATA").filter(|d| !d.is_empty());
    named.or_else(|| from_env().map(PathBuf::from)).unwrap_or_else(|| PathBuf::from(DEFAULT_DATA))
}

/// What can be asked.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the service and its page until Ctrl-C or SIGTERM.
    ///
    /// Without --rig it knows the virtual rig at the addresses where `palpate virtual-rig` listens;
    /// it answers, shows and exports also while no rig is there. An address beyond this machine
    /// needs a key first: palpate key create NAME.
    Serve(serve::ServeArgs),
    /// Queue, arm and run an experiment to its end.
    ///
    /// With a server up, its rig runs the experiment. Otherwise a server is started for it: with
    /// the rig of --rig, or, without one, with a virtual rig and a virtual operator. An interrupted
    /// run of the same files is gone on with where it stopped. Ctrl-C stops after the trial, twice
    /// aborts. Exit code: 0 success, 1 failed or aborted, 2 bad input.
    Run(run::RunArgs),
    /// Show what an experiment would do, and whether the rig can do it; nothing moves.
    ///
    /// Exit code 2 where something forbids it: each problem names file, key, value and limit.
    Plan(plan::PlanArgs),
    /// Fit the model to measurements of this skin, and write a calibration file.
    ///
    /// Exit code 2 where a table holds what cannot be used: each problem names line, column, value
    /// and limit.
    Calibrate(calibrate::CalibrateArgs),
    /// Simulate frames of contacts; nothing moves.
    Simulate(simulate::SimulateArgs),
    /// Show where rig, run and service stand.
    Status(At),
    /// Show and change what runs next.
    Queue(queue::QueueArgs),
    /// Pause the run under way, after its trial.
    #[command(after_help = STOPS)]
    Pause(ask::PauseArgs),
    /// Go on after a pause or a trip.
    Resume(ask::ActArgs),
    /// End the run under way after its trial, as a success.
    Stop(ask::ActArgs),
    /// Raise the tips now and end the run under way.
    #[command(after_help = STOPS)]
    Abort(ask::ActArgs),
    /// Say that what the run waits for has been done.
    Confirm(ask::ActArgs),
    /// Say that the last trial by hand was bad: it is done again.
    Repeat(ask::ActArgs),
    /// Emergency stop: every axis stops at once, and stays so until a reset.
    #[command(after_help = STOPS)]
    Estop(ask::ActArgs),
    /// Show, take or give back the operator lock, which blocks starting, never stopping.
    Lock(access::LockArgs),
    /// Make, show and revoke keys of the API.
    Key(access::KeyArgs),
    /// Check and move the rig by hand.
    Rig(rig::RigArgs),
    /// Datasets: what there is, files out, trials measured elsewhere in.
    Dataset(dataset::DatasetArgs),
    /// Train a net by a recipe, on a dataset; the model is kept in the service.
    ///
    /// The service trains, and goes on after a restart. Exit code 2 where the recipe holds what cannot
    /// be used: each problem names key, value and limit.
    Train(train::TrainArgs),
    /// Trainings and evaluations: what waits, runs and is over.
    Job(train::JobArgs),
    /// Models: what there is, how good they are, which serve.
    Model(model::ModelArgs),
    /// Say where and how hard frames of a file were touched.
    Infer(infer::InferArgs),
    /// Say where and how hard the rig's skin is being touched, frame by frame.
    Live(infer::LiveArgs),
    /// Say how good the model is.
    Evaluate(evaluate::EvaluateArgs),
}

/// Does what was asked. Errors are on standard error, in words; the exit code is 0, 1, or 2 for
/// bad input.
pub fn main(command: Command) -> ExitCode {
    let outcome = match command {
        Command::Plan(args) => plan::plan(&args),
        command => on_runtime(command),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("{error}");
        error.exit_code()
    })
}

fn on_runtime(command: Command) -> Result<ExitCode, CliError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|source| CliError::System { operation: "starting the runtime", source })?;
    let outcome = runtime.block_on(answer(command));
    // A thread may still wait at the terminal for an answer that nobody needs any more.
    runtime.shutdown_background();
    outcome
}

async fn answer(command: Command) -> Result<ExitCode, CliError> {
    let none = || json!({});
    match command {
        Command::Plan(args) => return plan::plan(&args),
        Command::Calibrate(args) => return calibrate::calibrate(args).await,
        Command::Run(args) => return run::run(args).await,
        Command::Simulate(args) => return simulate::simulate(args).await,
        Command::Rig(args) => return rig::rig(args).await,
        Command::Serve(args) => serve::serve(args).await?,
        Command::Status(at) => ask::status(&at).await?,
        Command::Queue(args) => queue::queue(args).await?,
        Command::Pause(args) => ask::pause(&args).await?,
        Command::Resume(args) => ask::act(&args, "resume", none()).await?,
        Command::Stop(args) => ask::act(&args, "stop", none()).await?,
        Command::Abort(args) => ask::act(&args, "abort", none()).await?,
        Command::Confirm(args) => ask::act(&args, "confirm", none()).await?,
        Command::Repeat(args) => ask::act(&args, "repeat", none()).await?,
        Command::Estop(args) => ask::estop(&args).await?,
        Command::Lock(args) => access::lock(args).await?,
        Command::Key(args) => access::key(args).await?,
        Command::Dataset(args) => dataset::dataset(args).await?,
        Command::Train(args) => train::train(args).await?,
        Command::Job(args) => train::job(args).await?,
        Command::Model(args) => model::model(args).await?,
        Command::Infer(args) => infer::infer(args).await?,
        Command::Live(args) => infer::live(args).await?,
        Command::Evaluate(args) => evaluate::evaluate(args).await?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Files of a virtual rig.
#[derive(Debug, Clone)]
pub struct VirtualRigFiles {
    /// Rig file.
    pub rig: PathBuf,
    /// Gap file.
    pub gap: PathBuf,
    /// Sensor file.
    pub sensor: PathBuf,
}

/// The files that were named, and for the rest the carried ones, written into a folder.
pub fn virtual_rig_files(
    folder: &Path,
    named: [Option<PathBuf>; 3],
) -> Result<VirtualRigFiles, CliError> {
    let [rig, gap, sensor] = named;
    let or_carried = |named: Option<PathBuf>, name: &str, text: &str| match named {
        Some(path) => Ok(path),
        None => {
            let path = folder.join(OsStr::new(name));
            files::write(&path, text).map(|()| path)
        }
    };
    Ok(VirtualRigFiles {
        rig: or_carried(rig, "rig.toml", DEFAULT_RIG)?,
        gap: or_carried(gap, "gap.toml", DEFAULT_GAP)?,
        sensor: or_carried(sensor, "sensor.toml", DEFAULT_SENSOR)?,
    })
}
