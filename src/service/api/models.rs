//! Models: what there is, how well they did, files out and in, and which of them serve.
//! Uses: `infer::{registry, serving}`, `store`. Never: training, frames.

use axum::extract::multipart::Multipart;
use axum::extract::{Path, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::auth::Asker;
use super::jobs::ndjson;
use super::problem::{ApiError, Body, ProblemBody};
use crate::infer::registry::{NewModel, facts};
use crate::infer::slot::Slot;
use crate::learn::model_file::{ModelFacts, manifest_for_foreign};
use crate::learn::residuals::Residuals;
use crate::problem::Problem;
use crate::store::ModelRow;
use crate::syntax::syntax_problem;

/// Largest ONNX file that is taken in.
pub const MODEL_MAX_BYTES: usize = 256 << 20;

/// A model.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ModelOut {
    /// Its id.
    pub id: String,
    /// What it is called.
    pub name: String,
    /// What it does: transfer, recon, end-to-end or points.
    pub task: String,
    /// What is known of it: datasets, recipe, calibration, code, where it has been.
    #[schema(value_type = Object)]
    pub manifest: Value,
    /// When it came.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: jiff::Timestamp,
    /// Whether it serves.
    pub serves: bool,
    /// Reports of its evaluations, newest first.
    #[schema(value_type = Vec<Object>)]
    pub scores: Vec<Value>,
}

/// A wish to let a model, or a calibration, serve.
#[derive(Debug, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PromotionRequest {
    /// A model's id or name, or a calibration's id.
    pub what: String,
    /// Why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Who.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
}

/// A wish to go back to what served before.
#[derive(Debug, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RollBackRequest {
    /// Where.
    pub slot: Slot,
    /// Why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Who.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
}

/// What serves in a slot.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ServesOut {
    /// The slot.
    pub slot: Slot,
    /// A model's id, or a calibration's; absent: nothing.
    pub what: Option<String>,
}

/// What serves, and what did.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ServingOut {
    /// For each slot.
    pub serves: Vec<ServesOut>,
    /// Promotions, newest first.
    pub history: Vec<PromotionOut>,
}

/// A promotion.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct PromotionOut {
    /// The slot.
    pub slot: String,
    /// A model's id, or a calibration's; absent: nothing.
    pub what: Option<String>,
    /// Who.
    pub who: String,
    /// Why.
    pub why: Option<String>,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub at: jiff::Timestamp,
    /// Whether it had served before and was gone back to.
    pub rolled_back: bool,
}

/// All models, newest first.
#[utoipa::path(get, path = "/api/v1/models", tag = "models",
    responses((status = 200, body = Vec<ModelOut>)))]
pub async fn list(State(app): State<App>) -> Result<Json<Vec<ModelOut>>, ApiError> {
    let mut models = Vec::new();
    for row in app.store.models().await? {
        models.push(out(&app, row).await?);
    }
    Ok(Json(models))
}

/// One model.
#[utoipa::path(get, path = "/api/v1/models/{model}", tag = "models",
    params(("model" = String, Path, description = "its id or name")),
    responses((status = 200, body = ModelOut), (status = 404, body = ProblemBody)))]
pub async fn one(
    State(app): State<App>,
    Path(model): Path<String>,
) -> Result<Json<ModelOut>, ApiError> {
    Ok(Json(out(&app, app.models.find(&model).await?).await?))
}

/// A model's ONNX file.
#[utoipa::path(get, path = "/api/v1/models/{model}/onnx", tag = "models",
    params(("model" = String, Path, description = "its id or name")),
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 404, body = ProblemBody)))]
pub async fn onnx(State(app): State<App>, Path(model): Path<String>) -> Result<Response, ApiError> {
    let row = app.models.find(&model).await?;
    let path = app.models.onnx(&row.id);
    let bytes = tokio::fs::read(&path).await;
    let bytes = bytes.map_err(crate::infer::error::InferError::file("reading", &path))?;
    let name = format!("attachment; filename=\"{}.onnx\"", row.id);
    let name = HeaderValue::try_from(name).unwrap_or(HeaderValue::from_static("attachment"));
    let kind = HeaderValue::from_static("application/octet-stream");
    Ok(([(header::CONTENT_TYPE, kind), (header::CONTENT_DISPOSITION, name)], bytes).into_response())
}

/// The losses of a model's training: a JSON object for each epoch; none where it came otherwise.
#[utoipa::path(get, path = "/api/v1/models/{model}/losses", tag = "models",
    params(("model" = String, Path, description = "its id or name")),
    responses((status = 200, body = String, content_type = "application/x-ndjson"),
        (status = 404, body = ProblemBody)))]
pub async fn losses(
    State(app): State<App>,
    Path(model): Path<String>,
) -> Result<Response, ApiError> {
    let row = app.models.find(&model).await?;
    Ok(ndjson(app.models.losses(&row.id).unwrap_or_default()))
}

/// What a Transfer-Net leaves over on trials that it did not learn from (paper, Fig. 10A).
#[utoipa::path(get, path = "/api/v1/models/{model}/residuals", tag = "models",
    params(("model" = String, Path, description = "its id or name")),
    responses((status = 200, body = Residuals), (status = 404, body = ProblemBody)))]
pub async fn residuals(
    State(app): State<App>,
    Path(model): Path<String>,
) -> Result<Json<Residuals>, ApiError> {
    Ok(Json(app.models.residuals(&model).await?))
}

/// What is handed in with a model from elsewhere.
#[derive(ToSchema)]
#[allow(dead_code)] // For the description alone.
pub struct ModelForm {
    /// The ONNX file.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
    /// Text of its sensor file.
    sensor: String,
    /// What is known of it: the table `model` of a manifest, TOML.
    facts: String,
    /// What it is called.
    name: String,
}

/// Takes in a model trained elsewhere.
#[utoipa::path(post, path = "/api/v1/models", tag = "models",
    request_body(content = ModelForm, content_type = "multipart/form-data"),
    responses((status = 201, body = ModelOut), (status = 422, body = ProblemBody)))]
pub async fn add(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    mut form: Multipart,
) -> Result<(StatusCode, Json<ModelOut>), ApiError> {
    let mut parts = std::collections::HashMap::new();
    let refused = |error: axum::extract::multipart::MultipartError| {
        ApiError::new(error.status(), error.body_text())
    };
    while let Some(field) = form.next_field().await.map_err(refused)? {
        let name = field.name().unwrap_or_default().to_owned();
        parts.insert(name, field.bytes().await.map_err(refused)?);
    }
    let outcome = keep(&app, &parts).await;
    let row = app.logged(&asker, "add a model", (None, None, None), outcome).await?;
    Ok((StatusCode::CREATED, Json(out(&app, row).await?)))
}

async fn keep(
    app: &App,
    parts: &std::collections::HashMap<String, bytes::Bytes>,
) -> Result<ModelRow, ApiError> {
    let part = |name: &str| {
        let problem = || Problem::new("form", name, "absent", "must be given");
        parts.get(name).ok_or_else(|| ApiError::problems(vec![problem()]))
    };
    let text = |name: &str| {
        let bytes = part(name)?.to_vec();
        String::from_utf8(bytes).map_err(|_| ApiError::value(name, "bytes", "must be text, UTF-8"))
    };
    let (sensor, name, said) = (text("sensor")?, text("name")?, text("facts")?);
    let (_, sensor_facts) = facts("sensor", &sensor).map_err(ApiError::problems)?;
    let said: ModelFacts = toml::from_str(&said)
        .map_err(|error| ApiError::problems(vec![syntax_problem("facts", &said, &error)]))?;
    let onnx = part("file")?.to_vec();
    let manifest = manifest_for_foreign(&onnx, said, &sensor_facts)
        .map_err(crate::infer::error::InferError::from)?;
    let new = NewModel { name, manifest, onnx, sensor, losses: None, residuals: None };
    // It must run before it is kept.
    new.try_out().await?;
    Ok(app.models.add(new).await?)
}

/// Keeps a calibration of this rig's sensor (text of its file), so that it can be promoted.
#[utoipa::path(post, path = "/api/v1/calibrations", tag = "models", request_body = String,
    responses((status = 201, body = String), (status = 422, body = ProblemBody)))]
pub async fn add_calibration(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    text: String,
) -> Result<(StatusCode, Json<String>), ApiError> {
    let outcome = app.serving.keep_calibration(&text).await.map_err(ApiError::from);
    let id = app.logged(&asker, "add a calibration", (None, None, None), outcome).await?;
    Ok((StatusCode::CREATED, Json(id)))
}

/// What serves, and what did.
#[utoipa::path(get, path = "/api/v1/serving", tag = "models",
    responses((status = 200, body = ServingOut)))]
pub async fn serving(State(app): State<App>) -> Result<Json<ServingOut>, ApiError> {
    let serves = app.serving.promoted().await?;
    let serves = serves.into_iter().map(|(slot, what)| ServesOut { slot, what }).collect();
    let history = app.serving.history().await?.into_iter().map(|row| PromotionOut {
        slot: row.slot,
        what: row.what,
        who: row.who,
        why: row.why,
        at: row.at,
        rolled_back: row.rolled_back,
    });
    Ok(Json(ServingOut { serves, history: history.collect() }))
}

/// Lets a model or a calibration serve. It is loaded and warmed first: no frame is dropped.
#[utoipa::path(post, path = "/api/v1/serving", tag = "models", request_body = PromotionRequest,
    responses((status = 200, body = ServesOut), (status = 404, body = ProblemBody),
        (status = 409, body = ProblemBody)))]
pub async fn promote(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(request): Body<PromotionRequest>,
) -> Result<Json<ServesOut>, ApiError> {
    let (who, why) = (request.who.as_deref(), request.why.as_deref());
    let promoted = app.serving.promote(&request.what, &asker.name(who), why).await;
    let outcome = promoted.map_err(ApiError::from);
    let slot = app.logged(&asker, "promote", (None, who, why), outcome).await?;
    Ok(Json(ServesOut { slot, what: Some(request.what) }))
}

/// Lets what served before serve again.
#[utoipa::path(post, path = "/api/v1/serving/roll-back", tag = "models",
    request_body = RollBackRequest,
    responses((status = 200, body = ServesOut), (status = 409, body = ProblemBody),
        (status = 422, body = ProblemBody)))]
pub async fn roll_back(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(request): Body<RollBackRequest>,
) -> Result<Json<ServesOut>, ApiError> {
    let (who, why, slot) = (request.who.as_deref(), request.why.as_deref(), request.slot);
    let outcome = app.serving.roll_back(slot, &asker.name(who), why).await.map_err(ApiError::from);
    let what = app.logged(&asker, "roll back", (None, who, why), outcome).await?;
    Ok(Json(ServesOut { slot, what }))
}

/// Whether a report says how good a model is: by a method that it is for, on rows that it did not
/// learn from, and on more than a few that were shown.
fn tells_of(task: &str, report: &Value) -> bool {
    let methods: &[&str] = match task {
        "transfer" => &["voltages", "paper"],
        "points" => &["fast"],
        _ => &["paper"],
    };
    let learned = report["held_out"] == false
        || matches!(report["part"].as_str(), Some("train" | "validation"));
    let is_for = report["scored"].as_str().is_some_and(|scored| methods.contains(&scored));
    is_for && !learned && report["examples"].is_null()
}

async fn out(app: &App, row: ModelRow) -> Result<ModelOut, ApiError> {
    let manifest: toml::Table = toml::from_str(&row.manifest).unwrap_or_default();
    let serves = app.serving.promoted().await?;
    let reports = app.store.evaluations_of(&row.id).await?.into_iter().filter_map(|job| job.result);
    let scores = reports.filter(|report| tells_of(&row.task, report));
    Ok(ModelOut {
        serves: serves.iter().any(|(_, what)| what.as_ref() == Some(&row.id)),
        manifest: serde_json::to_value(manifest.get("model")).unwrap_or_default(),
        scores: scores.collect(),
        id: row.id,
        name: row.name,
        task: row.task,
        created_at: row.created_at,
    })
}
