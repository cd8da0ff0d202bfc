//! Skins prepared for fits of frames: the model of a calibration, and the errors of the model,
//! which are estimated from known trials, cached, and kept next to the calibration.
//! Uses: `known`, `exact`, `simulate::model`; an optional cache. Never: the serving slots.

use std::path::{Path, PathBuf};

use sim_core::calibration::Calibration;
use sim_core::forward::ForwardModel;
use sim_core::sensor::Sensor;
use tracing::Span;

use super::known::known_trials;
use super::skin_errors::LEAST_KNOWN;
use super::{ExactSkin, KnownTrials, SkinErrors};
use crate::calibrate::skin;
use crate::digest::Hashing;
use crate::ids::CalibrationId;
use crate::infer::error::{InferError, InferResult};
use crate::new_file;
use crate::simulate::model::load_or_build;
use crate::store::Store;

/// Version of the estimation of errors: part of the cache's key, and of the file next to a calibration.
const ERRORS_VERSION: &str = "9";

/// The file of a stored calibration.
#[derive(Debug, Clone)]
pub struct StoredCalibration(PathBuf);

impl StoredCalibration {
    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Reads it: large for a skin, so not on a thread that answers requests.
    ///
    /// # Errors
    /// `InferError::File` if the file cannot be read; `Calibration` if it is invalid.
    pub fn read(&self) -> InferResult<Calibration> {
        Ok(Calibration::from_toml(&self.text()?)?)
    }

    /// Returns its text.
    ///
    /// # Errors
    /// `InferError::File` if the file cannot be read.
    pub fn text(&self) -> InferResult<String> {
        std::fs::read_to_string(&self.0).map_err(InferError::file("reading", &self.0))
    }
}

/// The calibrations of a service and their skins.
pub struct Skins {
    store: Store,
    sensor: Sensor,
    data: PathBuf,
}

impl Skins {
    /// Calibrations of this rig's sensor in a data folder.
    pub fn new(store: Store, sensor: Sensor, data: &Path) -> Self {
        Self { store, sensor, data: data.to_owned() }
    }

    /// Prepares the skin of a calibration, or the nominal one. Takes most of a minute, and seconds
    /// if its errors are in the cache.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration, or the model or its errors cannot be computed.
    pub async fn ready(&self, calibration: Option<&CalibrationId>) -> InferResult<ExactSkin> {
        let model = self.model(calibration).await?;
        let known = known_trials(&self.store, model.sensor()).await?;
        let cache = self.data.join("cache");
        let name = |id: &CalibrationId| format!("{id}.errors-{ERRORS_VERSION}.json");
        let carried = calibration.map(|id| self.calibrations().join(name(id)));
        let span = Span::current();
        let building = move || span.in_scope(|| ready(&model, &known, &cache, carried.as_deref()));
        tokio::task::spawn_blocking(building).await.map_err(|_| InferError::Worker)?
    }

    /// Builds the model of a stored calibration, or the nominal one.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration, or the model cannot be built.
    pub async fn model(&self, calibration: Option<&CalibrationId>) -> InferResult<ForwardModel> {
        let calibration = calibration.map(|id| self.stored(id)).transpose()?;
        let (sensor, cache) = (self.sensor.clone(), self.data.join("cache"));
        let span = Span::current();
        let building = tokio::task::spawn_blocking(move || {
            let _inside = span.entered();
            let sensor = match calibration {
                Some(stored) => stored.read()?.apply(&sensor)?,
                None => sensor.into(),
            };
            Ok(load_or_build(sensor, &cache)?)
        });
        building.await.map_err(|_| InferError::Worker)?
    }

    /// Stores a calibration of this sensor; returns its id.
    ///
    /// # Errors
    /// `InferError::Calibration` if it is invalid or of another sensor; `File` if it cannot be
    /// written.
    pub fn keep(&self, text: &str) -> InferResult<CalibrationId> {
        let calibration = Calibration::from_toml(text)?;
        calibration.apply(&self.sensor)?;
        let id = CalibrationId::unchecked(calibration.id()?);
        let folder = self.calibrations();
        let failed = InferError::file("writing", &folder);
        new_file::write(&folder, &format!("{id}.toml"), text).map_err(failed)?;
        Ok(id)
    }

    /// Finds the file of a calibration; an id cannot address other files.
    ///
    /// # Errors
    /// `InferError::NoSkin` if there is no such calibration.
    pub fn stored(&self, id: &CalibrationId) -> InferResult<StoredCalibration> {
        let digits = id
            .as_str()
            .strip_prefix("cal-")
            .filter(|digits| !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_hexdigit()));
        let path = self.calibrations().join(format!("{id}.toml"));
        let is_here = digits.is_some() && path.is_file();
        is_here.then_some(StoredCalibration(path)).ok_or_else(|| InferError::NoSkin(id.clone()))
    }

    fn calibrations(&self) -> PathBuf {
        self.data.join("calibrations")
    }
}

/// Prepares a skin with the cached errors of these trials, or estimates them. With too few trials they are those of the
/// file `carried`, which is written where there are enough: a calibration has its errors also in another database.
fn ready(
    model: &ForwardModel,
    known: &KnownTrials,
    cache: &Path,
    carried: Option<&Path>,
) -> InferResult<ExactSkin> {
    let path = cache.join(format!("skin-errors-{}.json", &key(model, known)[..16]));
    let channels = model.sensor().channels();
    let read = |path: &Path| -> Option<SkinErrors> {
        let errors: SkinErrors = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        (errors.channels() == channels).then_some(errors)
    };
    if known.pressed.len() < LEAST_KNOWN
        && let Some(errors) = carried.and_then(read)
    {
        return ExactSkin::with(model, errors);
    }
    let cached = read(&path);
    let is_new = cached.is_none();
    let skin = match cached {
        Some(errors) => ExactSkin::with(model, errors)?,
        None => ExactSkin::new(model, known)?,
    };
    if is_new {
        keep(&path, skin.errors());
    }
    let is_learned = skin.errors.learnt_from > 0;
    if let Some(carried) = carried.filter(|file| is_learned && (is_new || !file.exists())) {
        keep(carried, skin.errors());
    }
    Ok(skin)
}

/// Writes errors to a file, from which a later start reads them.
fn keep(path: &Path, errors: &SkinErrors) {
    let write = || -> std::io::Result<()> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let folder = path.parent().unwrap_or(path);
        new_file::write(folder, &name, serde_json::to_vec(errors)?).map(|_| ())
    };
    if let Err(error) = write() {
        tracing::warn!(%error, path = %path.display(), "the errors of a skin were not kept");
    }
}

/// Hash (sha256) of everything on which a skin's errors depend.
fn key(model: &ForwardModel, known: &KnownTrials) -> String {
    let mut digest = Hashing::default();
    let calibration = model.sensor().calibration().unwrap_or_default();
    for words in [ERRORS_VERSION, env!("CARGO_PKG_VERSION"), model.model_hash(), calibration] {
        digest.update(words);
        digest.update([0]);
    }
    let untouched = &known.untouched;
    let pressed = || known.pressed.iter().chain(&known.crowded);
    let before = pressed().filter_map(|trial| trial.untouched.as_ref());
    let frames = untouched.frames_v.iter().chain(&untouched.tared_v);
    for frame_v in frames.chain(before.map(|skin| &skin.voltages_v)) {
        frame_v.iter().for_each(|v| digest.update(v.to_le_bytes()));
    }
    digest.update(known.untouched.hours.to_le_bytes());
    for trial in pressed() {
        digest.update(trial.configuration.to_le_bytes());
        digest.update(trial.frames.to_le_bytes());
        skin::digest_trial(&mut digest, &trial.contacts, &trial.frame_v);
    }
    digest.finish()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use crate::infer::methods::Frames;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use sim_core::forward::{Contact, Workspace};
    use sim_core::responses::UnitResponses;

    use super::*;
    use crate::infer::maps::ForceMaps;
    use crate::infer::methods::ReadyMethod;
    use crate::infer::methods::exact::{ExactPipeline, KnownTrial, Untouched};

    const SENSOR: &str = include_str!("../../../../../experiments/sensors/ert-28.toml");

    /// Single touches of a model with noise, 10 % stronger than their label, whose configurations have even numbers.
    fn trials(model: &ForwardModel, count: u32) -> Vec<KnownTrial> {
        let (mut rng, mut work) = (ChaCha8Rng::seed_from_u64(5), Workspace::default());
        let mut one = |trial: u32| {
            let configuration = 2 * trial;
            let contact = Contact {
                x_mm: rng.random_range(60.0..480.0),
                y_mm: rng.random_range(60.0..500.0),
                force_n: rng.random_range(10.0..30.0),
            };
            let pressed = Contact { force_n: 1.1 * contact.force_n, ..contact };
            let volts = model.voltages(&[pressed], &mut work).expect("a contact on the skin");
            let frame_v = volts.iter().map(|v| (v + rng.random_range(-2e-3..2e-3)) as f32);
            let (contacts, frame_v) = (vec![contact], frame_v.collect());
            KnownTrial { configuration, contacts, frame_v, frames: 1.0, untouched: None }
        };
        (0..count).map(&mut one).collect()
    }

    #[test]
    fn a_skin_from_the_cache_answers_as_the_one_that_was_learnt() {
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let responses = Arc::new(UnitResponses::solve(&sensor).unwrap());
        let model = ForwardModel::new(&sensor, responses).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let cache = folder.path();
        let trials = trials(&model, 80);
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut noise_v = |_| (0..784).map(|_| rng.random_range(-2e-3f32..2e-3)).collect();
        let frames_v: Vec<Vec<f32>> = (0..40).map(&mut noise_v).collect();
        let untouched = Untouched { frames_v, averaged: 1.0, hours: 3.0, ..Untouched::default() };
        let known = |count: usize| KnownTrials {
            pressed: trials[..count].to_vec(),
            untouched: untouched.clone(),
            ..Default::default()
        };
        let (known, fewer, other) = (known(70), known(69), &trials[75]);
        let answer = || {
            let skin = Arc::new(ready(&model, &known, cache, None).unwrap());
            let exact = ExactPipeline { skin, points: None };
            let read = exact.read(&Frames::single(&other.frame_v), ForceMaps::Without);
            read.unwrap().remove(0)
        };
        // A damaged file is not read, and replaced.
        let kept = cache.join(format!("skin-errors-{}.json", &key(&model, &known)[..16]));
        std::fs::write(&kept, "{").unwrap();
        let learnt = answer();
        let files = || std::fs::read_dir(cache).unwrap().count();
        assert_eq!((files(), learnt.contacts.len()), (1, 1));
        assert!(std::fs::read(&kept).unwrap().len() > 1);
        assert!(learnt.probability.is_some_and(|p| p > 0.0 && p <= 1.0 + 1e-9), "{learnt:?}");
        let again = answer();
        let [is, was] = [&again, &learnt].map(|reading| &reading.contacts[0]);
        // JSON may lose one digit of a number.
        assert!((is.x_mm - was.x_mm).abs() < 1e-4 && files() == 1);
        let [is, was] = [is, was].map(|contact| contact.force_sd_n.unwrap());
        assert!((is - was).abs() < 1e-6 * was, "{is} N for {was}");
        // Other trials have other errors.
        assert_ne!(key(&model, &known), key(&model, &fewer));
        // A calibration has its errors with it.
        let (carried, none) = (cache.join("cal-1.errors.json"), KnownTrials::default());
        let of =
            |known: &KnownTrials| ready(&model, known, cache, Some(carried.as_path())).unwrap();
        assert!(of(&none).limitation().is_some() && !carried.exists());
        assert!(of(&known).limitation().is_none() && carried.exists());
        let elsewhere = of(&none);
        assert_eq!((elsewhere.limitation(), elsewhere.errors().learnt_from), (None, 70));
        // Without untouched trials the drift is not known to be 0.
        let pressed = KnownTrials { untouched: Untouched::default(), ..known.clone() };
        let elsewhere = tempfile::tempdir().unwrap();
        let mut skin = ready(&model, &pressed, elsewhere.path(), None).unwrap();
        let words = skin.limitation().unwrap();
        assert!(words.contains("drift of the offsets is unknown"), "{words}");
        // A fit that is worse on held-out trials limits the answers, too.
        skin.worse = Some("the fit is worse".into());
        assert_eq!(skin.limitation().unwrap(), format!("the fit is worse; {words}"));
    }
}
