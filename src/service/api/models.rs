//! Models: lists, scores, files, uploads, and promotions.
//! Uses: `infer::{registry, serving}`, `store`. Never: training, frames.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::App;
use super::audit::{Act, cut};
use super::form::{Form, Texts, invalid, missing};
use super::jobs::ndjson;
use super::limits::{MODEL_MAX_BYTES, WHO_MAX_CHARS};
use super::pages::{Page, PageParams, PageRequest};
use super::problem::{ApiError, ApiResult, Body, Path, Text};
use super::send::Created;
use crate::evaluate::request::Scored;
use crate::ids::{CalibrationId, ModelId, PromotedId};
use crate::infer::registry::{NewModel, facts};
use crate::infer::serving::Promotions;
use crate::infer::slot::Slot;
use crate::jobs::warnings_of;
use crate::learn::model_file::{Manifest, ModelFacts, manifest_for_foreign, manifest_with_id};
use crate::learn::residuals::Residuals;
use crate::learn::task::NetTask;
use crate::plain::violated;
use crate::problem::Problem;
use crate::store::{ModelRow, PromotionRow};
use crate::syntax::parse_toml;

/// A trained model with its manifest.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ModelOut {
    /// Id of the model, `mdl-..`.
    pub id: ModelId,
    /// Name of the model.
    pub name: String,
    /// Task: `transfer`, `recon`, `end-to-end`, `points`, or the quantity of a whole frame.
    pub task: String,
    /// Slot in which it can serve, for the sensor in its manifest.
    pub slot: Option<Slot>,
    /// Manifest: label, sensor, datasets, recipe, calibration, code, trained range.
    #[schema(value_type = Object)]
    pub manifest: Value,
    /// Time at which the model was stored.
    pub created_at: jiff::Timestamp,
    /// True if the model serves in the slot of its sensor.
    pub serves: bool,
    /// Reports of its evaluations, newest first.
    #[schema(value_type = Vec<Object>)]
    pub scores: Vec<Value>,
    /// Warnings of its training, oldest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// Request to promote a model or a calibration.
#[derive(Debug, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PromotionRequest {
    /// Id, start of the id, or name of a model, or id of a calibration.
    pub what: String,
    /// Reason, for the log of actions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Name of the person, for the log of actions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
}

/// Request to restore the previous model or calibration of a slot.
#[derive(Debug, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RollBackRequest {
    /// Slot of the model or calibration.
    pub slot: Slot,
    /// Name of its sensor; that of the rig if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// Reason, for the log of actions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Name of the person, for the log of actions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
}

/// Content of a slot.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ServesOut {
    /// Slot of the model or calibration.
    pub slot: Slot,
    /// Name of its sensor, if that is another one than the rig's: requests name the model by `SLOT@SENSOR`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// Id of the serving model or calibration; null if the slot is empty.
    #[schema(value_type = Option<String>)]
    pub what: Option<PromotedId>,
    /// What limits its answers; absent if nothing is known to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limitation: Option<String>,
    /// Id that a roll-back restores; absent if the slot would be empty, or if there is nothing to roll back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub restores: Option<PromotedId>,
}

/// Serving models and calibrations, with the history of promotions.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct ServingOut {
    /// Name of the rig's sensor.
    pub sensor: String,
    /// Content of each slot of the rig's sensor.
    pub serves: Vec<ServesOut>,
    /// Filled slots of other sensors.
    #[serde(default)]
    pub elsewhere: Vec<ServesOut>,
    /// Promotions, newest first.
    pub history: Vec<PromotionRow>,
}

/// Returns a page of the models, newest first.
#[utoipa::path(get, operation_id = "list_models", path = "/api/v1/models", tag = "models",
    params(PageParams), responses((status = 200, body = Page<ModelOut>)))]
pub async fn list(app: App, asked: PageRequest) -> ApiResult<Page<ModelOut>> {
    let Page { items: rows, next } =
        asked.of_all(app.store.models().await?, |model| model.id.clone())?;
    let promotions = app.serving.promotions().await?;
    let mut items = Vec::new();
    for row in rows {
        items.push(out(&app, row, &promotions).await?);
    }
    Ok(Page { items, next })
}

/// Returns a model.
#[utoipa::path(get, operation_id = "model", path = "/api/v1/models/{model}", tag = "models",
    responses((status = 200, body = ModelOut)))]
pub async fn one(app: App, Path(model): Path<String>) -> ApiResult<Json<ModelOut>> {
    let row = app.models.find(&model).await?;
    Ok(Json(out(&app, row, &app.serving.promotions().await?).await?))
}

/// Returns the ONNX file of a model.
#[utoipa::path(get, operation_id = "model_onnx",
    path = "/api/v1/models/{model}/onnx", tag = "models",
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream")))]
pub async fn onnx(app: App, Path(model): Path<String>) -> ApiResult<Response> {
    let row = app.models.find(&model).await?;
    let path = app.models.onnx(&row.id);
    let bytes = tokio::fs::read(&path).await;
    let bytes = bytes.map_err(crate::infer::error::InferError::file("reading", &path))?;
    let name = format!("attachment; filename=\"{}.onnx\"", row.id);
    let name = HeaderValue::try_from(name).unwrap_or(HeaderValue::from_static("attachment"));
    let kind = HeaderValue::from_static("application/octet-stream");
    Ok(([(header::CONTENT_TYPE, kind), (header::CONTENT_DISPOSITION, name)], bytes).into_response())
}

/// Returns the losses of a model's training, a JSON object per epoch.
///
/// The response is empty for an uploaded model.
#[utoipa::path(get, operation_id = "model_losses",
    path = "/api/v1/models/{model}/losses", tag = "models",
    responses((status = 200, body = String, content_type = "application/x-ndjson")))]
pub async fn losses(app: App, Path(model): Path<String>) -> ApiResult<Response> {
    let row = app.models.find(&model).await?;
    Ok(ndjson(app.models.losses(&row.id).unwrap_or_default()))
}

/// Returns the residuals of a Transfer-Net on trials outside its training part (paper, Fig. 10A).
#[utoipa::path(get, operation_id = "model_residuals", path = "/api/v1/models/{model}/residuals",
    tag = "models", responses((status = 200, body = Residuals)))]
pub async fn residuals(app: App, Path(model): Path<String>) -> ApiResult<Json<Residuals>> {
    Ok(Json(app.models.residuals(&model).await?))
}

/// Form of a model trained elsewhere.
#[derive(ToSchema)]
#[allow(dead_code)] // For the description alone.
pub struct ModelForm {
    /// ONNX file, at most 256 MiB.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
    /// Sensor file (TOML).
    sensor: String,
    /// Facts of the model: the table `model` of a manifest (TOML).
    facts: String,
    /// Name of the model.
    name: String,
    /// Id in the manifest of a net that a trainer of Palpate has made; it must be that of file and facts. Absent for a
    /// net of another program.
    id: Option<String>,
    /// Residuals of a Transfer-Net that a trainer of Palpate has made (JSON), as a model's residuals are returned.
    residuals: Option<String>,
}

/// Adds a model trained elsewhere.
#[utoipa::path(post, operation_id = "add_model", path = "/api/v1/models", tag = "models",
    request_body(content = ModelForm, content_type = "multipart/form-data"),
    responses((status = 201, body = ModelOut, headers(("Location", description = "the model"))),
        (status = 400, description = "a part of the form is missing, unknown or no text"),
        (status = 422,
            description = "sensor, facts, id or residuals are invalid, or the model does not run")))]
pub async fn add(app: App, act: Act, form: Form) -> ApiResult<Created<ModelOut>> {
    let names = ["sensor", "facts", "name", "id", "residuals"];
    let (file, texts) = form.parts(MODEL_MAX_BYTES, names).await?;
    app.still_allowed(&act).await?;
    let row = store(&app, file, texts).await?;
    act.about(row.id.as_str());
    let promotions = app.serving.promotions().await?;
    Ok(Created::at(format!("/api/v1/models/{}", row.id), out(&app, row, &promotions).await?))
}

/// Checks the parts of a form and stores the model.
async fn store(
    app: &App,
    file: Option<Vec<u8>>,
    [sensor, stated, name, id, residuals]: Texts<5>,
) -> ApiResult<ModelRow> {
    if let Some(name) = &name
        && let Some(limit) = violated(name, WHO_MAX_CHARS)
    {
        return Err(invalid("name", &cut(name, WHO_MAX_CHARS), &limit));
    }
    let sensor = sensor.ok_or_else(|| missing("sensor"))?;
    let name = name.ok_or_else(|| missing("name"))?;
    let stated = stated.ok_or_else(|| missing("facts"))?;
    let onnx = file.ok_or_else(|| missing("file"))?;
    let (_, sensor_facts) = facts("sensor", &sensor).map_err(ApiError::problems)?;
    let stated: ModelFacts = parse_toml("facts", &stated).map_err(ApiError::problems)?;
    let manifest = match id {
        None => manifest_for_foreign(&onnx, stated, &sensor_facts),
        Some(id) => manifest_with_id(&onnx, stated, &sensor_facts, ModelId::unchecked(id)),
    };
    let manifest = manifest.map_err(crate::infer::error::InferError::from)?;
    let residuals = residuals.map(|text| residuals_of(&manifest, &text)).transpose()?;
    let new = NewModel { name, manifest, onnx, sensor, losses: None, residuals };
    // The model must run on one frame before it is stored.
    new.try_out().await?;
    Ok(app.models.add(new).await?)
}

/// Reads the residuals of a Transfer-Net.
fn residuals_of(manifest: &Manifest, text: &str) -> ApiResult<Residuals> {
    let refused =
        |limit: &str| ApiError::problems(vec![Problem::new("form", "residuals", "..", limit)]);
    let residuals: Residuals =
        serde_json::from_str(text).map_err(|error| refused(&error.to_string()))?;
    let (facts, lengths) = (&manifest.model, [residuals.mean_v.len(), residuals.sd_v.len()]);
    if facts.task != NetTask::Transfer || lengths != [facts.channels; 2] {
        return Err(refused("must be of a Transfer-Net, with a mean and a deviation per channel"));
    }
    Ok(residuals)
}

/// Adds a calibration of this rig's sensor (text of its file), so that it can be promoted.
#[utoipa::path(post, path = "/api/v1/calibrations", tag = "models", request_body = String,
    responses((status = 201, body = CalibrationId),
        (status = 422, description = "the calibration is invalid or for another sensor")))]
pub async fn add_calibration(
    app: App,
    act: Act,
    Text(text): Text,
) -> ApiResult<(StatusCode, Json<CalibrationId>)> {
    let id = app.serving.skins().keep(&text)?;
    act.about(id.as_str());
    Ok((StatusCode::CREATED, Json(id)))
}

/// Returns the content of all slots, and the history of promotions.
#[utoipa::path(get, path = "/api/v1/serving", tag = "models",
    responses((status = 200, body = ServingOut)))]
pub async fn serving(app: App) -> ApiResult<Json<ServingOut>> {
    let promotions = app.serving.promotions().await?;
    let of = |sensor: &str| -> Vec<_> {
        Slot::ALL.iter().map(|slot| serves_out(&app, sensor, *slot, &promotions)).collect()
    };
    let others = promotions.sensors().into_iter().filter(|name| *name != app.serving.rig());
    let elsewhere = others.flat_map(of).filter(|serves| serves.what.is_some()).collect();
    let (sensor, serves) = (app.serving.rig().into(), of(app.serving.rig()));
    Ok(Json(ServingOut { sensor, serves, elsewhere, history: promotions.into_rows() }))
}

/// Promotes a model or a calibration.
///
/// It is loaded and warmed up before it replaces the serving one: no frame is dropped. A model of another sensor than the
/// rig's answers requests that name it by `SLOT@SENSOR`, such as `position@pad-60`.
#[utoipa::path(post, path = "/api/v1/serving", tag = "models", request_body = PromotionRequest,
    responses((status = 200, body = ServesOut),
        (status = 404,
            description = "no model or calibration has this id or name, or several ids begin like this"),
        (status = 409, description = "the model has other channels than the sensor of its name")))]
pub async fn promote(
    app: App,
    act: Act,
    Body(request): Body<PromotionRequest>,
) -> ApiResult<Json<ServesOut>> {
    let (who, why) = (request.who.as_deref(), request.why.as_deref());
    act.stated(who, why);
    act.about(&request.what);
    let (sensor, slot) = app.serving.promote(&request.what, &act.name(), why).await?;
    Ok(Json(serves_out(&app, &sensor, slot, &app.serving.promotions().await?)))
}

/// Restores the previous model or calibration of a slot.
#[utoipa::path(post, path = "/api/v1/serving/roll-back", tag = "models",
    request_body = RollBackRequest, responses((status = 200, body = ServesOut),
        (status = 409, description = "the slot has no earlier promotion"),
        (status = 422, description = "the slot is unknown")))]
pub async fn roll_back(
    app: App,
    act: Act,
    Body(request): Body<RollBackRequest>,
) -> ApiResult<Json<ServesOut>> {
    let (who, why, slot) = (request.who.as_deref(), request.why.as_deref(), request.slot);
    act.stated(who, why);
    let sensor = request.sensor.as_deref().unwrap_or(app.serving.rig());
    app.serving.roll_back(sensor, slot, &act.name(), why).await?;
    Ok(Json(serves_out(&app, sensor, slot, &app.serving.promotions().await?)))
}

fn serves_out(app: &App, sensor: &str, slot: Slot, promotions: &Promotions) -> ServesOut {
    let is_skin = slot == Slot::Skin && sensor == app.serving.rig();
    let skin = is_skin.then(|| app.serving.current().skin().cloned()).flatten();
    let limitation = skin.and_then(|skin| skin.limitation());
    let (what, restores) = (promotions.serving(sensor, slot), promotions.restores(sensor, slot));
    let sensor = (sensor != app.serving.rig()).then(|| sensor.to_owned());
    ServesOut { slot, sensor, what, limitation, restores }
}

/// True if a report is a score of a model of this task: by a method that uses the task, on rows
/// outside its training, and not a report of examples only.
fn is_score(task: &str, report: &Value) -> bool {
    let task = NetTask::deserialize(json!(task)).ok();
    let scored = Scored::deserialize(&report["scored"]).ok();
    let trained_on = report["held_out"] == false
        || matches!(report["part"].as_str(), Some("train" | "validation"));
    let rates = |(scored, task): (Scored, NetTask)| match task.quantity() {
        Some(_) => scored == Scored::Quantity,
        None => scored.rates(Slot::of(task)),
    };
    let is_for = scored.zip(task).is_some_and(rates);
    is_for && !trained_on && report["examples"].is_null()
}

async fn out(app: &App, row: ModelRow, promotions: &Promotions) -> ApiResult<ModelOut> {
    let manifest: toml::Table = toml::from_str(&row.manifest).unwrap_or_default();
    let promoted = Some(PromotedId::Model(row.id.clone()));
    let training = app.store.training_of(&row.id).await?.and_then(|job| job.result);
    let reports = app.store.evaluations_of(&row.id).await?.into_iter().filter_map(|job| job.result);
    let scores = reports.filter(|report| is_score(&row.task, report));
    let facts = manifest.get("model");
    let sensor = facts.and_then(|facts| facts.get("sensor")).and_then(toml::Value::as_str);
    let is_at = |slot: &Slot| promotions.serving(sensor.unwrap_or_default(), *slot) == promoted;
    Ok(ModelOut {
        serves: Slot::ALL.iter().any(is_at),
        manifest: serde_json::to_value(facts).unwrap_or_default(),
        scores: scores.collect(),
        warnings: training.as_ref().map(warnings_of).unwrap_or_default(),
        id: row.id,
        name: row.name,
        slot: NetTask::deserialize(json!(row.task)).ok().map(Slot::of),
        task: row.task,
        created_at: row.created_at,
    })
}
