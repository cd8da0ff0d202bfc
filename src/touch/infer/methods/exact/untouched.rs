//! The noise of a readout and the drift of its offsets, from the untouched frames of a run.
//! PURE. Uses: `infer::{scatter, untouched_frame}`. Never: a frame with a contact.

use serde::{Deserialize, Serialize};

use crate::infer::scatter::{Scatter, of_pairs};
use crate::infer::untouched_frame::UntouchedBefore;

/// Number of parts of the run between which offsets are compared.
const OFFSET_PARTS: usize = 10;
/// Smallest number of frames in a part.
const PART_FRAMES: usize = 4;
/// Smallest number of untouched frames from which the drift is estimated.
pub(super) const LEAST_UNTOUCHED: usize = OFFSET_PARTS * PART_FRAMES;
/// Age of the offsets for which an answer allows: a skin that was calibrated yesterday.
const AGE_HOURS: f64 = 24.0;
/// Number of frames in the untouched frame of a configuration.
const TARED_FRAMES: f64 = 4.0;
/// Shortest run from which the growth of the drift is extrapolated to that age.
const LEAST_HOURS: f64 = 2.0;

/// What the offset of a pair of electrodes differs by from the one that is subtracted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Drift {
    /// Standard deviation a day after the calibration, V; absent if it is unknown.
    pub(super) day_sd_v: Option<f64>,
    /// Standard deviation just after a frame of the untouched skin, V.
    tared_sd_v: f64,
    /// Variance by frequency around the electrodes ([`Scatter`]); empty if it is unknown.
    pub(super) spectrum: Vec<f64>,
}

impl Drift {
    /// Standard deviation of an offset, V: with a share of a day's drift since the untouched skin was
    /// measured, or with the offsets of the calibration.
    pub(super) fn sd_v(&self, share_of_day: Option<f64>) -> f64 {
        self.since_v(self.tared_sd_v, share_of_day)
    }

    fn since_v(&self, tared_sd_v: f64, share_of_day: Option<f64>) -> f64 {
        let day_sd_v = self.day_sd_v.unwrap_or(0.0);
        share_of_day.map_or(day_sd_v, |share| tared_sd_v.hypot(share.max(0.0) * day_sd_v))
    }

    /// Standard deviation of an offset of frames before which the untouched skin was measured, or was not, V.
    pub(super) fn after_v(&self, untouched: Option<&UntouchedBefore>) -> f64 {
        let scatter = untouched.and_then(|skin| skin.scatter.as_ref());
        let tared_sd_v = scatter.map_or(self.tared_sd_v, |scatter| scatter.sd_v);
        self.since_v(tared_sd_v, untouched.map(UntouchedBefore::share_of_day))
    }

    /// The spectrum of these offsets: that of their run, if it is known.
    pub(super) fn spectrum_after<'a>(
        &'a self,
        untouched: Option<&'a UntouchedBefore>,
    ) -> &'a [f64] {
        let scatter = untouched.and_then(|skin| skin.scatter.as_ref());
        let of_run = scatter.map(|scatter| scatter.spectrum.as_slice());
        of_run.filter(|spectrum| !spectrum.is_empty()).unwrap_or(&self.spectrum)
    }
}

/// Frames of a run without contacts.
#[derive(Debug, Clone, Default)]
pub struct Untouched {
    /// The frames in the order of time, V.
    pub frames_v: Vec<Vec<f32>>,
    /// For each of them the frame by which its configuration was tared, V; empty if there is none.
    pub tared_v: Vec<Vec<f32>>,
    /// Number of frames that each of them is the mean of.
    pub averaged: f64,
    /// Time between the first and the last, h.
    pub hours: f64,
}

impl Untouched {
    /// Number of frames in a part, if that is enough.
    fn part(&self) -> Option<usize> {
        Some(self.frames_v.len() / OFFSET_PARTS).filter(|count| *count >= PART_FRAMES)
    }

    /// Standard deviation of a channel's noise in one frame, V, within the parts of the run; none with too
    /// few frames. The sum around the ring of an injection, from which it is estimated without them, has
    /// the mains in it 28 times.
    pub(super) fn noise_sd_v(&self) -> Option<f64> {
        let count = self.part()?;
        let channels = self.frames_v[0].len();
        let mut sum_v2 = 0.0;
        for part in self.frames_v.chunks_exact(count).take(OFFSET_PARTS) {
            for channel in 0..channels {
                let values = part.iter().map(|frame| f64::from(frame[channel]));
                let mean = values.clone().sum::<f64>() / count as f64;
                sum_v2 += values.map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1) as f64;
            }
        }
        let noise_v = (self.averaged * sum_v2 / (OFFSET_PARTS * channels) as f64).sqrt();
        (noise_v > 0.0).then_some(noise_v)
    }

    /// The drift of the offsets, from those of a calibration, V.
    pub(super) fn drift(&self, offset_v: &[f64]) -> Drift {
        // Without tared frames: the noise of one.
        let pairs = offset_v.len().isqrt().max(1) as f64;
        let noise_v = self.noise_sd_v().map_or(0.0, |sd_v| sd_v / (TARED_FRAMES * pairs).sqrt());
        let tared_sd_v = self.tared_sd_v().unwrap_or(noise_v);
        let mut tared: Vec<&[f32]> = self.tared_v.iter().map(Vec::as_slice).collect();
        tared.retain(|frame_v| frame_v.len() == offset_v.len());
        tared.dedup();
        let spectrum = Scatter::of(&tared).map_or_else(Vec::new, |scatter| scatter.spectrum);
        Drift { day_sd_v: self.day_sd_v(offset_v), tared_sd_v, spectrum }
    }

    /// Standard deviation, V, of what the offset of a pair of electrodes differs from that of the frame by
    /// which a configuration was tared; none with too few of them.
    fn tared_sd_v(&self) -> Option<f64> {
        let both = self.frames_v.iter().zip(&self.tared_v).filter(|(f, t)| f.len() == t.len());
        let change = |(frame, tared): (&Vec<f32>, &Vec<f32>)| {
            let change_v: Vec<f64> =
                frame.iter().zip(tared).map(|(v, before)| f64::from(v - before)).collect();
            of_pairs(&change_v)
        };
        let changes: Vec<Vec<f64>> = both.map(change).collect();
        let pairs = changes.first().filter(|_| changes.len() >= LEAST_UNTOUCHED)?.len();
        let squares: f64 = changes.iter().flatten().map(|v| v * v).sum();
        // The noise of the frame itself is no offset.
        let noise_v2 = self.noise_sd_v()?.powi(2) / (self.averaged * pairs as f64);
        Some((squares / (changes.len() * pairs) as f64 - noise_v2).max(0.0).sqrt())
    }

    /// Standard deviation, V, of what the offset of a pair of electrodes differs from the stated one a day
    /// after the run. Offsets belong to the buffers of the electrodes, so the mean over the injections has
    /// them. The difference over the run is taken as a random walk: its variance grows with time. None
    /// with too few frames.
    fn day_sd_v(&self, offset_v: &[f64]) -> Option<f64> {
        let pairs = offset_v.len().isqrt().max(1);
        let change = |frame: &Vec<f32>| {
            let both = frame.iter().zip(offset_v);
            let change_v: Vec<f64> = both.map(|(v, offset)| f64::from(*v) - offset).collect();
            of_pairs(&change_v)
        };
        let count = self.part()?;
        let (mut means, mut noise_v2) = (Vec::with_capacity(OFFSET_PARTS), 0.0);
        for part in self.frames_v.chunks_exact(count).take(OFFSET_PARTS) {
            let changes: Vec<Vec<f64>> = part.iter().map(change).collect();
            let mean = |pair: usize| changes.iter().map(|c| c[pair]).sum::<f64>() / count as f64;
            let mean: Vec<f64> = (0..pairs).map(mean).collect();
            for (pair, mean) in mean.iter().enumerate() {
                let squares = changes.iter().map(|c| (c[pair] - mean).powi(2)).sum::<f64>();
                noise_v2 += squares / (count - 1) as f64;
            }
            means.push(mean);
        }
        // Variance of the mean of a part by noise alone.
        let noise_v2 = noise_v2 / (OFFSET_PARTS * pairs * count) as f64;
        let mean_square = |values: &mut dyn Iterator<Item = f64>, number: usize| {
            values.map(|v| v * v).sum::<f64>() / number as f64
        };
        let in_run_v2 =
            mean_square(&mut means.iter().flatten().copied(), OFFSET_PARTS * pairs) - noise_v2;
        let ends = means[0].iter().zip(&means[OFFSET_PARTS - 1]);
        let change_v2 = mean_square(&mut ends.map(|(a, b)| a - b), pairs) - 2.0 * noise_v2;
        let between_hours = self.hours * (1.0 - 1.0 / OFFSET_PARTS as f64);
        let growth = if self.hours >= LEAST_HOURS { AGE_HOURS / between_hours } else { 1.0 };
        Some((in_run_v2.max(0.0) + growth * change_v2.max(0.0)).sqrt())
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
        let untouched =
            |frames_v, hours| Untouched { frames_v, averaged: 2.0, hours, ..Untouched::default() };
        let day_sd_v = |frames_v, hours| untouched(frames_v, hours).day_sd_v(&[0.0; 16]);
        let sd_mv = |frames_v, hours| 1e3 * day_sd_v(frames_v, hours).unwrap();
        let noise = untouched(frames(1e-3, 1e-3), 12.0).noise_sd_v().unwrap();
        assert!((1e3 * noise / 2f64.sqrt() - 1.0).abs() < 0.03, "{noise}");
        assert_eq!(untouched(frames(0.0, 1e-3)[..30].to_vec(), 12.0).noise_sd_v(), None);
        assert!(sd_mv(frames(0.0, 1e-3), 12.0) < 0.2);
        // In the run: 1 mV / sqrt(12); over its nine tenths: 0.9 mV, that is 0.9 sqrt(24 / 10.8) in a day.
        let day = sd_mv(frames(1e-3, 1e-4), 12.0);
        assert!((day - 1.37).abs() < 0.05, "{day}");
        let short = sd_mv(frames(1e-3, 1e-4), 0.5);
        assert!((short - 0.94).abs() < 0.05, "{short}");
        assert_eq!(day_sd_v(frames(1e-3, 1e-4)[..30].to_vec(), 12.0), None);
    }

    #[test]
    fn a_tare_takes_the_drift_off_and_ages() {
        let frames_v = frames(1e-3, 1e-4);
        // Each frame is tared by the one before it.
        let tared_v: Vec<_> =
            frames_v.first().into_iter().chain(&frames_v).take(300).cloned().collect();
        let run = Untouched { frames_v, tared_v, averaged: 1.0, hours: 12.0 };
        let drift = run.drift(&[0.0; 16]);
        assert_eq!(drift.spectrum_after(None).len(), 3, "of four pairs");
        let sd_mv = |hours| 1e3 * drift.sd_v(hours);
        // The noise of the mean of four injections: 1e-4 / sqrt(4).
        assert!((sd_mv(Some(0.0)) - 0.05).abs() < 0.01, "{}", sd_mv(Some(0.0)));
        assert!((sd_mv(None) - 1.37).abs() < 0.05);
        assert!((sd_mv(Some(0.5)) - 0.5 * sd_mv(None)).abs() < 0.01);
        let without = Untouched { tared_v: vec![Vec::new(); 300], ..run };
        let drift = without.drift(&[0.0; 16]);
        let before = |scatter| {
            let (voltages_v, frames, hours) = (Vec::new(), 4.0, 0.0);
            UntouchedBefore { voltages_v, frames, hours, scatter }
        };
        let of_run = before(Some(Scatter { sd_v: 2e-3, spectrum: vec![0.5, 1.0, 1.5] }));
        assert_eq!(drift.after_v(Some(&of_run)), 2e-3);
        assert_eq!(drift.spectrum_after(Some(&of_run)), [0.5, 1.0, 1.5]);
        assert_eq!(drift.after_v(Some(&before(None))), drift.sd_v(Some(0.0)));
        assert!(drift.spectrum_after(Some(&before(None))).is_empty(), "no frame was tared");
        assert_eq!(Untouched::default().drift(&[0.0; 16]).sd_v(None), 0.0);
        // That of a mean of four frames.
        assert!((1e3 * drift.sd_v(Some(0.0)) - 0.025).abs() < 0.005, "{drift:?}");
    }
}
