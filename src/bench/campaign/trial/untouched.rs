//! The untouched skin between placements: windows of frames that are at rest and differ from the last
//! untouched ones by no more than their noise. A person tares the skin once; it is followed from there.
//! Uses: `trial::rest`, `rig::traits`. Never: motion, a frame of a placement.

use std::collections::VecDeque;
use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};

use super::rest::Window;
use crate::clock::Clock;
use crate::rig::error::RigError;
use crate::rig::traits::SkinReader;

/// Frames per window, one second at 30 frames per second: the mean of 10 frames does not show a weight of 5 N
/// on every skin.
pub const WINDOW_FRAMES: usize = 30;

/// Largest number of successive untouched windows in a mean: over 10 s the noise of seconds averages out, and offsets
/// hardly drift.
const MEAN_WINDOWS: usize = 10;

/// Longest time between two windows that follow each other, wall: in a longer one, of a pause or a stream that is opened
/// again, weights may have been placed.
const GAP: SignedDuration = SignedDuration::from_secs(3);

/// A mean of [`WINDOW_FRAMES`] frames, and the wall time of the last one.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Mean of the frames, V.
    pub window: Window,
    /// Wall time at which they were requested.
    pub from: Timestamp,
    /// Wall time of the last frame.
    pub at: Timestamp,
    /// Wall time since which the stream was open, and its device had not restarted, when they were requested; that of
    /// the last frame if it was opened again meanwhile.
    pub stream_since: Option<Timestamp>,
}

impl Seen {
    /// Takes the next frames.
    ///
    /// # Errors
    /// `RigError` if they do not arrive.
    pub async fn next(skin: &Arc<dyn SkinReader>, clock: &Clock) -> Result<Self, RigError> {
        let (from, stream_since) = (clock.timestamp(), skin.counters().since);
        let frames = skin.take(clock.now(), WINDOW_FRAMES).await?;
        let at = clock.timestamp();
        let stream_since = skin.counters().since_of_frames(stream_since, at);
        Ok(Self { window: Window::of(&frames), from, at, stream_since })
    }

    fn rests_after(&self, earlier: &Self) -> bool {
        self.window.rests_after(&earlier.window)
    }
}

/// Mean of the newest untouched windows, without a touch between them.
#[derive(Debug, Clone)]
pub struct UntouchedMean {
    /// Mean voltages, V.
    pub mean_v: Vec<f64>,
    /// Number of frames.
    pub frames: usize,
    /// Wall time of the last one.
    pub at: Timestamp,
    /// As in [`Seen`].
    pub stream_since: Option<Timestamp>,
}

/// Follows the untouched skin.
#[derive(Debug, Clone)]
pub struct UntouchedSkin {
    /// The newest untouched window.
    last: Seen,
    /// Means of the newest untouched windows since the last touch, V, that of `last` at the end.
    recent_v: VecDeque<Vec<f64>>,
    is_reported: bool,
    was_touched: bool,
    /// The window before, touched or not; none just after a placement.
    before: Option<Seen>,
    /// An untouched window whose end may hold the beginning of a touch.
    pending: Option<Seen>,
}

impl UntouchedSkin {
    /// Begins with a window in which, a person states, nothing touches the skin.
    pub fn tared(last: Seen) -> Self {
        let before = Some(last.clone());
        let recent_v = VecDeque::from([last.window.mean_v.clone()]);
        Self { last, recent_v, is_reported: true, was_touched: false, before, pending: None }
    }

    /// Adds the next window. Returns what to store: the first untouched window after a touch, and the mean of the
    /// newest ones when the next touch begins.
    pub fn push(&mut self, seen: Seen) -> Option<UntouchedMean> {
        let follows = |before: &Seen| {
            before.stream_since == seen.stream_since
                && before.at.duration_until(seen.from) <= GAP
                && seen.rests_after(before)
        };
        let is_untouched =
            self.before.as_ref().is_some_and(follows) && seen.rests_after(&self.last);
        self.before = Some(seen.clone());
        if !is_untouched {
            return self.touched();
        }
        self.last = self.pending.replace(seen)?;
        self.is_reported = std::mem::take(&mut self.was_touched);
        if self.is_reported {
            self.recent_v.clear();
        }
        if self.recent_v.len() == MEAN_WINDOWS {
            self.recent_v.pop_front();
        }
        self.recent_v.push_back(self.last.window.mean_v.clone());
        self.is_reported.then(|| self.mean())
    }

    /// Weights were placed. Returns the mean of the newest windows before them, unless the last one was returned
    /// already. The windows of the placement are not seen: the next window may hold its end, and nothing precedes it.
    pub fn placed(&mut self) -> Option<UntouchedMean> {
        self.before = None;
        self.touched()
    }

    fn touched(&mut self) -> Option<UntouchedMean> {
        (self.pending, self.was_touched) = (None, true);
        let is_reported = std::mem::replace(&mut self.is_reported, true);
        (!is_reported).then(|| self.mean())
    }

    /// Wall time since which the stream of the newest untouched window was open, as in [`Seen`].
    pub fn stream_since(&self) -> Option<Timestamp> {
        self.last.stream_since
    }

    /// Mean of the newest untouched windows since the last touch.
    pub fn mean(&self) -> UntouchedMean {
        let windows = self.recent_v.len();
        let mut mean_v = vec![0.0; self.last.window.mean_v.len()];
        for window_v in &self.recent_v {
            mean_v.iter_mut().zip(window_v).for_each(|(mean, v)| *mean += v / windows as f64);
        }
        let Seen { at, stream_since, .. } = self.last;
        UntouchedMean { mean_v, frames: windows * WINDOW_FRAMES, at, stream_since }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::campaign::bench::stand_in;

    /// A window of 784 channels with a load in half of them, in counts of 1 mV, and noise; it ends at second `at_s`.
    fn seen(load: f64, at_s: i64) -> Seen {
        let frames: Vec<_> = (0..WINDOW_FRAMES as i32)
            .map(|i| {
                let noise = |c: i32| f64::from((c * 31 + i * 17) % 7 - 3);
                let load = |c: i32| if c % 2 == 0 { load } else { 0.0 };
                let counts = (0..784).map(|c| (noise(c) + load(c)).round() as i16).collect();
                stand_in::frame(0, counts)
            })
            .collect();
        let [from, at] = [at_s - 1, at_s].map(|s| Timestamp::from_second(s).unwrap());
        Seen { window: Window::of(&frames), from, at, stream_since: None }
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
        assert_eq!(skin.placed().map(|found| found.at.as_second()), Some(16));
        assert!(skin.placed().is_none());
    }

    #[test]
    fn a_window_with_the_end_of_a_placement_is_no_zero() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        assert!((1..3).all(|at_s| skin.push(seen(0.0, at_s)).is_none()));
        assert!(skin.placed().is_some());
        // The weights are lifted within the first frames of a window: its mean is within the noise of the zero.
        let lifted = seen(1.0, 3);
        assert!(lifted.rests_after(&seen(0.0, 2)));
        let stored = [lifted, seen(0.0, 4), seen(0.0, 5)].map(|seen| skin.push(seen));
        assert_eq!(
            stored.map(|found| found.map(|found| found.at.as_second())),
            [None, None, Some(4)]
        );
    }

    #[test]
    fn the_mean_before_a_touch_is_of_the_newest_windows_since_the_last_one() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        assert_eq!(skin.mean().frames, WINDOW_FRAMES);
        assert!((1..4).all(|at_s| skin.push(seen(0.0, at_s)).is_none()));
        // Of 0 to 2 s: nothing confirms the window at 3 s.
        let few = skin.push(seen(9.0, 4)).unwrap();
        assert_eq!((few.frames, few.at.as_second()), (3 * WINDOW_FRAMES, 2));
        // The loads of these windows are 0 or a count: within the noise of one another.
        let load = |at_s: i64| if at_s % 2 == 0 { 1.0 } else { 0.0 };
        let mut skin = UntouchedSkin::tared(seen(load(0), 0));
        assert!((1..20).all(|at_s| skin.push(seen(load(at_s), at_s)).is_none()));
        let many = skin.push(seen(9.0, 20)).unwrap();
        assert_eq!((many.frames, many.at.as_second()), (MEAN_WINDOWS * WINDOW_FRAMES, 18));
        let windows_v = [0.0, 1.0].map(|load| seen(load, 0).window.mean_v);
        let half_v = (windows_v[0][0] + windows_v[1][0]) / 2.0;
        assert!((many.mean_v[0] - half_v).abs() < 1e-9, "{} for {half_v} V", many.mean_v[0]);
        let first = (21..30).find_map(|at_s| skin.push(seen(0.0, at_s))).unwrap();
        assert_eq!(first.frames, WINDOW_FRAMES);
    }

    #[test]
    fn a_window_after_a_gap_is_no_zero_and_windows_before_it_are_in_no_mean_after_it() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        assert!((1..4).all(|at_s| skin.push(seen(0.0, at_s)).is_none()));
        // The stream was open again after a minute; the window of 60 s may hold the end of a placement.
        let stored = [60, 61, 62].map(|at_s| skin.push(seen(0.0, at_s)));
        let stored = stored.map(|found| found.map(|found| (found.at.as_second(), found.frames)));
        assert_eq!(stored, [Some((2, 3 * WINDOW_FRAMES)), None, Some((61, WINDOW_FRAMES))]);
    }

    #[test]
    fn windows_before_the_stream_was_opened_again_are_in_no_mean_after_it() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        assert!((1..4).all(|at_s| skin.push(seen(0.0, at_s)).is_none()));
        // It was opened again at once: no gap shows it.
        let stream_since = Some(Timestamp::from_second(4).unwrap());
        let stored = [4, 5, 6].map(|at_s| skin.push(Seen { stream_since, ..seen(0.0, at_s) }));
        let stored = stored.map(|found| {
            found.map(|found| (found.at.as_second(), found.frames, found.stream_since))
        });
        let before = Some((2, 3 * WINDOW_FRAMES, None));
        assert_eq!(stored, [before, None, Some((5, WINDOW_FRAMES, stream_since))]);
    }

    #[tokio::test]
    async fn a_window_during_which_the_stream_is_opened_again_is_of_no_other_stream() {
        let stand_in = Arc::new(stand_in::Skin::default());
        *stand_in.takes.lock() = Duration::from_millis(50);
        let skin: Arc<dyn SkinReader> = stand_in.clone();
        let clock = Clock::new(1.0);
        let again = async { *stand_in.since.lock() = Some(Timestamp::UNIX_EPOCH) };
        // In this order: the frames are awaited before it is opened again.
        let (seen, ()) = futures::join!(Seen::next(&skin, &clock), again);
        let seen = seen.unwrap();
        assert_eq!(seen.stream_since, Some(seen.at));
    }

    #[test]
    fn a_weight_that_stays_is_no_zero() {
        let mut skin = UntouchedSkin::tared(seen(0.0, 0));
        assert!((1..20).all(|at_s| skin.push(seen(2.0, at_s)).is_none()));
    }
}
