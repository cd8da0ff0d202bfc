//! Skins prepared for fits of frames: the model of a calibration, and the errors of the model,
//! which are estimated from known trials and cached.
//! Uses: `store`, `exact`, `simulate::model`; an optional cache. Never: the serving slots.

use std::path::{Path, PathBuf};

use sim_core::calibrated::CalibratedSensor;
use sim_core::calibration::Calibration;
use sim_core::forward::ForwardModel;
use sim_core::sensor::Sensor;
use tracing::Span;

use super::{ExactSkin, KnownTrial, KnownTrials, SkinErrors, Untouched};
use crate::calibrate::skin;
use crate::dataset::pressed::{clock_rate, contacts, force_noise_n, tips_mm};
use crate::digest::Hashing;
use crate::ids::{CalibrationId, TrialId};
use crate::infer::error::InferError;
use crate::infer::untouched::UntouchedSkins;
use crate::new_file;
use crate::problem::Problem;
use crate::simulate::model::load_or_build;
use crate::state::StoredState;
use crate::store::{Condition, Label, MAX_PAGE, RunKind, RunRow, Store, TrialQuery, TrialRow};

/// Number of newest runs that are searched for the one with the known trials.
const RUNS_LOOKED_AT: u32 = 1000;
/// Largest number of known trials.
const KNOWN_TRIALS: usize = 1000;
/// Largest number of contacts, and largest force, N, of known trials: heavier frames have other
/// errors, and contacts that are hard to distinguish are light.
const KNOWN_CONTACTS: f64 = 3.0;
const KNOWN_FORCE_N: f64 = 40.0;
/// Largest number of untouched trials.
const UNTOUCHED_TRIALS: usize = 300;
/// Force below which a trial is untouched, N: a twentieth of the signal of the paper's deadband, noise of the
/// cells.
pub const UNTOUCHED_N: f64 = 0.5;

/// Version of the estimation of errors: part of the cache's key.
const ERRORS_VERSION: &str = "4";

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
    pub fn read(&self) -> Result<Calibration, InferError> {
        let text = std::fs::read_to_string(&self.0);
        let text = text.map_err(InferError::file("reading", &self.0))?;
        Ok(Calibration::from_toml(&text)?)
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
    pub async fn ready(
        &self,
        calibration: Option<&CalibrationId>,
    ) -> Result<ExactSkin, InferError> {
        let model = self.model(calibration).await?;
        let known = self.known_trials(model.sensor()).await?;
        let cache = self.data.join("cache");
        let span = Span::current();
        let building = move || span.in_scope(|| ready(&model, &known, &cache));
        tokio::task::spawn_blocking(building).await.map_err(|_| InferError::Worker)?
    }

    /// Trials of the run that a skin was calibrated to, or else of the newest Real-Hex run on this
    /// sensor, or else of the newest imported run on it: taken evenly from the untouched ones, and from those with few
    /// contacts above its deadband, of configurations to which no skin is fitted. Empty if the store does not have
    /// that run.
    async fn known_trials(&self, sensor: &CalibratedSensor) -> Result<KnownTrials, InferError> {
        let of_skin = sensor.skin().map(|skin| skin.evidence.run.clone());
        let runs = self.store.runs(RUNS_LOOKED_AT, None).await?.runs;
        let is_on_sensor = |run: &RunRow, kind: RunKind| {
            let is_measured = run.label != Label::Simulated;
            let same = || Sensor::from_toml(&run.sensor).is_ok_and(|s| s.file == sensor.file);
            run.kind == kind && run.state == StoredState::Ended && is_measured && same()
        };
        let newest = |kind| runs.iter().find(|run| is_on_sensor(run, kind));
        let run = match &of_skin {
            Some(uid) => runs.iter().find(|run| run.uid.to_string() == *uid),
            None => newest(RunKind::RealHex).or_else(|| newest(RunKind::Imported)),
        };
        let Some(run) = run else { return Ok(KnownTrials::default()) };
        let channels = sensor.channels();
        let force_noise_n = run.rig.as_deref().and_then(force_noise_n).unwrap_or(0.0);
        let light = [
            format!("max_force_n__gte={}", run.deadband_n),
            format!("max_force_n__lt={KNOWN_FORCE_N}"),
            format!("contact_count__lte={KNOWN_CONTACTS}"),
        ];
        let all = self.evenly(run, &light, KNOWN_TRIALS * skin::HELD_OUT_IN as usize).await?;
        let skins = UntouchedSkins::before(&self.store, &ids(&all)).await?;
        let pressed = |trial: &TrialRow| {
            let contacts = contacts(trial, run.kind, force_noise_n)?;
            skin::is_held_out(&tips_mm(trial, run.kind, &contacts)).then_some(())?;
            let frame_v = complete(trial.voltages_v.clone(), channels)?;
            let (frames, untouched) = (frames(trial), skins.of(trial.trial_id));
            Some(KnownTrial { contacts, frame_v, frames, untouched })
        };
        let pressed = all.iter().filter_map(pressed).take(KNOWN_TRIALS).collect();
        // Without a load cell there is no force where nothing touches.
        let untouched = match run.kind {
            RunKind::RealHex => format!("max_force_n__lt={UNTOUCHED_N}"),
            RunKind::RealRandom | RunKind::Imported => "contact_count=0".to_owned(),
        };
        let untouched = self.evenly(run, &[untouched], UNTOUCHED_TRIALS).await?;
        let at = |trial: Option<&TrialRow>| trial.and_then(|t| t.measured_at.or(t.started_at));
        let wall_s = match (at(untouched.first()), at(untouched.last())) {
            (Some(first), Some(last)) => last.as_second().saturating_sub(first.as_second()) as f64,
            _ => 0.0,
        };
        let hours = wall_s * run.rig.as_deref().map_or(1.0, clock_rate) / 3600.0;
        let skins = UntouchedSkins::before(&self.store, &ids(&untouched)).await?;
        let averaged = untouched.iter().map(frames).sum::<f64>() / untouched.len().max(1) as f64;
        let (mut frames_v, mut tared_v) = (Vec::new(), Vec::new());
        for trial in untouched {
            let Some(frame_v) = complete(trial.voltages_v, channels) else { continue };
            frames_v.push(frame_v);
            tared_v.push(skins.of(trial.trial_id).map_or_else(Vec::new, |skin| skin.voltages_v));
        }
        Ok(KnownTrials { pressed, untouched: Untouched { frames_v, tared_v, averaged, hours } })
    }

    /// At most `most` trials of a run that meet conditions, without flags, evenly in their order.
    async fn evenly(
        &self,
        run: &RunRow,
        conditions: &[String],
        most: usize,
    ) -> Result<Vec<TrialRow>, InferError> {
        let condition = |text: &String| {
            let wrong = |limit| vec![Problem::new("request", "where", text, limit)];
            Condition::parse(text).map_err(wrong).map_err(InferError::Problems)
        };
        let mut query = TrialQuery {
            run: Some(run.uid),
            flagged: Some(false),
            limit: MAX_PAGE,
            filters: conditions.iter().map(condition).collect::<Result<_, _>>()?,
            ..TrialQuery::default()
        };
        // All of them: settings with more tips are late in a run.
        let mut ids = Vec::new();
        loop {
            let page = self.store.trial_ids(&query).await?;
            ids.extend_from_slice(&page);
            if page.len() < MAX_PAGE as usize {
                break;
            }
            query.after = page.last().copied();
        }
        let count = ids.len().min(most);
        let chosen: Vec<_> = (0..count).map(|i| ids[i * ids.len() / count]).collect();
        Ok(self.store.trials_with_voltages(&chosen).await?)
    }

    /// Builds the model of a stored calibration, or the nominal one.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration, or the model cannot be built.
    pub async fn model(
        &self,
        calibration: Option<&CalibrationId>,
    ) -> Result<ForwardModel, InferError> {
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
    pub fn keep(&self, text: &str) -> Result<CalibrationId, InferError> {
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
    pub fn stored(&self, id: &CalibrationId) -> Result<StoredCalibration, InferError> {
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

fn ids(trials: &[TrialRow]) -> Vec<TrialId> {
    trials.iter().map(|trial| trial.trial_id).collect()
}

/// The frame, if it has all channels: one that was measured elsewhere may lack some.
fn complete(frame_v: Option<Vec<f32>>, channels: usize) -> Option<Vec<f32>> {
    frame_v.filter(|v| v.len() == channels && v.iter().all(|v| v.is_finite()))
}

fn frames(trial: &TrialRow) -> f64 {
    f64::from(trial.frame_count.max(1))
}

/// Prepares a skin with the cached errors of these trials, or estimates them and writes the cache.
fn ready(model: &ForwardModel, known: &KnownTrials, cache: &Path) -> Result<ExactSkin, InferError> {
    let name = format!("skin-errors-{}.json", &key(model, known)[..16]);
    let path = cache.join(&name);
    let kept = std::fs::read(&path).ok();
    let kept = kept.and_then(|bytes| serde_json::from_slice::<SkinErrors>(&bytes).ok());
    if let Some(errors) = kept.filter(|errors| errors.channels() == model.sensor().channels()) {
        return ExactSkin::with(model, errors);
    }
    let skin = ExactSkin::new(model, known)?;
    let keep = || -> std::io::Result<()> {
        new_file::write(cache, &name, serde_json::to_vec(skin.errors())?).map(|_| ())
    };
    if let Err(error) = keep() {
        tracing::warn!(%error, path = %path.display(), "the errors of a skin were not cached");
    }
    Ok(skin)
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
    let before = known.pressed.iter().filter_map(|trial| trial.untouched.as_ref());
    let frames = untouched.frames_v.iter().chain(&untouched.tared_v);
    for frame_v in frames.chain(before.map(|skin| &skin.voltages_v)) {
        frame_v.iter().for_each(|v| digest.update(v.to_le_bytes()));
    }
    digest.update(known.untouched.hours.to_le_bytes());
    for trial in &known.pressed {
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
    use crate::clock::Clock;
    use crate::ids::RunUid;
    use crate::infer::maps::ForceMaps;
    use crate::infer::methods::ReadyMethod;
    use crate::infer::methods::exact::ExactPipeline;
    use crate::store::{ImportedTrial, NewRun};

    const SENSOR: &str = include_str!("../../../../../experiments/sensors/ert-28.toml");

    /// Position of an imported trial, mm.
    fn place(trial: u32) -> [f64; 2] {
        [100.0 + f64::from(trial), 400.0 - f64::from(trial)]
    }

    /// One of four is untouched, and one of these lacks a channel.
    fn elsewhere(trial: u32, channels: usize) -> ImportedTrial {
        let [x_mm, y_mm] = place(trial).map(Some);
        let contact = crate::store::Contact { x_mm, y_mm, force_n: Some(9.0), diameter_mm: None };
        let mut voltages_v = vec![1e-3; channels];
        if trial == 4 {
            voltages_v[3] = f32::NAN;
        }
        ImportedTrial {
            configuration: trial,
            contacts: if trial.is_multiple_of(4) { Vec::new() } else { vec![contact] },
            voltages_v,
            frame_count: 8,
            ..ImportedTrial::default()
        }
    }

    #[tokio::test]
    async fn an_imported_run_on_the_sensor_has_known_trials() {
        let folder = std::env::temp_dir().join(format!("palpate-known-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let store = Store::open(&folder.join("palpate.db"), Clock::new(1.0)).await.unwrap();
        let skins = Skins::new(store.clone(), sensor.clone(), &folder);
        let none = skins.known_trials(&sensor.clone().into()).await.unwrap();
        assert!(none.pressed.is_empty() && none.untouched.frames_v.is_empty());
        let new = NewRun {
            uid: RunUid::new(),
            experiment: "elsewhere".into(),
            kind: RunKind::Imported,
            definition: "{}".into(),
            seed: None,
            rig: None,
            sensor: SENSOR.into(),
            calibration_id: None,
            plan: None,
            label: Label::Measured,
            version: "0.1.0".into(),
            git_commit: None,
            deadband_n: 0.0,
            tip_diameter_mm: None,
            trials_planned: 200,
            auto_resume: false,
            not_before: None,
            submitted_by: "test".into(),
        };
        let run = store.begin_import(new).await.unwrap();
        let trials = (0..200).map(|n| elsewhere(n, sensor.channels())).collect();
        store.import_trials(run.uid, None, trials).await.unwrap();
        store.end_import(run.uid).await.unwrap();
        let known = skins.known_trials(&sensor.into()).await.unwrap();
        let is_known = |n: &u32| !n.is_multiple_of(4) && skin::is_held_out(&[place(*n)]);
        let wanted = (0..200).filter(is_known).count();
        assert!(wanted > 0 && known.pressed.len() == wanted, "{} {wanted}", known.pressed.len());
        assert!(known.pressed.iter().all(|trial| trial.frames == 8.0));
        assert_eq!(known.untouched.frames_v.len(), 49, "one lacks a channel");
        store.close().await;
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Single touches of a model with noise, 10 % stronger than their label.
    fn trials(model: &ForwardModel, count: usize) -> Vec<KnownTrial> {
        let (mut rng, mut work) = (ChaCha8Rng::seed_from_u64(5), Workspace::default());
        let mut one = |_| {
            let contact = Contact {
                x_mm: rng.random_range(60.0..480.0),
                y_mm: rng.random_range(60.0..500.0),
                force_n: rng.random_range(10.0..30.0),
            };
            let pressed = Contact { force_n: 1.1 * contact.force_n, ..contact };
            let volts = model.voltages(&[pressed], &mut work).expect("a contact on the skin");
            let frame_v = volts.iter().map(|v| (v + rng.random_range(-2e-3..2e-3)) as f32);
            let (contacts, frame_v) = (vec![contact], frame_v.collect());
            KnownTrial { contacts, frame_v, frames: 1.0, untouched: None }
        };
        (0..count).map(&mut one).collect()
    }

    #[test]
    fn a_skin_from_the_cache_answers_as_the_one_that_was_learnt() {
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let responses = Arc::new(UnitResponses::solve(&sensor).unwrap());
        let model = ForwardModel::new(&sensor, responses).unwrap();
        let cache = std::env::temp_dir().join(format!("palpate-skins-{}", std::process::id()));
        let trials = trials(&model, 80);
        let known =
            |count: usize| KnownTrials { pressed: trials[..count].to_vec(), ..Default::default() };
        let (known, fewer, other) = (known(70), known(69), &trials[75]);
        let answer = || {
            let skin = Arc::new(ready(&model, &known, &cache).unwrap());
            let exact = ExactPipeline { skin, points: None };
            let read = exact.read(&Frames::single(&other.frame_v), ForceMaps::Without);
            read.unwrap().remove(0)
        };
        let learnt = answer();
        let files = || std::fs::read_dir(&cache).unwrap().count();
        assert_eq!((files(), learnt.contacts.len()), (1, 1));
        assert!(learnt.probability.is_some_and(|p| p > 0.0 && p <= 1.0 + 1e-9), "{learnt:?}");
        let again = answer();
        let [is, was] = [&again, &learnt].map(|reading| &reading.contacts[0]);
        // JSON may lose one digit of a number.
        assert!((is.x_mm - was.x_mm).abs() < 1e-4 && files() == 1);
        let [is, was] = [is, was].map(|contact| contact.force_sd_n.unwrap());
        assert!((is - was).abs() < 1e-6 * was, "{is} N for {was}");
        // Other trials have other errors.
        assert_ne!(key(&model, &known), key(&model, &fewer));
        std::fs::write(cache.join(format!("skin-errors-{}.json", &key(&model, &known)[..16])), "{")
            .unwrap();
        assert_eq!(answer().contacts.len(), 1);
        std::fs::remove_dir_all(&cache).unwrap();
    }
}
