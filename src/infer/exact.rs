//! Contacts fitted to a frame through the exact model of a skin (issue 5, `stack.md` part 4).
//! Uses: sim-core's `inverse::contacts`, `infer::points` (proposals). Never: files, threads.

use std::sync::Arc;

use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::inverse::contacts::{
    ContactFitter, ErrorModel, Fit, FitError, FitOptions, FitWork, FramePair, Observation,
    Proposal, Steady, SteadySettings,
};

use super::answer::{FoundContact, Reading};
use super::error::InferError;
use super::points::{PROPOSED, PointPipeline};

/// Standard deviation of a voltage's noise where a calibration says nothing else, V.
const NOISE_SD_V: f64 = 1.2e-3;

/// Directions of the model's error that are learnt from known trials, at most: with fewer, what is left
/// of it looks like one contact more (592 trials, 48 or 96 of them: exact count 75 or 77 %, each +-3.5).
const ERROR_DIRECTIONS: usize = 96;
/// Known trials that a direction needs.
const KNOWN_FOR_EACH: usize = 4;
/// Fewer known trials than this say nothing of the model's error.
const LEAST_KNOWN: usize = 60;

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

/// A skin that frames are fitted on. Building one takes seconds.
pub struct ExactSkin {
    /// Id of its calibration.
    calibration: Option<String>,
    /// Hash of its model.
    simulation: String,
    /// What its untouched frames show, V.
    offset_v: Vec<f64>,
    fitter: ContactFitter,
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
        let offsets_mv = model.sensor().skin().map(|skin| skin.offsets_mv.as_slice());
        let offset_v = match offsets_mv {
            Some(mv) if mv.len() == channels => mv.iter().map(|mv| 1e-3 * mv).collect(),
            _ => vec![0.0; channels],
        };
        let errors = ErrorModel::white(channels, NOISE_SD_V)?;
        let fitter = ContactFitter::new(model, &errors, FitOptions::default())?;
        let mut skin = Self {
            calibration: model.sensor().calibration().map(Into::into),
            simulation: model.model_hash().into(),
            offset_v,
            fitter,
        };
        if known.len() >= LEAST_KNOWN {
            let errors = skin.errors(model, known, errors)?;
            skin.fitter = ContactFitter::new(model, &errors, FitOptions::default())?;
        }
        Ok(skin)
    }

    /// What of known trials no contact explains: frames modelled at contacts that were refined from
    /// the true ones (sim-core's [`ErrorModel::with_pairs`] says why).
    fn errors(
        &self,
        model: &ForwardModel,
        known: &[KnownTrial],
        white: ErrorModel,
    ) -> Result<ErrorModel, InferError> {
        let (mut work, mut forward) = (FitWork::default(), Workspace::default());
        let mut frames = Vec::with_capacity(known.len());
        for trial in known {
            let mut measured_v = Vec::new();
            self.take_offsets(&trial.frame_v, &mut measured_v);
            let observation = Observation { frame_v: &measured_v, frames: trial.frames };
            let fit = self.fitter.refine(&observation, &trial.contacts, &mut work)?;
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
}

impl ExactPipeline {
    /// Reads frames (V, one after the other), each the mean of so many, each from scratch.
    pub fn read(&self, frames: &[f32], averaged: f64) -> Result<Vec<Reading>, InferError> {
        let (mut work, mut frame_v) = (FitWork::default(), Vec::new());
        let mut readings = Vec::new();
        for frame in frames.chunks_exact(self.skin.channels()) {
            self.skin.take_offsets(frame, &mut frame_v);
            let observation = Observation { frame_v: &frame_v, frames: averaged };
            let fit = self.skin.fitter.fit(&observation, &self.proposals(frame)?, &mut work)?;
            readings.push(reading(&fit));
        }
        Ok(readings)
    }

    /// Reads the next frame of a stream: the mean of those since the load last changed, from the last
    /// fit on where that still holds.
    pub fn follow(&self, frame: &[f32], tracked: &mut Tracked) -> Result<Reading, InferError> {
        self.skin.take_offsets(frame, &mut tracked.frame_v);
        let steady = match &mut tracked.steady {
            Some(steady) => steady,
            none => {
                let settings = SteadySettings::of_noise(NOISE_SD_V);
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
        let reading = reading(&fit);
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

fn reading(fit: &Fit) -> Reading {
    let mut contacts: Vec<FoundContact> = fit
        .contacts
        .iter()
        .map(|found| FoundContact {
            x_mm: found.contact.x_mm,
            y_mm: found.contact.y_mm,
            force_n: Some(found.contact.force_n),
            x_sd_mm: Some(found.x_sd_mm),
            y_sd_mm: Some(found.y_sd_mm),
            force_sd_n: Some(found.force_sd_n),
            ..FoundContact::default()
        })
        .collect();
    contacts.sort_by(|a, b| b.force_n.unwrap_or(0.0).total_cmp(&a.force_n.unwrap_or(0.0)));
    Reading { contacts, misfit: Some(fit.chi2 / fit.degrees_of_freedom), ..Reading::default() }
}
