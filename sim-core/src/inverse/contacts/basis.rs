//! The few directions in which frames differ: reduces 784 voltages to some tens of numbers.
//! Uses: the batch model for sample frames, the error model. Never: the meaning of a measured
//! frame.
//!
//! Light frames have 27 directions above the noise, the heaviest some tens more
//! (`docs/references.md`, "Feasibility study"). In units of each channel's noise an orthonormal
//! basis keeps white noise white; the basis is turned so that the model's relative error is
//! uncorrelated too. The drift of the offsets is correlated between the numbers, so that a measured frame is
//! whitened by the covariance of its error (`whitener`).

use faer::{Mat, Side};

use super::FitterError;
use super::dense::{PAD, dot};
use super::error::ErrorModel;
use super::fit::Observation;
use super::whitener::Whitener;
use crate::batch::{BatchModel, BatchWork};
use crate::forward::Contact;
use crate::sensor::Sensor;
use crate::stats::{frequency, pair_sums, waves};

/// Number of sample loads from which the directions are determined.
const SAMPLE_LOADS: usize = 640;
/// Largest number of contacts in a sample load.
const MOST_CONTACTS: usize = 6;
/// Range of the forces of a sample load, N.
const FORCES_N: [f64; 2] = [4.0, 40.0];
/// Limit on the part of a sample frame outside the basis, in standard deviations of one channel's
/// noise over the whole frame.
const OUTSIDE: f64 = 0.5;
/// Largest number of directions: the last ones of the heaviest frames are far below any model
/// error.
const MOST_DIRECTIONS: usize = 64;

/// The directions of one model's frames.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    channels: usize,
    directions: usize,
    /// Length of a projected frame, padding included.
    width: usize,
    /// Row-major: `width` rows of `channels`, per volt.
    rows: Vec<f64>,
    /// The untouched frame, V.
    rest_v: Vec<f64>,
    /// Number of pairs of electrodes.
    pairs: usize,
    /// Change of each number by 1 V of each wave of offsets around the electrodes: `width` rows of `pairs`.
    offsets: Vec<f64>,
    /// Variance of a channel outside the basis by it, per V^2 of drift.
    drift_outside: f64,
    /// Variance of each number by the model's error, per V^2 of signal.
    relative: Vec<f64>,
    /// Variance of a channel outside the basis by the model's error, per V^2 of signal.
    relative_outside: f64,
    inverse_sd: Vec<f64>,
}

/// A measured frame in the basis.
#[derive(Debug, Clone, Default)]
pub(super) struct Projected {
    /// The projected frame minus that of the untouched skin, whitened.
    pub z: Vec<f64>,
    /// Makes the errors of numbers that are not whitened independent.
    pub whitener: Whitener,
    /// Variance of each number by the model's error, before it is whitened.
    pub by_model: Vec<f64>,
    covariance: Vec<f64>,
    /// Misfit outside the basis, which no contact can explain.
    pub outside_chi2: f64,
}

impl Basis {
    /// Determines the directions of a model's frames.
    ///
    /// # Errors
    /// `FitterError::Batch` if a sample load is rejected; `FitterError::Eigenvalues` without
    /// convergence.
    pub fn new(
        batch: &BatchModel,
        sensor: &Sensor,
        rest_v: &[f64],
        error: &ErrorModel,
    ) -> Result<Self, FitterError> {
        let channels = rest_v.len();
        let inverse_sd: Vec<f64> = error.channel_sd_v.iter().map(|sd| 1.0 / sd).collect();
        let mut frames = sample_frames(batch, sensor)?;
        for frame in &mut frames {
            for ((v, rest), scale) in frame.iter_mut().zip(rest_v).zip(&inverse_sd) {
                *v = (*v - rest) * scale;
            }
        }
        let directions = orthonormal(&mut frames);
        let (rows, relative) = turned(&directions, error, &inverse_sd)?;
        let width = rows.len().next_multiple_of(PAD);
        let mut flat: Vec<f64> = Vec::with_capacity(width * channels);
        for row in &rows {
            flat.extend(row.iter().zip(&inverse_sd).map(|(b, scale)| b * scale));
        }
        flat.resize(width * channels, 0.0);
        let pairs = channels.isqrt().max(1);
        let waves = waves(pairs);
        let of_waves = |row: &[f64]| -> Vec<f64> {
            let sums = pair_sums(row);
            waves.iter().map(|wave| dot(wave, &sums)).collect()
        };
        let offsets: Vec<f64> = flat.chunks_exact(channels).flat_map(of_waves).collect();
        let by_drift: f64 = offsets.iter().map(|v| v * v).sum();
        let precision: f64 = inverse_sd.iter().map(|s| s * s).sum();
        let mean_precision = precision / channels as f64;
        // What the numbers have of the drift is not outside.
        let outside = channels.saturating_sub(rows.len()).max(1) as f64;
        let drift_outside = (precision - by_drift).max(0.0) / outside;
        let mut basis = Self {
            channels,
            directions: rows.len(),
            width,
            rows: flat,
            rest_v: rest_v.to_vec(),
            pairs,
            offsets,
            drift_outside,
            relative,
            relative_outside: error.floor.powi(2) / channels as f64 * mean_precision,
            inverse_sd,
        };
        basis.relative.resize(width, 0.0);
        Ok(basis)
    }

    /// Number of directions, without padding.
    pub fn directions(&self) -> usize {
        self.directions
    }

    /// Length of a projected frame, a multiple of [`PAD`].
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of pairs of electrodes, each with one offset.
    pub fn pairs(&self) -> usize {
        self.pairs
    }

    /// Projects columns of `channels` volts (`columns` holds them one after the other).
    pub fn project(&self, columns: &[f64], out: &mut Vec<f64>) {
        out.clear();
        for column in columns.chunks_exact(self.channels) {
            out.extend(self.rows.chunks_exact(self.channels).map(|row| dot(row, column)));
        }
    }

    /// Projects a model's frame, minus that of the untouched skin.
    pub fn project_frame(&self, frame_v: &[f64], scratch: &mut Vec<f64>, out: &mut Vec<f64>) {
        scratch.clear();
        scratch.extend(frame_v.iter().zip(&self.rest_v).map(|(v, rest)| v - rest));
        self.project(scratch, out);
    }

    /// Projects a measured frame and whitens it. If it is the mean of many, drift and model error dominate.
    pub fn measure(
        &self,
        observation: &Observation<'_>,
        scratch: &mut Vec<f64>,
        out: &mut Projected,
    ) {
        let Observation { frame_v, frames, offset_sd_v, .. } = *observation;
        let drift_v2 = offset_sd_v.powi(2);
        self.project_frame(frame_v, scratch, &mut out.z);
        let (mut signal_v2, mut scaled) = (-drift_v2 * self.channels as f64, 0.0);
        for (v, scale) in scratch.iter().zip(&self.inverse_sd) {
            signal_v2 += v * v - 1.0 / (frames * scale * scale);
            scaled += (v * scale).powi(2);
        }
        let signal_v2 = signal_v2.max(0.0);
        let inside: f64 = out.z.iter().map(|z| z * z).sum();
        let variance =
            1.0 / frames + drift_v2 * self.drift_outside + signal_v2 * self.relative_outside;
        out.outside_chi2 = (scaled - inside).max(0.0) / variance;
        out.by_model.clear();
        out.by_model.extend(self.relative.iter().map(|relative| signal_v2 * relative));
        self.drift(drift_v2, observation.offset_spectrum, scratch, &mut out.covariance);
        for (i, by_model) in out.by_model.iter().enumerate() {
            out.covariance[i * self.width + i] += 1.0 / frames + by_model;
        }
        out.whitener.set(&out.covariance, self.width);
        out.whitener.apply(&mut out.z);
    }

    /// Writes the covariance of the numbers by the drift of the offsets, its lower triangle.
    fn drift(
        &self,
        drift_v2: f64,
        spectrum: &[f64],
        waves: &mut Vec<f64>,
        covariance: &mut Vec<f64>,
    ) {
        waves.clear();
        for row in self.offsets.chunks_exact(self.pairs) {
            let power = |wave: usize| spectrum.get(frequency(wave)).copied().unwrap_or(1.0);
            let scaled = row.iter().enumerate().map(|(w, v)| v * (drift_v2 * power(w)).sqrt());
            waves.extend(scaled);
        }
        covariance.clear();
        covariance.resize(self.width * self.width, 0.0);
        for (i, row) in waves.chunks_exact(self.pairs).enumerate() {
            for (j, other) in waves.chunks_exact(self.pairs).enumerate().take(i + 1) {
                covariance[i * self.width + j] = dot(row, other);
            }
        }
    }
}

/// Frames of loads on points, V: the same in every call.
fn sample_frames(batch: &BatchModel, sensor: &Sensor) -> Result<Vec<Vec<f64>>, FitterError> {
    let points = sensor.points();
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut uniform = || {
        // xorshift64: any fixed spread of positions is sufficient.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let [least, most] = FORCES_N;
    let loads: Vec<Vec<Contact>> = (0..SAMPLE_LOADS)
        .map(|sample| {
            (0..1 + sample % MOST_CONTACTS)
                .map(|_| {
                    let point = &points[(uniform() * points.len() as f64) as usize];
                    let force_n = least * (most / least).powf(uniform());
                    Contact { x_mm: point.x_mm, y_mm: point.y_mm, force_n }
                })
                .collect()
        })
        .collect();
    let trials: Vec<&[Contact]> = loads.iter().map(Vec::as_slice).collect();
    let mut frames = vec![0f32; SAMPLE_LOADS * batch.frame_len()];
    batch.voltages(&trials, &mut frames, &mut BatchWork::default())?;
    let volts = |frame: &[f32]| frame.iter().map(|&v| f64::from(v)).collect();
    Ok(frames.chunks_exact(batch.frame_len()).map(volts).collect())
}

/// Orthonormal directions, the frame with the largest residual first; the frames are overwritten.
fn orthonormal(frames: &mut [Vec<f64>]) -> Vec<Vec<f64>> {
    let mut directions: Vec<Vec<f64>> = Vec::new();
    let mut lengths: Vec<f64> = frames.iter().map(|f| dot(f, f)).collect();
    while directions.len() < MOST_DIRECTIONS {
        let Some((longest, &length)) = lengths.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))
        else {
            break;
        };
        if length <= OUTSIDE * OUTSIDE {
            break;
        }
        let mut direction = frames[longest].clone();
        // Orthogonalised a second time: the residual has lost digits.
        for before in &directions {
            let along = dot(&direction, before);
            direction.iter_mut().zip(before).for_each(|(d, b)| *d -= along * b);
        }
        let scale = 1.0 / dot(&direction, &direction).sqrt();
        direction.iter_mut().for_each(|d| *d *= scale);
        for (frame, length) in frames.iter_mut().zip(&mut lengths) {
            let along = dot(frame, &direction);
            frame.iter_mut().zip(&direction).for_each(|(f, d)| *f -= along * d);
            *length = dot(frame, frame);
        }
        directions.push(direction);
    }
    directions
}

/// The directions, rotated so that the relative error is uncorrelated, with its variances.
fn turned(
    directions: &[Vec<f64>],
    error: &ErrorModel,
    inverse_sd: &[f64],
) -> Result<(Vec<Vec<f64>>, Vec<f64>), FitterError> {
    let count = directions.len();
    let scaled = |mode: &Vec<f64>| -> Vec<f64> {
        mode.iter().zip(inverse_sd).map(|(m, scale)| m * scale).collect()
    };
    let modes: Vec<Vec<f64>> = error.modes.iter().map(scaled).collect();
    let floor: Vec<f64> = {
        let share = error.floor.powi(2) / inverse_sd.len() as f64;
        inverse_sd.iter().map(|s| share * s * s).collect()
    };
    let of_modes: Vec<Vec<f64>> =
        directions.iter().map(|d| modes.iter().map(|m| dot(d, m)).collect()).collect();
    let weighted =
        |d: &Vec<f64>| -> Vec<f64> { d.iter().zip(&floor).map(|(d, f)| d * f).collect() };
    let of_floor: Vec<Vec<f64>> = directions.iter().map(weighted).collect();
    let covariance = Mat::from_fn(count, count, |i, j| {
        dot(&of_modes[i], &of_modes[j]) + dot(&directions[i], &of_floor[j])
    });
    let eigen = covariance.self_adjoint_eigen(Side::Lower).map_err(|_| FitterError::Eigenvalues)?;
    let (values, vectors) = (eigen.S(), eigen.U());
    let mut rows = Vec::with_capacity(count);
    for column in 0..count {
        let mut row = vec![0.0; inverse_sd.len()];
        for (k, direction) in directions.iter().enumerate() {
            let weight = vectors[(k, column)];
            row.iter_mut().zip(direction).for_each(|(r, d)| *r += weight * d);
        }
        rows.push(row);
    }
    Ok((rows, (0..count).map(|i| values[i].max(0.0)).collect()))
}
