//! A training as a job: makes its dataset, gathers examples, trains the net, stores the model.
//! Uses: `learn`, `infer::registry`, `dataset`. Never: HTTP, a checkpoint of other data.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nets::device::Compute;
use nets::train::{End, Flow, Observer, Progress};
use serde_json::{Value, json};
use sim_core::forward::ForwardModel;

use super::error::JobError;
use super::starts::Starts;
use super::{CHECKPOINT, Jobs, LOSSES, Watch};
use crate::clock::Clock;
use crate::dataset::background::background;
use crate::dataset::build::data_file;
use crate::ids::{CalibrationId, DatasetId, ModelId};
use crate::infer::registry::{self, NewModel};
use crate::learn::error::LearnError;
use crate::learn::examples::{Examples, MEASURED};
use crate::learn::model_file::{ModelFacts, model_of};
use crate::learn::recipe::Recipe;
use crate::learn::train::{self, Given, Learned};
use crate::new_file;
use crate::store::{DatasetRow, Label, TaskRow};

/// Name of the file with the id of the calibration whose simulations the training uses; empty for
/// the nominal skin.
const SKIN: &str = "skin";
/// Name of the file with the id of the Transfer-Net whose residuals are the noise.
const NOISE: &str = "noise";
/// Interval between two checkpoints, s.
const CHECKPOINT_EVERY_S: f64 = 30.0;

/// Checks a recipe.
///
/// # Errors
/// `JobError::Problems` with all problems of the recipe.
pub fn check(recipe: &str) -> Result<(), JobError> {
    Recipe::from_toml("recipe", recipe)?;
    Ok(())
}

/// Runs a training; `None` if it was stopped.
///
/// # Errors
/// `JobError` if the dataset, the training or the storage of the model fails.
pub async fn run(
    jobs: &Jobs,
    job: &TaskRow,
    watch: &Arc<Watch>,
) -> Result<Option<Value>, JobError> {
    let text = job.request["recipe"].as_str().unwrap_or_default();
    let mut recipe = Recipe::from_toml("recipe", text)?;
    let folder = jobs.folder(job.id);
    let noise_sd_v = match &recipe.noise_of {
        Some(name) => {
            // After a restart: the model of the first start, not the current one of that name.
            let id = match begun_with(&folder, NOISE) {
                Some(text) => ModelId::unchecked(text),
                None => jobs.inner.models.find(name).await?.id,
            };
            begin_with(&folder, NOISE, id.as_str())?;
            recipe.noise_of = Some(id.to_string());
            Some(jobs.inner.models.residuals(id.as_str()).await?.sd_v)
        }
        None => None,
    };
    let work = Work {
        recipe,
        folder: folder.clone(),
        scratch: jobs.inner.data.join("cache"),
        noise_sd_v,
        watch: watch.clone(),
        clock: jobs.inner.clock.clone(),
    };
    let made = match &work.recipe.dataset {
        Some(name) => {
            watch.phase("making the dataset", 0);
            // After a restart: the dataset of the first start, not the current one of that name.
            let name = job.dataset.as_ref().map_or(name.as_str(), DatasetId::as_str);
            let dataset = jobs.inner.datasets.resolve(name).await?;
            jobs.inner.store.begin_task(job.id, Some(&dataset.id)).await?;
            let file = data_file(&jobs.inner.datasets.datasets(), &dataset.id);
            background(move || work.on_dataset(&dataset, &file)).await??
        }
        None => {
            let serving = &jobs.inner.serving;
            let skin = match begun_with(&folder, SKIN) {
                Some(text) if text.is_empty() => None,
                Some(text) => Some(CalibrationId::unchecked(text)),
                None => serving.promoted_skin().await?,
            };
            let text = skin.as_ref().map_or("", CalibrationId::as_str);
            begin_with(&folder, SKIN, text)?;
            let (sensor, model) = serving.simulation(skin.as_ref()).await?;
            background(move || work.on_stream(sensor, &model)).await??
        }
    };
    let Some(new) = made else { return Ok(None) };
    watch.phase("storing the model", 0);
    let model = jobs.inner.models.add(new).await?;
    Ok(Some(json!({ "model": model.id, "name": model.name })))
}

/// Id used at the first start, whatever the name refers to now.
fn begun_with(folder: &Path, name: &str) -> Option<String> {
    std::fs::read_to_string(folder.join(name)).ok()
}

fn begin_with(folder: &Path, name: &str, what: &str) -> Result<(), LearnError> {
    write_whole(folder, name, what.as_bytes()).map_err(LearnError::file("writing", folder))
}

/// Inputs of a running training.
struct Work {
    recipe: Recipe,
    folder: PathBuf,
    scratch: PathBuf,
    noise_sd_v: Option<Vec<f32>>,
    watch: Arc<Watch>,
    clock: Clock,
}

impl Work {
    fn on_dataset(self, dataset: &DatasetRow, file: &Path) -> Result<Option<NewModel>, JobError> {
        self.watch.phase("gathering frames", dataset.rows);
        let columns = self.recipe.task().columns();
        let sensor = crate::dataset::read::sensor_text(file)?;
        let (skin, _) = registry::facts("sensor", &sensor)?;
        let conditions = &self.recipe.conditions;
        let examples = Examples::gather(file, conditions, columns, &self.scratch)?;
        let given = Given {
            data: std::iter::once(dataset.id.as_str())
                .chain(conditions.iter().map(String::as_str))
                .collect::<Vec<_>>()
                .join(" "),
            examples: &examples,
            skin: &skin,
            noise_sd_v: self.noise_sd_v.clone(),
            compute: compute(),
        };
        let mut observer = self.observer("training")?;
        let checkpoint = std::fs::read(self.folder.join(CHECKPOINT)).ok();
        let learned = train::train(&self.recipe, &given, checkpoint.as_deref(), &mut observer)?;
        let lineage = Lineage::of(dataset, columns.contains(&MEASURED));
        self.new_model(learned, lineage, sensor)
    }

    fn on_stream(self, sensor: String, model: &ForwardModel) -> Result<Option<NewModel>, JobError> {
        let mut observer = self.observer("training on simulations")?;
        let checkpoint = std::fs::read(self.folder.join(CHECKPOINT)).ok();
        let learned = train::train_on_stream(
            &self.recipe,
            model,
            compute(),
            checkpoint.as_deref(),
            &mut observer,
        )?;
        let lineage = Lineage {
            label: Label::Simulated,
            dataset: None,
            calibration: model.sensor().calibration().map(CalibrationId::unchecked),
            simulation: Some(model.model_hash().into()),
        };
        self.new_model(learned, lineage, sensor)
    }

    /// Converts the result to a model; `None` if the training was stopped.
    fn new_model(
        &self,
        learned: Learned,
        from: Lineage,
        sensor: String,
    ) -> Result<Option<NewModel>, JobError> {
        if learned.trained.end == End::Stopped {
            return Ok(None);
        }
        let (_, facts) = registry::facts("sensor", &sensor)?;
        let model = ModelFacts {
            task: self.recipe.task(),
            label: from.label,
            sensor: facts.name.clone(),
            channels: facts.channels,
            output_shape: learned.trained.network.output.clone(),
            force_map: self.recipe.map,
            datasets: from.dataset.into_iter().collect(),
            calibration: from.calibration,
            simulation: from.simulation,
            code: code(),
            recipe: Some(self.recipe_text()),
            trained_on: learned.range,
        };
        let made = model_of(&learned.trained.network, model, &facts);
        let (manifest, onnx) = made.map_err(LearnError::from)?;
        let residuals = learned.residuals;
        let losses = std::fs::read_to_string(self.folder.join(LOSSES)).ok();
        let name = self.recipe.name.clone();
        Ok(Some(NewModel { name, manifest, onnx, sensor, losses, residuals }))
    }

    fn recipe_text(&self) -> String {
        // A recipe was read from TOML and contains numbers, names and lists.
        toml::to_string(&self.recipe).unwrap_or_default()
    }

    fn observer(&self, phase: &str) -> Result<JobObserver<'_>, JobError> {
        new_file::make_folder(&self.folder).map_err(LearnError::file("making", &self.folder))?;
        self.watch.phase(phase, 0);
        let began_s = self.clock.process_s();
        Ok(JobObserver { work: self, began_s, first: None, kept_s: began_s })
    }
}

/// Reports the progress of a training, and stores its checkpoints and losses.
struct JobObserver<'a> {
    work: &'a Work,
    began_s: f64,
    /// Number of samples that were learned before this start.
    first: Option<u64>,
    kept_s: f64,
}

impl Observer for JobObserver<'_> {
    fn see(&mut self, progress: &Progress) -> Flow {
        let now_s = self.work.clock.process_s();
        let [done, total] = progress.samples;
        let first = *self.first.get_or_insert(done);
        let elapsed = std::time::Duration::from_secs_f64((now_s - self.began_s).max(1e-3));
        self.work.watch.change(|shown| {
            shown.total = total;
            shown.epoch = Some(u64::from(progress.epoch) + 1);
            shown.train_loss = Some(progress.train_loss);
            shown.validation_loss = progress.validation_loss.or(shown.validation_loss);
        });
        self.work.watch.done(done, done - first, elapsed);
        if let Some(validation) = progress.validation_loss {
            self.write_loss(progress, validation, now_s - self.began_s);
        }
        if self.work.watch.is_stopped() {
            Flow::Stop
        } else if now_s - self.kept_s >= CHECKPOINT_EVERY_S {
            self.kept_s = now_s;
            Flow::Checkpoint
        } else {
            Flow::Continue
        }
    }

    fn keep(&mut self, checkpoint: Vec<u8>) {
        let folder = &self.work.folder;
        match write_whole(folder, CHECKPOINT, &checkpoint) {
            Ok(()) => Starts::of(folder).got_on(),
            // The training continues; a restart resumes from an older checkpoint.
            Err(error) => {
                tracing::warn!(%error, folder = %folder.display(), "a checkpoint was not stored");
            }
        }
    }
}

impl JobObserver<'_> {
    fn write_loss(&self, progress: &Progress, validation: f64, elapsed_s: f64) {
        let line = json!({
            "epoch": progress.epoch + 1, "samples": progress.samples[0],
            "train_loss": progress.train_loss, "validation_loss": validation,
            "elapsed_s": elapsed_s,
        });
        let path = self.work.folder.join(LOSSES);
        let known = std::fs::read_to_string(&path).unwrap_or_default();
        // After a restart, epochs since the last checkpoint are repeated: the later line is valid.
        let before = |line: &&str| {
            let known: Option<Value> = serde_json::from_str(line).ok();
            known.is_some_and(|k| k["epoch"].as_u64() < Some(u64::from(progress.epoch) + 1))
        };
        let mut text: String = known.lines().filter(before).map(|l| format!("{l}\n")).collect();
        text += &format!("{line}\n");
        if let Err(error) = write_whole(&self.work.folder, LOSSES, text.as_bytes()) {
            tracing::warn!(%error, "losses were not stored");
        }
    }
}

fn write_whole(folder: &Path, name: &str, bytes: &[u8]) -> std::io::Result<()> {
    new_file::write(folder, name, bytes).map(|_| ())
}

/// Lineage that a model inherits from its dataset.
struct Lineage {
    label: Label,
    dataset: Option<DatasetId>,
    calibration: Option<CalibrationId>,
    simulation: Option<String>,
}

impl Lineage {
    /// Lineage of a dataset; `measured`: whether its measured frames are read.
    fn of(dataset: &DatasetRow, measured: bool) -> Self {
        let lineage = &dataset.lineage;
        let label = serde_json::from_value(lineage["runs"][0]["label"].clone()).ok();
        let label = label.filter(|_| measured);
        let model = &lineage["models"][0];
        let text = |value: &Value| value.as_str().map(str::to_owned);
        Self {
            label: label.unwrap_or(Label::Simulated),
            dataset: Some(dataset.id.clone()),
            calibration: text(&model["calibration"]).map(CalibrationId::unchecked),
            simulation: text(&model["model"]),
        }
    }
}

/// Device of trainings: that of this build.
fn compute() -> Compute {
    #[cfg(feature = "cuda")]
    return Compute::Cuda(0);
    #[cfg(all(feature = "wgpu", not(feature = "cuda")))]
    return Compute::Wgpu;
    #[cfg(not(any(feature = "cuda", feature = "wgpu")))]
    Compute::Cpu { threads: 0 }
}

/// Program and commit that train a model.
fn code() -> String {
    let commit = crate::commit::known().unwrap_or("unknown");
    format!("palpate {} {commit}", env!("CARGO_PKG_VERSION"))
}
