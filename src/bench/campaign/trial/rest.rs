//! Whether the signal of the skin is at rest: the means of two successive windows of frames differ by no
//! more than their noise.
//! PURE. Uses: `rig::traits` (a frame). Never: waiting, taking frames.

use std::sync::Arc;

use crate::rig::traits::Frame;

/// Frames per window; the means of two successive windows are compared.
pub const WINDOW: usize = 10;
/// Largest change between windows that counts as noise, as a multiple of the noise of their means.
const REST_NOISE_MULTIPLE: f64 = 1.5;

/// Mean of the frames of a window, and noise of one frame, V.
#[derive(Debug, Clone)]
pub struct Window {
    /// Mean voltages, V.
    pub mean_v: Vec<f64>,
    noise_v: f64,
    frames: f64,
}

impl Window {
    /// Averages frames; all have the same number of channels.
    pub fn of(frames: &[Arc<Frame>]) -> Self {
        let n = frames.len() as f64;
        let channels = frames.first().map_or(0, |f| f.counts.len());
        let (mut mean_v, mut square) = (vec![0.0; channels], 0.0);
        for f in frames {
            for (m, v) in mean_v.iter_mut().zip(f.voltages_v()) {
                *m += f64::from(v) / n;
            }
        }
        for f in frames {
            for (m, v) in mean_v.iter().zip(f.voltages_v()) {
                square += (f64::from(v) - m).powi(2);
            }
        }
        let noise_v = (square / ((n - 1.0).max(1.0) * channels.max(1) as f64)).sqrt();
        Self { mean_v, noise_v, frames: n }
    }

    /// Whether the skin has not changed since an earlier window, as far as the noise permits to see.
    pub fn rests_after(&self, last: &Self) -> bool {
        if self.mean_v.len() != last.mean_v.len() {
            return false;
        }
        let square: f64 = self.mean_v.iter().zip(&last.mean_v).map(|(a, b)| (a - b).powi(2)).sum();
        let change_v = (square / self.mean_v.len().max(1) as f64).sqrt();
        let noise_v = self.noise_v.max(last.noise_v) * (2.0 / self.frames).sqrt();
        change_v <= REST_NOISE_MULTIPLE * noise_v
    }
}

/// Whether the signal changes from the first frames of a measurement to the last; with too few frames, no.
pub fn changes_within(frames: &[Arc<Frame>]) -> bool {
    if frames.len() < 2 * WINDOW {
        return false;
    }
    let (first, last) = (&frames[..WINDOW], &frames[frames.len() - WINDOW..]);
    !Window::of(last).rests_after(&Window::of(first))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in;

    fn frames(level: f64, drift: f64) -> Vec<Arc<Frame>> {
        (0..WINDOW)
            .map(|i| {
                let counts = (0..784)
                    .map(|c| {
                        let noise = f64::from((c * 31 + i as i32 * 17) % 7 - 3);
                        (level + drift * i as f64 + noise) as i16
                    })
                    .collect();
                stand_in::frame(i as u32, counts)
            })
            .collect()
    }

    #[test]
    fn noise_alone_rests_and_a_creeping_signal_does_not() {
        let still = Window::of(&frames(100.0, 0.0));
        assert!(Window::of(&frames(100.0, 0.0)).rests_after(&still));
        assert!(!Window::of(&frames(104.0, 0.0)).rests_after(&still));
    }

    #[test]
    fn a_signal_that_jumps_between_the_first_and_the_last_frames_changes() {
        let with_last =
            |level| [frames(100.0, 0.0), frames(100.0, 0.0), frames(level, 0.0)].concat();
        assert!(!changes_within(&with_last(100.0)));
        assert!(changes_within(&with_last(104.0)));
        assert!(!changes_within(&frames(100.0, 3.0)), "too few to tell");
    }
}
