//! The paper's second baseline (V-D, Suppl. S-VI): the linearised model inverted in one step.
//! Uses: sim-core's `inverse::linear`, `dataset::force_map`. Never: a net, a second step.
//!
//! Forces on the sensor's points are drawn as a force map, and its peaks are read as for other
//! maps.

use std::sync::Arc;

use sim_core::forward::{Contact, ForwardModel};
use sim_core::inverse::linear::{OneStep, Penalty, PointSlopes, Regularisation};

use super::{Frames, ReadyMethod, UsedSkin};
use crate::dataset::force_map::ForceMap;
use crate::ids::CalibrationId;
use crate::infer::answer::Reading;
use crate::infer::error::InferResult;
use crate::infer::maps::{ForceMaps, MAP_1, contacts};
use crate::infer::registry::Model;

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
    calibration: Option<CalibrationId>,
    size_mm: [f64; 2],
}

impl OneStepPipeline {
    /// Linearises a model; peaks have at least `threshold_n`. Takes about 1 s.
    ///
    /// # Errors
    /// `InferError::OneStep` if the model cannot be inverted; `Map` if the map does not fit the
    /// skin.
    pub fn new(
        model: &ForwardModel,
        regularisation: Regularisation,
        threshold_n: f64,
    ) -> InferResult<Self> {
        let sensor = model.sensor();
        let size_mm = [sensor.file.width_mm, sensor.file.height_mm];
        let slopes = PointSlopes::secant(model, ABOUT_N)?;
        Ok(Self {
            step: Arc::new(OneStep::new(&slopes, regularisation)?),
            points_mm: sensor.points().iter().map(|p| [p.x_mm, p.y_mm]).collect(),
            offset_v: sensor.offsets_v(),
            draws: ForceMap::new(MAP_1, size_mm)?,
            threshold_n,
            calibration: sensor.calibration().map(CalibrationId::unchecked),
            size_mm,
        })
    }
}

impl ReadyMethod for OneStepPipeline {
    fn read(&self, frames: &Frames<'_>, maps: ForceMaps) -> InferResult<Vec<Reading>> {
        let mut readings = Vec::new();
        for frame in frames.voltages_v.chunks_exact(self.offset_v.len()) {
            let frame = frame.iter().zip(&self.offset_v).map(|(v, offset)| f64::from(*v) - offset);
            let forces = self.step.solve(&frame.collect::<Vec<_>>(), Penalty::Gcv)?.forces_n;
            let pressed = self.points_mm.iter().zip(forces).filter(|(_, n)| *n > 0.0);
            let of = |(&[x_mm, y_mm], force_n): (&[f64; 2], f64)| Contact { x_mm, y_mm, force_n };
            let pressed: Vec<Contact> = pressed.map(of).collect();
            let mut map = vec![0.0; self.draws.pixels() * self.draws.pixels()];
            self.draws.render(&pressed, &mut map)?;
            readings.push(Reading {
                contacts: contacts(&self.draws, &map, self.threshold_n),
                force_map_n: maps.keep(|| map),
                force_map_mm: maps.keep(|| MAP_1.side_mm),
                ..Reading::default()
            });
        }
        Ok(readings)
    }

    fn nets(&self) -> Vec<&Model> {
        Vec::new()
    }

    fn skin(&self) -> Option<UsedSkin<'_>> {
        let calibration = self.calibration.as_ref();
        Some(UsedSkin { id: "of one step", calibration, run: None, limitation: None })
    }

    fn size_mm(&self) -> [f64; 2] {
        self.size_mm
    }
}
