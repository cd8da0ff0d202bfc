//! Forward models of skins, kept warm for the twins and for simulations on request.
//! Uses: `simulate::model`, sim-core. Never: more than a few models; a wait of the campaign.

use std::path::PathBuf;
use std::sync::Arc;

use sim_core::calibration::{Calibration, CalibrationError};
use sim_core::forward::{ContactError, ForwardModel, Workspace};
use sim_core::sensor::{Sensor, SensorError};
use tokio::sync::Mutex;
use tracing::Instrument;

use crate::dataset::background::background;
use crate::ids::CalibrationId;
use crate::infer::error::InferError;
use crate::infer::methods::exact::skins::StoredCalibration;
use crate::simulate::model::{ModelUnavailable, load_or_build};

/// Largest number of models that are kept; one has about 60 MB.
const MODELS_KEPT: usize = 3;

/// Why the model of a skin is not available.
#[derive(Debug, thiserror::Error)]
pub enum SkinError {
    /// The sensor file is invalid, or of another kind of skin.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The calibration cannot be applied.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The calibration cannot be read.
    #[error(transparent)]
    Stored(#[from] InferError),
    /// The model cannot be built.
    #[error(transparent)]
    Model(#[from] ModelUnavailable),
    /// The untouched skin cannot be simulated.
    #[error(transparent)]
    Untouched(#[from] ContactError),
    /// A worker panicked.
    #[error("a worker panicked")]
    Worker,
}

/// The model of a skin, and its frame without contact.
#[derive(Debug)]
pub struct WarmSkin {
    /// Forward model of the skin with its calibration.
    pub model: Arc<ForwardModel>,
    /// Frame of the untouched skin, V, injection-major.
    pub untouched_v: Vec<f64>,
}

/// Where a calibration is read from if its model is not kept.
#[derive(Debug, Clone)]
pub enum Source {
    /// It was read already.
    Here(Arc<Calibration>),
    /// File of the calibration in the data folder.
    Stored(StoredCalibration),
}

/// A calibration of a skin.
#[derive(Debug, Clone)]
pub struct SkinCalibration {
    /// Id of the calibration.
    pub id: CalibrationId,
    /// Where it is read from.
    pub source: Source,
}

/// The kept models, the most recently used one last. Clones share them.
#[derive(Clone)]
pub struct WarmSkins {
    cache_dir: PathBuf,
    kept: Arc<Mutex<Vec<Kept>>>,
}

struct Kept {
    sensor_text: String,
    calibration: Option<CalibrationId>,
    skin: Arc<WarmSkin>,
}

impl WarmSkins {
    /// Keeps no model yet; unit responses are cached in `cache_dir`.
    pub fn new(cache_dir: PathBuf) -> Self {
        Self { cache_dir, kept: Arc::default() }
    }

    /// Returns the model of a sensor file with a calibration. Building one takes seconds; further
    /// requests wait meanwhile.
    ///
    /// # Errors
    /// `SkinError` if a file cannot be used or the model cannot be built.
    pub async fn of(
        &self,
        sensor_text: &str,
        calibration: Option<SkinCalibration>,
    ) -> Result<Arc<WarmSkin>, SkinError> {
        // A client that does not wait finds the model at its next request.
        let finding = self.clone().find_or_build(sensor_text.to_owned(), calibration);
        tokio::spawn(finding.in_current_span()).await.map_err(|_| SkinError::Worker)?
    }

    async fn find_or_build(
        self,
        sensor_text: String,
        calibration: Option<SkinCalibration>,
    ) -> Result<Arc<WarmSkin>, SkinError> {
        let (id, source) = calibration.map(|of| (of.id, of.source)).unzip();
        let mut kept = self.kept.lock().await;
        let is_it = |k: &Kept| k.sensor_text == sensor_text && k.calibration == id;
        if let Some(at) = kept.iter().position(is_it) {
            let found = kept.remove(at);
            let skin = found.skin.clone();
            kept.push(found);
            return Ok(skin);
        }
        let (text, cache_dir) = (sensor_text.clone(), self.cache_dir.clone());
        let building = move || -> Result<WarmSkin, SkinError> {
            let sensor = Sensor::from_toml(&text)?;
            let sensor = match source {
                Some(Source::Here(calibration)) => calibration.apply(&sensor)?,
                Some(Source::Stored(file)) => file.read()?.apply(&sensor)?,
                None => sensor.into(),
            };
            let model = load_or_build(sensor, &cache_dir)?;
            let untouched_v = model.voltages(&[], &mut Workspace::default())?.to_vec();
            Ok(WarmSkin { model: Arc::new(model), untouched_v })
        };
        let skin = Arc::new(background(building).await.map_err(|_| SkinError::Worker)??);
        if kept.len() >= MODELS_KEPT {
            kept.remove(0);
        }
        kept.push(Kept { sensor_text, calibration: id, skin: skin.clone() });
        Ok(skin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: &str = include_str!("../../../experiments/sensors/ert-28.toml");

    #[tokio::test]
    async fn the_models_that_were_used_last_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let skins = WarmSkins::new(folder.path().join("cache"));
        let get = async |n: usize| {
            let text = format!("# {n}\n{SENSOR}");
            skins.of(&text, None).await.unwrap()
        };
        let first = get(0).await;
        assert_eq!(first.untouched_v.len(), 784);
        assert!(Arc::ptr_eq(&first, &get(0).await));
        let mut others = Vec::new();
        for n in 1..MODELS_KEPT {
            others.push(get(n).await);
        }
        // The first one was used again: the second one goes.
        assert!(Arc::ptr_eq(&first, &get(0).await));
        get(MODELS_KEPT).await;
        assert!(Arc::ptr_eq(&first, &get(0).await));
        assert!(!Arc::ptr_eq(&others[0], &get(1).await));
        assert_eq!(skins.kept.lock().await.len(), MODELS_KEPT);
        let refused = skins.of("name = 1", None).await;
        assert!(matches!(refused, Err(SkinError::Sensor(_))));
    }
}
