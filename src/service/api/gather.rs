//! Gathers the results of an order: fetched from the store into its folder, and written as one process would have.
//! Uses: `palpate-worker` and this program as processes, at low priority. Never: space that is kept free for runs,
//! two orders at once, a result that was not compared with its sha256, a process that continues after the service.

use std::fs::{self, File};
use std::io;
use std::path::{Path as FilePath, PathBuf};
use std::pin::{Pin, pin};
use std::process::Stdio;
use std::time::Duration;

use axum::Json;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use tokio::process::{Child, Command};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::time::{interval, sleep, timeout};
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::orders::{kind_of, order_path, program, unavailable};
use super::problem::{ApiError, ApiResult, Path};
use crate::dataset::background::background;
use crate::dataset::space::KEPT_FREE_BYTES;
use crate::program::withhold_bulk;
use crate::store::Store;

/// Interval of checking the free space.
const GATHER_POLL: Duration = Duration::from_secs(1);
/// Interval of checking whether the work has ended with the service, and longest wait for that.
const GATHER_END: (Duration, Duration) = (Duration::from_millis(20), Duration::from_secs(5));
/// Output of the processes, in the folder of the order.
const GATHER_LOG: &str = "gather.log";
/// Kind of an order whose results belong into the database, and not into a folder.
const OF_A_RUN: &str = "twins";
/// Place of such results, for people.
const DATABASE: &str = "the database";

/// The last order that was gathered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct GatherOut {
    /// Name of its folder in `cluster/` of the data folder.
    pub folder: String,
    /// Folder of the data folder for its results: the kind of the order, and the same name; `the database` for twins.
    pub into: String,
    /// State of the work.
    pub state: GatherState,
    /// Why it failed; null otherwise.
    pub error: Option<String>,
}

/// State of gathering.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum GatherState {
    /// Results are fetched or written.
    Running,
    /// All results are in the folder.
    Done,
    /// It ended with an error; what was fetched stays, and is not fetched again.
    Failed,
}

/// Why an order is not gathered.
#[derive(Debug, thiserror::Error)]
enum GatherError {
    #[error(
        "{free} bytes of the disk are free, {} are reserved for runs: free some, then gather again",
        KEPT_FREE_BYTES
    )]
    DiskFull { free: u64 },
    /// Another order is gathered. Holds its folder.
    #[error("{0} is being gathered: wait for its end")]
    Busy(String),
    /// A process could not be started, or its output not be written.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: io::Error },
    /// A process ended with an error. Holds it.
    #[error("{0}")]
    Process(String),
    #[error("the service ended: gather again; what was fetched stays")]
    ServiceEnded,
}

impl From<GatherError> for ApiError {
    fn from(error: GatherError) -> Self {
        let status = match error {
            GatherError::DiskFull { .. } => StatusCode::INSUFFICIENT_STORAGE,
            GatherError::Busy(_) => StatusCode::CONFLICT,
            GatherError::File { .. } | GatherError::Process(_) | GatherError::ServiceEnded => {
                StatusCode::SERVICE_UNAVAILABLE
            }
        };
        Self::new(status, error.to_string())
    }
}

/// Gathers the results of an order into `KIND/FOLDER` of the data folder.
///
/// Trainings read Sim-Random from there, `sim-random/FOLDER`. Twins of a run are stored in the database.
/// `GET /api/v1/workers` shows the progress as `gather`. A repeated request continues. If less than 2 GiB of the disk
/// are free it ends, so that runs can store their trials; it also ends with the service.
#[utoipa::path(post, operation_id = "gather_order",
    path = "/api/v1/workers/folders/{folder}/gather", tag = "simulation",
    responses((status = 202, body = GatherOut),
        (status = 409,
            description = "the service knows no queue, gathers another order, or the order cannot be read"),
        (status = 503, description = "the worker is missing"),
        (status = 507, description = "less than 2 GiB of the disk are free")))]
pub async fn gather(
    app: App,
    act: Act,
    Path(folder): Path<String>,
) -> ApiResult<(StatusCode, Json<GatherOut>)> {
    act.about(&folder);
    let order = order_path(&app, &folder)?;
    let kind = kind_of(&order)?;
    let worker = program().map_err(unavailable)?;
    let free = app.store.free_bytes().await?;
    if free < KEPT_FREE_BYTES {
        return Err(GatherError::DiskFull { free }.into());
    }
    let own = std::env::current_exe().map_err(|error| unavailable(error.to_string()))?;
    let mut fetch = Command::new(worker);
    fetch.arg("fetch").args([&order, &order]);
    let mut write = Command::new(own);
    write.args(["cluster", "gather"]).arg(&order);
    // Twins and the scores of readings need the service of this folder, which may require a key.
    withhold_bulk(write.as_std_mut());
    write.arg("--data").arg(&app.facts.data).env_remove("PALPATE_URL");
    let into = if kind == OF_A_RUN {
        DATABASE.to_owned()
    } else {
        let into = format!("{kind}/{folder}");
        write.arg("--out").arg(app.facts.data.join(&into));
        into
    };
    let started = GatherOut { folder, into, state: GatherState::Running, error: None };
    {
        let mut last = app.facts.memory.gather.lock();
        if let Some(other) = last.as_ref().filter(|last| last.state == GatherState::Running) {
            return Err(GatherError::Busy(other.folder.clone()).into());
        }
        *last = Some(started.clone());
    }
    let mut ended = started.clone();
    tokio::spawn(async move {
        let log = order.join(GATHER_LOG);
        let early = must_end(&app.store, app.facts.ending.clone());
        match gathered([fetch, write], &log, early).await {
            Ok(()) => ended.state = GatherState::Done,
            Err(why) => {
                tracing::warn!(folder = ended.folder, "an order was not gathered: {why}");
                ended.state = GatherState::Failed;
                ended.error = Some(why.to_string());
            }
        }
        *app.facts.memory.gather.lock() = Some(ended);
    });
    Ok((StatusCode::ACCEPTED, Json(started)))
}

/// Waits until nothing is gathered. The end of the service must have begun: it ends the work.
pub async fn ended(app: &App) {
    let (poll, longest) = GATHER_END;
    let is_running = || {
        let last = app.facts.memory.gather.lock();
        last.as_ref().is_some_and(|last| last.state == GatherState::Running)
    };
    let ended = async {
        while is_running() {
            sleep(poll).await;
        }
    };
    if timeout(longest, ended).await.is_err() {
        tracing::error!("the gathering of an order did not end in time");
    }
}

/// Waits until the work must end: space that is reserved for runs is not free, or the service ends.
async fn must_end(store: &Store, mut ending: watch::Receiver<bool>) -> GatherError {
    let mut poll = interval(GATHER_POLL);
    loop {
        tokio::select! {
            _ = ending.wait_for(|ends| *ends) => return GatherError::ServiceEnded,
            _ = poll.tick() => {}
        }
        // Unknown free space is no reason to end: runs check it, too.
        if let Ok(free) = store.free_bytes().await
            && free < KEPT_FREE_BYTES
        {
            return GatherError::DiskFull { free };
        }
    }
}

/// Runs processes one after the other, each to its end, or all until `early`.
async fn gathered(
    commands: [Command; 2],
    log: &FilePath,
    early: impl Future<Output = GatherError>,
) -> Result<(), GatherError> {
    let mut early = pin!(early);
    for command in commands {
        run(command, log, early.as_mut()).await?;
    }
    Ok(())
}

async fn run(
    command: Command,
    log: &FilePath,
    early: Pin<&mut impl Future<Output = GatherError>>,
) -> Result<(), GatherError> {
    let mut child = start(command, log).await?;
    let status = tokio::select! {
        status = child.wait() => status,
        why = early => {
            // It may have ended by itself.
            let _ = child.kill().await;
            return Err(why);
        }
    };
    let status = status.map_err(|source| GatherError::File { path: log.to_owned(), source })?;
    if status.success() {
        return Ok(());
    }
    let said = fs::read_to_string(log).unwrap_or_default();
    let error = said.lines().rev().find_map(|line| line.strip_prefix("error: "));
    let words = || format!("{}: {status}", log.display());
    Err(GatherError::Process(error.map_or_else(words, str::to_owned)))
}

/// Starts a process at low priority.
async fn start(mut command: Command, log: &FilePath) -> Result<Child, GatherError> {
    let output =
        File::create(log).map_err(|source| GatherError::File { path: log.to_owned(), source })?;
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(output);
    // Ctrl-C in a terminal is for the service, which then ends it.
    command.process_group(0).kill_on_drop(true);
    let runtime = Handle::current();
    let started = background(move || {
        let _inside = runtime.enter();
        let path = PathBuf::from(command.as_std().get_program());
        command.spawn().map_err(|source| GatherError::File { path, source })
    });
    started.await.map_err(|error| GatherError::Process(error.to_string()))?
}

#[cfg(test)]
mod tests {
    use std::future::{pending, ready};

    use super::*;
    use crate::clock::Clock;

    #[tokio::test]
    async fn processes_end_with_the_first_error_with_the_disk_and_with_the_service() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        let shell = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]);
            command
        };
        let both = |scripts: [&str; 2]| gathered(scripts.map(shell), &log, pending());
        both(["exit 0", "exit 0"]).await.unwrap();
        let failed =
            both(["echo progress >&2; echo 'error: chunk 3 is missing' >&2; exit 1", "exit 0"]);
        assert_eq!(failed.await.unwrap_err().to_string(), "chunk 3 is missing");
        let second = both(["exit 0", "exit 7"]).await.unwrap_err().to_string();
        assert!(second.contains("exit status: 7"), "{second}");
        let missing = gathered([Command::new("/none/worker"), shell("exit 0")], &log, pending());
        assert!(missing.await.unwrap_err().to_string().starts_with("/none/worker: "));
        let full = GatherError::DiskFull { free: 7 };
        for (why, expected) in [(full, "7 bytes"), (GatherError::ServiceEnded, "the service ended")]
        {
            let begun = std::time::Instant::now();
            let ended = gathered(["exec sleep 60", "exit 0"].map(shell), &log, ready(why)).await;
            assert!(ended.unwrap_err().to_string().starts_with(expected));
            assert!(begun.elapsed() < Duration::from_secs(30));
        }
    }

    #[tokio::test]
    async fn the_end_of_the_service_ends_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("palpate.db"), Clock::new(1.0)).await.unwrap();
        let (tell, ending) = watch::channel(false);
        let mut early = pin!(must_end(&store, ending));
        let shortly = Duration::from_millis(100);
        // Unless this disk is full.
        let before = tokio::time::timeout(shortly, early.as_mut()).await;
        assert!(before.is_err(), "{before:?}");
        tell.send_replace(true);
        assert!(matches!(early.await, GatherError::ServiceEnded));
        store.close().await;
    }
}
