//! The paper's method (V-C): Transfer-Net, then Recon-Net, then the peaks of the map.
//! Uses: `infer::{maps, registry}`, `dataset::force_map`. Never: files.

use std::sync::Arc;

use super::{Frames, ReadyMethod};
use crate::dataset::force_map::peaks::THRESHOLD_N;
use crate::dataset::force_map::{ForceMap, ForceMapSpec, SIDE_MM};
use crate::infer::answer::Reading;
use crate::infer::error::{InferError, InferResult};
use crate::infer::maps::{ForceMaps, contacts};
use crate::infer::registry::Model;
use crate::learn::task::{Answers, Reads};
use crate::problem::Problem;

/// Least sum of a peak for nets trained without forces, whose contacts sum up to 1.
const HALF_A_CONTACT: f64 = 0.5;
/// Least force of a peak on another square than the paper's, as a share of the largest in training: the paper's 5 N are
/// an eighth of about 40 N.
const SHARE_OF_LARGEST: f64 = 0.125;
/// Number of frames whose maps are in memory at a time.
const MAPS_AT_ONCE: usize = 64;

/// Transfer-Net and Recon-Net, or an end-to-end net alone.
#[derive(Debug, Clone)]
pub struct MapPipeline {
    transfer: Option<Arc<Model>>,
    map: Arc<Model>,
    spec: ForceMapSpec,
    draws: ForceMap,
    /// Least force of a peak, N.
    threshold_n: f64,
    /// Whether peaks have forces.
    has_forces: bool,
}

impl MapPipeline {
    /// Combines a net with force maps as answers and, if it needs simulated voltages, a
    /// Transfer-Net. Without `transfer`, frames are the input of `map`. `threshold_n`: least force of a peak, N, if
    /// it is not that of the net.
    ///
    /// # Errors
    /// `InferError::OtherTask` if a net has another task; `Problems` if `map` reads measured
    /// voltages, so that `transfer` has no use; `Map` if the map does not fit the skin.
    pub fn new(
        transfer: Option<Arc<Model>>,
        map: Arc<Model>,
        threshold_n: Option<f64>,
    ) -> InferResult<Self> {
        if let Some(transfer) = &transfer
            && transfer.manifest.model.task.answers() != Answers::Frame
        {
            return Err(transfer.of_other_task("a Transfer-Net is needed"));
        }
        let wanted = "a Recon-Net or an end-to-end net is needed";
        let spec = map.manifest.model.force_map.ok_or_else(|| map.of_other_task(wanted))?;
        if let Some(transfer) = &transfer
            && map.manifest.model.task.reads() == Reads::Measured
        {
            let limit =
                format!("must be absent: map = {} reads measured voltages", map.manifest.id);
            let problem = Problem::new("request", "transfer", &transfer.manifest.id, limit);
            return Err(InferError::Problems(vec![problem]));
        }
        let draws = ForceMap::new(spec, map.size_mm())?;
        let trained_on = &map.manifest.model.trained_on;
        let has_forces = !trained_on.forces_unknown;
        let threshold_n = threshold_n.unwrap_or_else(|| least_n(spec, trained_on.max_force_n));
        Ok(Self { transfer, map, spec, draws, threshold_n, has_forces })
    }

    fn read_some(&self, frames: &[f32], kept: ForceMaps) -> InferResult<Vec<Reading>> {
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
        let least = if self.has_forces { self.threshold_n } else { HALF_A_CONTACT };
        for (frame, map) in frames.zip(maps.chunks_exact(pixels * pixels)) {
            let mut contacts = contacts(&self.draws, map, least);
            if !self.has_forces {
                contacts.iter_mut().for_each(|contact| contact.force_n = None);
            }
            let forces_n: Vec<f64> = contacts.iter().filter_map(|c| c.force_n).collect();
            let ranges = [&first.manifest.model.trained_on, &self.map.manifest.model.trained_on];
            let outside = ranges[0].frame(frame).into_iter().chain(ranges[1].answer(&forces_n));
            readings.push(Reading {
                contacts,
                force_map_n: kept.keep(|| map.to_vec()),
                force_map_mm: kept.keep(|| self.spec.side_mm),
                outside: outside.map(|out| out.to_string()).collect(),
                ..Reading::default()
            });
        }
        Ok(readings)
    }
}

impl ReadyMethod for MapPipeline {
    fn read(&self, frames: &Frames<'_>, maps: ForceMaps) -> InferResult<Vec<Reading>> {
        let mut readings = Vec::new();
        let first = self.transfer.as_ref().unwrap_or(&self.map);
        for frames in frames.voltages_v.chunks(MAPS_AT_ONCE * first.plan.channels()) {
            readings.extend(self.read_some(frames, maps)?);
        }
        Ok(readings)
    }

    fn nets(&self) -> Vec<&Model> {
        self.transfer.iter().chain([&self.map]).map(Arc::as_ref).collect()
    }

    fn reads(&self) -> Reads {
        match self.transfer {
            Some(_) => Reads::Measured,
            None => self.map.manifest.model.task.reads(),
        }
    }

    fn map(&self) -> ForceMapSpec {
        self.spec
    }

    fn threshold_n(&self) -> f64 {
        self.threshold_n
    }

    fn size_mm(&self) -> [f64; 2] {
        self.map.size_mm()
    }
}

/// Least force of a peak of a map of a skin, N, from the largest one in the training of its net.
fn least_n(spec: ForceMapSpec, largest_n: Option<f64>) -> f64 {
    let of_skin_n = largest_n.filter(|_| spec.side_mm != SIDE_MM).map(|n| SHARE_OF_LARGEST * n);
    // Rounded, since tables show it.
    of_skin_n.map_or(THRESHOLD_N, |n| THRESHOLD_N.min((100.0 * n).round() / 100.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::force_map::TABLE_IV_MAPS;

    #[test]
    fn the_papers_threshold_is_that_of_its_square_and_lighter_skins_have_a_lower_one() {
        let paper = TABLE_IV_MAPS[0];
        let pad = ForceMapSpec { pixel_mm: 2.5, diameter_mm: 10.0, side_mm: 100.0 };
        assert_eq!(least_n(paper, Some(8.0)), 5.0);
        assert_eq!((least_n(pad, Some(8.0)), least_n(pad, Some(3.333))), (1.0, 0.42));
        assert_eq!((least_n(pad, Some(90.0)), least_n(pad, None)), (5.0, 5.0));
    }
}
