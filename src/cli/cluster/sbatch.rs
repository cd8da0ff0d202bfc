//! `palpate cluster sbatch`: a work order and its array job, as files.
//! Uses: `chunk`, `job`, `table`, `twins`, `evaluation`. Never: Slurm, a chunk.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::json;

use super::evaluation::ReadingsRequest;
use super::job::{JOB_FILE, JOB_LOGS, Job, is_plain, is_time};
use super::table::TableRequest;
use super::twins::TwinsRequest;
use crate::chunk::folder::OrderFolder;
use crate::cli::data_or_default;
use crate::cli::error::{CliError, CliResult};
use crate::cli::files::this_program;
use crate::cli::next::Next;
use crate::cli::output::{counted, grouped, say, say_json};
use crate::cli::simulate::request::{RandomRequest, SolvedRequest, THREADS_MAX};
use crate::new_file;
use crate::problem::Checks;
use crate::simulate::random::chunks::work_order;

/// Largest number of tasks: the most that Slurm can be configured for.
const TASKS_MAX: u64 = 4_000_000;
/// Largest memory of a task, MiB.
const TASK_MEMORY_MAX_MIB: u64 = 16 << 20;

/// Options of `cluster sbatch`.
#[derive(Debug, Clone, Args)]
pub struct SbatchArgs {
    #[command(subcommand)]
    command: SbatchCommand,
}

/// Kinds of bulk work.
#[derive(Debug, Clone, Subcommand)]
enum SbatchCommand {
    /// Order Sim-Random; a chunk is a shard.
    ///
    /// The options that determine bytes are those of `palpate simulate random`, and the gathered folder has
    /// the same bytes.
    Random {
        #[command(flatten)]
        request: RandomRequest,
        #[command(flatten)]
        job: JobArgs,
    },
    /// Order the trainings of a table of the paper; a chunk is a net with its scores.
    ///
    /// The options that determine bytes are those of `palpate evaluate`; the vector instructions of this
    /// processor and the commit of the program determine them, too. A net trains on one thread.
    /// `palpate evaluate .. --trained` makes the table of the gathered nets.
    Table {
        #[command(flatten)]
        request: TableRequest,
        #[command(flatten)]
        job: JobArgs,
    },
    /// Order the twins of a run; a chunk has the frames of consecutive trials.
    ///
    /// The order contains the skin and the contacts of all trials that are stored, so that nodes need
    /// neither the database nor the rig. `palpate cluster gather` has the service store the twins.
    Twins {
        #[command(flatten)]
        request: TwinsRequest,
        #[command(flatten)]
        job: JobArgs,
    },
    /// Order the answers of exact to the frames of an evaluation; a chunk has those to some frames.
    ///
    /// The options are those of `palpate evaluate method`. The order contains the frames, the skin and the
    /// errors of its model. `palpate cluster gather` has the service score the answers, and
    /// `palpate evaluate method exact --trained` shows the scores.
    Evaluation {
        #[command(flatten)]
        request: Box<ReadingsRequest>,
        #[command(flatten)]
        job: JobArgs,
    },
}

/// Options of the array job.
#[derive(Debug, Clone, Args)]
pub struct JobArgs {
    /// Folder of the work order and its results, which all nodes share.
    #[arg(long, value_name = "DIR")]
    folder: PathBuf,
    /// Largest number of tasks of the array; task i of T makes the chunks i, i + T, ..
    #[arg(long, value_name = "T", default_value_t = 64)]
    tasks: u64,
    /// Processors of a task, and threads that simulate in it; a net trains on one.
    #[arg(long, value_name = "N", default_value_t = 1)]
    cpus: usize,
    /// Memory of a task, MiB [default: that of the partition].
    #[arg(long, value_name = "MIB")]
    memory_mib: Option<u64>,
    /// Partition of the cluster [default: the cluster's].
    #[arg(long, value_name = "NAME")]
    partition: Option<String>,
    /// Account that the job is charged to [default: yours].
    #[arg(long, value_name = "NAME")]
    account: Option<String>,
    /// Limit of a task's time, as Slurm reads it: minutes, H:MM:SS, D-HH [default: that of the partition].
    #[arg(long, value_name = "TIME")]
    time: Option<String>,
    /// Print JSON on standard output, for scripts.
    #[arg(long)]
    json: bool,
}

/// Writes a work order and its job.
///
/// # Errors
/// `CliError` if an option is invalid, the folder contains another order, or a file cannot be written.
pub async fn sbatch(args: &SbatchArgs) -> CliResult<()> {
    match &args.command {
        SbatchCommand::Random { request, job } => {
            let draft = job.draft(request.data.clone())?;
            let SolvedRequest { definition, sensor_text, calibration_text, .. } =
                request.solve()?;
            let order = work_order(&definition, sensor_text, calibration_text)?;
            let contents = format!("{} trials", grouped(definition.trials));
            job.finish(draft, OrderFolder::write(&job.folder, order)?, &contents, &[])
        }
        SbatchCommand::Table { request, job } => {
            let draft = job.draft(request.place.data.clone())?;
            let written = request.write(&job.folder, job.json).await?;
            let contents = format!("{} nets", written.0.order().chunks);
            job.finish(draft, written, &contents, request.resources())
        }
        SbatchCommand::Twins { request, job } => {
            let draft = job.draft(request.place.data.clone())?;
            let (order, trials) = request.order(job.json).await?;
            let contents = format!("{} twins", grouped(trials));
            job.finish(draft, OrderFolder::write(&job.folder, order)?, &contents, &[])
        }
        SbatchCommand::Evaluation { request, job } => {
            let draft = job.draft(request.place.data.clone())?;
            let (order, frames) = request.order(job.json).await?;
            let contents = format!("{} frames", grouped(frames));
            job.finish(draft, OrderFolder::write(&job.folder, order)?, &contents, &[])
        }
    }
}

impl JobArgs {
    /// Checks the options, and returns the job, still without an order.
    fn draft(&self, data: Option<PathBuf>) -> CliResult<Job> {
        let mut checks = Checks::of("command line");
        let limit = format!("must be from 1 to {TASKS_MAX}");
        checks.require((1..=TASKS_MAX).contains(&self.tasks), "tasks", self.tasks, &limit);
        let limit = format!("must be from 1 to {THREADS_MAX}");
        checks.require((1..=THREADS_MAX).contains(&self.cpus), "cpus", self.cpus, &limit);
        if let Some(memory_mib) = self.memory_mib {
            let limit = format!("must be from 1 to {TASK_MEMORY_MAX_MIB} MiB");
            let fits = (1..=TASK_MEMORY_MAX_MIB).contains(&memory_mib);
            checks.require(fits, "memory-mib", memory_mib, &limit);
        }
        let words =
            "must consist of letters, digits and -_./:=,@+, which Slurm reads without quotes";
        for (key, value) in [("partition", &self.partition), ("account", &self.account)] {
            let value = value.as_deref();
            checks.require(value.is_none_or(is_plain), key, value.unwrap_or_default(), words);
        }
        if let Some(time) = &self.time {
            let limit = "must be minutes, H:MM:SS, D-HH or D-HH:MM:SS";
            checks.require(is_time(time), "time", time, limit);
        }
        let folder = absolute(&self.folder)?;
        let data = absolute(&data_or_default(data))?;
        let palpate = this_program()?.display().to_string();
        for (key, path) in [("folder", &folder), ("data", &data), ("path of palpate", &palpate)] {
            checks.require(is_plain(path), key, path, words);
        }
        checks.done()?;
        Ok(Job { palpate, folder, data, cpus: self.cpus, ..Job::default() })
    }

    /// Writes the job of an order, which is in this folder and may be new there, and reports both. `resources`: further
    /// options of `sbatch` that its kind needs.
    fn finish(
        &self,
        draft: Job,
        (folder, is_new): (OrderFolder, bool),
        contents: &str,
        resources: &[&str],
    ) -> CliResult<()> {
        let order = folder.order();
        let job = Job {
            order: order.short_id().into(),
            chunks: order.chunks,
            tasks: self.tasks.min(order.chunks),
            options: self.options(resources),
            ..draft
        };
        let (path, text) = (self.folder.join(JOB_FILE), job.to_string());
        let is_same = fs::read_to_string(&path).is_ok_and(|there| there == text);
        let logs = self.folder.join(JOB_LOGS);
        fs::create_dir_all(&logs).map_err(CliError::file(&logs))?;
        if !is_same {
            new_file::write(&self.folder, JOB_FILE, &text).map_err(CliError::file(&path))?;
        }
        if self.json {
            say_json(&json!({
                "folder": job.folder,
                "order": order.id,
                "kind": order.kind,
                "chunks": order.chunks,
                "tasks": job.tasks,
                "job": format!("{}/{JOB_FILE}", job.folder),
                "changed": is_new || !is_same,
            }));
            return Ok(());
        }
        let chunks = counted(order.chunks, "chunk", "chunks");
        let tasks = counted(job.tasks, "task", "tasks");
        let state = match (is_new, is_same) {
            (true, _) => "is written",
            (false, true) => "is there already, nothing was changed",
            (false, false) => "is there already, its job was written again",
        };
        let folder = self.folder.display();
        say(format_args!(
            "work order {} ({contents} in {chunks}, an array of {tasks}) {state}: {folder}",
            order.short_id()
        ));
        let submit = format!("sbatch {folder}/{JOB_FILE}");
        Next::default()
            .line(submit, "submits the array job")
            .suggest(
                format_args!("palpate worker submit {folder}"),
                "lets workers over PostgreSQL make its chunks instead",
            )
            .suggest(format_args!("palpate cluster status {folder}"), "shows what is done")
            .say();
        Ok(())
    }

    /// Further options of `sbatch`.
    fn options(&self, resources: &[&str]) -> Vec<String> {
        let memory = self.memory_mib.map(|mib| format!("{mib}M"));
        let named = [
            ("mem", &memory),
            ("partition", &self.partition),
            ("account", &self.account),
            ("time", &self.time),
        ];
        let given = named.into_iter().filter_map(|(name, value)| Some((name, value.as_ref()?)));
        let given = given.map(|(name, value)| format!("{name}={value}"));
        given.chain(resources.iter().map(|&option| option.to_owned())).collect()
    }
}

fn absolute(path: &Path) -> CliResult<String> {
    let absolute = std::path::absolute(path).map_err(CliError::file(path))?;
    Ok(absolute.display().to_string())
}
