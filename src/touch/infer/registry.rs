//! The models of a service: their folders, and the loaded ones.
//! Uses: `store`, `learn::model_file`, `infer::plan`. Never: HTTP, which of them serve (`serving`).
//!
//! A model is a folder `DATA/models/mdl-..` with `model.onnx`, `manifest.toml`, `sensor.toml`, and
//! for those trained here `losses.ndjson` and `residuals.json`. The folder is complete before its row
//! is stored; it never changes.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parking_lot::Mutex;
use sim_core::sensor::Sensor;

use super::error::{InferError, InferResult};
use super::plan::Plan;
use super::slot::Slot;
use crate::clock::Clock;
use crate::dataset::import::sensor::ImportedSensor;
use crate::ids::{ModelId, PromotedId};
use crate::learn::model_file::{Manifest, ModelFacts};
use crate::learn::order::{LOSSES, MANIFEST, ONNX, RESIDUALS};
use crate::learn::residuals::Residuals;
use crate::learn::task::SensorFacts;
use crate::new_file::{self, sweep};
use crate::problem::Problem;
use crate::store::{ModelRow, Store};

/// Name of a model's sensor file.
pub const SENSOR_FILE: &str = "sensor.toml";
/// Number of models that stay loaded in addition to those in use.
const LOADED_MAX: usize = 8;
/// Shortest start of an id that names a model: `mdl-` and 6 digits.
const ID_START_MIN_CHARS: usize = 10;

/// The files and facts of a model to be added.
#[derive(Debug, Clone)]
pub struct NewModel {
    /// Name of the model.
    pub name: String,
    /// Manifest of the model.
    pub manifest: Manifest,
    /// Contents of its ONNX file.
    pub onnx: Vec<u8>,
    /// Text of its sensor file.
    pub sensor: String,
    /// Losses of its training, one JSON object per line.
    pub losses: Option<String>,
    /// Residuals; only of a Transfer-Net.
    pub residuals: Option<Residuals>,
}

impl NewModel {
    /// Checks that the model can be loaded and run.
    ///
    /// # Errors
    /// `InferError::Plan` if it cannot; `Worker` if the thread ended early.
    pub async fn try_out(&self) -> InferResult<()> {
        let (onnx, facts) = (self.onnx.clone(), self.manifest.model.clone());
        let trying = tokio::task::spawn_blocking(move || {
            Plan::load(&onnx, facts.channels, &facts.output_shape).map(|_| ())
        });
        trying.await.map_err(|_| InferError::Worker)?.map_err(InferError::from)
    }

    /// Returns the model as a loaded one.
    ///
    /// # Errors
    /// `InferError::Problems` if its sensor file is invalid; `Plan` if it cannot be run.
    pub fn load(&self) -> InferResult<Model> {
        let skin = ImportedSensor::from_toml(SENSOR_FILE, &self.sensor);
        let skin = skin.map_err(InferError::Problems)?;
        let ModelFacts { channels, output_shape, .. } = &self.manifest.model;
        Ok(Model {
            name: self.name.clone(),
            manifest: self.manifest.clone(),
            skin,
            points_mm: points_mm(&self.sensor),
            plan: Plan::load(&self.onnx, *channels, output_shape)?,
        })
    }

    /// Writes the files of the model into a folder, which is created if needed; the manifest last.
    ///
    /// # Errors
    /// `InferError::File` if a file cannot be written; `Json` if the residuals are not finite.
    pub fn save(&self, folder: &Path) -> InferResult<()> {
        let residuals = self.residuals.as_ref().map(serde_json::to_vec).transpose();
        let path = || folder.join(RESIDUALS);
        let residuals = residuals.map_err(|source| InferError::Json { path: path(), source })?;
        let manifest = self.manifest.to_toml();
        // The manifest is written last: a folder without one is incomplete.
        let files = [
            (ONNX, Some(self.onnx.as_slice())),
            (SENSOR_FILE, Some(self.sensor.as_bytes())),
            (LOSSES, self.losses.as_deref().map(str::as_bytes)),
            (RESIDUALS, residuals.as_deref()),
            (MANIFEST, Some(manifest.as_bytes())),
        ];
        for (name, bytes) in files {
            let Some(bytes) = bytes else { continue };
            let failed = InferError::file("writing", &folder.join(name));
            new_file::write(folder, name, bytes).map_err(failed)?;
        }
        Ok(())
    }
}

/// A loaded model.
pub struct Model {
    /// Name of the model.
    pub name: String,
    /// Manifest of the model.
    pub manifest: Manifest,
    /// Skin of its sensor.
    pub skin: ImportedSensor,
    /// Positions of its sensor's points, mm; empty if the sensor file is not one of Palpate's.
    pub points_mm: Vec<[f64; 2]>,
    /// Plan that runs the net.
    pub plan: Plan,
}

impl Model {
    /// Width and height of the skin, mm.
    pub fn size_mm(&self) -> [f64; 2] {
        [self.skin.width_mm, self.skin.height_mm]
    }

    /// The slot in which the model serves.
    pub fn slot(&self) -> Slot {
        Slot::of(self.manifest.model.task)
    }

    /// Checks that the model is for a sensor.
    ///
    /// # Errors
    /// `InferError::OtherSensor` if it is not.
    pub fn is_for(&self, sensor: &str, channels: usize) -> InferResult<()> {
        let facts = &self.manifest.model;
        if facts.sensor == sensor && facts.channels == channels {
            return Ok(());
        }
        Err(InferError::OtherSensor {
            id: self.manifest.id.to_string(),
            sensor: facts.sensor.clone(),
            channels: facts.channels,
            here: format!("{sensor} with {channels}"),
        })
    }

    /// The error for a model whose task is not the one needed.
    pub fn of_other_task(&self, wanted: &'static str) -> InferError {
        let (id, task) = (self.manifest.id.clone(), self.manifest.model.task.as_str());
        InferError::OtherTask { id, task, wanted }
    }
}

impl std::fmt::Debug for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Model").field("id", &self.manifest.id).finish_non_exhaustive()
    }
}

/// Facts of a sensor file that a model must match.
///
/// # Errors
/// All problems of the file.
pub fn facts(file: &str, text: &str) -> Result<(ImportedSensor, SensorFacts), Vec<Problem>> {
    let skin = ImportedSensor::from_toml(file, text)?;
    let points = points_mm(text).len();
    let facts = SensorFacts { name: skin.name.clone(), channels: skin.channels, points };
    Ok((skin, facts))
}

/// Positions of a sensor's points, mm; empty if the file is not one of Palpate's.
pub fn points_mm(text: &str) -> Vec<[f64; 2]> {
    let sensor = Sensor::from_toml(text);
    sensor.map_or_else(|_| Vec::new(), |s| s.points().iter().map(|p| [p.x_mm, p.y_mm]).collect())
}

/// The models of a service. Clones share them.
#[derive(Clone)]
pub struct Registry {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    folder: PathBuf,
    clock: Clock,
    /// Loaded models, the most recently used last.
    loaded: Mutex<Vec<Arc<Model>>>,
}

impl Registry {
    /// Opens the models of a data folder. Incomplete files of a killed process are removed, except behind a link: they may
    /// be those of a process that runs.
    ///
    /// # Errors
    /// `InferError::File` if an incomplete file cannot be removed.
    pub fn open(store: Store, data: &Path, clock: Clock) -> InferResult<Self> {
        let folder = data.join("models");
        let entries = fs::read_dir(&folder).into_iter().flatten().flatten();
        for entry in entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir())) {
            sweep(&entry.path()).map_err(InferError::file("sweeping", &folder))?;
        }
        Ok(Self { inner: Arc::new(Inner { store, folder, clock, loaded: Mutex::default() }) })
    }

    /// Adds a model. An existing one with the same id does not change, unless its files are damaged: they are written
    /// again.
    ///
    /// # Errors
    /// `InferError::File` if the folder cannot be written; `Store` if the row cannot.
    pub async fn add(&self, new: NewModel) -> InferResult<ModelRow> {
        let row = ModelRow {
            id: new.manifest.id.clone(),
            name: new.name.clone(),
            task: new.manifest.model.task.as_str().into(),
            manifest: new.manifest.to_toml(),
            created_at: self.inner.clock.timestamp(),
        };
        let folder = self.folder(&row.id);
        let known = self.inner.store.model(row.id.as_str()).await?;
        let known = known.filter(|known| known.id == row.id);
        let writing = tokio::task::spawn_blocking(move || match known {
            // The id covers neither the sensor file nor the residuals: those of a whole model stay.
            Some(known) if read(&folder, &known).is_ok() => Ok(()),
            _ => new.save(&folder),
        });
        writing.await.map_err(|_| InferError::Worker)??;
        self.inner.store.insert_model(row.clone()).await?;
        self.find(row.id.as_str()).await
    }

    /// Returns the model with an id, or the newest one with a name, or the only one whose id begins like this, or the
    /// promoted one of a slot and a sensor: `position@pad-60`.
    ///
    /// # Errors
    /// `InferError::NoModel` if there is none; `SeveralModels` if several ids begin like this; `Store` if the store
    /// fails.
    pub async fn find(&self, id_or_name: &str) -> InferResult<ModelRow> {
        let promoted = match id_or_name.split_once('@') {
            Some((slot, sensor)) => self.inner.store.promoted(slot, sensor).await?,
            None => None,
        };
        let id_or_name = promoted.as_ref().map_or(id_or_name, PromotedId::as_str);
        match self.inner.store.model(id_or_name).await? {
            Some(row) => Ok(row),
            None => only(self.inner.store.models().await?, id_or_name),
        }
    }

    /// Returns a loaded model. The first call takes longer.
    ///
    /// # Errors
    /// `InferError` if there is no such model, or its files are damaged.
    pub async fn load(&self, id_or_name: &str) -> InferResult<Arc<Model>> {
        let row = self.find(id_or_name).await?;
        let found = self.loaded(|models| {
            let at = models.iter().position(|model| model.manifest.id == row.id)?;
            let model = models.remove(at);
            models.push(model.clone());
            Some(model)
        });
        if let Some(model) = found {
            return Ok(model);
        }
        let folder = self.folder(&row.id);
        let loading = tokio::task::spawn_blocking(move || read(&folder, &row));
        let model = Arc::new(loading.await.map_err(|_| InferError::Worker)??);
        self.loaded(|models| {
            models.push(model.clone());
            let over = models.len().saturating_sub(LOADED_MAX);
            models.drain(..over);
        });
        Ok(model)
    }

    /// Returns the residuals of a Transfer-Net.
    ///
    /// # Errors
    /// `InferError` if there is no such model, or it has no residuals.
    pub async fn residuals(&self, id_or_name: &str) -> InferResult<Residuals> {
        let row = self.find(id_or_name).await?;
        let path = self.folder(&row.id).join(RESIDUALS);
        let text = fs::read_to_string(&path).map_err(InferError::file("reading", &path))?;
        serde_json::from_str(&text).map_err(|source| InferError::Json { path, source })
    }

    /// The losses of a model's training, one JSON object per line; `None` if it was not trained
    /// here.
    pub fn losses(&self, id: &ModelId) -> Option<String> {
        fs::read_to_string(self.folder(id).join(LOSSES)).ok()
    }

    /// Path of a model's ONNX file.
    pub fn onnx(&self, id: &ModelId) -> PathBuf {
        self.folder(id).join(ONNX)
    }

    fn folder(&self, id: &ModelId) -> PathBuf {
        self.inner.folder.join(id.as_str())
    }

    fn loaded<T>(&self, with: impl FnOnce(&mut Vec<Arc<Model>>) -> T) -> T {
        with(&mut self.inner.loaded.lock())
    }
}

/// Returns the only model whose id begins with `start`: `mdl-` and at least 6 digits.
fn only(models: Vec<ModelRow>, start: &str) -> InferResult<ModelRow> {
    let is_start = start.len() >= ID_START_MIN_CHARS && start.starts_with("mdl-");
    let begins = |row: &ModelRow| is_start && row.id.as_str().starts_with(start);
    let mut found: Vec<ModelRow> = models.into_iter().filter(begins).collect();
    if found.len() > 1 {
        let ids: Vec<&str> = found.iter().map(|row| row.id.as_str()).collect();
        return Err(InferError::SeveralModels { start: start.into(), ids: ids.join(", ") });
    }
    found.pop().ok_or_else(|| InferError::NoModel(start.into()))
}

fn read(folder: &Path, row: &ModelRow) -> InferResult<Model> {
    let text = |name: &str| {
        let path = folder.join(name);
        fs::read_to_string(&path).map_err(InferError::file("reading", &path))
    };
    let sensor = text(SENSOR_FILE)?;
    let (skin, facts) = facts(SENSOR_FILE, &sensor).map_err(InferError::Problems)?;
    let manifest = Manifest::from_toml(MANIFEST, &text(MANIFEST)?, &facts);
    let manifest = manifest.map_err(InferError::Problems)?;
    let path = folder.join(ONNX);
    let onnx = fs::read(&path).map_err(InferError::file("reading", &path))?;
    manifest.check_file(&onnx)?;
    let plan = Plan::load(&onnx, manifest.model.channels, &manifest.model.output_shape)?;
    Ok(Model { name: row.name.clone(), manifest, skin, points_mm: points_mm(&sensor), plan })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_start_of_an_id_names_a_model_if_it_is_the_only_one() {
        let created_at = Clock::new(1.0).timestamp();
        let row = |id: &str| ModelRow {
            id: ModelId::unchecked(id),
            name: "net".into(),
            task: "transfer".into(),
            manifest: String::new(),
            created_at,
        };
        let models = ["mdl-0123456789abcdef", "mdl-0123457789abcdef"].map(row).to_vec();
        let of = |start: &str| only(models.clone(), start).map_err(|error| error.to_string());
        assert_eq!(of("mdl-0123456"), Ok(models[0].clone()));
        assert_eq!(of("mdl-0123457"), Ok(models[1].clone()));
        assert_eq!(
            of("mdl-012345"),
            Err("model mdl-012345: several ids begin like this, state more digits of one: \
                 mdl-0123456789abcdef, mdl-0123457789abcdef"
                .to_owned())
        );
        for unknown in ["mdl-999999", "mdl-01234", "0123456789", "mdl-0123456789abcdef0", ""] {
            assert_eq!(of(unknown), Err(InferError::NoModel(unknown.into()).to_string()));
        }
        let short = only(vec![models[0].clone()], "mdl-01234");
        assert!(matches!(short, Err(InferError::NoModel(_))), "5 digits: {short:?}");
    }
}
