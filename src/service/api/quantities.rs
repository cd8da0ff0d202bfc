//! Answers of a net that estimates a quantity of a whole frame. It need not be for the rig's sensor.
//! Uses: `infer::quantity`. Never: what serves.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::limits::FRAMES_MAX;
use super::problem::{ApiError, Body, Path, ProblemBody};
use crate::dataset::background::background;
use crate::infer::error::InferError;
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
#[utoipa::path(post, operation_id = "model_quantities",
    path = "/api/v1/models/{model}/quantities", tag = "models",
    params(("model" = String, Path, description = "id or name of the model")),
    request_body = QuantityRequest,
    responses((status = 200, body = Vec<QuantityAnswer>),
        (status = 404, body = ProblemBody, description = "no model has this id or name"),
        (status = 409, body = ProblemBody, description = "the model answers no quantity"),
        (status = 422, body = ProblemBody, description = "a frame is invalid"),
        (status = 503, body = ProblemBody, description = "too many requests are in progress")))]
pub async fn quantities(
    State(app): State<App>,
    Path(model): Path<String>,
    Body(request): Body<QuantityRequest>,
) -> Result<Json<Vec<QuantityAnswer>>, ApiError> {
    let model = app.models.load(&model).await?;
    model.quantity()?;
    let (count, channels) = (request.frames.len(), model.plan.channels());
    if count == 0 || count > FRAMES_MAX {
        return Err(ApiError::value("frames", count, &format!("must be from 1 to {FRAMES_MAX}")));
    }
    check(&request.frames, channels)?;
    let turn = app.turns.answer().await?;
    let work = move || {
        let _turn = turn;
        model.quantities(&request.frames.concat())
    };
    Ok(Json(background(work).await.map_err(|_| InferError::Worker)??))
}

/// Checks that all frames are complete and finite.
fn check(frames: &[Vec<f32>], channels: usize) -> Result<(), ApiError> {
    for (index, frame) in frames.iter().enumerate() {
        if frame.len() != channels {
            let key = format!("frames[{index}]");
            let limit = format!("must have {channels} voltages, one per channel of the net");
            return Err(ApiError::value(&key, frame.len(), &limit));
        }
        if let Some(channel) = frame.iter().position(|v| !v.is_finite()) {
            let key = format!("frames[{index}][{channel}]");
            let limit = "must be a finite number of volts";
            return Err(ApiError::value(&key, frame[channel], limit));
        }
    }
    Ok(())
}
