//! Contacts fitted to a frame through the exact model of a skin (issue 5, `stack.md` part 4).
//! Uses: sim-core's `inverse::contacts`, `infer::points` (proposals). Never: files, threads.

use std::sync::Arc;

use sim_core::forward::ForwardModel;
use sim_core::inverse::contacts::{
    ContactFitter, ErrorModel, Fit, FitError, FitOptions, FitWork, Observation, Proposal,
};

use super::answer::{FoundContact, Reading};
use super::error::InferError;
use super::points::{PROPOSED, PointPipeline};

/// Standard deviation of a voltage's noise where a calibration says nothing else, V.
const NOISE_SD_V: f64 = 1.2e-3;

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
    /// Of a model, calibrated or not.
    pub fn new(model: &ForwardModel) -> Result<Self, InferError> {
        let channels = model.circuit().electrodes.len().pow(2);
        let errors = ErrorModel::white(channels, NOISE_SD_V);
        Ok(Self {
            calibration: model.sensor().calibration().map(Into::into),
            simulation: model.model_hash().into(),
            offset_v: vec![0.0; channels],
            fitter: ContactFitter::new(model, errors, FitOptions::default())?,
        })
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
}

impl ExactPipeline {
    /// Reads frames (V, one after the other), each the mean of so many, each from scratch.
    pub fn read(&self, frames: &[f32], averaged: f64) -> Result<Vec<Reading>, InferError> {
        let mut tracked = Tracked::default();
        let mut readings = Vec::new();
        for frame in frames.chunks_exact(self.skin.channels()) {
            tracked.last = None;
            readings.push(self.follow(frame, averaged, &mut tracked)?);
        }
        Ok(readings)
    }

    /// Reads the next frame of a stream: from the last fit on, where it still holds.
    pub fn follow(
        &self,
        frame: &[f32],
        averaged: f64,
        tracked: &mut Tracked,
    ) -> Result<Reading, InferError> {
        tracked.frame_v.clear();
        let offsets = self.skin.offset_v.iter();
        tracked.frame_v.extend(frame.iter().zip(offsets).map(|(v, offset)| f64::from(*v) - offset));
        let observation = Observation { frame_v: &tracked.frame_v, frames: averaged };
        let fitter = &self.skin.fitter;
        let fit = match &tracked.last {
            Some(last) => fitter.track(&observation, last, &mut tracked.work)?,
            None => {
                let proposals = self.proposals(frame)?;
                fitter.fit(&observation, &proposals, &mut tracked.work)?
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
    Reading {
        contacts,
        misfit: Some(fit.chi2 / fit.degrees_of_freedom),
        ..Reading::default()
    }
}

impl From<FitError> for InferError {
    fn from(error: FitError) -> Self {
        Self::Fit(error)
    }
}
