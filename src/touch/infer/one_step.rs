//! The paper's second baseline (V-D, Suppl. S-VI): the linearised model inverted in one step.
//! Uses: sim-core's `inverse::linear`, `dataset::force_map`. Never: a net, a second step.
//!
//! Forces on the sensor's points are drawn as a force map, and its peaks are read as for other
//! maps.

use std::sync::Arc;

use sim_core::forward::ForwardModel;
use sim_core::inverse::linear::{OneStep, Penalty, PointSlopes, Regularisation};

use super::answer::Reading;
use super::error::InferError;
use super::maps::contacts;
use crate::dataset::force_map::{ForceMap, ForceMapSpec};

/// Force per point about which the model is linearised, N: the middle of the usual range.
const ABOUT_N: f64 = 15.0;

/// A linearised model with its decomposition.
#[derive(Debug, Clone)]
pub struct OneStepPipeline {
    step: Arc<OneStep>,
    points_mm: Vec<[f64; 2]>,
    offset_v: Vec<f64>,
    draws: ForceMap,
    threshold_n: f64,
}

impl OneStepPipeline {
    /// Linearises a model; maps are laid out by `spec`, peaks have at least `threshold_n`. Takes
    /// about 1 s.
    ///
    /// # Errors
    /// `InferError::OneStep` if the model cannot be inverted; `Map` if the map does not fit the
    /// skin.
    pub fn new(
        model: &ForwardModel,
        regularisation: Regularisation,
        spec: ForceMapSpec,
        threshold_n: f64,
    ) -> Result<Self, InferError> {
        let sensor = model.sensor();
        let slopes = PointSlopes::secant(model, ABOUT_N)?;
        let channels = sensor.channels();
        let offsets =
            sensor.skin().map(|skin| skin.offsets_mv.iter().map(|mv| 1e-3 * mv).collect());
        let offsets = offsets.filter(|offsets: &Vec<f64>| offsets.len() == channels);
        Ok(Self {
            step: Arc::new(OneStep::new(&slopes, regularisation)?),
            points_mm: sensor.points().iter().map(|p| [p.x_mm, p.y_mm]).collect(),
            offset_v: offsets.unwrap_or_else(|| vec![0.0; channels]),
            draws: ForceMap::new(spec, sensor.file.width_mm, sensor.file.height_mm)?,
            threshold_n,
        })
    }

    /// Reads frames (V, one after the other).
    ///
    /// # Errors
    /// `InferError::OneStep` if a frame is not finite.
    pub fn read(&self, frames: &[f32], with_map: bool) -> Result<Vec<Reading>, InferError> {
        let mut readings = Vec::new();
        for frame in frames.chunks_exact(self.offset_v.len()) {
            let frame = frame.iter().zip(&self.offset_v).map(|(v, offset)| f64::from(*v) - offset);
            let forces = self.step.solve(&frame.collect::<Vec<_>>(), Penalty::Gcv)?.forces_n;
            let pressed = self.points_mm.iter().zip(forces).filter(|(_, n)| *n > 0.0);
            let pressed: Vec<(f64, f64, f64)> = pressed.map(|([x, y], n)| (*x, *y, n)).collect();
            let mut map = vec![0.0; self.draws.pixels() * self.draws.pixels()];
            self.draws.render(&pressed, &mut map)?;
            readings.push(Reading {
                contacts: contacts(&self.draws, &map, self.threshold_n),
                force_map_n: with_map.then_some(map),
                ..Reading::default()
            });
        }
        Ok(readings)
    }
}
