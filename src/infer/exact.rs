//! Contacts fitted to a frame through the exact model of a skin.
//! Uses: sim-core's `inverse::contacts`, `infer::points` (proposals), std threads while a skin is made
//! ready. Never: files.

use std::sync::Arc;
use std::thread;

use serde::{Deserialize, Serialize};
use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::inverse::contacts::{
    ContactFitter, ErrorModel, ErrorModelError, Fit, FitError, FitOptions, FitWork, FittedContact,
    FramePair, Observation, Origin, Proposal, Steady, SteadySettings,
};
use sim_core::inverse::skin::{MeasuredTrial, noise_v};

use super::answer::{FoundContact, Reading};
use super::error::InferError;
use super::points::{PROPOSED, PointPipeline};

/// Standard deviation of a voltage's noise where neither known trials nor the calibration say it, V.
const NOISE_SD_V: f64 = 1.2e-3;

/// Directions of the model's error that are learnt from known trials, at most: with fewer, what is left
/// of it looks like one contact more (592 trials, 48 or 96 of them: exact count 75 or 77 %, each +-3.5).
const ERROR_DIRECTIONS: usize = 96;
/// Known trials that a direction needs.
const KNOWN_FOR_EACH: usize = 4;
/// Fewer known trials than this say nothing of the model's error.
const LEAST_KNOWN: usize = 60;
/// Threads that make a skin ready, at most.
const THREADS: usize = 8;
/// Known trials that tell by how much standard deviations are too small.
const STRETCHED_BY: usize = 200;
/// They are told by contacts of at least this force, N: the paper's deadband.
const CLEAR_N: f64 = 5.0;
/// The share of known contacts that tell it: what is said of contacts is relied on at its edges. And below
/// which |x| lies as often, of a normal x of standard deviation 1.
const TOLD_BY: f64 = 0.9;
const TOLD_BY_SD: f64 = 1.645;
/// A fit that leaves over so many times the noise that it reckons with explains the frame badly.
const MISFIT_EXPLAINED: f64 = 3.0;

/// A measured trial whose contacts are known.
#[derive(Debug, Clone)]
pub struct KnownTrial {
    /// What pressed.
    pub contacts: Vec<Contact>,
    /// Its measured frame, V.
    pub frame_v: Vec<f32>,
    /// Frames that it is the mean of.
    pub frames: f64,
}

/// A skin that frames are fitted on. Building one takes most of a minute.
pub struct ExactSkin {
    /// Id of its calibration.
    calibration: Option<String>,
    /// The run that it was calibrated to.
    run: Option<String>,
    /// Hash of its model.
    simulation: String,
    /// Its width and height.
    size_mm: [f64; 2],
    /// What its untouched frames show, V.
    offset_v: Vec<f64>,
    errors: SkinErrors,
    fitter: ContactFitter,
}

/// How far frames of a skin are from those of its model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkinErrors {
    /// Standard deviation of a voltage's noise in one frame, V.
    noise_sd_v: f64,
    model: ErrorModel,
    /// Factors on the standard deviations of places and forces: contacts imitate a part of the model's
    /// error, which the fit cannot know.
    stretch: Stretch,
}

impl SkinErrors {
    /// Voltages of a frame.
    pub fn channels(&self) -> usize {
        self.model.channels()
    }
}

/// By how much more known contacts are missed than standard deviations say.
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
    /// Of a model, calibrated or not. How far it is from this skin is learnt from known trials, where
    /// there are enough; otherwise every misfit is taken for noise.
    pub fn new(model: &ForwardModel, known: &[KnownTrial]) -> Result<Self, InferError> {
        let channels = model.sensor().channels();
        let offset_v = offset_v(model);
        let enough = known.len() >= LEAST_KNOWN;
        let noise_sd_v = Some(known).filter(|_| enough).and_then(|known| seen(known, &offset_v));
        let evidence = model.sensor().skin().map(|skin| skin.evidence.noise_v);
        let noise_sd_v = noise_sd_v.or(evidence).unwrap_or(NOISE_SD_V);
        let white = ErrorModel::white(channels, noise_sd_v)?;
        let stretch = Stretch { place: 1.0, force: 1.0 };
        let skin = Self::with(model, SkinErrors { noise_sd_v, model: white.clone(), stretch })?;
        if !enough {
            return Ok(skin);
        }
        let learnt = match skin.learn(model, known, white) {
            Ok(learnt) => learnt,
            // Trials that drown in the noise tell nothing but the noise.
            Err(InferError::Errors(ErrorModelError::FewPairs { .. })) => return Ok(skin),
            Err(error) => return Err(error),
        };
        let mut skin = Self::with(model, SkinErrors { noise_sd_v, model: learnt, stretch })?;
        skin.errors.stretch = skin.stretch(known)?;
        Ok(skin)
    }

    /// Of a model whose errors were learnt before.
    pub fn with(model: &ForwardModel, errors: SkinErrors) -> Result<Self, InferError> {
        Ok(Self {
            calibration: model.sensor().calibration().map(Into::into),
            run: model.sensor().skin().map(|skin| skin.evidence.run.clone()),
            simulation: model.model_hash().into(),
            size_mm: [model.sensor().file.width_mm, model.sensor().file.height_mm],
            offset_v: offset_v(model),
            fitter: ContactFitter::new(model, &errors.model, FitOptions::default())?,
            errors,
        })
    }

    /// Its width and height, mm.
    pub fn size_mm(&self) -> [f64; 2] {
        self.size_mm
    }

    /// What was learnt of its errors.
    pub fn errors(&self) -> &SkinErrors {
        &self.errors
    }

    /// How far fits lie from known contacts, in the standard deviations that they state.
    fn stretch(&self, known: &[KnownTrial]) -> Result<Stretch, InferError> {
        let some: Vec<&KnownTrial> =
            known.iter().step_by(known.len().div_ceil(STRETCHED_BY)).collect();
        let (mut places, mut forces) = (Vec::new(), Vec::new());
        for (trial, (_, fit)) in some.iter().zip(self.refined(&some)?) {
            if fit.contacts.len() != trial.contacts.len() {
                continue;
            }
            // Contacts of a fit come in another order; no search would report the lightest.
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

    /// Frames of known trials without offsets, V, and their fits from the true contacts on; on some
    /// threads, in the trials' order.
    fn refined(&self, known: &[&KnownTrial]) -> Result<Vec<(Vec<f64>, Fit)>, InferError> {
        let refine = |trials: &[&KnownTrial]| {
            let mut work = FitWork::default();
            let one = |trial: &&KnownTrial| {
                let mut frame_v = Vec::new();
                self.take_offsets(&trial.frame_v, &mut frame_v);
                let observation = Observation { frame_v: &frame_v, frames: trial.frames };
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

    /// What of known trials no contact explains: frames modelled at contacts that were refined from
    /// the true ones (sim-core's [`ErrorModel::with_pairs`] says why).
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
            frames.push((measured_v, modelled_v.to_vec(), trial.frames));
        }
        let pairs: Vec<FramePair<'_>> = frames
            .iter()
            .map(|(measured_v, modelled_v, frames)| FramePair {
                measured_v,
                modelled_v,
                frames: *frames,
            })
            .collect();
        Ok(white.with_pairs(&pairs, ERROR_DIRECTIONS.min(pairs.len() / KNOWN_FOR_EACH))?)
    }

    /// The run that it was calibrated to.
    pub fn run(&self) -> Option<&str> {
        self.run.as_deref()
    }

    /// Id of its calibration.
    pub fn calibration(&self) -> Option<&str> {
        self.calibration.as_deref()
    }

    /// What answers carry as their model: the calibration, or else the model's hash.
    pub fn id(&self) -> &str {
        self.calibration.as_deref().unwrap_or(&self.simulation)
    }

    /// Voltages of a frame.
    pub fn channels(&self) -> usize {
        self.offset_v.len()
    }

    /// What a fit says.
    fn reading(&self, fit: &Fit) -> Reading {
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
            format!("misfit = {misfit:.1}: contacts on this skin explain up to {MISFIT_EXPLAINED}")
        });
        let outside = outside.into_iter().collect();
        Reading { contacts, misfit: Some(misfit), outside, ..Reading::default() }
    }

    /// A frame without what the untouched skin shows, V.
    fn take_offsets(&self, frame: &[f32], frame_v: &mut Vec<f64>) {
        frame_v.clear();
        let offsets = self.offset_v.iter();
        frame_v.extend(frame.iter().zip(offsets).map(|(v, offset)| f64::from(*v) - offset));
    }
}

/// A skin and, where there is one, a net that says where to begin.
#[derive(Debug, Clone)]
pub struct ExactPipeline {
    /// The skin.
    pub skin: Arc<ExactSkin>,
    /// The net.
    pub points: Option<PointPipeline>,
}

/// Memory of fits, and the last of them; one for each stream of frames.
#[derive(Default)]
pub struct Tracked {
    work: FitWork,
    frame_v: Vec<f64>,
    last: Option<Fit>,
    steady: Option<Steady>,
    /// Of which skin all that is.
    skin: Option<String>,
}

impl ExactPipeline {
    /// What answers carry as their model: the skin's id and the net's.
    pub fn models(&self) -> String {
        let net = self.points.as_ref().map(|points| format!("+{}", points.model()));
        format!("{}{}", self.skin.id(), net.unwrap_or_default())
    }

    /// Reads frames (V, one after the other), each the mean of so many, each from scratch.
    pub fn read(&self, frames: &[f32], averaged: f64) -> Result<Vec<Reading>, InferError> {
        let (mut work, mut frame_v) = (FitWork::default(), Vec::new());
        let mut readings = Vec::new();
        for frame in frames.chunks_exact(self.skin.channels()) {
            self.skin.take_offsets(frame, &mut frame_v);
            let observation = Observation { frame_v: &frame_v, frames: averaged };
            let fit = self.skin.fitter.fit(&observation, &self.proposals(frame)?, &mut work)?;
            readings.push(self.skin.reading(&fit));
        }
        Ok(readings)
    }

    /// Reads the next frame of a stream: the mean of those since the load last changed, from the last
    /// fit on where that still holds.
    pub fn follow(&self, frame: &[f32], tracked: &mut Tracked) -> Result<Reading, InferError> {
        if tracked.skin.as_deref() != Some(self.skin.id()) {
            *tracked = Tracked { skin: Some(self.skin.id().to_owned()), ..Tracked::default() };
        }
        self.skin.take_offsets(frame, &mut tracked.frame_v);
        let steady = match &mut tracked.steady {
            Some(steady) => steady,
            none => {
                let settings = SteadySettings::of_noise(self.skin.errors.noise_sd_v);
                none.insert(Steady::new(self.skin.channels(), settings)?)
            }
        };
        let mean = steady.push(&tracked.frame_v)?;
        let observation = Observation { frame_v: mean.mean_v, frames: mean.frames };
        let before = tracked.last.take().filter(|_| !mean.changed);
        let fit = match before {
            Some(last) => self.skin.fitter.track(&observation, &last, &mut tracked.work)?,
            None => {
                let proposals = self.proposals(frame)?;
                self.skin.fitter.fit(&observation, &proposals, &mut tracked.work)?
            }
        };
        let mut reading = self.skin.reading(&fit);
        reading.averaged = Some(mean.frames);
        reading.searched = Some(fit.origin == Origin::Search);
        tracked.last = Some(fit);
        Ok(reading)
    }

    fn proposals(&self, frame: &[f32]) -> Result<Vec<Proposal>, InferError> {
        let Some(points) = &self.points else { return Ok(Vec::new()) };
        let candidates = points.candidates(frame, PROPOSED)?;
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

/// What a model's untouched skin shows, V; nothing where that is not known.
fn offset_v(model: &ForwardModel) -> Vec<f64> {
    let channels = model.sensor().channels();
    let offsets_mv = model.sensor().skin().map(|skin| skin.offsets_mv.as_slice());
    match offsets_mv {
        Some(mv) if mv.len() == channels => mv.iter().map(|mv| 1e-3 * mv).collect(),
        _ => vec![0.0; channels],
    }
}

/// Noise of one frame's voltages, as known trials show it, V.
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

/// The factor that makes nine tenths of these what they are of a normal; never less than 1.
fn stretched(mut in_sd: Vec<f64>) -> f64 {
    in_sd.retain(|z| z.is_finite());
    in_sd.sort_by(f64::total_cmp);
    let at = (TOLD_BY * in_sd.len() as f64) as usize;
    in_sd.get(at).map_or(1.0, |edge| (edge / TOLD_BY_SD).max(1.0))
}
