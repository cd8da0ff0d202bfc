//! Frames of a held load: drift, creep and noise on top of its static voltages.
//! Uses: gap, chance. Never: the forward model (a held load is solved once).
//!
//! `out = static gain(t) exp(-d(t)) (1 + creep log10(1 + t_held)) + offset + noise`. The two drifts
//! are Ornstein-Uhlenbeck processes of process time. Offsets belong to the buffers of the
//! electrodes and so cancel around the ring; noise belongs to the converter, on each difference:
//! the 28 values of an injection sum to noise.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::chance::stream;
use super::gap::{Gap, ReadoutGap};

/// Readout of one skin, with the state of its drift.
#[derive(Debug, Clone)]
pub struct Readout {
    gap: ReadoutGap,
    seed: u64,
    rng: ChaCha8Rng,
    ln_a: Drift,
    gain: Drift,
    offsets_v: Vec<f64>,
    held: Option<Held>,
}

/// The held load, and the time since which it is held.
#[derive(Debug, Clone, Copy)]
struct Held {
    fingerprint: u64,
    since_s: f64,
}

/// A random drift around zero, with standard deviation and correlation time.
#[derive(Debug, Clone, Copy)]
struct Drift {
    sd: f64,
    time_s: f64,
    value: f64,
    at_s: Option<f64>,
}

impl Drift {
    fn new(sd: f64, time_s: f64) -> Self {
        Self { sd, time_s, value: 0.0, at_s: None }
    }

    /// Value at a later time; an earlier time leaves it unchanged.
    fn at(&mut self, time_s: f64, normal: f64) -> f64 {
        let kept = match self.at_s {
            None => 0.0,
            Some(before) => (-(time_s - before).max(0.0) / self.time_s).exp(),
        };
        self.value = kept * self.value + (1.0 - kept * kept).sqrt() * self.sd * normal;
        self.at_s = Some(self.at_s.map_or(time_s, |before| before.max(time_s)));
        self.value
    }
}

impl Readout {
    /// Creates the readout of a gap and a seed.
    pub fn new(gap: &Gap, seed: u64) -> Self {
        let gap = gap.readout;
        Self {
            gap,
            seed,
            rng: stream(seed, "readout noise"),
            ln_a: Drift::new(gap.ln_a_drift_sd, gap.ln_a_drift_time_s),
            gain: Drift::new(gap.gain_drift_sd, gap.gain_drift_time_s),
            offsets_v: Vec::new(),
            held: None,
        }
    }

    /// One frame of a held load at a process time, V. `static_v` and `out` have the same length,
    /// electrodes squared (the rest of a longer one is not changed).
    pub fn frame(&mut self, static_v: &[f64], process_time_s: f64, out: &mut [f32]) {
        if self.offsets_v.len() != static_v.len() {
            self.offsets_v = offsets_v(self.seed, static_v.len(), self.gap.offset_sd_mv * 1e-3);
        }
        let mut normal = || -> f64 { StandardNormal.sample(&mut self.rng) };
        let ln_a = self.ln_a.at(process_time_s, normal());
        let gain = 1.0 + self.gain.at(process_time_s, normal());
        let factor = gain * (-ln_a).exp() * self.creep(static_v, process_time_s);
        let noise_v = self.gap.noise_sd_mv * 1e-3;
        for ((out, v), offset) in out.iter_mut().zip(static_v).zip(&self.offsets_v) {
            let noise: f64 = StandardNormal.sample(&mut self.rng);
            *out = (factor * v + offset + noise_v * noise) as f32;
        }
    }

    /// Growth of the signal since the begin of the load.
    fn creep(&mut self, static_v: &[f64], process_time_s: f64) -> f64 {
        if self.gap.creep_per_decade == 0.0 {
            return 1.0;
        }
        let fingerprint = static_v.iter().fold(0xcbf2_9ce4_8422_2325u64, |hash, v| {
            (hash ^ v.to_bits()).wrapping_mul(0x0000_0100_0000_01b3)
        });
        let held = match self.held {
            Some(held) if held.fingerprint == fingerprint => held,
            _ => Held { fingerprint, since_s: process_time_s },
        };
        self.held = Some(held);
        let held_s = (process_time_s - held.since_s).max(0.0);
        1.0 + self.gap.creep_per_decade * held_s.ln_1p() / std::f64::consts::LN_10
    }
}

/// Fixed offsets of the channels: differences of buffer offsets around the ring of each injection.
fn offsets_v(seed: u64, channels: usize, sd_v: f64) -> Vec<f64> {
    let electrodes = (channels as f64).sqrt().round() as usize;
    let mut rng = stream(seed, "readout offsets");
    let mut out = Vec::with_capacity(channels);
    for start in (0..channels).step_by(electrodes.max(1)) {
        let count = electrodes.min(channels - start);
        let buffers: Vec<f64> = (0..count)
            .map(|_| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                sd_v / 2f64.sqrt() * normal
            })
            .collect();
        out.extend((0..count).map(|j| buffers[j] - buffers[(j + 1) % count]));
    }
    out
}
