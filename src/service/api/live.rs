//! Live frames over a WebSocket: the newest one, as fast as the client takes them.
//! Uses: the campaign's newest frame. Never: a queue (a slow client misses frames).

use std::time::Duration;

use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::response::Response;
use serde::Serialize;
use tokio::time::timeout;
use utoipa::ToSchema;

use super::App;
use crate::rig::traits::Frame;

/// Shortest time between two frames to one client: thirty a second.
const BEAT: Duration = Duration::from_millis(33);
/// A client that takes longer for one frame is gone.
const SEND: Duration = Duration::from_secs(5);

/// A frame as it is shown.
#[derive(Debug, Serialize, ToSchema)]
pub struct LiveFrame {
    /// Counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Largest magnitude of an injection's sum, V: zero up to noise.
    pub largest_injection_sum_v: f64,
    /// 784 voltages, injection-major, V.
    pub voltages_v: Vec<f32>,
}

/// Live frames: a WebSocket of JSON messages.
#[utoipa::path(get, path = "/api/v1/frames/live", tag = "frames",
    responses((status = 101, description = "messages are LiveFrame", body = LiveFrame)))]
pub async fn frames(State(app): State<App>, upgrade: WebSocketUpgrade) -> Response {
    upgrade.on_upgrade(move |socket| send(app, socket))
}

async fn send(app: App, mut socket: WebSocket) {
    let mut frames = app.campaign.watch_frames();
    let mut ending = app.facts.ending.clone();
    loop {
        tokio::select! {
            changed = frames.changed() => if changed.is_err() { return },
            _ = ending.wait_for(|e| *e) => return,
            message = socket.recv() => match message {
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
        }
        let frame = frames.borrow_and_update().clone();
        let Some(frame) = frame else { continue };
        let Ok(text) = serde_json::to_string(&shown(&frame)) else { return };
        let sent = timeout(SEND, socket.send(Message::Text(text.into()))).await;
        if !matches!(sent, Ok(Ok(()))) {
            return;
        }
        tokio::time::sleep(BEAT).await;
    }
}

fn shown(frame: &Frame) -> LiveFrame {
    LiveFrame {
        sequence: frame.sequence,
        device_time_us: frame.device_time_us,
        largest_injection_sum_v: frame.largest_injection_sum_v(),
        voltages_v: frame.voltages_v(),
    }
}
