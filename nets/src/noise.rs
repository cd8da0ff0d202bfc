//! Gaussian noise on frames (paper V-C), a function of seed, epoch and sample alone.
//! PURE. Never: targets.

use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::chance::{Purpose, generator};

/// Gaussian noise on every channel, redrawn in each epoch (paper V-C).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Noise {
    /// Factor on each channel's standard deviation, which the plan states: the paper's 0, 0.1, 0.5.
    pub level: f64,
    /// Additional standard deviation of all channels, V: the readout's white noise.
    pub white_v: f64,
}

/// Noise of a training.
#[derive(Debug, Clone)]
pub struct NoiseSource {
    seed: u64,
    /// Standard deviation of each channel, V; empty without noise.
    sd_v: Vec<f32>,
}

impl NoiseSource {
    /// Noise of a recipe; `sd_v` is multiplied by its level, and may be `None` if the level is
    /// zero.
    pub fn new(seed: u64, noise: Noise, sd_v: Option<&[f32]>, channels: usize) -> Self {
        let of = |channel: usize| {
            let scaled = sd_v.map_or(0.0, |sd_v| noise.level * f64::from(sd_v[channel]));
            scaled.hypot(noise.white_v) as f32
        };
        let sd_v: Vec<f32> = (0..channels).map(of).collect();
        let none = sd_v.iter().all(|&sd| sd == 0.0);
        Self { seed, sd_v: if none { Vec::new() } else { sd_v } }
    }

    /// Adds the noise of an epoch to a sample's frame.
    pub fn add(&self, epoch: u64, sample: u64, frame: &mut [f32]) {
        if self.sd_v.is_empty() {
            return;
        }
        let mut chance = generator(self.seed, Purpose::Noise, epoch, sample);
        for (v, sd) in frame.iter_mut().zip(&self.sd_v) {
            let normal: f32 = StandardNormal.sample(&mut chance);
            *v += sd * normal;
        }
    }
}
