//! Windows of frames of a skin at rest, for a mean with little noise.
//! PURE. Uses: `campaign::trial::rest`. Never: waiting, inference.

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::time::Instant;

use crate::campaign::trial::rest::{WINDOW, Window};
use crate::rig::traits::Frame;

/// Windows of the mean: 30 frames, for which the accuracy of the methods is published.
const WINDOWS: usize = 3;

/// Collects frames. The windows are those since the last change of the load, at most `WINDOWS`.
#[derive(Default)]
pub(super) struct Calm {
    frames: Vec<Arc<Frame>>,
    /// Each with the time at which its first frame arrived.
    windows: VecDeque<(Window, Instant)>,
}

/// A mean of frames.
pub(super) struct Mean {
    /// Mean voltage of each channel, V, injection-major.
    pub volts: Vec<f32>,
    /// Number of averaged frames.
    pub frames: f64,
    /// Time at which the first of them arrived.
    pub since: Instant,
}

impl Calm {
    /// Adds a frame. Returns whether the skin is at rest if the frame completes a window.
    pub fn push(&mut self, frame: Arc<Frame>) -> Option<bool> {
        if self.frames.first().is_some_and(|first| first.counts.len() != frame.counts.len()) {
            *self = Self::default();
        }
        self.frames.push(frame);
        if self.frames.len() < WINDOW {
            return None;
        }
        let frames = std::mem::take(&mut self.frames);
        let window = Window::of(&frames);
        let at_rest = self.windows.back().map(|(last, _)| window.rests_after(last));
        if at_rest == Some(false) {
            self.windows.clear();
        }
        if self.windows.len() == WINDOWS {
            self.windows.pop_front();
        }
        self.windows.push_back((window, frames[0].received));
        Some(at_rest == Some(true))
    }

    /// The mean of the windows; `None` before the first.
    pub fn mean(&self) -> Option<Mean> {
        let (first, since) = self.windows.front()?;
        let share = 1.0 / self.windows.len() as f64;
        let mut volts = vec![0.0; first.mean_v.len()];
        for (window, _) in &self.windows {
            for (sum, v) in volts.iter_mut().zip(&window.mean_v) {
                *sum += share * v;
            }
        }
        let volts = volts.into_iter().map(|v| v as f32).collect();
        let frames = (self.windows.len() * WINDOW) as f64;
        Some(Mean { volts, frames, since: *since })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window of frames with noise around a level, in counts.
    fn window(level: i16) -> impl Iterator<Item = Arc<Frame>> {
        (0..WINDOW as i32).map(move |i| {
            let noise = |c: i32| ((c * 31 + i * 17) % 7 - 3) as i16;
            Arc::new(Frame {
                sequence: 0,
                device_time_us: 0,
                volts_per_count: 1e-3,
                counts: (0..784).map(|c| level + noise(c)).collect(),
                received: Instant::now(),
            })
        })
    }

    fn pushed(calm: &mut Calm, level: i16) -> bool {
        window(level).filter_map(|frame| calm.push(frame)).next().unwrap()
    }

    #[test]
    fn the_mean_is_of_the_frames_since_the_last_change() {
        let mut calm = Calm::default();
        assert!(calm.mean().is_none());
        assert!(!pushed(&mut calm, 100), "one window has nothing to be compared with");
        for _ in 0..4 {
            assert!(pushed(&mut calm, 100));
        }
        let mean = calm.mean().unwrap();
        assert_eq!(mean.frames, 30.0);
        assert!((mean.volts[0] - 0.1).abs() < 0.003);
        assert!(!pushed(&mut calm, 140), "a weight was placed");
        let mean = calm.mean().unwrap();
        assert_eq!(mean.frames, 10.0);
        assert!((mean.volts[0] - 0.14).abs() < 0.003);
    }
}
