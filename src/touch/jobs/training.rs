//! A training as a job: makes its dataset, writes the order, follows the trainer, stores the model.
//! Uses: `learn`, `infer::registry`, `dataset`, the trainer's process. Never: HTTP, a net.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::error::{JobError, JobResult};
use super::kept::{self, WARNINGS};
use super::starts::Starts;
use super::trainer::{self, Ended};
use super::{Jobs, Watch};
use crate::dataset::background::background;
use crate::dataset::import::sensor::ImportedSensor;
use crate::dataset::origin;
use crate::ids::{CalibrationId, DatasetId, ModelId};
use crate::infer::registry::{self, NewModel};
use crate::learn::error::LearnError;
use crate::learn::model_file::Manifest;
use crate::learn::order::{
    CHECKPOINT, Event, LOSSES, MANIFEST, ONNX, ORDER, ORDER_VERSION, Order, RESIDUALS, Source,
};
use crate::learn::recipe::Recipe;
use crate::learn::task::MEASURED;
use crate::new_file;
use crate::store::{Label, TaskRow};

/// Name of the file with the id of the calibration whose simulations the training uses; empty for
/// the nominal skin.
const SKIN_FILE: &str = "skin";
/// Name of the file with the id of the Transfer-Net whose residuals are the noise.
const NOISE: &str = "noise";

/// Request for a training.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainingRequest {
    /// Text of the recipe file (TOML).
    pub recipe: String,
    /// Whether the map is scaled from the skin of the paper, 560 mm, to that of the dataset.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub scale_map: bool,
}

/// Runs a training; `None` if it was stopped.
///
/// # Errors
/// `JobError` if the dataset, the training or the storage of the model fails.
pub async fn run(jobs: &Jobs, job: &TaskRow, watch: &Arc<Watch>) -> JobResult<Option<Value>> {
    let folder = jobs.folder(job.id);
    recall_warnings(&folder, watch);
    let (recipe, order) = prepare(jobs, job, watch, &folder).await?;
    let text = serde_json::to_string(&order).map_err(JobError::Json)?;
    kept::unmark(&folder);
    if !folder.join(CHECKPOINT).exists() {
        kept::adopt(jobs, &folder, &text).await;
        recall_warnings(&folder, watch);
    }
    write(&folder, ORDER, text.as_bytes())?;
    let Some(program) = trainer::path(watch).await? else { return Ok(None) };
    if watch.is_stopped() {
        return Ok(None);
    }
    watch.phase("starting the trainer", 0);
    let starts = Starts::of(&folder);
    let seen = |event| show(event, &folder, watch, &starts);
    let ended = trainer::run(&program, &folder, watch, seen).await;
    if let Err(trainer::TrainerError::Ended(end)) = &ended
        && end.signal.is_some()
    {
        kept::keep(&folder);
    }
    if ended? == Ended::Stopped {
        return Ok(None);
    }
    watch.phase("storing the model", 0);
    let new = background(move || result(&folder, &order, recipe.name)).await??;
    let model = jobs.inner.models.add(new).await?;
    let mut made = json!({ "model": model.id, "name": model.name });
    let warnings = watch.warnings();
    if !warnings.is_empty() {
        made["warnings"] = warnings.into();
    }
    Ok(Some(made))
}

/// Adds a warning of a training, and keeps it for a later start.
fn warn(folder: &Path, watch: &Watch, message: String) {
    tracing::info!(warning = message, "a training warns");
    watch.warn(message);
    let kept = json!(watch.warnings()).to_string();
    if let Err(error) = new_file::write(folder, WARNINGS, kept) {
        tracing::warn!(%error, "the warnings of a training are not kept");
    }
}

/// Adds the warnings of earlier starts of a training.
fn recall_warnings(folder: &Path, watch: &Watch) {
    let kept = fs::read_to_string(folder.join(WARNINGS)).ok();
    let warnings: Option<Vec<String>> = kept.and_then(|text| serde_json::from_str(&text).ok());
    warnings.into_iter().flatten().for_each(|message| watch.warn(message));
}

/// Resolves the names of a recipe, as at the first start of the job, and makes its dataset.
async fn prepare(
    jobs: &Jobs,
    job: &TaskRow,
    watch: &Watch,
    folder: &Path,
) -> JobResult<(Recipe, Order)> {
    let request: TrainingRequest =
        serde_json::from_value(job.request.clone()).map_err(JobError::Json)?;
    let mut recipe = Recipe::from_toml("recipe", &request.recipe)?;
    let noise_sd_v = match &recipe.noise_of {
        Some(name) => {
            // After a restart: the model of the first start, not the current one of that name.
            let id = match begun_with(folder, NOISE) {
                Some(text) => ModelId::unchecked(text),
                None => jobs.inner.models.find(name).await?.id,
            };
            write(folder, NOISE, id.as_str().as_bytes())?;
            recipe.noise_of = Some(id.to_string());
            Some(jobs.inner.models.residuals(id.as_str()).await?.sd_v)
        }
        None => None,
    };
    let cache = jobs.inner.data.join("cache");
    let (sensor, source) = match &recipe.dataset {
        Some(name) => {
            watch.phase("making the dataset", 0);
            // After a restart: the dataset of the first start, not the current one of that name.
            let name = job.dataset.as_ref().map_or(name.as_str(), DatasetId::as_str);
            let dataset = jobs.inner.datasets.resolve(name).await?;
            jobs.inner.store.begin_task(job.id, Some(&dataset.id)).await?;
            let file = jobs.inner.datasets.used(&dataset.id);
            let of = file.clone();
            let sensor = background(move || crate::dataset::read::sensor_text(&of)).await??;
            let Inherited { label, calibration, simulation } = inherited(&dataset.lineage, &recipe);
            let source = Source::Dataset {
                label,
                calibration,
                simulation,
                id: dataset.id,
                file: absolute(&file),
                rows: dataset.rows,
                scratch: absolute(&cache),
            };
            (sensor, source)
        }
        None => {
            let serving = &jobs.inner.serving;
            let skin = match begun_with(folder, SKIN_FILE) {
                Some(text) if text.is_empty() => None,
                Some(text) => Some(CalibrationId::unchecked(text)),
                None => serving.promoted_skin().await?,
            };
            let text = skin.as_ref().map_or("", CalibrationId::as_str);
            write(folder, SKIN_FILE, text.as_bytes())?;
            let stored = skin.as_ref().map(|id| serving.skins().stored(id)).transpose()?;
            let calibration = stored.map(|stored| absolute(stored.path()));
            let cache = absolute(&cache);
            (serving.sensor_text().to_owned(), Source::Stream { calibration, cache })
        }
    };
    let skin = ImportedSensor::from_toml("sensor", &sensor)?;
    let skin_mm = skin.width_mm.max(skin.height_mm);
    if request.scale_map {
        recipe.map = recipe.map.map(|map| map.on_skin(skin_mm));
    }
    if let Some(map) = recipe.map.filter(|map| map.side_mm > 2.0 * skin_mm) {
        let message = format!(
            "map = {map}: most of it is beyond the skin of the sensor {}; state the side of its square, mm, as in {}",
            skin.name,
            map.on_skin(skin_mm)
        );
        warn(folder, watch, message);
    }
    let order = Order {
        version: ORDER_VERSION.into(),
        // A recipe was read from TOML and contains numbers, names and lists.
        recipe: toml::to_string(&recipe).unwrap_or_default(),
        code: code(),
        sensor,
        noise_sd_v,
        compute: None,
        source,
    };
    Ok((recipe, order))
}

/// What a model inherits from the lineage of its dataset.
pub(super) struct Inherited {
    pub(super) label: Label,
    /// Calibration of the dataset's twins.
    pub(super) calibration: Option<CalibrationId>,
    /// Hash of the model that simulated them.
    pub(super) simulation: Option<String>,
}

/// What the model of a recipe inherits from the lineage of its dataset.
pub(super) fn inherited(lineage: &Value, recipe: &Recipe) -> Inherited {
    // A net that reads no measured frames is of simulations.
    let label = origin::label(lineage).filter(|_| recipe.task().columns().contains(&MEASURED));
    let model = &lineage["models"][0];
    let text = |value: &Value| value.as_str().map(str::to_owned);
    Inherited {
        label: label.unwrap_or(Label::Simulated),
        calibration: text(&model["calibration"]).map(CalibrationId::unchecked),
        simulation: text(&model["model"]),
    }
}

/// The trainer need not run in this process's folder.
pub(super) fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Shows an event of the trainer in the job's progress.
fn show(event: Event, folder: &Path, watch: &Watch, starts: &Starts) {
    match event {
        Event::Phase { phase, total } => watch.phase(&phase, total),
        Event::Learned { done, total, new, elapsed_s, epoch, train_loss, validation_loss } => {
            watch.change(|shown| {
                shown.total = total;
                shown.epoch = Some(epoch);
                shown.train_loss = train_loss;
                shown.validation_loss = validation_loss.or(shown.validation_loss);
            });
            let elapsed = Duration::try_from_secs_f64(elapsed_s).unwrap_or_default();
            watch.done(done, new, elapsed.max(Duration::from_millis(1)));
        }
        Event::Checkpoint => starts.got_on(),
        Event::Warning { message } => warn(folder, watch, message),
        // The process's end reports these.
        Event::Done | Event::Stopped | Event::Failed { .. } => {}
    }
}

/// Reads the trainer's result, and checks that it is the one of the order.
///
/// # Errors
/// `JobError` if a file is missing or invalid, or of another order.
pub(super) fn result(folder: &Path, order: &Order, name: String) -> JobResult<NewModel> {
    let path = |name: &str| folder.join(name);
    let read = |name: &str| {
        fs::read_to_string(path(name)).map_err(LearnError::file("reading", &path(name)))
    };
    let (_, facts) = registry::facts("sensor", &order.sensor)?;
    let manifest = Manifest::from_toml(MANIFEST, &read(MANIFEST)?, &facts)?;
    let onnx = fs::read(path(ONNX)).map_err(LearnError::file("reading", &path(ONNX)))?;
    manifest.check_file(&onnx).map_err(LearnError::from)?;
    let same =
        manifest.model.recipe.as_ref() == Some(&order.recipe) && manifest.model.code == order.code;
    if !same {
        let limit = "is not of this recipe and code";
        return Err(LearnError::value("training", "result", MANIFEST, limit).into());
    }
    let residuals = match fs::read(path(RESIDUALS)) {
        Ok(bytes) => Some(serde_json::from_slice(&bytes).map_err(JobError::Json)?),
        Err(_) => None,
    };
    let losses = fs::read_to_string(path(LOSSES)).ok();
    Ok(NewModel { name, manifest, onnx, sensor: order.sensor.clone(), losses, residuals })
}

/// Id used at the first start, whatever the name refers to now.
fn begun_with(folder: &Path, name: &str) -> Option<String> {
    fs::read_to_string(folder.join(name)).ok()
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<(), LearnError> {
    new_file::write(folder, name, bytes).map_err(LearnError::file("writing", folder))?;
    Ok(())
}

/// Program and commit that train a model.
pub(super) fn code() -> String {
    let commit = crate::commit::known().unwrap_or("unknown");
    format!("palpate {} {commit}", env!("CARGO_PKG_VERSION"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_training_that_resumes_keeps_its_warnings() {
        let folder = tempfile::tempdir().unwrap();
        let starts = Starts::of(folder.path());
        let begin = |message: &str| {
            let watch = Watch::default();
            recall_warnings(folder.path(), &watch);
            show(Event::Warning { message: message.into() }, folder.path(), &watch, &starts);
            watch.progress().warnings
        };
        let [map, constant] = ["the map is large", "3 of 9 channels are constant"];
        assert_eq!(begin(map), [map]);
        assert_eq!(begin(constant), [map, constant]);
        assert_eq!(begin(map), [map, constant]);
    }
}
