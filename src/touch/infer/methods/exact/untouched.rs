//! The noise of a readout and the drift of its offsets, from the untouched frames of a run.
//! PURE. Uses: nothing. Never: a frame with a contact.

/// Number of parts of the run between which offsets are compared.
const PARTS: usize = 10;
/// Smallest number of frames in a part.
const PART_FRAMES: usize = 4;
/// Age of the offsets for which an answer allows: a skin that was calibrated yesterday.
const AGE_HOURS: f64 = 24.0;
/// Shortest run from which the growth of the drift is extrapolated to that age.
const LEAST_HOURS: f64 = 2.0;

/// Frames of a run without contacts.
#[derive(Debug, Clone, Default)]
pub struct Untouched {
    /// The frames in the order of time, V.
    pub frames_v: Vec<Vec<f32>>,
    /// Number of frames that each of them is the mean of.
    pub averaged: f64,
    /// Time between the first and the last, h.
    pub hours: f64,
}

impl Untouched {
    /// Number of frames in a part, if that is enough.
    fn part(&self) -> Option<usize> {
        Some(self.frames_v.len() / PARTS).filter(|count| *count >= PART_FRAMES)
    }

    /// Standard deviation of a channel's noise in one frame, V, within the parts of the run; none with too
    /// few frames. The sum around the ring of an injection, from which it is estimated without them, has
    /// the mains in it 28 times.
    pub(super) fn noise_sd_v(&self) -> Option<f64> {
        let count = self.part()?;
        let channels = self.frames_v[0].len();
        let mut sum_v2 = 0.0;
        for part in self.frames_v.chunks_exact(count).take(PARTS) {
            for channel in 0..channels {
                let values = part.iter().map(|frame| f64::from(frame[channel]));
                let mean = values.clone().sum::<f64>() / count as f64;
                sum_v2 += values.map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1) as f64;
            }
        }
        let noise_v = (self.averaged * sum_v2 / (PARTS * channels) as f64).sqrt();
        (noise_v > 0.0).then_some(noise_v)
    }

    /// Standard deviation, V, of what the offset of a pair of electrodes differs from the stated one a day
    /// after the run. Offsets belong to the buffers of the electrodes, so the mean over the injections has
    /// them. The difference over the run is taken as a random walk: its variance grows with time. 0 with
    /// too few frames.
    pub(super) fn drift_sd_v(&self, offset_v: &[f64]) -> f64 {
        let pairs = offset_v.len().isqrt().max(1);
        let of_pair = |frame: &Vec<f32>, pair: usize| -> f64 {
            let channels = (pair..offset_v.len()).step_by(pairs);
            channels.map(|c| f64::from(frame[c]) - offset_v[c]).sum::<f64>() / pairs as f64
        };
        let Some(count) = self.part() else { return 0.0 };
        let (mut means, mut noise_v2) = (Vec::with_capacity(PARTS), 0.0);
        for part in self.frames_v.chunks_exact(count).take(PARTS) {
            let mean = |pair| part.iter().map(|f| of_pair(f, pair)).sum::<f64>() / count as f64;
            let mean: Vec<f64> = (0..pairs).map(mean).collect();
            for (pair, mean) in mean.iter().enumerate() {
                let squares = part.iter().map(|f| (of_pair(f, pair) - mean).powi(2)).sum::<f64>();
                noise_v2 += squares / (count - 1) as f64;
            }
            means.push(mean);
        }
        // Variance of the mean of a part by noise alone.
        let noise_v2 = noise_v2 / (PARTS * pairs * count) as f64;
        let mean_square = |values: &mut dyn Iterator<Item = f64>, number: usize| {
            values.map(|v| v * v).sum::<f64>() / number as f64
        };
        let in_run_v2 = mean_square(&mut means.iter().flatten().copied(), PARTS * pairs) - noise_v2;
        let ends = means[0].iter().zip(&means[PARTS - 1]);
        let change_v2 = mean_square(&mut ends.map(|(a, b)| a - b), pairs) - 2.0 * noise_v2;
        let between_hours = self.hours * (1.0 - 1.0 / PARTS as f64);
        let growth = if self.hours >= LEAST_HOURS { AGE_HOURS / between_hours } else { 1.0 };
        (in_run_v2.max(0.0) + growth * change_v2.max(0.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Frames of four electrodes whose offsets change evenly over the run, with noise, V.
    fn frames(change_v: f64, noise_v: f64) -> Vec<Vec<f32>> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut noise = || noise_v * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let offset = |n: usize, c: usize| {
            change_v * (n as f64 / 299.0 - 0.5) * if c.is_multiple_of(2) { 1.0 } else { -1.0 }
        };
        (0..300).map(|n| (0..16).map(|c| (offset(n, c) + noise()) as f32).collect()).collect()
    }

    #[test]
    fn a_drift_is_told_from_noise_and_extrapolated_to_a_day() {
        let untouched = |frames_v, hours| Untouched { frames_v, averaged: 2.0, hours };
        let sd_mv = |frames_v, hours| 1e3 * untouched(frames_v, hours).drift_sd_v(&[0.0; 16]);
        let noise = untouched(frames(1e-3, 1e-3), 12.0).noise_sd_v().unwrap();
        assert!((1e3 * noise / 2f64.sqrt() - 1.0).abs() < 0.03, "{noise}");
        assert_eq!(untouched(frames(0.0, 1e-3)[..30].to_vec(), 12.0).noise_sd_v(), None);
        assert!(sd_mv(frames(0.0, 1e-3), 12.0) < 0.2);
        // In the run: 1 mV / sqrt(12); over its nine tenths: 0.9 mV, that is 0.9 sqrt(24 / 10.8) in a day.
        let day = sd_mv(frames(1e-3, 1e-4), 12.0);
        assert!((day - 1.37).abs() < 0.05, "{day}");
        let short = sd_mv(frames(1e-3, 1e-4), 0.5);
        assert!((short - 0.94).abs() < 0.05, "{short}");
        assert_eq!(sd_mv(frames(1e-3, 1e-4)[..30].to_vec(), 12.0), 0.0);
    }
}
