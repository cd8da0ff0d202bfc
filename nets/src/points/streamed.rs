//! Samples for Point-Net, simulated during training: a fixed set is memorised within a few epochs
//! (`docs/references.md`, "Feasibility study").
//! Uses: sim-core. Never: files. A sample is a function of seed and number alone.

use std::sync::Arc;

use parking_lot::Mutex;
use sim_core::batch::{BatchModel, BatchWork};
use sim_core::forward::Contact;
use sim_core::sensor::Point;

use super::draws::Draws;
use crate::error::{SamplesError, SamplesResult};
use crate::samples::Samples;

/// A stream of simulated samples: the frame, and the force at each point.
pub struct Streamed {
    model: Arc<BatchModel>,
    points: Vec<Point>,
    draws: Draws,
    seed: u64,
    len: u64,
    work: Mutex<BatchWork>,
}

impl Streamed {
    /// A stream of a seed, with `len` samples per epoch. `points` are those of the model's skin.
    pub fn new(
        model: Arc<BatchModel>,
        points: &[Point],
        draws: Draws,
        seed: u64,
        len: u64,
    ) -> Self {
        let work = Mutex::default();
        Self { model, points: points.to_vec(), draws, seed, len, work }
    }
}

impl Samples for Streamed {
    fn len(&self) -> u64 {
        self.len
    }

    fn input_len(&self) -> usize {
        self.model.frame_len()
    }

    fn target_len(&self) -> usize {
        self.points.len()
    }

    fn is_stream(&self) -> bool {
        true
    }

    fn read(&self, samples: &[u64], inputs: &mut [f32], targets: &mut [f32]) -> SamplesResult<()> {
        targets.fill(0.0);
        let mut trials = Vec::with_capacity(samples.len());
        for (&number, target) in samples.iter().zip(targets.chunks_exact_mut(self.points.len())) {
            let drawn = self.draws.sample(self.seed, number, self.points.len());
            let contacts = drawn.into_iter().map(|(point, force_n)| {
                target[point] = force_n as f32;
                let Point { x_mm, y_mm, .. } = self.points[point];
                Contact { x_mm, y_mm, force_n }
            });
            trials.push(contacts.collect::<Vec<_>>());
        }
        let trials: Vec<&[Contact]> = trials.iter().map(Vec::as_slice).collect();
        // Work is scratch memory: contents left by a failed thread are overwritten.
        let mut work = self.work.lock();
        self.model
            .voltages(&trials, inputs, &mut work)
            .map_err(|e| SamplesError::Source { message: e.to_string() })
    }
}
