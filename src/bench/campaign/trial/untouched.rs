//! The untouched skin between placements: windows of frames that are at rest and differ from the last
//! untouched ones by no more than their noise. A person tares the skin once; it is followed from there.
//! Uses: `trial::rest`, `rig::traits`. Never: motion, a frame of a placement.

use std::sync::Arc;

use jiff::Timestamp;

use super::rest::Window;
use crate::clock::Clock;
use crate::rig::error::RigError;
use crate::rig::traits::SkinReader;

/// Frames per window, one second at 30 frames per second: the mean of 10 frames does not show a weight of 5 N
/// on every skin.
pub const WINDOW_FRAMES: usize = 30;

/// A mean of [`WINDOW_FRAMES`] frames, and the wall time of the last one.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Mean of the frames, V.
    pub window: Window,
    /// Wall time of the last frame.
    pub at: Timestamp,
}

impl Seen {
    /// Takes the next frames.
    ///
    /// # Errors
    /// `RigError` if they do not arrive.
    pub async fn next(skin: &Arc<dyn SkinReader>, clock: &Clock) -> Result<Self, RigError> {
        let frames = skin.take(clock.now(), WINDOW_FRAMES).await?;
        Ok(Self { window: Window::of(&frames), at: clock.timestamp() })
    }
}

/// Follows the untouched skin.
#[derive(Debug, Clone)]
pub struct UntouchedSkin {
    /// The newest untouched window.
    last: Seen,
    is_reported: bool,
    was_touched: bool,
    /// The window before, touched or not.
    before: Option<Window>,
    /// An untouched window whose end may hold the beginning of a touch.
    pending: Option<Seen>,
}

impl UntouchedSkin {
    /// Begins with a window in which, a person states, nothing touches the skin.
    pub fn tared(last: Seen) -> Self {
        let before = Some(last.window.clone());
        Self { last, is_reported: true, was_touched: false, before, pending: None }
    }

    /// Adds the next window. Returns an untouched one to store: the first one after a touch, and the newest
    /// one when the next touch begins.
    pub fn push(&mut self, seen: Seen) -> Option<Seen> {
        let rests = self.before.as_ref().is_some_and(|before| seen.window.rests_after(before));
        let is_untouched = rests && seen.window.rests_after(&self.last.window);
        self.before = Some(seen.window.clone());
        if !is_untouched {
            return self.touched();
        }
        self.last = self.pending.replace(seen)?;
        self.is_reported = std::mem::take(&mut self.was_touched);
        self.is_reported.then(|| self.last.clone())
    }

    /// Something touches the skin. Returns the newest window before it, unless it was returned already.
    pub fn touched(&mut self) -> Option<Seen> {
        (self.pending, self.was_touched) = (None, true);
        let is_reported = std::mem::replace(&mut self.is_reported, true);
        (!is_reported).then(|| self.last.clone())
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::Instant;

    use super::*;
    use crate::rig::traits::Frame;

    /// A window of 784 channels with a load in half of them, in counts of 1 mV, and noise; it ends at second `at_s`.
    fn seen(load: f64, at_s: i64) -> Seen {
        let frames: Vec<_> = (0..WINDOW_FRAMES as i32)
            .map(|i| {
                let noise = |c: i32| f64::from((c * 31 + i * 17) % 7 - 3);
                let load = |c: i32| if c % 2 == 0 { load } else { 0.0 };
                let counts = (0..784).map(|c| (noise(c) + load(c)).round() as i16).collect();
                let (sequence, device_time_us, volts_per_count) = (0, 0, 1e-3);
                let received = Instant::now();
                Arc::new(Frame { sequence, device_time_us, volts_per_count, counts, received })
            })
            .collect();
        Seen { window: Window::of(&frames), at: Timestamp::from_second(at_s).unwrap() }
    }

    #[test]
    fn the_first_untouched_window_after_a_touch_and_the_last_before_the_next_are_stored() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        let mut push = |load, at_s| skin.push(seen(load, at_s)).map(|found| found.at.as_second());
        // Nothing but what was tared, then weights.
        let stored: Vec<_> = (1..5).map(|at_s| push(0.0, at_s)).collect();
        assert_eq!(stored, [None; 4]);
        // The window at 4 s may hold the beginning of the touch.
        assert_eq!(push(3.0, 5), Some(3));
        assert_eq!(push(3.0, 6), None);
        // Weights are lifted: one window in motion, one at rest that nothing confirms yet.
        assert_eq!([push(1.5, 7), push(0.0, 8), push(0.0, 9)], [None; 3]);
        assert_eq!(push(0.0, 10), Some(9));
        assert_eq!([push(0.0, 11), push(0.0, 12)], [None; 2]);
        assert_eq!(push(9.0, 13), Some(11));
        let after = [14, 15, 16, 17].map(|at_s| push(0.0, at_s));
        assert_eq!(after, [None, None, Some(15), None]);
        // A confirmation states that weights are on the skin.
        assert_eq!(skin.touched().map(|found| found.at.as_second()), Some(16));
        assert!(skin.touched().is_none());
    }

    #[test]
    fn a_weight_that_stays_is_no_zero() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        assert!((1..20).all(|at_s| skin.push(seen(2.0, at_s)).is_none()));
    }
}
