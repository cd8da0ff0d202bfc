//! Contacts fitted to a frame through the exact model of a skin.
//! Uses: sim-core's `inverse::contacts`, `fast` (proposals), std threads for the preparation of a
//! skin. Never: files (`skins` has them).

pub mod skins;
mod untouched;
mod zero;

use std::sync::Arc;
use std::thread;

use serde::{Deserialize, Serialize};
use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::inverse::contacts::{
    ContactFitter, ErrorModel, ErrorModelError, Fit, FitError, FitOptions, FitWork, FittedContact,
    FramePair, Observation, Origin, Proposal, Steady, SteadySettings,
};
use sim_core::inverse::skin::{MeasuredTrial, noise_v};
use sim_core::stats::{sorted, upper_quantile};

use self::untouched::Drift;
pub use self::untouched::{Untouched, scatter_v};
use self::zero::Zero;
use super::fast::{PROPOSED, PointPipeline};
use super::{Frames, ReadyMethod, UntouchedBefore, UsedSkin};
use crate::ids::CalibrationId;
use crate::infer::answer::{FoundContact, Reading};
use crate::infer::error::InferError;
use crate::infer::registry::Model;

/// Standard deviation of a voltage's noise if neither known trials nor the calibration state it, V.
const NOISE_SD_V: f64 = 1.2e-3;

/// Largest number of directions of the model's error that are estimated from known trials: with
/// fewer, the residual is fitted as an additional contact (592 trials, 48 or 96 of them: exact
/// count 75 or 77 %, each +-3.5).
const ERROR_DIRECTIONS: usize = 96;
/// Number of known trials needed per direction.
const KNOWN_FOR_EACH: usize = 4;
/// Smallest number of known trials from which the model's error is estimated.
const LEAST_KNOWN: usize = 60;
/// Largest number of threads that prepare a skin.
const THREADS: usize = 8;
/// Number of known trials from which the factors on standard deviations are estimated.
const STRETCHED_BY: usize = 200;
/// Smallest force of a contact used for these factors, N: the paper's deadband.
const CLEAR_N: f64 = 5.0;
/// Quantile at which the factors are determined: users rely on the limits of the errors.
/// `TOLD_BY_SD` is this quantile of |x|, for a normal x of standard deviation 1.
const TOLD_BY: f64 = 0.9;
const TOLD_BY_SD: f64 = 1.645;
/// Drift in a day, in standard deviations of the noise of a pair, from which offsets must be measured anew.
const DRIFT_MATTERS: f64 = 2.0;
/// Largest offset that the live zero takes off, in standard deviations of the drift.
const ZERO_SD: f64 = 3.0;
/// A fit whose residual exceeds this multiple of the assumed noise does not explain the frame.
const MISFIT_EXPLAINED: f64 = 3.0;

/// A measured trial whose contacts are known.
#[derive(Debug, Clone)]
pub struct KnownTrial {
    /// Contacts that pressed the skin.
    pub contacts: Vec<Contact>,
    /// Measured frame, V.
    pub frame_v: Vec<f32>,
    /// Number of averaged frames.
    pub frames: f64,
    /// The untouched skin before it, if it was measured.
    pub untouched: Option<UntouchedBefore>,
}

/// The trials of a run from which the errors of a skin are estimated.
#[derive(Debug, Clone, Default)]
pub struct KnownTrials {
    /// With contacts, of configurations that no skin is fitted to.
    pub pressed: Vec<KnownTrial>,
    /// Without contacts.
    pub untouched: Untouched,
}

/// A skin for fits of contacts. Its preparation takes most of a minute.
pub struct ExactSkin {
    /// Id of its calibration; `None` for the nominal skin.
    calibration: Option<CalibrationId>,
    /// The run that it was calibrated to, if any.
    run: Option<String>,
    /// Hash of its model.
    simulation: String,
    /// Width and height, mm.
    size_mm: [f64; 2],
    /// Offsets of the untouched frame, V.
    offset_v: Vec<f64>,
    errors: SkinErrors,
    fitter: ContactFitter,
}

/// Difference of a skin's frames from those of its model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkinErrors {
    /// Standard deviation of a voltage's noise in one frame, V.
    noise_sd_v: f64,
    /// What the offsets of the readout differ by from those that are subtracted.
    drift: Drift,
    model: ErrorModel,
    /// Factors on the standard deviations of positions and forces: contacts imitate a part of the
    /// model's error, which the fit cannot detect.
    stretch: Stretch,
    /// Number of known trials from which the model's error was estimated; 0 if it was not.
    learnt_from: usize,
}

impl SkinErrors {
    /// Number of voltages in a frame.
    pub fn channels(&self) -> usize {
        self.model.channels()
    }
}

/// Ratio of the errors of known contacts to the stated standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Stretch {
    place: f64,
    force: f64,
}

impl std::fmt::Debug for ExactSkin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ExactSkin").field("simulation", &self.simulation).finish_non_exhaustive()
    }
}

impl ExactSkin {
    /// Prepares a model, calibrated or not. Its difference from this skin is estimated from known
    /// trials, if there are enough; otherwise every misfit counts as noise.
    ///
    /// # Errors
    /// `InferError` if the error model is invalid or a known trial cannot be fitted.
    pub fn new(model: &ForwardModel, trials: &KnownTrials) -> Result<Self, InferError> {
        let KnownTrials { pressed: known, untouched } = trials;
        let channels = model.sensor().channels();
        let offset_v = offset_v(model);
        let enough = known.len() >= LEAST_KNOWN;
        let noise_sd_v = untouched.noise_sd_v().filter(|_| enough);
        let noise_sd_v = noise_sd_v.or_else(|| enough.then(|| seen(known, &offset_v)).flatten());
        let evidence = model.sensor().skin().map(|skin| skin.evidence.noise_v);
        let noise_sd_v = noise_sd_v.or(evidence).unwrap_or(NOISE_SD_V);
        let drift = untouched.drift(&offset_v);
        let white = ErrorModel::white(channels, noise_sd_v)?;
        let stretch = Stretch { place: 1.0, force: 1.0 };
        let skin = Self::with(
            model,
            SkinErrors { noise_sd_v, drift, model: white.clone(), stretch, learnt_from: 0 },
        )?;
        if !enough {
            return Ok(skin);
        }
        let learnt = match skin.learn(model, known, white) {
            Ok(learnt) => learnt,
            // Trials below the noise contain no information except the noise.
            Err(InferError::Errors(ErrorModelError::FewPairs { .. })) => return Ok(skin),
            Err(error) => return Err(error),
        };
        let learnt_from = known.len();
        let errors = SkinErrors { noise_sd_v, drift, model: learnt, stretch, learnt_from };
        let mut skin = Self::with(model, errors)?;
        skin.errors.stretch = skin.stretch(known)?;
        Ok(skin)
    }

    /// Prepares a model with errors that were estimated earlier.
    ///
    /// # Errors
    /// `InferError::Fitter` if the tables of the fit cannot be computed.
    pub fn with(model: &ForwardModel, errors: SkinErrors) -> Result<Self, InferError> {
        Ok(Self {
            calibration: model.sensor().calibration().map(CalibrationId::unchecked),
            run: model.sensor().skin().map(|skin| skin.evidence.run.clone()),
            simulation: model.model_hash().into(),
            size_mm: [model.sensor().file.width_mm, model.sensor().file.height_mm],
            offset_v: offset_v(model),
            fitter: ContactFitter::new(model, &errors.model, FitOptions::default())?,
            errors,
        })
    }

    /// Width and height, mm.
    pub fn size_mm(&self) -> [f64; 2] {
        self.size_mm
    }

    /// What limits the answers of this skin, if anything is known to.
    pub fn limitation(&self) -> Option<String> {
        let unknown = self.errors.learnt_from == 0;
        unknown.then(|| {
            let of_run = match &self.run {
                Some(run) => format!("the run {run}, to which it was calibrated,"),
                None => "a Real-Hex run on this sensor".to_owned(),
            };
            format!(
                "the errors of its model are unknown: the database has fewer than {LEAST_KNOWN} trials of \
                 {of_run} of 1 to 3 contacts that it was not fitted to; every misfit counts as noise"
            )
        })
    }

    /// The estimated errors of the model.
    pub fn errors(&self) -> &SkinErrors {
        &self.errors
    }

    /// Ratio of the distance of fits from known contacts to the standard deviations that they
    /// state.
    fn stretch(&self, known: &[KnownTrial]) -> Result<Stretch, InferError> {
        let some: Vec<&KnownTrial> =
            known.iter().step_by(known.len().div_ceil(STRETCHED_BY)).collect();
        let (mut places, mut forces) = (Vec::new(), Vec::new());
        for (trial, (_, fit)) in some.iter().zip(self.refined(&some)?) {
            if fit.contacts.len() != trial.contacts.len() {
                continue;
            }
            // Contacts of a fit are in another order; a search would not report the lightest.
            let clear = trial.contacts.iter().filter(|truth| truth.force_n >= CLEAR_N);
            for (truth, found) in clear.filter_map(|truth| Some((truth, nearest(&fit, truth)?))) {
                let is = found.contact;
                places.push(((is.x_mm - truth.x_mm) / found.x_sd_mm).abs());
                places.push(((is.y_mm - truth.y_mm) / found.y_sd_mm).abs());
                forces.push(((is.force_n - truth.force_n) / found.force_sd_n).abs());
            }
        }
        Ok(Stretch { place: stretched(places), force: stretched(forces) })
    }

    /// Frames of known trials without offsets, V, and their fits started at the true contacts; on
    /// several threads, in the order of the trials.
    fn refined(&self, known: &[&KnownTrial]) -> Result<Vec<(Vec<f64>, Fit)>, InferError> {
        let refine = |trials: &[&KnownTrial]| {
            let mut work = FitWork::default();
            let one = |trial: &&KnownTrial| {
                let mut frame_v = Vec::new();
                let untouched = self.better(trial.untouched.as_ref());
                self.take_offsets(&trial.frame_v, untouched, &mut frame_v);
                let observation = self.observation(&frame_v, trial.frames, untouched);
                let fit = self.fitter.refine(&observation, &trial.contacts, &mut work)?;
                Ok((frame_v, fit))
            };
            trials.iter().map(one).collect::<Result<Vec<_>, InferError>>()
        };
        let threads = thread::available_parallelism().map_or(1, |n| n.get().min(THREADS));
        let shares = known.chunks(known.len().div_ceil(threads).max(1));
        let done: Result<Vec<_>, InferError> = thread::scope(|scope| {
            let working: Vec<_> = shares.map(|share| scope.spawn(|| refine(share))).collect();
            let join = |handle: thread::ScopedJoinHandle<'_, _>| {
                handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            working.into_iter().map(join).collect()
        });
        Ok(done?.into_iter().flatten().collect())
    }

    /// Estimates the part of known trials that no contact explains: frames are modelled at contacts
    /// that were refined from the true ones (reason: sim-core's [`ErrorModel::with_pairs`]).
    fn learn(
        &self,
        model: &ForwardModel,
        known: &[KnownTrial],
        white: ErrorModel,
    ) -> Result<ErrorModel, InferError> {
        let mut forward = Workspace::default();
        let mut frames = Vec::with_capacity(known.len());
        let fits = self.refined(&known.iter().collect::<Vec<_>>())?;
        for (trial, (measured_v, fit)) in known.iter().zip(fits) {
            let refined: Vec<Contact> = fit.contacts.iter().map(|found| found.contact).collect();
            let modelled_v = model.voltages(&refined, &mut forward).map_err(FitError::from)?;
            let offset_sd_v = self.offset_sd_v(self.better(trial.untouched.as_ref()));
            frames.push((measured_v, modelled_v.to_vec(), trial.frames, offset_sd_v));
        }
        let pairs: Vec<FramePair<'_>> = frames
            .iter()
            .map(|(measured_v, modelled_v, frames, offset_sd_v)| FramePair {
                measured_v,
                modelled_v,
                frames: *frames,
                offset_sd_v: *offset_sd_v,
            })
            .collect();
        Ok(white.with_pairs(&pairs, ERROR_DIRECTIONS.min(pairs.len() / KNOWN_FOR_EACH))?)
    }

    /// Id of the run that it was calibrated to, if any.
    pub fn run(&self) -> Option<&str> {
        self.run.as_deref()
    }

    /// Id of its calibration, if any.
    pub fn calibration(&self) -> Option<&CalibrationId> {
        self.calibration.as_ref()
    }

    /// Id of the model in answers: the calibration's, or else the hash of the model.
    pub fn id(&self) -> &str {
        self.calibration.as_ref().map_or(self.simulation.as_str(), CalibrationId::as_str)
    }

    /// Number of voltages in a frame.
    pub fn channels(&self) -> usize {
        self.offset_v.len()
    }

    /// The untouched skin, if it gives better offsets than the calibration.
    fn better<'a>(&self, untouched: Option<&'a UntouchedBefore>) -> Option<&'a UntouchedBefore> {
        let fits = |skin: &&UntouchedBefore| skin.voltages_v.len() == self.channels();
        let day_sd_v = self.errors.drift.day_sd_v;
        let is_better = |skin: &&UntouchedBefore| {
            day_sd_v.is_none_or(|day_sd_v| self.offset_sd_v(Some(skin)) < day_sd_v)
        };
        untouched.filter(fits).filter(is_better)
    }

    /// Standard deviation of what is left of an offset, V: at least the noise of the untouched frame.
    fn offset_sd_v(&self, untouched: Option<&UntouchedBefore>) -> f64 {
        let pairs = self.channels().isqrt() as f64;
        let noise_v =
            |skin: &UntouchedBefore| self.errors.noise_sd_v / (pairs * skin.frames).sqrt();
        self.errors.drift.after_v(untouched).max(untouched.map_or(0.0, noise_v))
    }

    /// Warns of offsets that may have drifted by more than the noise of a mean of `frames` frames.
    fn drifted(&self, is_tared: bool, frames: f64) -> Option<String> {
        let drift_v = self.errors.drift.sd_v(None);
        let pairs = self.channels().isqrt() as f64;
        let matters = drift_v > DRIFT_MATTERS * self.errors.noise_sd_v / (pairs * frames).sqrt();
        (matters && !is_tared).then(|| {
            let drift_mv = 1e3 * drift_v;
            format!("offsets of the calibration, which drift by {drift_mv:.2} mV a day: tare the empty skin")
        })
    }

    /// Converts the fit of a mean of `frames` frames to a reading.
    fn reading(&self, fit: &Fit, is_tared: bool, frames: f64) -> Reading {
        let Stretch { place, force } = self.errors.stretch;
        let contact = |found: &FittedContact| FoundContact {
            x_mm: found.contact.x_mm,
            y_mm: found.contact.y_mm,
            force_n: Some(found.contact.force_n),
            x_sd_mm: Some(place * found.x_sd_mm),
            y_sd_mm: Some(place * found.y_sd_mm),
            force_sd_n: Some(force * found.force_sd_n),
            ..FoundContact::default()
        };
        let mut contacts: Vec<FoundContact> = fit.contacts.iter().map(contact).collect();
        contacts.sort_by(|a, b| b.force_n.unwrap_or(0.0).total_cmp(&a.force_n.unwrap_or(0.0)));
        let misfit = fit.chi2 / fit.degrees_of_freedom;
        let outside = (misfit > MISFIT_EXPLAINED).then(|| {
            format!("misfit = {misfit:.1}: limit {MISFIT_EXPLAINED} for contacts on this skin")
        });
        let outside = outside.into_iter().collect();
        let notes = self.drifted(is_tared, frames).into_iter().collect();
        Reading { contacts, misfit: Some(misfit), outside, notes, ..Reading::default() }
    }

    /// Subtracts the offsets of the untouched skin from a frame, V: those of the calibration, and their
    /// drift since, if the untouched skin was measured.
    fn take_offsets(
        &self,
        frame: &[f32],
        untouched: Option<&UntouchedBefore>,
        frame_v: &mut Vec<f64>,
    ) {
        self.take_calibrated(frame, frame_v);
        if let Some(untouched) = untouched {
            let mut drifted_v = Vec::new();
            self.take_calibrated(&untouched.voltages_v, &mut drifted_v);
            Zero::of(&drifted_v).take_off(frame_v);
        }
    }

    fn take_calibrated(&self, frame: &[f32], frame_v: &mut Vec<f64>) {
        frame_v.clear();
        let offsets = self.offset_v.iter();
        frame_v.extend(frame.iter().zip(offsets).map(|(v, offset)| f64::from(*v) - offset));
    }

    /// A mean of `frames` frames without offsets, V, as the fit reads it.
    fn observation<'a>(
        &self,
        frame_v: &'a [f64],
        frames: f64,
        untouched: Option<&UntouchedBefore>,
    ) -> Observation<'a> {
        let offset_sd_v = self.offset_sd_v(untouched);
        Observation { frame_v, frames, offset_sd_v }
    }
}

/// A skin and an optional net that proposes starts.
#[derive(Debug, Clone)]
pub struct ExactPipeline {
    /// Skin of the fits.
    pub skin: Arc<ExactSkin>,
    /// Net that proposes starts; without it, the search alone.
    pub points: Option<PointPipeline>,
}

/// State of the fits of one stream of frames.
#[derive(Default)]
pub struct Tracked {
    work: FitWork,
    frame_v: Vec<f64>,
    last: Option<Fit>,
    steady: Option<Steady>,
    zero: Zero,
    /// Id of the skin of this state.
    skin: Option<String>,
}

impl ReadyMethod for ExactPipeline {
    /// Ids of the skin and the net.
    fn id(&self) -> String {
        let net = self.points.as_ref().map(|points| format!("+{}", points.model()));
        format!("{}{}", self.skin.id(), net.unwrap_or_default())
    }

    fn read(&self, frames: &Frames<'_>, _: bool) -> Result<Vec<Reading>, InferError> {
        let Frames { voltages_v, averaged, untouched } = *frames;
        let untouched = self.skin.better(untouched);
        let (mut work, mut frame_v) = (FitWork::default(), Vec::new());
        let mut readings = Vec::new();
        for frame in voltages_v.chunks_exact(self.skin.channels()) {
            self.skin.take_offsets(frame, untouched, &mut frame_v);
            let observation = self.skin.observation(&frame_v, averaged, untouched);
            let proposals = self.proposals(&frame_v)?;
            let fit = self.skin.fitter.fit(&observation, &proposals, &mut work)?;
            readings.push(self.skin.reading(&fit, frames.untouched.is_some(), averaged));
        }
        Ok(readings)
    }

    /// Fits the mean of the frames since the last change of the load, starting from the last fit if
    /// it is still valid. While nothing is found, the zero follows the offsets.
    fn follow(&self, frame: &[f32], _: bool, tracked: &mut Tracked) -> Result<Reading, InferError> {
        if tracked.skin.as_deref() != Some(self.skin.id()) {
            *tracked = Tracked { skin: Some(self.skin.id().to_owned()), ..Tracked::default() };
        }
        self.skin.take_calibrated(frame, &mut tracked.frame_v);
        tracked.zero.take_off(&mut tracked.frame_v);
        let steady = match &mut tracked.steady {
            Some(steady) => steady,
            none => {
                let settings = SteadySettings::of_noise(self.skin.errors.noise_sd_v);
                none.insert(Steady::new(self.skin.channels(), settings)?)
            }
        };
        let mean = steady.push(&tracked.frame_v)?;
        let offset_sd_v = self.skin.errors.drift.sd_v(tracked.zero.left());
        let observation = Observation { frame_v: mean.mean_v, frames: mean.frames, offset_sd_v };
        let before = tracked.last.take().filter(|_| !mean.changed);
        let fit = match before {
            Some(last) => self.skin.fitter.track(&observation, &last, &mut tracked.work)?,
            None => {
                let proposals = self.proposals(&tracked.frame_v)?;
                self.skin.fitter.fit(&observation, &proposals, &mut tracked.work)?
            }
        };
        if fit.contacts.is_empty() {
            let SkinErrors { noise_sd_v, drift, .. } = &self.skin.errors;
            let most_v = ZERO_SD * drift.sd_v(None).max(*noise_sd_v);
            tracked.zero.learn(&tracked.frame_v, mean.frames, most_v);
        }
        let mut reading = self.skin.reading(&fit, tracked.zero.left().is_some(), mean.frames);
        reading.averaged = Some(mean.frames);
        reading.searched = Some(fit.origin == Origin::Search);
        tracked.last = Some(fit);
        Ok(reading)
    }

    fn nets(&self) -> Vec<&Model> {
        self.points.iter().map(PointPipeline::net).collect()
    }

    fn skin(&self) -> Option<UsedSkin<'_>> {
        let (calibration, run) = (self.skin.calibration(), self.skin.run());
        Some(UsedSkin { id: self.skin.id(), calibration, run })
    }

    fn takes_untouched(&self) -> bool {
        true
    }

    fn size_mm(&self) -> [f64; 2] {
        self.skin.size_mm()
    }
}

impl ExactPipeline {
    /// Proposals for a frame without offsets, V. The net reads it with those of the calibration.
    fn proposals(&self, frame_v: &[f64]) -> Result<Vec<Proposal>, InferError> {
        let Some(points) = &self.points else { return Ok(Vec::new()) };
        let offsets = self.skin.offset_v.iter();
        let frame: Vec<f32> = frame_v.iter().zip(offsets).map(|(v, o)| (v + o) as f32).collect();
        let candidates = points.candidates(&frame, PROPOSED)?;
        let proposal = |found: &FoundContact| {
            Some(Proposal {
                contact: sim_core::forward::Contact {
                    x_mm: found.x_mm,
                    y_mm: found.y_mm,
                    force_n: found.force_n?,
                },
                weight: found.presence?,
            })
        };
        Ok(candidates.iter().flatten().filter_map(proposal).collect())
    }
}

/// Offsets of a model's untouched frame, V; zero if they are unknown.
fn offset_v(model: &ForwardModel) -> Vec<f64> {
    let channels = model.sensor().channels();
    let offsets_mv = model.sensor().skin().map(|skin| skin.offsets_mv.as_slice());
    match offsets_mv {
        Some(mv) if mv.len() == channels => mv.iter().map(|mv| 1e-3 * mv).collect(),
        _ => vec![0.0; channels],
    }
}

/// Standard deviation of the noise in one frame, estimated from known trials, V.
fn seen(known: &[KnownTrial], offset_v: &[f64]) -> Option<f64> {
    let single = |trial: &KnownTrial| {
        let root = trial.frames.sqrt();
        let volts = trial.frame_v.iter().zip(offset_v);
        let frame_v = volts.map(|(v, offset)| (root * (f64::from(*v) - offset)) as f32).collect();
        MeasuredTrial { contacts: Vec::new(), frame_v }
    };
    noise_v(&known.iter().map(single).collect::<Vec<_>>())
}

/// The fitted contact nearest to a true one.
fn nearest<'a>(fit: &'a Fit, truth: &Contact) -> Option<&'a FittedContact> {
    let square_mm2 = |found: &FittedContact| {
        (found.contact.x_mm - truth.x_mm).powi(2) + (found.contact.y_mm - truth.y_mm).powi(2)
    };
    fit.contacts.iter().min_by(|a, b| square_mm2(a).total_cmp(&square_mm2(b)))
}

/// The factor that makes the 90 % quantile of these that of a normal; at least 1.
fn stretched(mut in_sd: Vec<f64>) -> f64 {
    in_sd.retain(|z| z.is_finite());
    upper_quantile(&sorted(in_sd), TOLD_BY).map_or(1.0, |edge| (edge / TOLD_BY_SD).max(1.0))
}
