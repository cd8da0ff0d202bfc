//! The paper's way (V-C): Transfer-Net, then Recon-Net, then the peaks of the map.
//! Uses: `infer::{registry, plan}`, `dataset::force_map`. Never: files, a threshold of its own.

use std::sync::Arc;

use super::answer::{FoundContact, Reading};
use super::error::InferError;
use super::registry::Model;
use crate::dataset::force_map::{ForceMap, ForceMapSpec, TABLE_IV};
use crate::learn::model_file::NetTask;

/// Least sum of a peak where contacts sum up to 1, since no force was known.
const HALF_A_CONTACT: f64 = 0.5;
/// Frames whose maps are held at a time.
const FRAMES_AT_ONCE: usize = 64;

/// Transfer-Net and Recon-Net, or an end-to-end net alone.
#[derive(Debug, Clone)]
pub struct MapPipeline {
    transfer: Option<Arc<Model>>,
    map: Arc<Model>,
    spec: ForceMapSpec,
    draws: ForceMap,
    /// Least force of a peak, N.
    threshold_n: f64,
    /// Whether peaks say how hard.
    has_forces: bool,
}

impl MapPipeline {
    /// Of a net that gives maps and, where it wants simulated voltages, one that makes them. Without
    /// a `transfer` frames go into `map` as they are.
    pub fn new(
        transfer: Option<Arc<Model>>,
        map: Arc<Model>,
        threshold_n: f64,
    ) -> Result<Self, InferError> {
        let other = |model: &Model, wanted| InferError::OtherTask {
            id: model.manifest.id.clone(),
            task: model.manifest.model.task.as_str(),
            wanted,
        };
        if let Some(transfer) = &transfer
            && transfer.manifest.model.task != NetTask::Transfer
        {
            return Err(other(transfer, "one that gives simulated voltages is wanted"));
        }
        let spec = map.manifest.model.force_map;
        let spec = spec.ok_or_else(|| other(&map, "one that gives force maps is wanted"))?;
        let draws = ForceMap::new(spec, map.skin.width_mm, map.skin.height_mm)?;
        let has_forces = !map.manifest.model.trained_on.forces_unknown;
        let threshold_n = if has_forces { threshold_n } else { HALF_A_CONTACT };
        Ok(Self { transfer, map, spec, draws, threshold_n, has_forces })
    }

    /// Ids of its models.
    pub fn models(&self) -> Vec<String> {
        self.nets().map(|model| model.manifest.id.clone()).collect()
    }

    /// Its nets, in order.
    pub fn nets(&self) -> impl Iterator<Item = &Model> {
        self.transfer.iter().chain([&self.map]).map(Arc::as_ref)
    }

    /// What the net that gives maps was trained for.
    pub fn task(&self) -> NetTask {
        self.map.manifest.model.task
    }

    /// How its maps are laid out.
    pub fn spec(&self) -> ForceMapSpec {
        self.spec
    }

    /// Reads frames (V, one after the other); no more maps are held than are wished for.
    pub fn read(&self, frames: &[f32], with_map: bool) -> Result<Vec<Reading>, InferError> {
        let mut readings = Vec::new();
        let first = self.transfer.as_ref().unwrap_or(&self.map);
        for frames in frames.chunks(FRAMES_AT_ONCE * first.plan.channels()) {
            readings.extend(self.read_some(frames, with_map)?);
        }
        Ok(readings)
    }

    fn read_some(&self, frames: &[f32], with_map: bool) -> Result<Vec<Reading>, InferError> {
        let mut transferred = Vec::new();
        let frames_in = match &self.transfer {
            Some(transfer) => {
                transfer.plan.answer(frames, &mut transferred)?;
                &transferred
            }
            None => frames,
        };
        let mut maps = Vec::new();
        self.map.plan.answer(frames_in, &mut maps)?;
        let first = self.transfer.as_ref().unwrap_or(&self.map);
        let frames = frames.chunks_exact(first.plan.channels());
        let pixels = self.draws.pixels();
        let mut readings = Vec::with_capacity(frames.len());
        for (frame, map) in frames.zip(maps.chunks_exact(pixels * pixels)) {
            let mut contacts = contacts(&self.draws, map, self.threshold_n);
            if !self.has_forces {
                contacts.iter_mut().for_each(|contact| contact.force_n = None);
            }
            let forces_n: Vec<f64> = contacts.iter().filter_map(|c| c.force_n).collect();
            let ranges = [&first.manifest.model.trained_on, &self.map.manifest.model.trained_on];
            let outside = ranges[0].frame(frame).into_iter().chain(ranges[1].answer(&forces_n));
            readings.push(Reading {
                contacts,
                force_map_n: with_map.then(|| map.to_vec()),
                outside: outside.map(|out| out.to_string()).collect(),
                ..Reading::default()
            });
        }
        Ok(readings)
    }
}

/// How contacts are drawn that no net made a map of: the paper's Map 1, 160 x 160 pixels.
pub const MAP_1: ForceMapSpec = TABLE_IV[0];

/// Draws the contacts of readings that have no map (Map 1); those without a force are left out.
pub fn draw(readings: &mut [Reading], [width_mm, height_mm]: [f64; 2]) -> Result<(), InferError> {
    let draws = ForceMap::new(MAP_1, width_mm, height_mm)?;
    for reading in readings.iter_mut().filter(|reading| reading.force_map_n.is_none()) {
        let pressed = reading.contacts.iter().filter_map(|c| Some((c.x_mm, c.y_mm, c.force_n?)));
        let mut map = vec![0.0; draws.pixels() * draws.pixels()];
        draws.render(&pressed.collect::<Vec<_>>(), &mut map)?;
        reading.force_map_n = Some(map);
    }
    Ok(())
}

/// The peaks of a map as contacts, strongest first.
pub fn contacts(draws: &ForceMap, map: &[f32], threshold_n: f64) -> Vec<FoundContact> {
    let mut peaks = draws.peaks(map, threshold_n);
    peaks.sort_by(|a, b| b.force_n.total_cmp(&a.force_n));
    let found = |p: &crate::dataset::force_map::peaks::Peak| FoundContact {
        x_mm: p.x_mm,
        y_mm: p.y_mm,
        force_n: Some(p.force_n),
        diameter_mm: Some(p.diameter_mm),
        ..FoundContact::default()
    };
    peaks.iter().map(found).collect()
}
