//! Liveness, readiness and metrics.
//! Uses: the store, the campaign's status. Never: the rig itself.

use std::fmt::Write;

use axum::Json;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ApiResult};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::status::WireStatus;
use crate::store::Soundness;

/// Free space below which the disk of the database counts as full, bytes. It suffices for several
/// hundred trials, so that readiness reports a full disk before a commit fails.
const DISK_FULL_BYTES: u64 = 16 * 1024 * 1024;

/// Identity of the process.
#[derive(Debug, Serialize, ToSchema)]
pub struct Live {
    /// Always `palpate`.
    pub service: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Process id of the service.
    pub pid: u32,
}

/// Returns name, version and process id of the service.
#[utoipa::path(get, operation_id = "liveness",
    path = "/health/live", tag = "health", responses((status = 200, body = Live)))]
pub async fn live() -> Json<Live> {
    let version = env!("CARGO_PKG_VERSION");
    Json(Live { service: "palpate", version, pid: std::process::id() })
}

/// Checks that the service can store trials.
///
/// The database responds and is not damaged, its disk is not full, and the campaign's thread runs.
#[utoipa::path(get, operation_id = "readiness", path = "/health/ready", tag = "health",
    responses((status = 204),
        (status = 503,
            description = "the database is damaged, unchecked or not readable, the disk is full, or the campaign has ended")))]
pub async fn ready(app: App) -> ApiResult<StatusCode> {
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
            "the disk of the data folder is full: {free} bytes are free, limit {DISK_FULL_BYTES}; \
             delete files"
        );
        return Err(unavailable(words));
    }
    if app.campaign.watch_status().has_changed().is_err() {
        return Err(unavailable("the campaign's thread has ended".into()));
    }
    Ok(StatusCode::NO_CONTENT)
}

/// Returns counters and gauges in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "health",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub async fn metrics(app: App) -> impl IntoResponse {
    let status = app.campaign.status();
    let mut text = String::new();
    let mut metric = |name: &str, kind: &str, help: &str, values: &[(String, f64)]| {
        let _ = writeln!(text, "# HELP palpate_{name} {help}\n# TYPE palpate_{name} {kind}");
        for (labels, value) in values {
            let _ = writeln!(text, "palpate_{name}{labels} {value}");
        }
    };
    let rig = &status.rig;
    let state = |s: &RigState| {
        (format!("{{state=\"{}\"}}", s.as_str()), f64::from(u8::from(*s == rig.state)))
    };
    let states: Vec<(String, f64)> = RigState::ALL.iter().map(state).collect();
    metric("rig_state", "gauge", "1 for the current state of the rig.", &states);
    let plain = |v: u64| vec![(String::new(), v as f64)];
    let wires = |get: fn(&WireStatus) -> u64| -> Vec<(String, f64)> {
        rig.wires.iter().map(|w| (format!("{{wire=\"{}\"}}", w.name), get(w) as f64)).collect()
    };
    let (stream, (wrong_keys, _)) = (&rig.stream, app.facts.wrong_keys.count());
    for (name, help, values) in [
        ("frames_total", "Frames accepted.", plain(stream.frames)),
        ("frames_missed_total", "Frames missing in the stream.", plain(stream.missed)),
        ("packets_garbled_total", "Packets rejected.", plain(stream.garbled)),
        ("wire_requests_total", "Requests answered.", wires(|w| w.requests)),
        ("wire_retries_total", "Requests sent again.", wires(|w| w.retries)),
        ("wire_timeouts_total", "Requests without a reply in time.", wires(|w| w.timeouts)),
        ("wrong_keys_total", "Requests without a valid key.", plain(wrong_keys)),
    ] {
        metric(name, "counter", help, &values);
    }
    if let Some(run) = &status.run {
        let uid = format!("{{run=\"{}\"}}", run.uid);
        for (name, help, value) in [
            ("trials_planned", "Trials in the plan.", run.trials_planned),
            ("trials_stored", "Trials stored.", run.trials_stored),
            ("trials_skipped", "Planned trials of skipped configurations.", run.trials_skipped),
            ("retries", "Failed attempts.", run.retries),
        ] {
            metric(name, "gauge", help, &[(uid.clone(), value as f64)]);
        }
        if let Some(eta) = run.eta {
            let value = [(uid, eta.remaining_s)];
            metric("remaining_seconds", "gauge", "Remaining wall time.", &value);
        }
    }
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text)
}
