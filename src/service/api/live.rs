//! Live frames over a WebSocket: always the newest, as fast as the client receives them.
//! Uses: the campaign's newest frame. Never: a queue (a slow client misses frames).

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use axum::response::Response;
use serde::Serialize;
use tokio::sync::watch::Receiver;
use tokio::time::{Instant, sleep_until};
use utoipa::ToSchema;

use super::App;
use super::limits::FRAME_CLIENTS;
use super::problem::{ApiError, ProblemBody};
use super::socket::{LiveClient, is_sent};
use crate::campaign::bench::stuck::StuckChannels;
use crate::rig::traits::Frame;

/// Shortest time between two frames to one client. Less than the 33.3 ms of a board's frame, so that a
/// client that keeps up misses none of 30 per second.
pub(super) const FRAME_INTERVAL: Duration = Duration::from_millis(30);
/// Number of equal counts after which a channel is shown as stuck: 2 s. In trials fewer suffice, because
/// the skin is pressed in between; here it may be at rest, and a quiet channel repeats a count by chance.
pub(super) const STUCK_FRAMES: u32 = 60;

/// A live frame.
#[derive(Debug, Serialize, ToSchema)]
pub struct LiveFrame {
    /// Frame counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Largest magnitude of an injection sum, V; zero up to noise.
    pub largest_injection_sum_v: f64,
    /// Voltages, V, 784, injection-major.
    pub voltages_v: Vec<f32>,
    /// Indices of the channels that returned one count in the last 60 frames that were sent.
    pub stuck: Vec<usize>,
    /// Indices of the channels at the end of the converter's range.
    pub saturated: Vec<usize>,
}

/// Streams live frames as JSON messages over a WebSocket.
#[utoipa::path(get, operation_id = "live_frames", path = "/api/v1/frames/live", tag = "frames",
    params(("ticket" = Option<String>, Query,
        description = "a ticket of `POST /api/v1/tickets`: a browser's WebSocket sends no header with a key")),
    responses((status = 101, description = "WebSocket whose messages are LiveFrame", body = LiveFrame),
        (status = 503, body = ProblemBody, description = "too many clients are connected")))]
pub async fn frames(client: LiveClient) -> Result<Response, ApiError> {
    let places = client.app.turns.frames.clone();
    client.open(&places, (FRAME_CLIENTS, "live frames"), send)
}

async fn send(app: App, mut socket: WebSocket) {
    let mut frames = app.campaign.watch_frames();
    let mut ending = app.facts.ending.clone();
    let mut channels = StuckChannels::default();
    while let Some(frame) = next_frame(&mut frames, &mut ending, &mut socket).await {
        let next = Instant::now() + FRAME_INTERVAL;
        let Ok(text) = serde_json::to_string(&shown(&frame, &mut channels)) else { return };
        if !is_sent(&mut socket, text.into()).await {
            return;
        }
        sleep_until(next).await;
    }
}

/// Waits for the next frame of the stream. It is absent if the client closes the socket, or if the campaign or the
/// service ends.
pub(super) async fn next_frame(
    frames: &mut Receiver<Option<Arc<Frame>>>,
    ending: &mut Receiver<bool>,
    socket: &mut WebSocket,
) -> Option<Arc<Frame>> {
    loop {
        tokio::select! {
            changed = frames.changed() => changed.ok()?,
            _ = ending.wait_for(|e| *e) => return None,
            message = socket.recv() => match message {
                Some(Ok(Message::Close(_)) | Err(_)) | None => return None,
                Some(Ok(_)) => continue,
            },
        }
        let frame = frames.borrow_and_update().clone();
        if frame.is_some() {
            return frame;
        }
    }
}

fn shown(frame: &Frame, channels: &mut StuckChannels) -> LiveFrame {
    channels.push(&frame.counts);
    LiveFrame {
        stuck: channels.unchanged_in(STUCK_FRAMES),
        saturated: frame.saturated().collect(),
        sequence: frame.sequence,
        device_time_us: frame.device_time_us,
        largest_injection_sum_v: frame.largest_injection_sum_v(),
        voltages_v: frame.voltages_v(),
    }
}
