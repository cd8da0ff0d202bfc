//! `GET /api/v1/status`: where rig, run and service stand.
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

/// Everything that a first look needs.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ServiceStatus {
    /// Rig and run.
    #[serde(flatten)]
    pub campaign: Status,
    /// The service.
    pub service: About,
    /// The operator lock, while it is held.
    pub lock: Option<LockRow>,
    /// Runs that wait in the queue.
    pub queue_length: usize,
}

/// The service itself.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct About {
    /// Version of the program.
    pub version: &'static str,
    /// Commit of the program, where it is known.
    pub git_commit: Option<&'static str>,
    /// The database file.
    pub database: String,
    /// Since when it runs.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: Timestamp,
    /// Its process.
    pub pid: u32,
}

/// Where rig, run and service stand.
#[utoipa::path(get, path = "/api/v1/status", tag = "status",
    responses((status = 200, body = ServiceStatus)))]
pub async fn status(State(app): State<App>) -> Result<Json<ServiceStatus>, ApiError> {
    let service = About {
        version: env!("CARGO_PKG_VERSION"),
        git_commit: crate::commit::known(),
        database: app.store.path().display().to_string(),
        started_at: app.facts.started_at,
        pid: std::process::id(),
    };
    let lock = app.store.lock().await?;
    let queue_length = app.store.queue().await?.len();
    Ok(Json(ServiceStatus { campaign: app.campaign.status(), service, lock, queue_length }))
}
