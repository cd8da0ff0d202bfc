//! `GET /api/v1/status`: snapshot of rig, run and service.
//! Uses: `campaign::shown::status`, `store`. Never: a wait for the rig.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::ApiError;
use crate::campaign::shown::status::Status;
use crate::store::LockRow;

/// Status of rig, run and service.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ServiceStatus {
    /// Status of rig and run.
    #[serde(flatten)]
    pub campaign: Status,
    /// Version and process of the service.
    pub service: ServiceInfo,
    /// The operator lock; absent if it is free.
    pub lock: Option<LockRow>,
    /// Number of runs in the queue.
    pub queue_length: usize,
    /// What the next run that was started waits for, as text: its start time, or the active run;
    /// absent if none waits.
    pub waiting_for: Option<String>,
}

/// Version and process of the service.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ServiceInfo {
    /// Version of the program.
    pub version: &'static str,
    /// Commit of the program; absent if it is unknown.
    pub git_commit: Option<&'static str>,
    /// Path of the database file.
    pub database: String,
    /// Time of the start of the service.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: Timestamp,
    /// Process id.
    pub pid: u32,
    /// Number of requests without a valid key since the start.
    pub wrong_keys: u64,
    /// Time of the last one; absent if there was none.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub wrong_key_at: Option<Timestamp>,
}

/// Returns the status of rig, run and service.
#[utoipa::path(get, path = "/api/v1/status", tag = "status",
    responses((status = 200, body = ServiceStatus)))]
pub async fn status(State(app): State<App>) -> Result<Json<ServiceStatus>, ApiError> {
    let (wrong_keys, wrong_key_at) = app.facts.wrong_keys.count();
    let service = ServiceInfo {
        version: env!("CARGO_PKG_VERSION"),
        git_commit: crate::commit::known(),
        database: app.store.path().display().to_string(),
        started_at: app.facts.started_at,
        pid: std::process::id(),
        wrong_keys,
        wrong_key_at,
    };
    let lock = app.store.lock().await?;
    let queue_length = app.store.queue().await?.len();
    let waiting_for = app.conductor.waiting_for().await?;
    let campaign = app.campaign.status();
    Ok(Json(ServiceStatus { campaign, service, lock, queue_length, waiting_for }))
}
