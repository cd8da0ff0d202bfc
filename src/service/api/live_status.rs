//! The status over a WebSocket, with every sample of the load cells: one message is made for all clients.
//! Uses: `status`, the campaign's samples, `envelope`, `live`. Never: a queue (a slow client misses messages), a wait of
//! the campaign.

use std::iter::from_fn;
use std::time::Duration;

use axum::extract::ws::{Utf8Bytes, WebSocket};
use axum::response::Response;
use serde::Serialize;
use tokio::sync::broadcast::Sender;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, timeout};
use utoipa::ToSchema;

use super::App;
use super::envelope::{SamplesOut, envelope};
use super::limits::STATUS_CLIENTS;
use super::live::arrived;
use super::problem::ApiResult;
use super::socket::{LiveClient, closed, is_sent};
use super::status::{ServiceStatus, StoredPart};

/// Shortest time between two messages.
const STATUS_INTERVAL: Duration = Duration::from_millis(100);
/// Longest time between two messages, less an interval: a client that receives none for two seconds has
/// lost its connection.
const HEARTBEAT: Duration = Duration::from_millis(850);
/// Longest wait for the stored part of the status; afterwards the last one is shown.
const STORED_WAIT: Duration = Duration::from_millis(300);
/// Most samples of a message.
const SAMPLES_OF_MESSAGE: usize = 50;
/// Messages that a client may be behind.
const MESSAGES_BEHIND: usize = 4;

/// Message of the live status.
#[derive(Debug, Serialize, ToSchema)]
pub struct LiveStatus {
    /// Status of rig, run and service. What is stored of it (lock, queue, last trial) may be 1 s old.
    pub status: ServiceStatus,
    /// Samples of the load cells since the last message, at most 50 with all extremes.
    pub samples: SamplesOut,
}

/// The messages for all clients.
#[derive(Debug)]
pub struct Messages(Sender<Utf8Bytes>);

impl Default for Messages {
    fn default() -> Self {
        Self(Sender::new(MESSAGES_BEHIND))
    }
}

/// Streams the status with the samples of the load cells as JSON messages over a WebSocket.
///
/// A message is sent when the status has changed or samples have arrived, at most 10 per second and at
/// least one per second.
#[utoipa::path(get, operation_id = "live_status", path = "/api/v1/status/live", tag = "status",
    params(("ticket" = Option<String>, Query,
        description = "a ticket of `POST /api/v1/tickets`: a browser's WebSocket sends no header with a key")),
    responses((status = 101, description = "WebSocket whose messages are LiveStatus", body = LiveStatus),
        (status = 503, description = "too many clients are connected")))]
pub async fn live(client: LiveClient) -> ApiResult<Response> {
    let places = client.app.turns.status.clone();
    client.open(&places, (STATUS_CLIENTS, "live status"), send)
}

async fn send(app: App, mut socket: WebSocket) {
    let mut messages = app.facts.memory.live_status.0.subscribe();
    let mut ending = app.facts.ending.clone();
    loop {
        let text = tokio::select! {
            message = messages.recv() => match message {
                Ok(text) => text,
                Err(RecvError::Lagged(_)) => continue,
                Err(RecvError::Closed) => return,
            },
            _ = ending.wait_for(|e| *e) => return,
            () = closed(&mut socket) => return,
        };
        if !is_sent(&mut socket, text).await {
            return;
        }
    }
}

/// Makes the messages until the service ends. Without clients only the times of the suspenders are
/// followed.
pub async fn publish(app: App) {
    let mut changes = app.campaign.watch_status();
    let mut follower = app.campaign.follow_samples();
    let mut stored = StoredPart::default();
    let mut reading: Option<JoinHandle<Option<StoredPart>>> = None;
    let mut sent = Instant::now();
    let (mut clients, mut samples) = (0, Vec::new());
    let mut tick = tokio::time::interval(STATUS_INTERVAL);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        samples.extend(from_fn(|| arrived(&mut follower)));
        let now = app.facts.memory.live_status.0.receiver_count();
        let is_new = now > std::mem::replace(&mut clients, now);
        let has_changed = changes.has_changed().unwrap_or(false) || !samples.is_empty();
        if !is_due(now > 0, is_new || has_changed, sent.elapsed()) {
            continue;
        }
        sent = Instant::now();
        changes.mark_unchanged();
        // A reading that takes longer continues, and is shown by a later message.
        let task = reading.get_or_insert_with(|| tokio::spawn(read_stored(app.clone())));
        if let Ok(read) = timeout(STORED_WAIT, task).await {
            reading = None;
            stored = read.ok().flatten().unwrap_or(stored);
        }
        let status = app.status_with(stored.clone()).await;
        let samples = envelope(&std::mem::take(&mut samples), SAMPLES_OF_MESSAGE);
        if now == 0 {
            continue;
        }
        let samples = SamplesOut::of(&samples);
        let message = LiveStatus { status, samples };
        match serde_json::to_string(&message) {
            // The last client may have left meanwhile.
            Ok(text) => drop(app.facts.memory.live_status.0.send(text.into())),
            Err(error) => tracing::error!(%error, "a live status cannot be written"),
        }
    }
}

/// The stored part, at most as old as it is kept; `None` if it cannot be read.
async fn read_stored(app: App) -> Option<StoredPart> {
    app.facts.memory.stored_part.get((), app.stored_part()).await.ok()
}

/// Whether a message is made now: at once for something new, otherwise as a heartbeat.
fn is_due(has_clients: bool, is_new: bool, since_last: Duration) -> bool {
    has_clients && is_new || since_last >= HEARTBEAT
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_due_for_something_new_and_at_least_once_per_second() {
        let soon = STATUS_INTERVAL;
        assert!(is_due(true, true, soon));
        assert!(!is_due(true, false, soon) && !is_due(false, true, soon));
        assert!(is_due(true, false, HEARTBEAT) && is_due(false, false, HEARTBEAT));
        assert!(HEARTBEAT + STATUS_INTERVAL < Duration::from_secs(1));
    }
}
