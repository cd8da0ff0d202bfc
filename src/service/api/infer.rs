//! Estimates contacts from the frames of a request.
//! Uses: `infer::serving`. Never: the frames of the rig (`live_contacts`).

use std::sync::Arc;

use axum::extract::{FromRequest, Request};
use axum::http::header;
use axum::{Json, extract::Query};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::limits::{EXACT_MAX, FRAMES_MAX, MAPS_MAX};
use super::problem::{ApiError, ApiResult};
use super::turns::turn;
use crate::clock::Clock;
use crate::dataset::background::background;
use crate::ids::CalibrationId;
use crate::infer::answer::Reading;
use crate::infer::error::InferError;
use crate::infer::maps::ForceMaps;
use crate::infer::methods::{Frames, Method};
use crate::infer::pipeline::Pipeline;
use crate::infer::registry::Model;
use crate::infer::slot::Slot;

/// Options of an inference.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct InferOptions {
    /// Method from a frame to contacts.
    #[param(inline)]
    pub method: Method,
    /// Id, start of the id, or name of a model to use instead of the serving one, or for `exact` id of a
    /// calibration; it need not be promoted. `SLOT@SENSOR` is the promoted one of another sensor than the rig's,
    /// whose nets are used alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Id, start of the id, or name of a Transfer-Net to use instead of the serving one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<String>,
    /// Include the force map: the output of the net, or for `fast` and `exact` the contacts
    /// rendered as Map 1 (4x20).
    #[serde(default)]
    pub map: bool,
    /// Number of frames of which each given frame is the mean, 1 to 1e6: `exact` assumes less
    /// noise.
    #[serde(default = "one")]
    pub averaged: f64,
}

fn one() -> f64 {
    1.0
}

/// Request for contacts of frames.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct InferRequest {
    /// Method, models and form of the answers, as keys of the request itself.
    #[serde(flatten)]
    pub options: InferOptions,
    /// Frames, V, each with one voltage per channel of the sensor, injection-major; 1 to 2000, for
    /// `exact` 300, with maps 100.
    pub frames: Vec<Vec<f32>>,
}

/// Contacts of a frame.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameAnswer {
    /// Contacts, force map, and values outside the trained range.
    #[serde(flatten)]
    pub reading: Reading,
    /// Id of the model, or ids joined by `+`. For `exact`: id of the calibration, and of the
    /// Point-Net that proposes contacts.
    pub model: String,
    /// Method that was used.
    pub method: Method,
    /// Latency, microseconds: for several frames their mean; live, from the arrival of the frame's
    /// last byte.
    pub latency_us: u64,
}

/// Estimates the contacts of frames.
///
/// In addition to JSON, the body may be frames of little-endian f32, one after the other, as
/// `application/octet-stream`, with the options in the query.
#[utoipa::path(post, path = "/api/v1/infer", tag = "infer", params(InferOptions),
    request_body(content((InferRequest = "application/json"),
        (Vec<u8> = "application/octet-stream"))),
    responses((status = 200, body = Vec<FrameAnswer>),
        (status = 404,
            description = "no model or calibration has the given id or name, or several ids begin like this"),
        (status = 409,
            description = "no model serves for the method, or a model does not fit method or sensor"),
        (status = 422, description = "a frame or an option is invalid"),
        (status = 503, description = "too many requests are in progress")))]
pub async fn infer(app: App, request: Request) -> ApiResult<Json<Vec<FrameAnswer>>> {
    let (options, sent) = received(&app, request).await?;
    let named = Named::load(&app, &options).await?;
    let frames = sent.frames(&options, named.sensor(&app).1)?;
    let fits = options.method.is_fit();
    let turn = turn(if fits { &app.turns.fits } else { &app.turns.answers }).await?;
    let pipeline = named.pipeline(&app, &options).await?;
    let clock = Clock::new(1.0);
    let work = move || {
        let _turn = turn;
        let started_s = clock.process_s();
        let averaged = options.averaged;
        let frames = Frames { averaged, ..Frames::single(&frames) };
        let answered =
            pipeline.answer(options.method, &frames, ForceMaps::if_wanted(options.map))?;
        let count = answered.readings.len().max(1) as f64;
        let latency_us = (1e6 * (clock.process_s() - started_s) / count) as u64;
        let answer = |reading| FrameAnswer {
            reading,
            model: answered.model.clone(),
            method: options.method,
            latency_us,
        };
        Ok::<_, InferError>(answered.readings.into_iter().map(answer).collect())
    };
    // Low priority: the campaign and the live frames come first.
    let answers = background(work).await.map_err(|_| InferError::Worker)??;
    Ok(Json(answers))
}

/// The models that a request names; without any, those that serve answer.
struct Named {
    nets: Vec<Arc<Model>>,
    skin: Option<CalibrationId>,
}

impl Named {
    async fn load(app: &App, options: &InferOptions) -> ApiResult<Self> {
        let slots = options.method.slots();
        let skin = options.model.as_deref().and_then(|id| id.parse::<CalibrationId>().ok());
        if let Some(id) = skin.as_ref().filter(|_| !slots.contains(&Slot::Skin)) {
            let limit = format!("must be a net: {} uses no calibration", options.method.name());
            return Err(ApiError::value("model", id, &limit));
        }
        let net = options.model.as_ref().filter(|_| skin.is_none());
        let mut nets = Vec::new();
        for name in options.transfer.iter().chain(net) {
            let model = app.models.load(name).await?;
            if !slots.contains(&model.slot()) {
                return Err(model.of_other_task("the method has no use for it").into());
            }
            nets.push(model);
        }
        Ok(Self { nets, skin })
    }

    /// Name and channels of the sensor of the frames: that of the nets, or else the rig's.
    fn sensor<'a>(&'a self, app: &'a App) -> (&'a str, usize) {
        let of_net = |net: &'a Arc<Model>| {
            let facts = &net.manifest.model;
            (facts.sensor.as_str(), facts.channels)
        };
        let of_rig = app.serving.sensor();
        self.nets.first().map_or((of_rig.file.name.as_str(), of_rig.channels()), of_net)
    }

    /// What serves, with the named models in their slots. Nets of another sensor than the rig's answer alone.
    async fn pipeline(&self, app: &App, options: &InferOptions) -> ApiResult<Pipeline> {
        let (sensor, channels) = self.sensor(app);
        let of_rig = app.serving.sensor();
        let mut pipeline = match sensor == of_rig.file.name && channels == of_rig.channels() {
            true => app.serving.once_restored(Some(options.method)).await.as_ref().clone(),
            false => Pipeline::default(),
        };
        for net in &self.nets {
            net.is_for(sensor, channels)?;
            pipeline = pipeline.with(net.clone())?;
        }
        if self.skin.is_some() {
            let skin = app.serving.skin(self.skin.as_ref()).await?;
            pipeline = pipeline.with_skin(Some(skin));
        }
        if let Some(transfer) = &options.transfer
            && !pipeline.uses_transfer()
        {
            let limit = "must be absent: an end-to-end net reads measured voltages";
            return Err(ApiError::value("transfer", transfer, limit));
        }
        Ok(pipeline)
    }
}

/// Frames as they were sent, V: their length depends on the models.
enum Sent {
    /// A list for each frame.
    Lists(Vec<Vec<f32>>),
    /// Little-endian f32, one frame after the other.
    Bytes(bytes::Bytes),
}

/// Reads the options and the frames.
async fn received(app: &App, request: Request) -> ApiResult<(InferOptions, Sent)> {
    let kind = request.headers().get(header::CONTENT_TYPE);
    let raw = kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/octet-stream"));
    let (options, sent) = if raw {
        let query = Query::<InferOptions>::try_from_uri(request.uri()).map_err(ApiError::from)?.0;
        let bytes = bytes::Bytes::from_request(request, app).await;
        let bytes = bytes.map_err(|e| ApiError::of_body(e.status(), e.body_text(), &e))?;
        (query, Sent::Bytes(bytes))
    } else {
        let body =
            Json::<InferRequest>::from_request(request, app).await.map_err(ApiError::from)?;
        (body.0.options, Sent::Lists(body.0.frames))
    };
    if !(options.averaged >= 1.0 && options.averaged <= 1e6) {
        return Err(ApiError::value("averaged", options.averaged, "must be from 1 to 1e6 frames"));
    }
    Ok((options, sent))
}

impl Sent {
    /// The frames, V, one after the other; checks that all are complete and finite.
    fn frames(self, options: &InferOptions, channels: usize) -> ApiResult<Vec<f32>> {
        let frames: Vec<f32> = match self {
            Self::Bytes(bytes) => {
                let frame_bytes = 4 * channels;
                if bytes.len() % frame_bytes != 0 {
                    let limit = format!(
                        "must be a multiple of {frame_bytes} bytes: frames of {channels} f32"
                    );
                    return Err(ApiError::value("body", bytes.len(), &limit));
                }
                bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
            }
            Self::Lists(frames) => joined(&frames, channels, "sensor")?,
        };
        let count = frames.len() / channels;
        for (applies, most, of) in [
            (true, FRAMES_MAX, ""),
            (options.method.is_fit(), EXACT_MAX, " for a method that fits contacts"),
            (options.map, MAPS_MAX, " if maps are requested"),
        ] {
            if applies && !(1..=most).contains(&count) {
                let limit = format!("must be from 1 to {most}{of}");
                return Err(ApiError::value("frames", count, &limit));
            }
        }
        check_finite(&frames, channels)?;
        Ok(frames)
    }
}

/// Joins frames, V, that have a voltage for each channel `of` a sensor or a net.
///
/// # Errors
/// 422 if one has not.
pub(super) fn joined(frames: &[Vec<f32>], channels: usize, of: &str) -> ApiResult<Vec<f32>> {
    if let Some(index) = frames.iter().position(|frame| frame.len() != channels) {
        let limit = format!("must have {channels} voltages, one per channel of the {of}");
        return Err(ApiError::value(&format!("frames[{index}]"), frames[index].len(), &limit));
    }
    Ok(frames.concat())
}

/// Checks that the voltages of joined frames are finite.
///
/// # Errors
/// 422 if one is not.
pub(super) fn check_finite(frames: &[f32], channels: usize) -> ApiResult<()> {
    let Some(at) = frames.iter().position(|v| !v.is_finite()) else { return Ok(()) };
    let key = format!("frames[{}][{}]", at / channels, at % channels);
    Err(ApiError::value(&key, frames[at], "must be a finite number of volts"))
}
