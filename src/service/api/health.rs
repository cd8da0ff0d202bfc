//! Liveness, readiness and metrics.
//! Uses: the store, the campaign's status. Never: the rig itself.

use std::fmt::Write;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ProblemBody};
use crate::campaign::bench::rig_state::RigState;
use crate::store::Soundness;

/// A disk with less than this for the database counts as full, bytes: some hundred trials, so that
/// the service says so before a commit fails.
const DISK_FULL_BYTES: u64 = 16 * 1024 * 1024;

/// A process that answers.
#[derive(Debug, Serialize, ToSchema)]
pub struct Live {
    /// Always `palpate`.
    pub service: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Its process.
    pub pid: u32,
}

/// The process answers.
#[utoipa::path(get, path = "/health/live", tag = "health", responses((status = 200, body = Live)))]
pub async fn live() -> Json<Live> {
    let version = env!("CARGO_PKG_VERSION");
    Json(Live { service: "palpate", version, pid: std::process::id() })
}

/// The database answers and was found sound, its disk is not full, and the campaign's thread lives.
#[utoipa::path(get, path = "/health/ready", tag = "health",
    responses((status = 204), (status = 503, body = ProblemBody)))]
pub async fn ready(State(app): State<App>) -> Result<StatusCode, ApiError> {
    let unavailable = |words: String| ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words);
    app.store.last_event_seq().await.map_err(|e| unavailable(e.to_string()))?;
    match app.store.soundness() {
        Soundness::Sound => {}
        Soundness::Unchecked => return Err(unavailable("the database is being checked".into())),
        Soundness::Damaged(findings) => {
            return Err(unavailable(format!("the database is damaged: {}", findings.join("; "))));
        }
    }
    let free = app.store.free_bytes().await.map_err(|e| unavailable(e.to_string()))?;
    if free < DISK_FULL_BYTES {
        let words = format!(
            "the disk of the data folder is full: {free} bytes are free, at least \
                             {DISK_FULL_BYTES} are needed"
        );
        return Err(unavailable(words));
    }
    if app.campaign.watch_status().has_changed().is_err() {
        return Err(unavailable("the campaign's thread has ended".into()));
    }
    Ok(StatusCode::NO_CONTENT)
}

/// Counters and gauges in Prometheus' text format.
#[utoipa::path(get, path = "/metrics", tag = "health",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub async fn metrics(State(app): State<App>) -> impl IntoResponse {
    let status = app.campaign.status();
    let mut text = String::new();
    let mut metric = |name: &str, kind: &str, help: &str, values: &[(String, f64)]| {
        let _ = writeln!(text, "# HELP palpate_{name} {help}\n# TYPE palpate_{name} {kind}");
        for (labels, value) in values {
            let _ = writeln!(text, "palpate_{name}{labels} {value}");
        }
    };
    let plain = |v: f64| [(String::new(), v)];
    let rig = &status.rig;
    let states: Vec<(String, f64)> = [
        RigState::Disconnected,
        RigState::Disarmed,
        RigState::Homed,
        RigState::Armed,
        RigState::Tripped,
    ]
    .map(|s| (format!("{{state=\"{}\"}}", s.as_str()), f64::from(u8::from(s == rig.state))))
    .to_vec();
    metric("rig_state", "gauge", "1 for the state that the rig is in.", &states);
    let s = &rig.stream;
    metric("frames_total", "counter", "Frames accepted.", &plain(s.frames as f64));
    metric(
        "frames_missed_total",
        "counter",
        "Frames missing in the stream.",
        &plain(s.missed as f64),
    );
    metric("packets_garbled_total", "counter", "Packets refused.", &plain(s.garbled as f64));
    let wires =
        |get: fn(&crate::campaign::shown::status::WireStatus) -> u64| -> Vec<(String, f64)> {
            rig.wires.iter().map(|w| (format!("{{wire=\"{}\"}}", w.name), get(w) as f64)).collect()
        };
    metric("wire_requests_total", "counter", "Requests answered.", &wires(|w| w.requests));
    metric("wire_retries_total", "counter", "Requests sent again.", &wires(|w| w.retries));
    metric("wire_timeouts_total", "counter", "Replies that did not come.", &wires(|w| w.timeouts));
    if let Some(run) = &status.run {
        let uid = format!("{{run=\"{}\"}}", run.uid);
        let of_run = |v: u64| [(uid.clone(), v as f64)];
        metric("trials_planned", "gauge", "Trials in the plan.", &of_run(run.trials_planned));
        metric("trials_stored", "gauge", "Trials stored.", &of_run(run.trials_stored));
        metric("trials_skipped", "gauge", "Trials given up.", &of_run(run.trials_skipped));
        metric("retries", "gauge", "Failed attempts.", &of_run(run.retries));
        if let Some(eta) = run.eta {
            let value = [(uid.clone(), eta.remaining_s)];
            metric("remaining_seconds", "gauge", "Time to go, wall.", &value);
        }
    }
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text)
}
