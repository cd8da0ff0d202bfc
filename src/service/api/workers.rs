//! Bulk work on other machines: what workers and their queue do, and submitting or cancelling an order; `gather`
//! brings its results here.
//! Uses: `orders`. Never: an address or a key, a wait for a queue that does not answer.

use std::convert::Infallible;
use std::ffi::OsStr;
use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::http::StatusCode;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::gather::GatherOut;
use super::orders::{
    Unanswered, WORKER, ask, check_configured, folders, is_configured, is_id, order_path,
    unavailable,
};
use super::problem::{ApiError, ApiResult, Path};

/// Longest wait for the state of the queue.
const STATE_WITHIN: Duration = Duration::from_secs(30);
/// Longest wait for a submission: a large order takes seconds.
const CHANGE_WITHIN: Duration = Duration::from_secs(120);

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
    /// Names of the folders in `cluster/` of the data folder whose order the store does not have.
    #[serde(default)]
    pub unsubmitted: Vec<String>,
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
    /// What it states of its machine; null if it states nothing.
    #[serde(default)]
    pub about: Option<WorkerMachineOut>,
}

/// What a worker states of its machine.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct WorkerMachineOut {
    /// Number of chunks that it makes at once.
    pub at_once: Option<u64>,
    /// Memory for chunks that need a certain one, MiB.
    pub memory_mib: Option<u64>,
    /// Whether it takes chunks that need a GPU.
    pub gpu: Option<bool>,
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
        (status = 503,
            description = "the worker is missing, or its queue or store does not answer")))]
pub async fn all(app: App) -> ApiResult<Json<WorkersOut>> {
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
    tag = "simulation", responses((status = 200, body = SubmittedOut),
        (status = 409, description = "the service knows no queue, or the worker refuses"),
        (status = 503,
            description = "the worker is missing, or its queue or store does not answer")))]
pub async fn submit(
    app: App,
    act: Act,
    Path(folder): Path<String>,
) -> ApiResult<Json<SubmittedOut>> {
    act.about(&folder);
    let path = order_path(&app, &folder)?;
    change(&app, [OsStr::new("submit"), path.as_os_str()]).await
}

/// Removes the chunks of an order from the queue. Results stay.
///
/// A chunk that is being made is completed.
#[utoipa::path(delete, operation_id = "cancel_order", path = "/api/v1/workers/orders/{order}",
    tag = "simulation",
    params(("order" = String, Path, description = "id of the order, or its first 8 digits or more")),
    responses((status = 200, body = CancelledOut),
        (status = 404, description = "this is no id of an order"),
        (status = 409, description = "the service knows no queue, or the worker refuses"),
        (status = 503,
            description = "the worker is missing, or its queue or store does not answer")))]
pub async fn cancel(
    app: App,
    act: Act,
    Path(order): Path<String>,
) -> ApiResult<Json<CancelledOut>> {
    act.about(&order);
    if !is_id(&order) {
        return Err(ApiError::not_found(format!("order {order}: must be an id")));
    }
    change(&app, [OsStr::new("cancel"), OsStr::new(&order)]).await
}

/// Has the worker change the queue.
async fn change<T: DeserializeOwned>(app: &App, words: [&OsStr; 2]) -> ApiResult<Json<T>> {
    check_configured()?;
    let asked = ask(&words, CHANGE_WITHIN).await;
    // Whatever became of it, the next reader sees the present state.
    app.facts.memory.workers.forget(&()).await;
    let text = asked.map_err(|error| match error {
        Unanswered::Invalid(why) => ApiError::new(StatusCode::CONFLICT, why),
        Unanswered::Failed(why) => unavailable(why),
    })?;
    serde_json::from_slice(&text).map(Json).map_err(|error| unavailable(error.to_string()))
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
    let data = data.to_owned();
    let mut folders = tokio::task::spawn_blocking(move || folders(&data)).await.unwrap_or_default();
    for order in &mut found.orders {
        order.folder = folders.remove(&order.order);
    }
    found.unsubmitted = folders.into_values().collect();
    found.unsubmitted.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_state_is_read_as_the_worker_prints_it() {
        let text = r#"{"workers": [{"worker": "desk/1/a", "heard_s": 3, "lost": false,
              "about": {"pid": 1, "at_once": 2, "gpu": false}}],
            "orders": [{"chunks": 9, "done": 2, "order": "ab", "waiting": 5, "running": 1, "again": 1,
              "again_error": "desk: no kernel", "failed": 1, "missing": 0, "per_minute": 1.5, "to_go_s": 240,
              "errors": [{"key": "cd", "index": 4, "attempts": 8, "error": "e"}]}]}"#;
        let found: WorkersOut = serde_json::from_str(text).unwrap();
        assert!(!found.configured);
        assert_eq!((found.workers[0].heard_s, found.orders[0].to_go_s), (3, Some(240)));
        let about = found.workers[0].about.as_ref().unwrap();
        assert_eq!((about.at_once, about.gpu, about.memory_mib), (Some(2), Some(false), None));
        assert_eq!(found.orders[0].errors[0].attempts, 8);
    }
}
