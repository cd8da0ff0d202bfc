//! The command line: what each command is given, and what it prints.
//! Uses: every other module. Never: an address or a password as an argument.

use std::io::{Write, stderr, stdout};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use serde::Serialize;

use crate::child;
use crate::needs::{Needs, memory_mib};
use crate::order::is_hash;
use crate::queue::Queue;
use crate::store::Store;
use crate::work::{CONNECTIONS, Work};
use crate::{WorkerError, WorkerResult};
use crate::{address, fetch, setup, status, submit, work};

/// Environment of all commands, as the help shows it.
const ENVIRONMENT: &str = "\
Environment:
  PALPATE_QUEUE_FILE   file (mode 600) with postgres://USER:PASSWORD@HOST/DATABASE; or PALPATE_QUEUE has it
  PALPATE_STORE        folder or s3://BUCKET/PREFIX for results, with keys in AWS_ACCESS_KEY_ID and the
                       like; or PALPATE_STORE_FILE, a file (mode 600) with both
  PALPATE_STORE_CA     certificates of the store's authority, PEM [default: those of the system]
  PALPATE_PROGRAM      the program that makes chunks [default: palpate next to this one, or in PATH]
  PALPATE_LOG          level of the log, such as debug

Exit codes:
  0  success
  1  failed: the cause is on standard error
  2  invalid input: an address, a file or an option";

/// Makes chunks of bulk work on any machine: a queue on PostgreSQL, results in an object store.
#[derive(Debug, Parser)]
#[command(name = "palpate-worker", version, after_help = ENVIRONMENT)]
pub struct Options {
    #[command(subcommand)]
    command: Command,
    /// Print JSON on standard output, for scripts.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make the tables of the queue and the role of workers; once per database, as its owner.
    Setup,
    /// Submit the order of a folder: its missing chunks, and those that were set aside.
    Submit(Submit),
    /// Take chunks, make them, and put their results into the store, until SIGTERM.
    Work(WorkOptions),
    /// Show workers and orders: done, waiting and failed chunks, rate, time to go.
    Status(StatusOptions),
    /// Remove the chunks of an order from the queue; results stay.
    Cancel {
        /// Folder of the order, its id, or the first 8 digits or more.
        order: String,
    },
    /// Fetch the results of an order, each checked by its hash; then `palpate cluster gather`.
    Fetch(FetchOptions),
}

#[derive(Debug, Args)]
struct Submit {
    /// Folder with order.json.
    folder: PathBuf,
    /// Chunks of a high priority are taken first.
    #[arg(long, value_enum, default_value = "normal")]
    priority: Priority,
    /// Attempts after which a chunk is set aside with its error.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(i16).range(1..=100))]
    attempts: i16,
    /// Only workers with a GPU take the chunks.
    #[arg(long)]
    gpu: bool,
    /// Only workers with this memory take the chunks, MiB.
    #[arg(long, value_name = "MIB", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=4_194_304))]
    memory_mib: u64,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Priority {
    High,
    Normal,
    Low,
}

#[derive(Debug, Args)]
struct WorkOptions {
    /// Chunks that are made at once, each by its own program.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    at_once: u16,
    /// Threads of each program [default: the machine's cores divided by --at-once].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// This machine has a GPU for chunks that need one.
    #[arg(long)]
    gpu: bool,
    /// Memory for chunks that need a certain one, MiB [default: that of the machine].
    #[arg(long, value_name = "MIB")]
    memory_mib: Option<u64>,
    /// Time without a heartbeat after which the chunks of a worker are returned, s. The same for all
    /// workers.
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    lease_s: u64,
    /// Longest time for one chunk, s.
    #[arg(long, value_name = "S", default_value_t = 3600, value_parser = clap::value_parser!(u64).range(1..=604_800))]
    limit_s: u64,
    /// Program that makes chunks [env: PALPATE_PROGRAM].
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Folder in which chunks are made [default: the system's temporary folder].
    #[arg(long, value_name = "DIR")]
    scratch: Option<PathBuf>,
    /// End when no chunk that this machine may make waits or is being made, by others either.
    #[arg(long)]
    until_idle: bool,
}

#[derive(Debug, Args)]
struct StatusOptions {
    /// Folder of an order, its id, or the first 8 digits or more [default: all orders].
    order: Option<String>,
    /// Wait until no chunk of the order waits or is being made.
    #[arg(long, requires = "order")]
    wait: bool,
    /// Time without a heartbeat after which a worker is shown as lost, s.
    #[arg(long, value_name = "S", default_value_t = 60)]
    lease_s: u64,
}

#[derive(Debug, Args)]
struct FetchOptions {
    /// Folder of the order, its id, or the first 8 digits or more.
    order: String,
    /// Folder for its results; made if needed.
    folder: PathBuf,
    /// Remove damaged results from the store, so that `submit` has them made again.
    #[arg(long)]
    discard_damaged: bool,
}

/// Most threads that `palpate cluster make` takes.
const THREADS_MAX: usize = 256;
/// Interval at which `status --wait` asks.
const WAIT_POLL: Duration = Duration::from_secs(2);

impl Options {
    /// Runs the command.
    ///
    /// # Errors
    /// `WorkerError` of the command.
    pub async fn run(self) -> WorkerResult<ExitCode> {
        let queue = || address::queue().map(|options| Queue::new(options, CONNECTIONS));
        let store = || address::store().and_then(Store::open);
        let json = self.json;
        match self.command {
            Command::Setup => {
                setup::setup(&queue()?).await?;
                next(
                    json,
                    "CREATE ROLE desk_1 LOGIN PASSWORD '..' IN ROLE palpate_worker;   (in psql, for each machine)",
                );
            }
            Command::Submit(of) => {
                let priority = match of.priority {
                    Priority::High => -100,
                    Priority::Normal => 0,
                    Priority::Low => 100,
                };
                let needs = Needs { gpu: of.gpu, memory_mib: of.memory_mib };
                let (queue, store) = (queue()?, store()?);
                let done = submit::submit(&queue, &store, &of.folder, priority, of.attempts, needs)
                    .await?;
                let submit::Submitted { order, chunks, done: ready, present, added, again } = &done;
                let text = format!(
                    "order {order}: {chunks} chunks: {added} submitted ({again} had failed), {present} in the queue, {ready} done"
                );
                print(json, &done, &text)?;
                next(json, &format!("palpate worker status {} --wait", of.folder.display()));
            }
            Command::Work(of) => {
                let options = address::queue()?;
                let meminfo = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
                let cores = std::thread::available_parallelism().map_or(1, usize::from);
                let share = (cores / usize::from(of.at_once)).clamp(1, THREADS_MAX);
                let memory = of.memory_mib.unwrap_or_else(|| memory_mib(&meminfo));
                let work = Work {
                    at_once: of.at_once.into(),
                    threads: of.threads.map_or(share, usize::from),
                    has: Needs { gpu: of.gpu, memory_mib: memory },
                    lease: Duration::from_secs(of.lease_s),
                    limit: Duration::from_secs(of.limit_s),
                    program: child::program(of.program),
                    scratch: of.scratch.unwrap_or_else(std::env::temp_dir),
                    until_idle: of.until_idle,
                };
                let queue = Queue::new(options, CONNECTIONS + u32::from(of.at_once));
                work::work(queue, store()?, work).await?;
            }
            Command::Status(of) => {
                let (queue, store) = (queue()?, store()?);
                let order = match &of.order {
                    Some(start) => Some(resolve(&store, start).await?),
                    None => None,
                };
                let lease = Duration::from_secs(of.lease_s);
                let mut found = status::status(&queue, &store, order.as_deref(), lease).await?;
                while of.wait && !found.orders.iter().all(status::OrderStatus::is_over) {
                    tokio::time::sleep(WAIT_POLL).await;
                    // A queue that restarts is waited for, as by workers.
                    match status::status(&queue, &store, order.as_deref(), lease).await {
                        Err(WorkerError::Queue(_) | WorkerError::Store(_)) => (),
                        other => found = other?,
                    }
                }
                print(json, &found, found.to_string().trim_end())?;
                let is_complete = found.orders.iter().all(|order| order.done >= order.chunks);
                if let Some(order) = of.order.filter(|_| is_complete) {
                    next(json, &format!("palpate worker fetch {order} FOLDER"));
                }
                if of.wait && !is_complete {
                    return Ok(ExitCode::FAILURE);
                }
            }
            Command::Cancel { order } => {
                let (queue, store) = (queue()?, store()?);
                let order = resolve(&store, &order).await?;
                let removed = queue.cancel(&order).await?;
                let text =
                    format!("order {order}: {removed} chunks removed from the queue; results stay");
                print(json, &serde_json::json!({ "order": order, "removed": removed }), &text)?;
            }
            Command::Fetch(of) => {
                let store = store()?;
                let order = resolve(&store, &of.order).await?;
                let damaged = match of.discard_damaged {
                    true => fetch::Damaged::Discarded,
                    false => fetch::Damaged::Kept,
                };
                let done = fetch::fetch(&store, &order, &of.folder, damaged).await?;
                let fetch::Fetched { chunks, fetched, present, missing, bytes, damaged } = &done;
                let text = format!(
                    "order {order}: {fetched} of {chunks} results fetched ({bytes} bytes), {present} were here, \
                     {missing} not done, {} damaged",
                    damaged.len()
                );
                print(json, &done, &text)?;
                let folder = of.folder.display();
                if !damaged.is_empty() {
                    let again = if of.discard_damaged {
                        "removed from the store"
                    } else {
                        "see --discard-damaged"
                    };
                    let list = damaged.join("\n  ");
                    return Err(WorkerError::Failed(format!(
                        "damaged results, {again}:\n  {list}"
                    )));
                }
                let command = if *missing == 0 { "gather" } else { "status" };
                let out = if *missing == 0 { " --out DIR" } else { "" };
                next(json, &format!("palpate cluster {command} {folder}{out}"));
            }
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// The order of a folder, or the one whose id begins with these digits.
async fn resolve(store: &Store, start: &str) -> WorkerResult<String> {
    const DIGITS_MIN: usize = 8;
    if is_hash(start) {
        return Ok(start.to_owned());
    }
    let invalid = |what: &str| WorkerError::Invalid(format!("order {start}: {what}"));
    if Path::new(start).is_dir() {
        let found = Store::order_folder(Path::new(start))?.order("").await?;
        let (order, _) = found.ok_or_else(|| invalid("the folder has no order.json"))?;
        return Ok(order.id);
    }
    if start.len() < DIGITS_MIN {
        return Err(invalid("must have 8 digits or more"));
    }
    let mut found = store.orders().await?;
    found.retain(|id| id.starts_with(start));
    match found.as_slice() {
        [id] => Ok(id.clone()),
        [] => Err(invalid("not in the store")),
        _ => Err(invalid("several orders begin with it")),
    }
}

/// Prints a result, as JSON or as text.
fn print(json: bool, value: &impl Serialize, text: &str) -> WorkerResult<()> {
    let line = if json {
        serde_json::to_string(value).map_err(|error| WorkerError::Failed(error.to_string()))?
    } else {
        text.to_owned()
    };
    writeln!(stdout(), "{line}").map_err(WorkerError::file("standard output"))
}

/// Prints a command to type next, on standard error.
fn next(json: bool, command: &str) {
    if !json {
        drop(writeln!(stderr(), "next: {command}"));
    }
}
