//! Statistics of the data for normalisation: moments, principal components, size of targets.
//! Uses: faer for the eigenvectors. Never: all of the data, validation data.

use faer::{Mat, Side};
use rand::RngExt;
use sim_core::stats::{median, norm};

use crate::chance::{Purpose, generator};
use crate::error::{SamplesError, SamplesResult};
use crate::network::{Layer, NORM_FLOOR_V};
use crate::noise::NoiseSource;
use crate::samples::{Samples, read_finite};

/// Largest number of samples that are measured, drawn from the seed.
pub const MEASURED_MAX: u64 = 8192;
/// Number of samples in memory at a time.
const SAMPLES_AT_ONCE: usize = 64;
/// A channel whose standard deviation is below this share of the median of those that change is constant: what it
/// does later has no information, and would be scaled up without a bound.
const CONSTANT: f64 = 1e-4;
/// Standard deviation of a constant channel: its standardised value is zero.
const NEVER_V: f32 = 1e30;
/// One of this number of values of a channel is an extreme, at each end.
const EXTREME_IN: usize = 100;
/// Largest number of values of frames in memory from which extremes are found, 256 MB.
const HELD_MAX: usize = 1 << 26;

/// What is measured of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measured {
    /// Mean and standard deviation of each channel.
    Moments,
    /// The same, and this number of principal components.
    Components(usize),
    /// Median of each channel, and standard deviation without its lowest and highest hundredth.
    WithoutExtremes,
}

impl Measured {
    /// Number of principal components, if they are measured.
    fn components(self) -> Option<usize> {
        match self {
            Self::Components(components) => Some(components),
            Self::Moments | Self::WithoutExtremes => None,
        }
    }
}

/// Statistics of the training data.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// Mean of each input channel, or its median.
    pub mean: Vec<f32>,
    /// Standard deviation of each input channel, or that without its extremes; huge where a channel is
    /// constant, so that it is ignored.
    pub sd: Vec<f32>,
    /// Mean of each number of a target.
    pub target_mean: Vec<f32>,
    /// Standard deviation of each number of a target; 1 where it is zero.
    pub target_sd: Vec<f32>,
    /// Root mean square of all targets' numbers; 1 where it is zero.
    pub target_size: f32,
    /// From `(v / |v|, ln |v|)` to whitened components and standardised logarithm: weight
    /// `[components + 1][channels + 1]`, bias `[components + 1]`. Empty unless asked for.
    pub whitening: (Vec<f32>, Vec<f32>),
}

/// Sums over samples of the differences from the first one, in f64: those of a constant number are zero, whereas its
/// sums would be rounded, and the rounding taken for a spread.
struct Moments {
    count: f64,
    first: Vec<f64>,
    sum: Vec<f64>,
    square: Vec<f64>,
}

impl Moments {
    fn new(len: usize) -> Self {
        Self { count: 0.0, first: vec![0.0; len], sum: vec![0.0; len], square: vec![0.0; len] }
    }

    fn add(&mut self, numbers: impl Iterator<Item = f64>) {
        for (i, x) in numbers.enumerate() {
            if self.count == 0.0 {
                self.first[i] = x;
            }
            let apart = x - self.first[i];
            self.sum[i] += apart;
            self.square[i] += apart * apart;
        }
        self.count += 1.0;
    }

    fn mean(&self, i: usize) -> f64 {
        self.first[i] + self.sum[i] / self.count
    }

    fn spread(&self, i: usize) -> f64 {
        (self.square[i] / self.count - (self.sum[i] / self.count).powi(2)).max(0.0).sqrt()
    }

    fn sd(&self, i: usize) -> f64 {
        let sd = self.spread(i);
        if sd > 0.0 { sd } else { 1.0 }
    }

    fn spreads(&self) -> Vec<f64> {
        (0..self.sum.len()).map(|i| self.spread(i)).collect()
    }
}

/// Standard deviations of channels as divisors; those of constant ones are [`NEVER_V`].
fn divisors(sds: &[f64]) -> Vec<f32> {
    let changing = sds.iter().copied().filter(|sd| *sd > 0.0);
    let least = CONSTANT * median(changing).unwrap_or(0.0);
    sds.iter().map(|&sd| if sd > least { sd as f32 } else { NEVER_V }).collect()
}

/// Median of each channel of frames, `[rows][channels]`, and its standard deviation without its lowest and
/// highest values: one in [`EXTREME_IN`] each, at least one if there are three.
fn without_extremes(frames: &[f32], channels: usize) -> (Vec<f32>, Vec<f64>) {
    let rows = frames.len() / channels;
    let cut = rows.div_ceil(EXTREME_IN).min(rows.saturating_sub(1) / 2);
    let of_channel = |channel: usize| {
        let mut values: Vec<f32> = frames.iter().skip(channel).step_by(channels).copied().collect();
        values.sort_unstable_by(f32::total_cmp);
        let mut kept = Moments::new(1);
        values[cut..rows - cut].iter().for_each(|&v| kept.add([f64::from(v)].into_iter()));
        (values[rows / 2], kept.spread(0))
    };
    (0..channels).map(of_channel).unzip()
}

impl Statistics {
    /// Placeholder without data: determines the shape of networks, and nothing else.
    pub fn unknown(measured: Measured, channels: usize, target: usize) -> Self {
        let whitening = measured.components().map(|components| {
            let width = components.min(channels) + 1;
            (vec![0.0; width * (channels + 1)], vec![0.0; width])
        });
        let whitening = whitening.unwrap_or_default();
        let [mean, target_mean] = [channels, target].map(|len| vec![0.0; len]);
        let [sd, target_sd] = [channels, target].map(|len| vec![1.0; len]);
        Self { mean, sd, target_mean, target_sd, target_size: 1.0, whitening }
    }

    /// Measures up to [`MEASURED_MAX`] samples with the noise of the first epoch: components that
    /// contain only noise must have the variance of that noise.
    ///
    /// # Errors
    /// `SamplesError` if a sample cannot be read, or the frames have no principal components.
    pub fn measure(
        from: &dyn Samples,
        measured: Measured,
        noise: &NoiseSource,
        seed: u64,
    ) -> SamplesResult<Self> {
        let (channels, targets) = (from.input_len(), from.target_len());
        let (components, mut held) = (measured.components(), Vec::new());
        let most = match measured {
            Measured::WithoutExtremes => {
                MEASURED_MAX.min((HELD_MAX / channels).max(SAMPLES_AT_ONCE) as u64)
            }
            Measured::Moments | Measured::Components(_) => MEASURED_MAX,
        };
        let mut of_inputs = Moments::new(channels);
        let mut of_logs = Moments::new(1);
        let mut of_targets = Moments::new(1);
        let mut of_each_target = Moments::new(targets);
        let rows = components.map_or(0, |_| channels);
        let mut products = Mat::<f64>::zeros(rows, rows);
        let mut unit_sum = vec![0.0; channels];
        let picked = pick(from, most, seed);
        let (mut x, mut y) =
            (vec![0.0; SAMPLES_AT_ONCE * channels], vec![0.0; SAMPLES_AT_ONCE * targets]);
        for numbers in picked.chunks(SAMPLES_AT_ONCE) {
            let (x, y) = (&mut x[..numbers.len() * channels], &mut y[..numbers.len() * targets]);
            read_finite(from, numbers, x, y)?;
            let mut units = Mat::<f64>::zeros(channels, numbers.len());
            for (row, frame) in x.chunks_exact_mut(channels).enumerate() {
                noise.add(0, numbers[row], frame);
                if measured == Measured::WithoutExtremes {
                    held.extend_from_slice(frame);
                }
                of_inputs.add(frame.iter().map(|&v| f64::from(v)));
                let norm = norm(frame).max(f64::from(NORM_FLOOR_V));
                of_logs.add([norm.ln()].into_iter());
                for (i, &v) in frame.iter().enumerate() {
                    units[(i, row)] = f64::from(v) / norm;
                    unit_sum[i] += units[(i, row)];
                }
            }
            y.iter().for_each(|&v| of_targets.add([f64::from(v)].into_iter()));
            for target in y.chunks_exact(targets) {
                of_each_target.add(target.iter().map(|&v| f64::from(v)));
            }
            if products.nrows() > 0 {
                products += &units * units.transpose();
            }
        }
        let each = |len: usize, f: &dyn Fn(usize) -> f64| (0..len).map(|i| f(i) as f32).collect();
        let size = of_targets.mean(0).hypot(of_targets.spread(0));
        let mut statistics = Self {
            mean: each(channels, &|i| of_inputs.mean(i)),
            sd: divisors(&of_inputs.spreads()),
            target_mean: each(targets, &|i| of_each_target.mean(i)),
            target_sd: each(targets, &|i| of_each_target.sd(i)),
            target_size: if size > 0.0 { size as f32 } else { 1.0 },
            whitening: (Vec::new(), Vec::new()),
        };
        if measured == Measured::WithoutExtremes {
            let (medians, sds) = without_extremes(&held, channels);
            (statistics.mean, statistics.sd) = (medians, divisors(&sds));
        }
        if let Some(components) = components {
            let count = of_inputs.count;
            let mean: Vec<f64> = unit_sum.iter().map(|s| s / count).collect();
            let covariance = Mat::from_fn(channels, channels, |i, j| {
                products[(i, j)] / count - mean[i] * mean[j]
            });
            statistics.whitening =
                whitening(&covariance, &mean, [of_logs.mean(0), of_logs.sd(0)], components)?;
        }
        Ok(statistics)
    }

    /// Number of channels that are constant in the training data, and therefore ignored.
    pub fn constant_channels(&self) -> usize {
        self.sd.iter().filter(|&&sd| sd == NEVER_V).count()
    }

    /// The layer `target_sd x + target_mean + shift`, for each number of a target.
    pub fn in_units_of_targets(&self, shift: f32) -> Layer {
        let sd: Vec<f32> = self.target_sd.iter().map(|sd| 1.0 / sd).collect();
        let terms = self.target_mean.iter().zip(&sd);
        Layer::Standardise { mean: terms.map(|(mean, sd)| -(mean + shift) * sd).collect(), sd }
    }
}

/// Numbers of the samples to measure: all if there are at most `most`, else drawn with replacement.
fn pick(from: &dyn Samples, most: u64, seed: u64) -> Vec<u64> {
    if from.len() <= most {
        return (0..from.len()).collect();
    }
    let mut chance = generator(seed, Purpose::Statistics, 0, 0);
    let mut picked: Vec<u64> = (0..most).map(|_| chance.random_range(0..from.len())).collect();
    picked.sort_unstable(); // Rows of a file are read in their order.
    picked
}

/// Rows of principal components over their standard deviation, and a row for the logarithm.
fn whitening(
    covariance: &Mat<f64>,
    mean: &[f64],
    [log_mean, log_sd]: [f64; 2],
    components: usize,
) -> SamplesResult<(Vec<f32>, Vec<f32>)> {
    let channels = mean.len();
    let message = || "the covariance of the frames has no eigenvectors".to_string();
    let decomposed = covariance
        .self_adjoint_eigen(Side::Lower)
        .map_err(|_| SamplesError::Source { message: message() })?;
    let (values, vectors) = (decomposed.S().column_vector(), decomposed.U());
    // A smaller component is rounding error.
    let least = values[channels - 1].max(f64::MIN_POSITIVE) * 1e-10;
    let (mut weight, mut bias) = (Vec::new(), Vec::new());
    for nth in 0..components.min(channels) {
        let column = channels - 1 - nth;
        let scale = 1.0 / values[column].max(least).sqrt();
        let row = (0..channels).map(|i| vectors[(i, column)] * scale);
        bias.push(-row.clone().zip(mean).map(|(w, m)| w * m).sum::<f64>() as f32);
        weight.extend(row.map(|w| w as f32).chain([0.0]));
    }
    weight.extend(std::iter::repeat_n(0.0, channels).chain([(1.0 / log_sd) as f32]));
    bias.push((-log_mean / log_sd) as f32);
    Ok((weight, bias))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_that_hardly_changes_is_constant_also_among_many_dead_ones() {
        let sds = [0.0, 0.0, 0.0, 1e-7, 0.5];
        assert_eq!(divisors(&sds), [NEVER_V, NEVER_V, NEVER_V, NEVER_V, 0.5]);
        assert_eq!(divisors(&[0.0, 0.0]), [NEVER_V; 2]);
    }
}
