//! Frames as a real converter sees them: each channel sampled in its turn, in counts.
//! Uses: `laws`, `field`. Never: the network (a held load is solved once).
//!
//! Channel i of a frame that begins at t is sampled at `t + i / sample_hz`. In its order,
//! `counts(g(T, held) v + crosstalk + mains + buffers_j - buffers_(j+1) + converter(T) + white)`: temperature and
//! relaxation change the signal, buffers of electrodes carry offsets, separate 1/f noise and a separate walk, and the
//! offset of the converter, which all channels share, follows the temperature.

use std::f64::consts::{LN_10, TAU};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::field::{normal, stream};
use crate::laws::{Laws, ReadoutLaw};

/// A day, s.
pub const DAY_S: f64 = 86_400.0;
const HOUR_S: f64 = 3_600.0;
/// Correlation time of the temperature's irregular part, s.
const HOURS_S: f64 = 7_200.0;
/// Correlation times of the parts of 1/f noise, s: equal variance in each decade.
const FLICKER_S: [f64; 5] = [0.1, 1.0, 10.0, 100.0, 1_000.0];

/// Readout of one skin, with its state.
#[derive(Debug, Clone)]
pub struct Readout {
    law: ReadoutLaw,
    rng: ChaCha8Rng,
    buffers: Vec<Buffer>,
    converter_v_per_k: f64,
    temperature: Walk,
    day_phase: f64,
    mains_phase: f64,
    previous_v: f64,
    /// Latest time of a frame, s: a readout is drawn at 0.
    at_s: f64,
    held: Option<(u64, f64)>,
}

/// Buffer of one electrode, V.
#[derive(Debug, Clone)]
struct Buffer {
    offset: Drift,
    per_k: f64,
    flicker: [Walk; FLICKER_S.len()],
}

/// A random walk that does not return, V: its value at every hour, straight lines between. It is a function of
/// the time alone, so that a session continues the one of the day before.
#[derive(Debug, Clone)]
struct Drift {
    step_v: f64,
    rng: ChaCha8Rng,
    at_hours_v: Vec<f64>,
}

impl Drift {
    fn at(&mut self, time_s: f64) -> f64 {
        let hours = time_s.max(0.0) / HOUR_S;
        let before = hours as usize;
        while self.at_hours_v.len() < before + 2 {
            let last_v = self.at_hours_v.last().copied().unwrap_or(0.0);
            self.at_hours_v.push(last_v + self.step_v * normal(&mut self.rng));
        }
        let (a, b) = (self.at_hours_v[before], self.at_hours_v[before + 1]);
        a + (b - a) * (hours - before as f64)
    }
}

/// A random walk that returns to zero.
#[derive(Debug, Clone, Copy)]
struct Walk {
    sd: f64,
    time_s: f64,
    value: f64,
}

impl Walk {
    /// A walk that has been going for long.
    fn settled(sd: f64, time_s: f64, rng: &mut ChaCha8Rng) -> Self {
        Self { sd, time_s, value: sd * normal(rng) }
    }

    fn advance(&mut self, elapsed_s: f64, rng: &mut ChaCha8Rng) {
        let kept = (-elapsed_s / self.time_s).exp();
        self.value = kept * self.value + (1.0 - kept * kept).sqrt() * self.sd * normal(rng);
    }
}

impl Readout {
    /// Draws the readout of a seed with a number of electrodes.
    pub fn new(laws: &Laws, seed: u64, electrodes: usize) -> Self {
        let law = laws.readout;
        let mut rng = stream(seed, "readout");
        let step_v = 1e-3 * law.offset_per_day_mv * (HOUR_S / DAY_S).sqrt();
        let buffers = (0..electrodes)
            .map(|electrode| Buffer {
                offset: Drift {
                    step_v,
                    rng: stream(seed, &format!("offset {electrode}")),
                    at_hours_v: vec![1e-3 * law.offset_mv * normal(&mut rng)],
                },
                per_k: 1e-3 * law.offset_per_k_mv * normal(&mut rng),
                flicker: FLICKER_S.map(|time_s| {
                    let sd = 1e-3 * law.flicker_mv / (FLICKER_S.len() as f64).sqrt();
                    Walk::settled(sd, time_s, &mut rng)
                }),
            })
            .collect();
        let temperature = Walk::settled(law.hours_k, HOURS_S, &mut rng);
        let [day_phase, mains_phase] = [0, 1].map(|_| TAU * rng.random::<f64>());
        let converter_v_per_k = 1e-3 * law.converter_per_k_mv * normal(&mut rng);
        Self {
            law,
            rng,
            buffers,
            converter_v_per_k,
            temperature,
            day_phase,
            mains_phase,
            previous_v: 0.0,
            at_s: 0.0,
            held: None,
        }
    }

    /// One frame of a held load that begins at a process time, V. `static_v` and `out` hold the squared
    /// number of electrodes. Time that runs back counts as none.
    pub fn frame(&mut self, static_v: &[f64], process_time_s: f64, out: &mut [f32]) {
        let elapsed_s = (process_time_s - self.at_s).max(0.0);
        self.at_s = self.at_s.max(process_time_s);
        self.temperature.advance(elapsed_s, &mut self.rng);
        for buffer in &mut self.buffers {
            for part in &mut buffer.flicker {
                part.advance(elapsed_s, &mut self.rng);
            }
        }
        let warm_k = self.temperature.value
            + self.law.day_k
                * ((TAU * process_time_s / DAY_S + self.day_phase).sin() - self.day_phase.sin());
        let gain =
            (1.0 + self.law.conductance_per_k * warm_k) * self.relaxed(static_v, process_time_s);
        let count = self.buffers.len();
        let volts = |buffer: &mut Buffer| {
            buffer.offset.at(process_time_s)
                + buffer.per_k * warm_k
                + buffer.flicker.iter().map(|w| w.value).sum::<f64>()
        };
        let converter_v = self.converter_v_per_k * warm_k;
        let buffers_v: Vec<f64> = self.buffers.iter_mut().map(volts).collect();
        for (i, (out, v)) in out.iter_mut().zip(static_v).enumerate() {
            let j = i % count;
            let at_s = process_time_s + i as f64 / self.law.sample_hz;
            let mains = (TAU * self.law.mains_hz * at_s + self.mains_phase).sin();
            let clean = gain * v + buffers_v[j] - buffers_v[(j + 1) % count];
            let mixed = clean + self.law.crosstalk * (self.previous_v - clean) + converter_v;
            self.previous_v = clean;
            let noise_mv = self.law.mains_mv * mains + self.law.white_mv * normal(&mut self.rng);
            let step_v = 1e-3 * self.law.count_mv;
            *out = ((mixed + 1e-3 * noise_mv) / step_v).round().mul_add(step_v, 0.0) as f32;
        }
    }

    /// Growth of the signal since the load is held.
    fn relaxed(&mut self, static_v: &[f64], process_time_s: f64) -> f64 {
        let load =
            static_v.iter().fold(0u64, |sum, v| sum.rotate_left(5).wrapping_add(v.to_bits()));
        let since_s = match self.held {
            Some((known, since_s)) if known == load => since_s,
            _ => process_time_s,
        };
        self.held = Some((load, since_s));
        1.0 + self.law.relaxation_per_decade * (process_time_s - since_s).max(0.0).ln_1p() / LN_10
    }
}
