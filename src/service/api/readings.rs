//! Evaluations of `exact` of which other machines read the frames: what they need, and the scores of their answers.
//! Uses: `jobs::readings`. Never: a score of answers to other frames.

use axum::Json;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::audit::Act;
use super::form::{Form, invalid, missing};
use super::limits::FRAMES_MAX_BYTES;
use super::problem::{ApiError, ApiResult, Body, Params};
use crate::evaluate::request::{EvaluationReport, EvaluationRequest};
use crate::infer::answer::Reading;
use crate::jobs::readings::{ORDERED_FRAMES_MAX, ReadingInputs};

/// Size of a chunk.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ChunkParams {
    /// Number of frames of a chunk, 1 to 5000; 50 if absent.
    #[param(minimum = 1, maximum = 5000, default = 50)]
    pub chunk_rows: Option<u32>,
}

/// Returns what other machines need to read the frames of an evaluation of `exact`: skin, errors of its model, frames.
///
/// The dataset is made if needed. To prepare a skin takes up to most of a minute.
#[utoipa::path(post, operation_id = "evaluation_inputs", path = "/api/v1/evaluations/inputs",
    tag = "jobs", params(ChunkParams), request_body = EvaluationRequest,
    responses((status = 200, body = ReadingInputs),
        (status = 400, description = "a parameter is invalid, or the dataset cannot be made"),
        (status = 404, description = "the dataset or the calibration does not exist"),
        (status = 409,
            description = "the dataset is of another sensor, or another person holds the operator lock"),
        (status = 422,
            description = "the request is invalid, not of `exact` without nets, or has more than 5000 rows"),
        (status = 507, description = "the disk has no room for the dataset")))]
pub async fn inputs(
    app: App,
    act: Act,
    Params(ChunkParams { chunk_rows }): Params<ChunkParams>,
    Body(request): Body<EvaluationRequest>,
) -> ApiResult<Json<ReadingInputs>> {
    let chunk_rows = chunk_rows.unwrap_or(50);
    if !(1..=ORDERED_FRAMES_MAX).contains(&u64::from(chunk_rows)) {
        let words = format!("must be from 1 to {ORDERED_FRAMES_MAX}");
        return Err(ApiError::query("chunk_rows", chunk_rows, &words));
    }
    act.about(&request.dataset);
    Ok(Json(app.jobs.reading_inputs(&request, chunk_rows as usize).await?))
}

/// Form of readings.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes the request for openapi.yaml")]
pub struct ReadingsForm {
    /// Readings of all frames, in their order, a JSON object per line; at most 64 MiB.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
    /// The EvaluationRequest, JSON.
    request: String,
    /// Simulation id of the skin's model.
    model: String,
    /// sha256 of the frames of all chunks, one after the other, as text.
    frames_sha256: String,
}

/// Scores readings of the frames of an evaluation of `exact` that other machines have made.
///
/// They must be of the model and of the frames that the service would use. The report states no latencies.
#[utoipa::path(post, operation_id = "score_readings", path = "/api/v1/evaluations/readings",
    tag = "jobs", request_body(content = ReadingsForm, content_type = "multipart/form-data"),
    responses((status = 200, body = Object, description = "the EvaluationReport"),
        (status = 400, description = "the form is invalid, or the dataset cannot be made"),
        (status = 404, description = "the dataset or the calibration does not exist"),
        (status = 409,
            description = "the dataset is of another sensor, or another person holds the operator lock"),
        (status = 422,
            description = "the request is invalid, or the readings are of another model or of other frames"),
        (status = 507, description = "the disk has no room for the dataset")))]
pub async fn score(app: App, act: Act, form: Form) -> ApiResult<Json<EvaluationReport>> {
    let names = ["request", "model", "frames_sha256"];
    let (file, [request, model, frames_sha256]) = form.parts(FRAMES_MAX_BYTES, names).await?;
    app.still_allowed(&act).await?;
    let file = file.ok_or_else(|| missing("file"))?;
    let request = request.ok_or_else(|| missing("request"))?;
    let model = model.ok_or_else(|| missing("model"))?;
    let frames_sha256 = frames_sha256.ok_or_else(|| missing("frames_sha256"))?;
    let request: EvaluationRequest = serde_json::from_str(&request)
        .map_err(|error| invalid("request", "..", &error.to_string()))?;
    act.about(&request.dataset);
    let mut readings: Vec<Reading> = Vec::new();
    for line in file.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
        let reading = serde_json::from_slice(line);
        readings.push(reading.map_err(|error| invalid("file", "..", &error.to_string()))?);
    }
    Ok(Json(app.jobs.score_readings(&request, &model, &frames_sha256, readings).await?))
}
