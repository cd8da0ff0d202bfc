//! Contacts fitted to a frame through the exact model of a skin.
//! Uses: `skin`, sim-core's `inverse::contacts`, `fast` (proposals). Never: files (`skins` has them); other answers to
//! a frame, here or in the search of sim-core, without a higher `READINGS_VERSION` (`jobs::readings::chunks`).

mod errors;
mod known;
mod rehearsal;
mod skin;
mod skin_errors;
pub mod skins;
mod untouched;
mod zero;

use std::sync::Arc;

use sim_core::inverse::contacts::{
    Fit, FitWork, Observation, Origin, Proposal, Steady, SteadySettings,
};

pub use self::errors::{KnownTrial, KnownTrials};
pub use self::known::UNTOUCHED_N;
pub use self::skin::ExactSkin;
pub use self::skin_errors::SkinErrors;
pub use self::untouched::Untouched;
use self::zero::Zero;
use super::fast::{PROPOSED, PointPipeline};
use super::{Frames, ReadyMethod, UsedSkin};
use crate::infer::answer::{FoundContact, Reading};
use crate::infer::error::InferResult;
use crate::infer::maps::ForceMaps;
use crate::infer::registry::Model;

/// Largest offset that the live zero takes off, in standard deviations of the drift.
const ZERO_SD: f64 = 3.0;

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

impl Tracked {
    /// Notes the process time since the last frame of the stream, s: its zero ages.
    pub fn pass(&mut self, seconds: f64) {
        self.zero.pass(seconds);
    }
}

impl ReadyMethod for ExactPipeline {
    /// Ids of the skin and the net.
    fn id(&self) -> String {
        let net = self.points.as_ref().map(|points| format!("+{}", points.model()));
        format!("{}{}", self.skin.id(), net.unwrap_or_default())
    }

    fn read(&self, frames: &Frames<'_>, _: ForceMaps) -> InferResult<Vec<Reading>> {
        let Frames { voltages_v, averaged, untouched } = *frames;
        let untouched = self.skin.better(untouched);
        let (mut work, mut frame_v) = (FitWork::default(), Vec::new());
        let mut readings = Vec::new();
        for frame in voltages_v.chunks_exact(self.skin.channels()) {
            self.skin.take_offsets(frame, untouched, &mut frame_v);
            let observation = self.skin.observation(&frame_v, averaged, untouched);
            let proposals = self.proposals(&frame_v)?;
            let fit = self.skin.fitter.fit(&observation, &proposals, &mut work)?;
            let zero_hours = frames.untouched.map(|skin| skin.hours);
            readings.push(self.skin.reading(&fit, zero_hours, averaged));
        }
        Ok(readings)
    }

    /// Fits the mean of the frames since the last change of the load, starting from the last fit if
    /// it is still valid. While nothing is found, the zero follows the offsets; it ages while something is.
    fn follow(&self, frame: &[f32], _: ForceMaps, tracked: &mut Tracked) -> InferResult<Reading> {
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
        let drift = &self.skin.errors.drift;
        let observation = Observation {
            frame_v: mean.mean_v,
            frames: mean.frames,
            offset_sd_v: drift.sd_v(tracked.zero.share_of_day()),
            offset_spectrum: &drift.spectrum,
        };
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
        } else {
            tracked.zero.touched();
        }
        let zero_hours = tracked.zero.share_of_day().map(|_| tracked.zero.hours());
        let mut reading = self.skin.reading(&fit, zero_hours, mean.frames);
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
        Some(UsedSkin { id: self.skin.id(), calibration, run, limitation: self.skin.limitation() })
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
    fn proposals(&self, frame_v: &[f64]) -> InferResult<Vec<Proposal>> {
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
