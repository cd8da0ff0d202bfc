//! Contacts of the rig's live frames, and how live clients follow what serves.
//! Uses: `infer::serving`, the frames of `live`. Never: a delay of the rig.

use axum::extract::ws::WebSocket;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use tokio::time::Instant;
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::infer::FrameAnswer;
use super::limits::LIVE_CLIENTS;
use super::live::LiveFrames;
use super::problem::{ApiError, ApiResult, Params};
use super::socket::{LiveClient, is_sent};
use crate::clock::Clock;
use crate::infer::error::InferResult;
use crate::infer::maps::ForceMaps;
use crate::infer::methods::Method;
use crate::infer::methods::exact::Tracked;
use crate::infer::pipeline::{Followed, Pipeline};
use crate::rig::traits::Frame;

/// Options of a live stream of contacts.
#[derive(Debug, Clone, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct LiveParams {
    /// Method; absent: the best one for which models serve.
    #[param(inline)]
    pub method: Option<Method>,
    /// Include the force map: the output of the net, or for `fast` and `exact` the contacts
    /// rendered as Map 1 (4x20).
    #[serde(default)]
    pub map: bool,
    /// A ticket of `POST /api/v1/tickets`: a browser's WebSocket sends no header with a key.
    #[expect(dead_code, reason = "auth reads it")]
    ticket: Option<String>,
}

/// Contacts of a live frame.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct LiveAnswer {
    /// Frame counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Contacts of the frame.
    #[serde(flatten)]
    pub answer: FrameAnswer,
}

/// Streams the contacts of the rig's live frames as JSON messages over a WebSocket.
///
/// At most 33 messages per second on average. A client that is late by at most four frames misses none, a slow one
/// misses frames; nothing waits for it.
#[utoipa::path(get, operation_id = "live_contacts", path = "/api/v1/live", tag = "infer",
    params(LiveParams),
    responses((status = 101, description = "WebSocket whose messages are LiveAnswer", body = LiveAnswer),
        (status = 409, description = "no model serves for the method"),
        (status = 503, description = "too many live clients are connected")))]
pub async fn live(Params(options): Params<LiveParams>, client: LiveClient) -> ApiResult<Response> {
    let serving = client.app.serving.once_restored(options.method).await;
    let method = match options.method {
        Some(method) => method,
        None => serving.best().ok_or_else(|| {
            let words = "no model serves: train or add a model, then promote it";
            ApiError::new(StatusCode::CONFLICT, words)
        })?,
    };
    // Checked now, so that the error is a status instead of a message for each frame.
    serving.ready(method)?;
    let (places, maps) = (client.app.turns.live.clone(), ForceMaps::if_wanted(options.map));
    client.open(&places, (LIVE_CLIENTS, "live contacts"), move |app, socket| {
        let (clock, mut tracked, mut last) = (Clock::new(1.0), Tracked::default(), None);
        follow(app, socket, move |pipeline, frame| {
            let before = last.replace((frame.device_time_us, frame.received));
            tracked.pass(before.map_or(0.0, |before| passed_s(before, frame)));
            let volts = frame.voltages_v();
            let Followed { reading, model } =
                pipeline.follow(method, &volts, maps, &mut tracked)?;
            let latency_us = (clock.now() - frame.received).as_micros() as u64;
            let answer = FrameAnswer { reading, model, method, latency_us };
            let (sequence, device_time_us) = (frame.sequence, frame.device_time_us);
            Ok(LiveAnswer { sequence, device_time_us, answer })
        })
    })
}

/// Process time between two frames, s: by the clock of the device, and by that of this machine if the device started
/// again.
fn passed_s((device_time_us, received): (u64, Instant), frame: &Frame) -> f64 {
    let device_s = 1e-6 * frame.device_time_us.saturating_sub(device_time_us) as f64;
    device_s.max(frame.received.saturating_duration_since(received).as_secs_f64())
}

/// Sends what `answer` makes of the frames, as JSON, one after the other, until the client leaves.
pub(super) async fn follow<T: Serialize + Send + 'static>(
    app: App,
    mut socket: WebSocket,
    mut answer: impl FnMut(&Pipeline, &Frame) -> InferResult<T> + Send + 'static,
) {
    let mut frames = LiveFrames::of(&app);
    while let Some(frame) = frames.next(&mut socket).await {
        let sequence = frame.sequence;
        let pipeline = app.serving.current();
        let work = move || {
            let answered = answer(&pipeline, &frame);
            (answered, answer)
        };
        let Ok((answered, again)) = tokio::task::spawn_blocking(work).await else { return };
        answer = again;
        let text = match answered {
            Ok(answered) => serde_json::to_string(&answered),
            Err(error) => serde_json::to_string(&serde_json::json!({
                "sequence": sequence, "error": error.to_string(),
            })),
        };
        let Ok(text) = text else { return };
        if !is_sent(&mut socket, text.into()).await {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn time_passes_by_the_clock_of_the_device_and_by_ours_if_it_started_again() {
        let began = Instant::now();
        let frame = |device_time_us, wall_s| Frame {
            sequence: 1,
            device_time_us,
            volts_per_count: 1.0,
            counts: Vec::new(),
            received: began + Duration::from_secs(wall_s),
        };
        let first = (5_000_000, began);
        // 60 times as fast as the clock of the wall; missing frames do not matter.
        assert_eq!(passed_s(first, &frame(125_000_000, 2)), 120.0);
        assert_eq!(passed_s(first, &frame(1_000, 3600)), 3600.0);
    }
}
