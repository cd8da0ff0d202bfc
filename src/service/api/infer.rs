//! Frames in, contacts out: on request, and live from the rig's stream.
//! Uses: `infer::serving`, the campaign's newest frame. Never: a queue of frames, a wait of the rig's.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequest, Request, State};
use axum::http::{StatusCode, header};
use axum::response::Response;
use axum::{Json, extract::Query};
use serde::{Deserialize, Serialize};
use tokio::sync::Semaphore;
use tokio::time::timeout;
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::problem::{ApiError, Params, ProblemBody};
use crate::clock::Clock;
use crate::dataset::background::background;
use crate::infer::answer::Reading;
use crate::infer::error::InferError;
use crate::infer::methods::Method;
use crate::infer::methods::exact::Tracked;
use crate::infer::pipeline::Pipeline;
use crate::infer::slot::Slot;

/// Largest body with frames.
pub const FRAMES_MAX_BYTES: usize = 64 << 20;
/// Most frames of a request.
const FRAMES_MAX: usize = 2_000;
/// Most frames of a request for `exact`: a fit takes a tenth of a second.
const EXACT_MAX: usize = 300;
/// Most frames of a request for maps: each is 25,600 numbers.
const MAPS_MAX: usize = 100;
/// Requests that nets answer at a time; others wait.
const ANSWERED_AT_ONCE: usize = 4;
/// Requests that `exact` answers at a time; others wait.
const FITTED_AT_ONCE: usize = 2;
/// Live clients at a time.
const LIVE_AT_ONCE: usize = 8;
/// Longest wait for a turn.
const TURN: Duration = Duration::from_secs(10);
/// A client that takes longer for one message is gone.
const SEND: Duration = Duration::from_secs(5);

/// How frames are to be answered.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct Wish {
    /// `paper`, `fast` or `exact`.
    #[param(inline)]
    pub method: Method,
    /// A model's id or name, in place of the one that serves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// A Transfer-Net's id or name before it, in place of the one that serves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<String>,
    /// With the force map: the net's own, or what `fast` and `exact` found, drawn as Map 1.
    #[serde(default)]
    pub map: bool,
    /// Each frame is the mean of so many: `exact` reckons with less noise.
    #[serde(default = "one")]
    pub averaged: f64,
}

fn one() -> f64 {
    1.0
}

/// Frames to answer.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct InferRequest {
    /// How.
    #[serde(flatten)]
    pub wish: Wish,
    /// The frames, V, each of the sensor's channels, injection-major.
    pub frames: Vec<Vec<f32>>,
}

/// The answer to a frame.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct FrameAnswer {
    /// Contacts, map, what is outside of the trained range.
    #[serde(flatten)]
    pub reading: Reading,
    /// The model's id, or ids with a `+` between; for `exact` a calibration's id, and that of the
    /// Point-Net that proposes to it.
    pub model: String,
    /// The method.
    pub method: Method,
    /// Time to this answer, microseconds: of several frames, their mean; live, since the frame's last
    /// byte arrived.
    pub latency_us: u64,
}

/// Contacts of frames. Besides JSON it takes little-endian f32 frames, one after the other, as
/// `application/octet-stream`, with the wish in the query.
#[utoipa::path(post, path = "/api/v1/infer", tag = "infer", params(Wish),
    request_body(content((InferRequest = "application/json"),
        (Vec<u8> = "application/octet-stream"))),
    responses((status = 200, body = Vec<FrameAnswer>), (status = 404, body = ProblemBody),
        (status = 409, body = ProblemBody), (status = 422, body = ProblemBody), (status = 503, body = ProblemBody)))]
pub async fn infer(
    State(app): State<App>,
    request: Request,
) -> Result<Json<Vec<FrameAnswer>>, ApiError> {
    let channels = app.serving.sensor().channels();
    let (wish, frames) = received(&app, request, channels).await?;
    let pipeline = pipeline(&app, &wish).await?;
    let turns = if wish.method.is_fit() { &app.turns.fits } else { &app.turns.answers };
    let Ok(Ok(turn)) = timeout(TURN, turns.clone().acquire_owned()).await else {
        let words = "as many requests as can be are being answered: ask again";
        return Err(ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words));
    };
    let clock = Clock::new(1.0);
    let work = move || {
        let _turn = turn;
        let began_s = clock.process_s();
        let answered = pipeline.answer(wish.method, &frames, wish.averaged, wish.map)?;
        let count = answered.readings.len().max(1) as f64;
        let latency_us = (1e6 * (clock.process_s() - began_s) / count) as u64;
        let answer = |reading| FrameAnswer {
            reading,
            model: answered.model.clone(),
            method: wish.method,
            latency_us,
        };
        Ok::<_, InferError>(answered.readings.into_iter().map(answer).collect())
    };
    // Whoever asks waits for the campaign and for the live frames.
    let answers = background(work).await.map_err(|_| InferError::Worker)??;
    Ok(Json(answers))
}

async fn pipeline(app: &App, wish: &Wish) -> Result<Pipeline, ApiError> {
    let mut pipeline = app.serving.once_restored(Some(wish.method)).await.as_ref().clone();
    for name in wish.transfer.iter().chain(&wish.model) {
        let model = app.models.load(name).await?;
        app.serving.fits(&model)?;
        if !wish.method.slots().contains(&Slot::of(model.manifest.model.task)) {
            return Err(InferError::OtherTask {
                id: model.manifest.id.clone(),
                task: model.manifest.model.task.as_str(),
                wanted: "the method has no use for it",
            }
            .into());
        }
        pipeline = pipeline.with(model)?;
    }
    Ok(pipeline)
}

/// The wish and its frames, all of them whole and finite.
async fn received(
    app: &App,
    request: Request,
    channels: usize,
) -> Result<(Wish, Vec<f32>), ApiError> {
    let kind = request.headers().get(header::CONTENT_TYPE);
    let raw = kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/octet-stream"));
    let (wish, frames) = if raw {
        let query = Query::<Wish>::try_from_uri(request.uri()).map_err(ApiError::from)?.0;
        let bytes = bytes::Bytes::from_request(request, app).await;
        let bytes = bytes.map_err(|e| ApiError::new(e.status(), e.body_text()))?;
        if bytes.len() % (4 * channels) != 0 {
            let limit = format!("bytes: must be frames of {channels} little-endian f32");
            return Err(ApiError::value("body", bytes.len(), &limit));
        }
        (query, bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    } else {
        let body =
            Json::<InferRequest>::from_request(request, app).await.map_err(ApiError::from)?;
        let InferRequest { wish, frames } = body.0;
        for (index, frame) in frames.iter().enumerate() {
            if frame.len() != channels {
                let key = format!("frames[{index}]");
                let limit = format!("voltages: must be {channels}, as the sensor has channels");
                return Err(ApiError::value(&key, frame.len(), &limit));
            }
        }
        (wish, frames.concat())
    };
    let count = frames.len() / channels;
    if count == 0 || count > FRAMES_MAX {
        return Err(ApiError::value("frames", count, &format!("must be from 1 to {FRAMES_MAX}")));
    }
    if wish.method.is_fit() && count > EXACT_MAX {
        let limit = format!("must be from 1 to {EXACT_MAX} where contacts are fitted");
        return Err(ApiError::value("frames", count, &limit));
    }
    if wish.map && count > MAPS_MAX {
        let limit = format!("must be from 1 to {MAPS_MAX} where maps are wished for");
        return Err(ApiError::value("frames", count, &limit));
    }
    if let Some(at) = frames.iter().position(|v| !v.is_finite()) {
        let key = format!("frames[{}][{}]", at / channels, at % channels);
        return Err(ApiError::value(&key, frames[at], "must be a finite number of volts"));
    }
    if !(wish.averaged >= 1.0 && wish.averaged <= 1e6) {
        return Err(ApiError::value("averaged", wish.averaged, "must be from 1 to 1e6 frames"));
    }
    Ok((wish, frames))
}

/// What is wished of the live answers.
#[derive(Debug, Clone, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct LiveWish {
    /// `paper`, `fast` or `exact`; the best one that something serves for otherwise.
    #[param(inline)]
    pub method: Option<Method>,
    /// With the force map: the net's own, or what `fast` and `exact` found, drawn as Map 1.
    #[serde(default)]
    pub map: bool,
    /// The key of who asks, since a browser's WebSocket sends no headers.
    #[expect(dead_code, reason = "auth reads it")]
    key: Option<String>,
}

/// The answer to a live frame.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct LiveAnswer {
    /// Counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// The answer.
    #[serde(flatten)]
    pub answer: FrameAnswer,
}

/// Contacts of the rig's frames as they come: a WebSocket of JSON messages. A client that is slow
/// misses frames, nobody waits for it.
#[utoipa::path(get, path = "/api/v1/live", tag = "infer", params(LiveWish),
    responses((status = 101, description = "messages are LiveAnswer", body = LiveAnswer),
        (status = 409, body = ProblemBody), (status = 503, body = ProblemBody)))]
pub async fn live(
    State(app): State<App>,
    Params(wish): Params<LiveWish>,
    upgrade: WebSocketUpgrade,
) -> Result<Response, ApiError> {
    let serving = app.serving.once_restored(wish.method).await;
    let method = match wish.method {
        Some(method) => method,
        None => best(&serving).ok_or_else(|| {
            let words = "nothing serves yet: train or add a model, and promote it";
            ApiError::new(StatusCode::CONFLICT, words)
        })?,
    };
    // Said now, with a status, what every frame would say otherwise.
    serving.ready(method)?;
    let turn = app.turns.live.clone().try_acquire_owned().map_err(|_| {
        let words = format!("{LIVE_AT_ONCE} clients follow the skin already");
        ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words)
    })?;
    Ok(upgrade.on_upgrade(async move |socket| {
        follow(app, socket, method, wish.map).await;
        drop(turn);
    }))
}

/// Turns of those who want answers: the campaign comes first.
#[derive(Clone)]
pub struct Turns {
    answers: Arc<Semaphore>,
    fits: Arc<Semaphore>,
    live: Arc<Semaphore>,
}

impl Default for Turns {
    fn default() -> Self {
        let of = |count| Arc::new(Semaphore::new(count));
        Self { answers: of(ANSWERED_AT_ONCE), fits: of(FITTED_AT_ONCE), live: of(LIVE_AT_ONCE) }
    }
}

fn best(pipeline: &Pipeline) -> Option<Method> {
    Method::ALL.into_iter().rev().find(|method| pipeline.ready(*method).is_ok())
}

async fn follow(app: App, mut socket: WebSocket, method: Method, map: bool) {
    let mut frames = app.campaign.watch_frames();
    let mut ending = app.facts.ending.clone();
    let clock = Clock::new(1.0);
    let mut tracked = Tracked::default();
    loop {
        tokio::select! {
            changed = frames.changed() => if changed.is_err() { return },
            _ = ending.wait_for(|e| *e) => return,
            message = socket.recv() => match message {
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                Some(Ok(_)) => continue,
            },
        }
        let Some(frame) = frames.borrow_and_update().clone() else { continue };
        let pipeline = app.serving.current();
        let mut memory = std::mem::take(&mut tracked);
        let volts = frame.voltages_v();
        let work = move || {
            let answered = pipeline.follow(method, &volts, map, &mut memory);
            (answered, memory)
        };
        let Ok((answered, memory)) = tokio::task::spawn_blocking(work).await else { return };
        tracked = memory;
        let text = match answered {
            Ok((reading, model)) => {
                let latency_us = (clock.now() - frame.received).as_micros() as u64;
                let answer = FrameAnswer { reading, model, method, latency_us };
                let (sequence, device_time_us) = (frame.sequence, frame.device_time_us);
                serde_json::to_string(&LiveAnswer { sequence, device_time_us, answer })
            }
            Err(error) => serde_json::to_string(&serde_json::json!({
                "sequence": frame.sequence, "error": error.to_string(),
            })),
        };
        let Ok(text) = text else { return };
        let sent = timeout(SEND, socket.send(Message::Text(text.into()))).await;
        if !matches!(sent, Ok(Ok(()))) {
            return;
        }
    }
}
