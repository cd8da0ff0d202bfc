//! Covariance of the difference between measured and modelled frames.
//! Uses: faer's symmetric eigenvalues, serde. Never: the positions of the contacts.
//!
//! Covariance of a frame's error:
//! `diag(sd^2) / frames + offset^2 (1 1') x I + |v|^2 (sum of m m' + floor^2 I / channels)`: white
//! noise that averaging lowers; the drift of the offsets since the skin was last untouched, which is
//! that of the buffers of the electrodes and so the same in every injection; and a model error in
//! proportion to the signal `|v|`. Averaging lowers neither of the latter. The drift belongs to the
//! observation, the others to the model. The columns m come from held-out pairs of measured and
//! modelled frames.

use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

/// Smallest signal of a pair that is used, in standard deviations of the noise.
const LEAST_SIGNAL: f64 = 3.0;

/// Typical relative error of a model: pairs with a larger noise get a small weight.
const USUAL_ERROR: f64 = 0.1;

/// Number of parts into which errors are divided for the variance along their directions.
const PARTS: usize = 5;

/// Why an error model is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ErrorModelError {
    /// The noise of a channel is not a positive finite number.
    #[error("error model: noise of channel {channel} = {sd_v} V is not a finite number > 0")]
    Noise { channel: usize, sd_v: f64 },
    /// The frames of a pair have the wrong length, or a value is not finite.
    #[error("error model: pair {pair} is not two frames of {channels} finite voltages")]
    Pair { pair: usize, channels: usize },
    /// Too few pairs have a signal above the noise.
    #[error("error model: {found} of {given} pairs have a signal above the noise, {needed} needed")]
    FewPairs { found: usize, given: usize, needed: usize },
    /// The eigenvalues did not converge.
    #[error("error model: eigenvalues of the residuals' covariance did not converge")]
    Eigenvalues,
}

/// A measured and a modelled frame of the same load, V.
#[derive(Debug, Clone, Copy)]
pub struct FramePair<'a> {
    /// Measured frame, offsets subtracted, V.
    pub measured_v: &'a [f64],
    /// Modelled frame, V.
    pub modelled_v: &'a [f64],
    /// Number of frames in the mean of the measured one.
    pub frames: f64,
    /// Standard deviation of the offset of a pair of electrodes in the measured one, V.
    pub offset_sd_v: f64,
}

/// The error model of one readout and one model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorModel {
    /// Standard deviation of the noise of each channel in a single frame, V.
    pub(super) channel_sd_v: Vec<f64>,
    /// Directions of the relative error; a column's square is its variance.
    pub(super) modes: Vec<Vec<f64>>,
    /// Residual of the relative error, as a share of the signal: the same on all channels.
    pub(super) floor: f64,
}

impl ErrorModel {
    /// White noise with the same standard deviation on all channels, V.
    ///
    /// # Errors
    /// `ErrorModelError::Noise` if `sd_v` is not a finite number > 0.
    pub fn white(channels: usize, sd_v: f64) -> Result<Self, ErrorModelError> {
        Self::of_channels(vec![sd_v; channels])
    }

    /// White noise with the standard deviation of each channel, V.
    ///
    /// # Errors
    /// `ErrorModelError::Noise` if a value is not a finite number > 0.
    pub fn of_channels(channel_sd_v: Vec<f64>) -> Result<Self, ErrorModelError> {
        let bad = |sd: &f64| !(*sd > 0.0 && sd.is_finite());
        if let Some(channel) = channel_sd_v.iter().position(bad) {
            return Err(ErrorModelError::Noise { channel, sd_v: channel_sd_v[channel] });
        }
        Ok(Self { channel_sd_v, modes: Vec::new(), floor: 0.0 })
    }

    /// Adds a relative error estimated from pairs that the model was not fitted to: the `rank`
    /// strongest directions of `(measured - modelled) / |modelled|`, and one share for the
    /// residual; the contribution of the noise is subtracted. Needs more pairs than directions.
    ///
    /// There are two uses. With frames modelled at the true contacts, the covariance contains all
    /// errors and determines the standard deviations of contacts. With frames modelled at refined
    /// contacts ([`super::ContactFitter::refine`]), it contains only what no contact imitates,
    /// which is what distinguishes one contact from two: counts are better, standard deviations too
    /// small.
    ///
    /// # Errors
    /// `Pair` if a frame is invalid; `FewPairs` if at most `rank` pairs have enough signal;
    /// `Eigenvalues` without convergence.
    pub fn with_pairs(
        mut self,
        pairs: &[FramePair<'_>],
        rank: usize,
    ) -> Result<Self, ErrorModelError> {
        let channels = self.channel_sd_v.len();
        let white_v2: f64 = self.channel_sd_v.iter().map(|sd| sd * sd).sum();
        let mut errors: Vec<Vec<f64>> = Vec::with_capacity(pairs.len());
        let (mut noise_share, mut weights) = (0.0, 0.0);
        for (index, pair) in pairs.iter().enumerate() {
            let sound =
                |frame: &[f64]| frame.len() == channels && frame.iter().all(|v| v.is_finite());
            let offset_v2 = pair.offset_sd_v.powi(2);
            let known = pair.frames > 0.0 && offset_v2.is_finite();
            if !(sound(pair.measured_v) && sound(pair.modelled_v) && known) {
                return Err(ErrorModelError::Pair { pair: index, channels });
            }
            let signal_v2: f64 = pair.modelled_v.iter().map(|v| v * v).sum();
            let noise_v2 = white_v2 / pair.frames + channels as f64 * offset_v2;
            if signal_v2 < LEAST_SIGNAL.powi(2) * noise_v2 / channels as f64 {
                continue;
            }
            let noise = noise_v2 / signal_v2;
            // The less noise a pair has, the larger its weight.
            let weight = (1.0 + noise / USUAL_ERROR.powi(2)).powi(-2);
            let scale = (weight / signal_v2).sqrt();
            let both = pair.measured_v.iter().zip(pair.modelled_v);
            errors.push(both.map(|(measured, modelled)| scale * (measured - modelled)).collect());
            noise_share += weight * noise;
            weights += weight;
        }
        let found = errors.len();
        if found <= rank {
            return Err(ErrorModelError::FewPairs { found, given: pairs.len(), needed: rank + 1 });
        }
        let root = (found as f64 / weights).sqrt();
        errors.iter_mut().flatten().for_each(|e| *e *= root);
        self.decompose(&errors, noise_share / weights, rank)?;
        Ok(self)
    }

    /// Splits the covariance of relative errors; `noise` is the share of the noise in its trace.
    fn decompose(
        &mut self,
        errors: &[Vec<f64>],
        noise: f64,
        rank: usize,
    ) -> Result<(), ErrorModelError> {
        let (count, channels) = (errors.len(), self.channel_sd_v.len());
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        // The Gram matrix has the covariance's eigenvalues, and its vectors mix the errors into
        // the covariance's.
        let gram = Mat::from_fn(count, count, |i, j| dot(&errors[i], &errors[j]) / count as f64);
        let (values, vectors) = eigenvectors(&gram)?;
        let others = variances_in_others(&gram, rank)?;
        let per_channel = noise / channels as f64;
        let trace: f64 = values.iter().sum();
        let mut explained = 0.0;
        self.modes.clear();
        for (column, &variance) in (0..count).rev().zip(&others) {
            let value = values[column];
            let own = variance.min(value) - per_channel;
            if own <= 0.0 {
                continue;
            }
            explained += own;
            let scale = (own / (value * count as f64)).sqrt();
            let mut mode = vec![0.0; channels];
            for (row, error) in errors.iter().enumerate() {
                let weight = scale * vectors[(row, column)];
                mode.iter_mut().zip(error).for_each(|(m, e)| *m += weight * e);
            }
            self.modes.push(mode);
        }
        self.floor = (trace - noise - explained).max(0.0).sqrt();
        Ok(())
    }

    /// Number of channels in a frame.
    pub fn channels(&self) -> usize {
        self.channel_sd_v.len()
    }

    /// The total relative error, as a share of the signal.
    pub fn relative(&self) -> f64 {
        let modes: f64 = self.modes.iter().flatten().map(|m| m * m).sum();
        (modes + self.floor * self.floor).sqrt()
    }
}

/// Eigenvalues, the smallest first, and eigenvectors of a Gram matrix.
fn eigenvectors(gram: &Mat<f64>) -> Result<(Vec<f64>, Mat<f64>), ErrorModelError> {
    let eigen = gram.self_adjoint_eigen(Side::Lower).map_err(|_| ErrorModelError::Eigenvalues)?;
    Ok((eigen.S().column_vector().iter().copied().collect(), eigen.U().to_owned()))
}

/// Variance along the `rank` strongest directions in errors that did not determine them: the errors are divided into
/// [`PARTS`] parts in their order, and each is projected on the directions of the others. Noise alone has strong
/// directions in its own frames, and none in others.
fn variances_in_others(gram: &Mat<f64>, rank: usize) -> Result<Vec<f64>, ErrorModelError> {
    let count = gram.nrows();
    let mut sums = vec![0.0; rank];
    for part in 0..PARTS {
        let (own, others): (Vec<usize>, Vec<usize>) =
            (0..count).partition(|i| i * PARTS / count == part);
        let among = Mat::from_fn(others.len(), others.len(), |i, j| gram[(others[i], others[j])]);
        let (values, vectors) = eigenvectors(&among)?;
        for (column, sum) in (0..others.len()).rev().zip(&mut sums) {
            if values[column] <= 0.0 {
                continue;
            }
            for &j in &own {
                let along =
                    others.iter().enumerate().map(|(i, &o)| vectors[(i, column)] * gram[(o, j)]);
                // The Gram matrix is divided by the number of errors.
                *sum += along.sum::<f64>().powi(2) / values[column];
            }
        }
    }
    Ok(sums)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn noise_has_no_directions() {
        const CHANNELS: usize = 100;
        const NOISE_SHARE: f64 = 0.01;
        const ALONG: f64 = 0.05;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut normal = || (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0;
        // A signal of 1 V; an error along one direction, and white noise of a known size.
        let modelled_v = [0.1; CHANNELS];
        let direction: [f64; CHANNELS] = std::array::from_fn(|i| if i < 25 { 0.2 } else { 0.0 });
        let sd_v = (NOISE_SHARE / CHANNELS as f64).sqrt();
        let measured: Vec<Vec<f64>> = (0..200)
            .map(|_| {
                let along = ALONG * normal();
                direction.iter().map(|d| 0.1 + along * d + sd_v * normal()).collect()
            })
            .collect();
        let pair = |frame| FramePair {
            measured_v: frame,
            modelled_v: &modelled_v,
            frames: 1.0,
            offset_sd_v: 0.0,
        };
        let pairs: Vec<_> = measured.iter().map(|frame| pair(frame)).collect();
        let error = ErrorModel::white(CHANNELS, sd_v).unwrap().with_pairs(&pairs, 20).unwrap();
        let variance = |mode: &Vec<f64>| mode.iter().map(|m| m * m).sum::<f64>();
        let first = &error.modes[0];
        let alike = first.iter().zip(&direction).map(|(m, d)| m * d).sum::<f64>().abs()
            / variance(first).sqrt();
        assert!(alike > 0.95, "{alike}");
        assert!((variance(first).sqrt() / ALONG - 1.0).abs() < 0.2, "{}", variance(first));
        // The strongest 19 directions of such noise in 200 frames have 24 times the variance of a channel more than noise
        // has in 19 channels.
        let rest = error.modes[1..].iter().map(variance).sum::<f64>();
        assert!(rest < 4.0 * NOISE_SHARE / CHANNELS as f64, "{rest}");
    }
}
