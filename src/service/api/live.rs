//! Live frames over a WebSocket, and which frames a live client is sent: each in its order, or the newest ones if the
//! client is slower than the stream.
//! Uses: the campaign's frames. Never: a wait of the rig (a slow client misses frames).

use std::iter::from_fn;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::WebSocket;
use axum::response::Response;
use serde::Serialize;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::{broadcast, watch};
use tokio::time::{Instant, sleep_until};
use utoipa::ToSchema;

use super::App;
use super::limits::FRAME_CLIENTS;
use super::problem::ApiResult;
use super::socket::{LiveClient, closed, is_sent};
use crate::campaign::bench::stuck::StuckChannels;
use crate::rig::traits::Frame;

/// Shortest mean time between two frames to one client. Less than the 33.3 ms of a board's frame, so that a
/// client that keeps up misses none of 30 per second.
const FRAME_INTERVAL: Duration = Duration::from_millis(30);
/// Frames by which a client may be late and miss none: 0.13 s of a board, more than a busy machine delays a thread.
const FRAMES_LATE: u32 = 4;
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
        (status = 503, description = "too many clients are connected")))]
pub async fn frames(client: LiveClient) -> ApiResult<Response> {
    let places = client.app.turns.frames.clone();
    client.open(&places, (FRAME_CLIENTS, "live frames"), send)
}

async fn send(app: App, mut socket: WebSocket) {
    let mut frames = LiveFrames::of(&app);
    let mut channels = StuckChannels::default();
    while let Some(frame) = frames.next(&mut socket).await {
        let Ok(text) = serde_json::to_string(&shown(&frame, &mut channels)) else { return };
        if !is_sent(&mut socket, text.into()).await {
            return;
        }
    }
}

/// The frames of the stream for one client.
pub(super) struct LiveFrames {
    frames: InTurn,
    ending: watch::Receiver<bool>,
    /// When the next frame may be taken.
    due: Instant,
}

impl LiveFrames {
    /// The frames from now on.
    pub(super) fn of(app: &App) -> Self {
        let frames = InTurn { each: app.campaign.follow_frames(), hurried: 0 };
        Self { frames, ending: app.facts.ending.clone(), due: Instant::now() }
    }

    /// Waits for the next frame. It is absent if the client closes the socket, or if the campaign or the service ends.
    pub(super) async fn next(&mut self, socket: &mut WebSocket) -> Option<Arc<Frame>> {
        sleep_until(self.due).await;
        let frame = tokio::select! {
            frame = self.frames.next() => frame?,
            _ = self.ending.wait_for(|e| *e) => return None,
            () = closed(socket) => return None,
        };
        self.due = due_after(self.due, Instant::now());
        Some(frame)
    }
}

/// When the frame after one that is taken `now`, and was due, is due: the mean time between two is `FRAME_INTERVAL`,
/// and what was delayed may follow without a rest.
fn due_after(due: Instant, now: Instant) -> Instant {
    let earliest = now.checked_sub(FRAMES_LATE * FRAME_INTERVAL).unwrap_or(due);
    due.max(earliest) + FRAME_INTERVAL
}

/// Each frame in its order while its taker keeps up, else the newest ones.
struct InTurn {
    each: broadcast::Receiver<Arc<Frame>>,
    /// Frames that had already arrived when they were taken, one after the other.
    hurried: u32,
}

impl InTurn {
    /// Waits for the next frame; `None` if none comes any more. It may be cancelled.
    async fn next(&mut self) -> Option<Arc<Frame>> {
        if let Some(mut frame) = arrived(&mut self.each) {
            self.hurried = self.hurried.saturating_add(1);
            if self.hurried > FRAMES_LATE {
                frame = from_fn(|| arrived(&mut self.each)).last().unwrap_or(frame);
            }
            return Some(frame);
        }
        loop {
            match self.each.recv().await {
                Ok(frame) => {
                    self.hurried = 0;
                    return Some(frame);
                }
                Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return None,
            }
        }
    }
}

/// The oldest value that has arrived and is not taken; those that a slow follower missed are absent.
pub(super) fn arrived<T: Clone>(follower: &mut broadcast::Receiver<T>) -> Option<T> {
    loop {
        match follower.try_recv() {
            Ok(value) => return Some(value),
            Err(TryRecvError::Lagged(_)) => {}
            Err(TryRecvError::Empty | TryRecvError::Closed) => return None,
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

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(sequence: u32) -> Arc<Frame> {
        let (device_time_us, volts_per_count, counts) = (0, 1e-3, vec![0; 4]);
        let received = Instant::now();
        Arc::new(Frame { sequence, device_time_us, volts_per_count, counts, received })
    }

    #[tokio::test]
    async fn a_delayed_client_misses_no_frame_and_a_slow_one_is_sent_the_newest() {
        let (stream, each) = broadcast::channel(64);
        let mut frames = InTurn { each, hurried: 0 };
        let send = |sequences: std::ops::Range<u32>| {
            for sequence in sequences {
                stream.send(frame(sequence)).unwrap();
            }
        };
        send(0..FRAMES_LATE + 10);
        for wanted in 0..FRAMES_LATE {
            assert_eq!(frames.next().await.unwrap().sequence, wanted);
        }
        assert_eq!(frames.next().await.unwrap().sequence, FRAMES_LATE + 9);
        // Still slower than the stream: only the newest.
        send(20..23);
        assert_eq!(frames.next().await.unwrap().sequence, 22);
        // A frame that is awaited: it keeps up again.
        let (awaited, ()) = tokio::join!(frames.next(), async { send(23..24) });
        assert_eq!(awaited.unwrap().sequence, 23);
        send(24..26);
        assert_eq!(frames.next().await.unwrap().sequence, 24);
        assert_eq!(frames.next().await.unwrap().sequence, 25);
        drop(stream);
        assert!(frames.next().await.is_none());
    }

    #[test]
    fn a_delay_is_made_up_without_a_rest_and_the_mean_rate_has_a_limit() {
        let start = Instant::now();
        // The rest of a client that was never late is an interval.
        assert_eq!(due_after(start, start), start + FRAME_INTERVAL);
        // One that took no frame for a minute may take a few at once, no more.
        let now = start + Duration::from_secs(60);
        let (mut due, mut taken) = (start, 0);
        while due <= now {
            due = due_after(due, now);
            taken += 1;
        }
        assert_eq!(taken, FRAMES_LATE + 1);
    }
}
