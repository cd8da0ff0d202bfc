//! Quantities of whole frames: of a request, by any net, which need not be for the rig's sensor; and live, by
//! the nets that serve.
//! Uses: `infer::{quantity, pipeline}`. Never: contacts.

use axum::Json;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::infer::{check_finite, joined};
use super::limits::{FRAMES_MAX, LIVE_CLIENTS};
use super::live_contacts::follow;
use super::problem::{ApiError, ApiResult, Body, Path};
use super::socket::LiveClient;
use super::turns::turn;
use crate::clock::Clock;
use crate::dataset::background::background;
use crate::infer::error::InferError;
use crate::infer::pipeline::AnsweredQuantities;
use crate::infer::quantity::QuantityAnswer;

/// Request for answers of a net.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantityRequest {
    /// Frames, V, each with one voltage per channel of the net; 1 to 2000.
    pub frames: Vec<Vec<f32>>,
}

/// Answers frames by a net that estimates a position, pattern, count or force.
///
/// The net may be of an imported sensor. Contacts and force maps come from `/api/v1/infer`.
#[utoipa::path(post, operation_id = "model_quantities", path = "/api/v1/models/{model}/quantities",
    tag = "models", request_body = QuantityRequest,
    responses((status = 200, body = Vec<QuantityAnswer>),
        (status = 409, description = "the model answers no quantity"),
        (status = 422, description = "a frame is invalid"),
        (status = 503, description = "too many requests are in progress")))]
pub async fn quantities(
    app: App,
    Path(model): Path<String>,
    Body(request): Body<QuantityRequest>,
) -> ApiResult<Json<Vec<QuantityAnswer>>> {
    let model = app.models.load(&model).await?;
    model.quantity()?;
    let (count, channels) = (request.frames.len(), model.plan.channels());
    if count == 0 || count > FRAMES_MAX {
        return Err(ApiError::value("frames", count, &format!("must be from 1 to {FRAMES_MAX}")));
    }
    let frames = joined(&request.frames, channels, "net")?;
    check_finite(&frames, channels)?;
    let turn = turn(&app.turns.answers).await?;
    let work = move || {
        let _turn = turn;
        model.quantities(&frames)
    };
    Ok(Json(background(work).await.map_err(|_| InferError::Worker)??))
}

/// Quantities of a live frame.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct LiveQuantities {
    /// Frame counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Answers of the serving nets.
    #[serde(flatten)]
    pub answer: QuantityAnswer,
    /// Ids of the nets, joined by `+`.
    pub model: String,
    /// Latency from the arrival of the frame's last byte, microseconds.
    pub latency_us: u64,
}

/// Streams the quantities of the rig's live frames as JSON messages over a WebSocket.
///
/// All promoted nets of a position, pattern, count or force answer. At most 33 messages per second on average. A
/// client that is late by at most four frames misses none, a slow one misses frames; nothing waits for it.
#[utoipa::path(get, operation_id = "live_quantities", path = "/api/v1/live/quantities",
    tag = "infer",
    params(("ticket" = Option<String>, Query,
        description = "a ticket of `POST /api/v1/tickets`: a browser's WebSocket sends no header with a key")),
    responses((status = 101, description = "WebSocket whose messages are LiveQuantities", body = LiveQuantities),
        (status = 409, description = "no net of a quantity serves"),
        (status = 503, description = "too many live clients are connected")))]
pub async fn live(client: LiveClient) -> ApiResult<Response> {
    client.app.serving.once_restored(None).await.has_quantities()?;
    let places = client.app.turns.live.clone();
    client.open(&places, (LIVE_CLIENTS, "live contacts and quantities"), |app, socket| {
        let clock = Clock::new(1.0);
        follow(app, socket, move |pipeline, frame| {
            let AnsweredQuantities { answer, model } = pipeline.quantities(&frame.voltages_v())?;
            let latency_us = (clock.now() - frame.received).as_micros() as u64;
            let (sequence, device_time_us) = (frame.sequence, frame.device_time_us);
            Ok(LiveQuantities { sequence, device_time_us, answer, model, latency_us })
        })
    })
}
