//! Bulk work on other machines: what workers and their queue do, and submitting or cancelling an order; `gather`
//! brings its results here.
//! Uses: `palpate-worker` as a process, which alone knows queue and store. Never: an address or a key, a wait for
//! a queue that does not answer.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path as FilePath, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::process::Command;
use tokio::time::timeout;
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::gather::GatherOut;
use super::problem::{ApiError, Path, ProblemBody};
use crate::program::{Known, Program};

/// The program that makes chunks of bulk work over PostgreSQL.
pub static WORKER: Known = Known {
    name: "palpate-worker",
    variable: "PALPATE_WORKER",
    folder: "worker",
    workspace: "worker",
    about: "the worker",
};
/// Folder of the data folder in which the folders of work orders are.
const ORDERS: &str = "cluster";
/// Variables that name a queue, and those that name a store.
const ADDRESSES: [[&str; 2]; 2] =
    [["PALPATE_QUEUE", "PALPATE_QUEUE_FILE"], ["PALPATE_STORE", "PALPATE_STORE_FILE"]];
/// Longest wait for the state of the queue.
const STATE_WITHIN: Duration = Duration::from_secs(30);
/// Longest wait for a submission: a large order takes seconds.
const CHANGE_WITHIN: Duration = Duration::from_secs(120);
/// Digits of the id of an order: at least, and all of them.
const ID_DIGITS: (usize, usize) = (8, 64);

/// What workers and their queue do.
#[derive(Debug, Clone, Default, Serialize, Deserialize, ToSchema)]
pub struct WorkersOut {
    /// Whether the service was started with the addresses of a queue and a store.
    #[serde(default)]
    pub configured: bool,
    /// The workers, the last heard first.
    pub workers: Vec<WorkerOut>,
    /// The orders of the store.
    pub orders: Vec<WorkOrderOut>,
    /// The last order that was gathered since the start of the service; null if there is none.
    #[serde(default)]
    pub gather: Option<GatherOut>,
}

/// A worker.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct WorkerOut {
    /// Host, process and a random part.
    pub worker: String,
    /// Time since its last heartbeat, s.
    pub heard_s: i64,
    /// Whether its lease has ended.
    pub lost: bool,
}

/// A work order.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct WorkOrderOut {
    /// Id of the order.
    pub order: String,
    /// Its folder in `cluster/` of the data folder; null if it was ordered elsewhere.
    #[serde(default)]
    pub folder: Option<String>,
    /// Number of its chunks.
    pub chunks: u64,
    /// Number of chunks whose result is in the store.
    pub done: u64,
    /// Number of chunks that wait for a worker.
    pub waiting: u64,
    /// Number of chunks that a worker makes.
    pub running: u64,
    /// Number of waiting chunks that a machine could not make.
    pub again: u64,
    /// Error of one of these; null if there is none.
    pub again_error: Option<String>,
    /// Number of chunks that are set aside.
    pub failed: u64,
    /// Number of chunks that are neither done nor in the queue.
    pub missing: u64,
    /// Chunks that were done in the last 10 minutes, per minute; null if there were none.
    pub per_minute: Option<f64>,
    /// Predicted time to the end, s; null without a rate.
    pub to_go_s: Option<u64>,
    /// The first chunks that are set aside.
    pub errors: Vec<SetAsideOut>,
}

/// A chunk that is set aside.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct SetAsideOut {
    /// Its place in the order, from 0.
    pub index: u64,
    /// Number of attempts.
    pub attempts: u32,
    /// The last error.
    pub error: String,
}

/// A submitted order.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct SubmittedOut {
    /// Id of the order.
    pub order: String,
    /// Number of its chunks.
    pub chunks: u64,
    /// Number of chunks that were done.
    pub done: u64,
    /// Number of chunks that the queue had.
    pub present: u64,
    /// Number of chunks that were added.
    pub added: u64,
    /// Number of chunks among these that had been set aside.
    pub again: u64,
}

/// A cancelled order.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct CancelledOut {
    /// Id of the order.
    pub order: String,
    /// Number of chunks that were removed from the queue.
    pub removed: u64,
}

/// Returns what workers and their queue do: orders, workers, rates, failures.
///
/// A service that was started without the addresses of a queue and a store returns `configured: false`.
#[utoipa::path(get, operation_id = "workers", path = "/api/v1/workers", tag = "simulation",
    responses((status = 200, body = WorkersOut),
        (status = 503, body = ProblemBody,
            description = "the worker is missing, or its queue or store does not answer")))]
pub async fn all(State(app): State<App>) -> Result<Json<WorkersOut>, ApiError> {
    let read = async { Ok::<_, Infallible>(state(&app.facts.data).await.map(Arc::new)) };
    // An error is kept, too: a queue that does not answer is not asked by each reader.
    let Ok(state) = app.facts.memory.workers.get((), read).await;
    let gather = app.facts.memory.gather.lock().clone();
    let with_gather = |state: Arc<WorkersOut>| WorkersOut { gather, ..WorkersOut::clone(&state) };
    state.map(with_gather).map(Json).map_err(unavailable)
}

/// Submits the order of a folder, `cluster/FOLDER` of the data folder, to the queue.
///
/// `palpate cluster sbatch` writes such a folder. A repeated submission adds what the queue lacks.
#[utoipa::path(post, operation_id = "submit_order", path = "/api/v1/workers/folders/{folder}",
    tag = "simulation", params(("folder" = String, Path, description = "name of the folder")),
    responses((status = 200, body = SubmittedOut),
        (status = 404, body = ProblemBody, description = "no folder of this name has an order"),
        (status = 409, body = ProblemBody, description = "the service knows no queue, or the worker refuses"),
        (status = 503, body = ProblemBody,
            description = "the worker is missing, or its queue or store does not answer")))]
pub async fn submit(
    State(app): State<App>,
    act: Act,
    Path(folder): Path<String>,
) -> Result<Json<SubmittedOut>, ApiError> {
    act.about(&folder);
    let path = order_path(&app, &folder)?;
    change([OsStr::new("submit"), path.as_os_str()]).await
}

/// Removes the chunks of an order from the queue. Results stay.
///
/// A chunk that is being made is completed.
#[utoipa::path(delete, operation_id = "cancel_order", path = "/api/v1/workers/orders/{order}",
    tag = "simulation",
    params(("order" = String, Path, description = "id of the order, or its first 8 digits or more")),
    responses((status = 200, body = CancelledOut),
        (status = 404, body = ProblemBody, description = "this is no id of an order"),
        (status = 409, body = ProblemBody, description = "the service knows no queue, or the worker refuses"),
        (status = 503, body = ProblemBody,
            description = "the worker is missing, or its queue or store does not answer")))]
pub async fn cancel(act: Act, Path(order): Path<String>) -> Result<Json<CancelledOut>, ApiError> {
    act.about(&order);
    if !is_id(&order) {
        return Err(ApiError::not_found(format!("order {order}: must be an id")));
    }
    change([OsStr::new("cancel"), OsStr::new(&order)]).await
}

/// Path of a folder with an order.
///
/// # Errors
/// 404 if no folder of this name has an order, 409 if the service knows no queue.
pub fn order_path(app: &App, folder: &str) -> Result<PathBuf, ApiError> {
    let missing = || ApiError::not_found(format!("{ORDERS}/{folder}: no folder with an order"));
    let path = order_folder(&app.facts.data, folder).ok_or_else(missing)?;
    check_configured()?;
    Ok(path)
}

fn check_configured() -> Result<(), ApiError> {
    if is_configured() {
        return Ok(());
    }
    let names = ADDRESSES.map(|names| names[1]).join(" and ");
    let words = format!("the service knows no queue: start it with {names}");
    Err(ApiError::new(StatusCode::CONFLICT, words))
}

/// Has the worker change the queue.
async fn change<T: DeserializeOwned>(words: [&OsStr; 2]) -> Result<Json<T>, ApiError> {
    check_configured()?;
    let text = ask(&words, CHANGE_WITHIN).await.map_err(|error| match error {
        Unanswered::Invalid(why) => ApiError::new(StatusCode::CONFLICT, why),
        Unanswered::Failed(why) => unavailable(why),
    })?;
    serde_json::from_slice(&text).map(Json).map_err(|error| unavailable(error.to_string()))
}

/// The error that something outside of this service is missing (503).
pub fn unavailable(why: String) -> ApiError {
    ApiError::new(StatusCode::SERVICE_UNAVAILABLE, why)
}

/// Whether the service was started with the addresses of a queue and a store.
fn is_configured() -> bool {
    let is_set = |name: &&str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    ADDRESSES.iter().all(|names| names.iter().any(is_set))
}

/// State of workers and queue, as the worker states it, with the folders of this service.
async fn state(data: &FilePath) -> Result<WorkersOut, String> {
    if !is_configured() {
        return Ok(WorkersOut::default());
    }
    let text = ask(&[OsStr::new("status")], STATE_WITHIN).await.map_err(|error| match error {
        Unanswered::Invalid(why) | Unanswered::Failed(why) => why,
    })?;
    let mut found: WorkersOut = serde_json::from_slice(&text)
        .map_err(|error| format!("{}: status: {error}", WORKER.name))?;
    found.configured = true;
    let folder = data.join(ORDERS);
    let mut folders =
        tokio::task::spawn_blocking(move || folders(&folder)).await.unwrap_or_default();
    for order in &mut found.orders {
        order.folder = folders.remove(&order.order);
    }
    Ok(found)
}

/// Names of the folders with an order, by the id of the order.
fn folders(orders: &FilePath) -> BTreeMap<String, String> {
    #[derive(Deserialize)]
    struct Order {
        id: String,
    }
    let named = |entry: fs::DirEntry| {
        let text = fs::read(entry.path().join("order.json")).ok()?;
        let order: Order = serde_json::from_slice(&text).ok()?;
        Some((order.id, entry.file_name().into_string().ok()?))
    };
    fs::read_dir(orders).into_iter().flatten().flatten().filter_map(named).collect()
}

/// Path of a folder with an order; `None` if the name is none of a folder, or has no order.
fn order_folder(data: &FilePath, name: &str) -> Option<PathBuf> {
    const NAME_MAX_CHARS: usize = 100;
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let is_name = name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.len() <= NAME_MAX_CHARS
        && name.chars().all(is_of_name);
    let path = data.join(ORDERS).join(name);
    (is_name && path.join("order.json").is_file()).then_some(path)
}

/// Whether a text is the id of an order, or its beginning.
fn is_id(text: &str) -> bool {
    let (least, most) = ID_DIGITS;
    (least..=most).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Why the worker has not answered.
#[derive(Debug, PartialEq, Eq)]
enum Unanswered {
    /// An input is invalid.
    Invalid(String),
    /// It is missing, or its queue or store does not answer.
    Failed(String),
}

/// Exit code of the worker for an invalid input.
const INVALID_INPUT: i32 = 2;

/// Path of the worker.
///
/// # Errors
/// Why it is missing; it is not built here, which takes minutes.
pub fn program() -> Result<PathBuf, String> {
    match WORKER.find() {
        Program::Ready(program) => Ok(program),
        Program::Source(_) => {
            Err("the worker is not built yet: run `palpate worker status` once".into())
        }
        Program::Missing => Err(WORKER.missing().to_string()),
    }
}

/// What the worker prints as JSON.
async fn ask(words: &[&OsStr], within: Duration) -> Result<Vec<u8>, Unanswered> {
    let mut command = Command::new(program().map_err(Unanswered::Failed)?);
    command.args(words).arg("--json").stdin(Stdio::null());
    // Ctrl-C in a terminal is for the service.
    command.process_group(0).kill_on_drop(true);
    answer(command, within).await
}

async fn answer(mut command: Command, within: Duration) -> Result<Vec<u8>, Unanswered> {
    let done = match timeout(within, command.output()).await {
        Ok(done) => done.map_err(|error| Unanswered::Failed(error.to_string()))?,
        Err(_) => {
            let words = format!("{}: no answer within {} s", WORKER.name, within.as_secs());
            return Err(Unanswered::Failed(words));
        }
    };
    if done.status.success() {
        return Ok(done.stdout);
    }
    let said = String::from_utf8_lossy(&done.stderr);
    let error = said.lines().rev().find_map(|line| line.strip_prefix("error: "));
    let words = error.map_or_else(|| format!("{}: {}", WORKER.name, done.status), str::to_owned);
    Err(if done.status.code() == Some(INVALID_INPUT) {
        Unanswered::Invalid(words)
    } else {
        Unanswered::Failed(words)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_folder_with_an_order_has_a_path() {
        let data = std::env::temp_dir().join(format!("palpate-orders-{}", std::process::id()));
        let folder = data.join(ORDERS).join("sim-1");
        fs::create_dir_all(&folder).unwrap();
        assert_eq!(order_folder(&data, "sim-1"), None);
        fs::write(folder.join("order.json"), r#"{"id": "ab", "kind": "sim-random"}"#).unwrap();
        assert_eq!(order_folder(&data, "sim-1"), Some(folder));
        for other in ["", ".", "..", "../cluster/sim-1", "-sim", "sim 1", "none", &"s".repeat(101)]
        {
            assert_eq!(order_folder(&data, other), None, "{other}");
        }
        let found = folders(&data.join(ORDERS));
        assert_eq!(found.get("ab").map(String::as_str), Some("sim-1"));
        fs::remove_dir_all(data).unwrap();
    }

    #[test]
    fn an_id_has_8_to_64_hexadecimal_digits() {
        assert!(is_id("0123abcd") && is_id(&"f".repeat(64)));
        assert!(
            !is_id("0123abc")
                && !is_id(&"f".repeat(65))
                && !is_id("../../etc")
                && !is_id("--json-x")
        );
    }

    #[tokio::test]
    async fn the_answer_of_the_worker_is_its_output_or_its_error() {
        let shell = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]).kill_on_drop(true);
            command
        };
        let ask = |script| answer(shell(script), Duration::from_secs(1));
        assert_eq!(ask("echo '{}'").await, Ok(b"{}\n".to_vec()));
        let failed = ask("echo 'INFO a'; echo 'error: queue: db: refused' >&2; exit 1").await;
        assert_eq!(failed, Err(Unanswered::Failed("queue: db: refused".into())));
        let invalid = ask("echo 'error: order: not in the store' >&2; exit 2").await;
        assert_eq!(invalid, Err(Unanswered::Invalid("order: not in the store".into())));
        let late = ask("sleep 20").await;
        assert_eq!(late, Err(Unanswered::Failed("palpate-worker: no answer within 1 s".into())));
    }

    #[test]
    fn the_state_is_read_as_the_worker_prints_it() {
        let text = r#"{"workers": [{"worker": "desk/1/a", "heard_s": 3, "lost": false, "about": {"pid": 1}}],
            "orders": [{"chunks": 9, "done": 2, "order": "ab", "waiting": 5, "running": 1, "again": 1,
              "again_error": "desk: no kernel", "failed": 1, "missing": 0, "per_minute": 1.5, "to_go_s": 240,
              "errors": [{"key": "cd", "index": 4, "attempts": 8, "error": "e"}]}]}"#;
        let found: WorkersOut = serde_json::from_str(text).unwrap();
        assert!(!found.configured);
        assert_eq!((found.workers[0].heard_s, found.orders[0].to_go_s), (3, Some(240)));
        assert_eq!(found.orders[0].errors[0].attempts, 8);
    }
}
