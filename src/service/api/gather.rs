//! Gathers the results of an order: fetched from the store into its folder, and written as one process would have.
//! Uses: `palpate-worker` and this program as processes, at low priority. Never: space that is kept free for runs,
//! two orders at once, a result that was not compared with its sha256.

use std::fs::{self, File};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::Path as FilePath;
use std::process::{Command, Stdio};
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::problem::{ApiError, Path, ProblemBody};
use super::workers::{order_path, program, unavailable};
use crate::dataset::background::background;
use crate::dataset::space::KEPT_FREE_BYTES;

/// Interval of checking the processes and the free space.
const GATHER_POLL: Duration = Duration::from_secs(1);
/// Output of the processes, in the folder of the order.
const GATHER_LOG: &str = "gather.log";
/// Folder of the data folder from which trainings read Sim-Random; also the kind of its orders.
const SIM_RANDOM: &str = "sim-random";

/// The last order that was gathered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct GatherOut {
    /// Name of its folder in `cluster/` of the data folder; its rows are in `sim-random/`, under the same name.
    pub folder: String,
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
    /// All rows are in `sim-random/`.
    Done,
    /// It ended with an error; what was fetched stays, and is not fetched again.
    Failed,
}

/// Gathers the results of an order into `sim-random/FOLDER` of the data folder.
///
/// `GET /api/v1/workers` shows the progress as `gather`. A repeated request continues. If less than 2 GiB of the disk
/// are free it ends, so that runs can store their trials.
#[utoipa::path(post, operation_id = "gather_order",
    path = "/api/v1/workers/folders/{folder}/gather", tag = "simulation",
    params(("folder" = String, Path, description = "name of the folder")),
    responses((status = 202, body = GatherOut),
        (status = 404, body = ProblemBody, description = "no folder of this name has an order"),
        (status = 409, body = ProblemBody,
            description = "the service knows no queue, gathers another order, or the order is not of Sim-Random"),
        (status = 503, body = ProblemBody, description = "the worker is missing"),
        (status = 507, body = ProblemBody, description = "the disk has no room")))]
pub async fn gather(
    State(app): State<App>,
    act: Act,
    Path(folder): Path<String>,
) -> Result<(StatusCode, Json<GatherOut>), ApiError> {
    act.about(&folder);
    let order = order_path(&app, &folder)?;
    let path = order.clone();
    let kind = background(move || kind_of(&path)).await?;
    if kind.as_deref() != Some(SIM_RANDOM) {
        let kind = kind.unwrap_or_else(|| "unknown".into());
        let words =
            format!("the order has the kind {kind}: gather it with `palpate cluster gather`");
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let worker = program().map_err(unavailable)?;
    app.datasets.check_upload(0).await?;
    let own = std::env::current_exe().map_err(|error| unavailable(error.to_string()))?;
    let mut fetch = Command::new(worker);
    fetch.arg("fetch").args([&order, &order]);
    let mut write = Command::new(own);
    write.args(["cluster", "gather"]).arg(&order).arg("--out");
    write.arg(app.facts.data.join(SIM_RANDOM).join(&folder));
    let started = GatherOut { folder, state: GatherState::Running, error: None };
    {
        let mut last = app.facts.memory.gather.lock();
        if let Some(other) = last.as_ref().filter(|last| last.state == GatherState::Running) {
            let words = format!("{} is being gathered: wait for its end", other.folder);
            return Err(ApiError::new(StatusCode::CONFLICT, words));
        }
        *last = Some(started.clone());
    }
    let mut ended = started.clone();
    tokio::spawn(async move {
        let (store, runtime) = (app.store.clone(), Handle::current());
        let work = move || {
            let log = order.join(GATHER_LOG);
            // Unknown free space is no reason to end: runs check it, too.
            let is_full =
                || runtime.block_on(store.free_bytes()).is_ok_and(|free| free < KEPT_FREE_BYTES);
            [fetch, write].into_iter().try_for_each(|command| run(command, &log, &is_full))
        };
        let done = background(work).await.unwrap_or_else(|error| Err(error.to_string()));
        match done {
            Ok(()) => ended.state = GatherState::Done,
            Err(why) => {
                tracing::warn!(folder = ended.folder, "an order was not gathered: {why}");
                ended.state = GatherState::Failed;
                ended.error = Some(why);
            }
        }
        *app.facts.memory.gather.lock() = Some(ended);
    });
    Ok((StatusCode::ACCEPTED, Json(started)))
}

/// Kind of an order's chunks; `None` if its file cannot be read.
fn kind_of(order: &FilePath) -> Option<String> {
    #[derive(Deserialize)]
    struct OrderKind {
        kind: String,
    }
    let text = fs::read(order.join("order.json")).ok()?;
    serde_json::from_slice(&text).map(|OrderKind { kind }| kind).ok()
}

/// Runs a process to its end, or until the disk is full.
fn run(mut command: Command, log: &FilePath, is_full: &dyn Fn() -> bool) -> Result<(), String> {
    let failed = |error: io::Error| format!("{}: {error}", log.display());
    let output = File::create(log).map_err(failed)?;
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(output);
    // Ctrl-C in a terminal is for the service.
    let mut child = command
        .process_group(0)
        .spawn()
        .map_err(|error| format!("{}: {error}", command.get_program().display()))?;
    loop {
        if let Some(status) = child.try_wait().map_err(failed)? {
            if status.success() {
                return Ok(());
            }
            let said = fs::read_to_string(log).unwrap_or_default();
            let error = said.lines().rev().find_map(|line| line.strip_prefix("error: "));
            return Err(error.map_or_else(|| format!("{}: {status}", log.display()), str::to_owned));
        }
        if is_full() {
            // It may have ended by itself.
            let _ = child.kill();
            let _ = child.wait();
            let kept = KEPT_FREE_BYTES >> 30;
            return Err(format!(
                "less than {kept} GiB of the disk are free, which runs need: free some"
            ));
        }
        std::thread::sleep(GATHER_POLL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kind_of_an_order_is_read_from_its_file() {
        let folder = std::env::temp_dir().join(format!("palpate-kind-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        assert_eq!(kind_of(&folder), None);
        fs::write(folder.join("order.json"), r#"{"id": "ab", "kind": "twins"}"#).unwrap();
        assert_eq!(kind_of(&folder).as_deref(), Some("twins"));
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_process_ends_with_its_error_or_with_the_space_on_the_disk() {
        let log = std::env::temp_dir().join(format!("palpate-gather-{}", std::process::id()));
        let shell = |script: &str, is_full: bool| {
            let mut command = Command::new("sh");
            command.args(["-c", script]);
            run(command, &log, &move || is_full)
        };
        assert_eq!(shell("exit 0", false), Ok(()));
        let failed =
            shell("echo progress >&2; echo 'error: chunk 3 is missing' >&2; exit 1", false);
        assert_eq!(failed, Err("chunk 3 is missing".into()));
        assert!(shell("exit 7", false).unwrap_err().contains("exit status: 7"));
        assert!(shell("exec sleep 60", true).unwrap_err().contains("2 GiB"));
        fs::remove_file(log).unwrap();
    }
}
