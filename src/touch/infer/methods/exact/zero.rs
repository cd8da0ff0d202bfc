//! What the offsets of a readout have drifted by since the skin was calibrated: from a frame of the untouched
//! skin, or from live frames in which nothing is found.
//! PURE. Uses: `infer::{scatter, untouched_frame}`. Never: a frame with a contact.
//!
//! Offsets drift in the buffers of the electrodes, so each pair of electrodes has one, the same in every
//! injection. The place of a light contact is in the same numbers: its frame is `I (d_j - d_k)`, with the
//! current I and, for each pair, a number d that depends on the place. A drift looks like a contact, and must be
//! measured.

use std::collections::VecDeque;

use crate::infer::scatter::of_pairs;
use crate::infer::untouched_frame::share_of_day;

/// Number of untouched frames over which the zero follows, 10 s at 30 frames per second: slowly enough that
/// the noise averages out, quickly enough for drifts over minutes.
const FOLLOWS: f64 = 300.0;
/// Number of frames in the mean from which a frame without contact is taken as untouched: one frame may hide
/// a light touch.
const SURE_FRAMES: f64 = 15.0;
/// Number of newest frames that wait before the zero follows them, 0.5 s: a light touch is found only in the mean of
/// some frames with it, and those are then dropped.
const WAITING_FRAMES: usize = 15;

/// Offsets of the pairs of electrodes, relative to those of the calibration.
#[derive(Debug, Clone, Default)]
pub struct Zero {
    offset_v: Vec<f64>,
    frames: f64,
    /// Offsets of the newest frames without a contact, V, from which it has not learned yet; at most `WAITING_FRAMES`.
    waiting_v: VecDeque<Vec<f64>>,
    /// Process time since the last frame from which it learned, s.
    idle_s: f64,
}

impl Zero {
    /// The zero of a frame of the untouched skin from which the offsets of the calibration are subtracted, V.
    pub fn of(untouched_v: &[f64]) -> Self {
        let offset_v = of_pairs(untouched_v);
        Self { offset_v, frames: f64::INFINITY, ..Self::default() }
    }

    /// Process time since the last frame from which it learned, h.
    pub fn hours(&self) -> f64 {
        self.idle_s / 3600.0
    }

    /// Share of the drift of a day that it may have: what is left of the first offset, and its age; none before an
    /// untouched frame.
    pub fn share_of_day(&self) -> Option<f64> {
        self.left().map(|left| left.hypot(share_of_day(self.hours())))
    }

    /// Notes that process time passed, s.
    pub fn pass(&mut self, seconds: f64) {
        self.idle_s += seconds;
    }

    /// Share of the first offset that is left; none before an untouched frame.
    fn left(&self) -> Option<f64> {
        (self.frames > 0.0).then(|| SURE_FRAMES / (self.frames + SURE_FRAMES))
    }

    /// Subtracts the zero from a frame, V.
    pub fn take_off(&self, frame_v: &mut [f64]) {
        if !self.offset_v.is_empty() {
            let offsets = self.offset_v.iter().cycle();
            frame_v.iter_mut().zip(offsets).for_each(|(v, offset)| *v -= offset);
        }
    }

    /// Learns from the frame that came `WAITING_FRAMES` frames before this one, from which the zero is already
    /// subtracted, V: the mean of the last `averaged` frames shows no contact. Offsets stay within `most_v`: beyond
    /// it, something rests on the skin.
    pub fn learn(&mut self, frame_v: &[f64], averaged: f64, most_v: f64) {
        if averaged < SURE_FRAMES {
            self.touched();
            return;
        }
        let mut of_frame_v = of_pairs(frame_v);
        self.offset_v.resize(of_frame_v.len(), 0.0);
        of_frame_v.iter_mut().zip(&self.offset_v).for_each(|(v, offset)| *v += offset);
        self.waiting_v.push_back(of_frame_v);
        if self.waiting_v.len() > WAITING_FRAMES
            && let Some(before_v) = self.waiting_v.pop_front()
        {
            self.follow(&before_v, most_v);
        }
    }

    /// The load has changed, or a contact is found: the frames just before it may have the beginning of a touch.
    pub fn touched(&mut self) {
        self.waiting_v.clear();
    }

    /// Follows the offsets of a frame, V.
    fn follow(&mut self, of_frame_v: &[f64], most_v: f64) {
        self.idle_s = 0.0;
        self.frames = (self.frames + 1.0).min(FOLLOWS);
        let share = 1.0 / (self.frames + SURE_FRAMES);
        for (offset, v) in self.offset_v.iter_mut().zip(of_frame_v) {
            *offset = (*offset + share * (v - *offset)).clamp(-most_v, most_v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame of two pairs with these offsets, V.
    fn frame(offset_v: f64) -> [f64; 4] {
        [offset_v, -offset_v, offset_v, -offset_v]
    }

    fn left(zero: &Zero, mut frame_v: [f64; 4]) -> [f64; 4] {
        zero.take_off(&mut frame_v);
        frame_v
    }

    #[test]
    fn the_zero_follows_means_without_contacts_up_to_a_bound() {
        let mut zero = Zero::default();
        for _ in 0..1000 {
            zero.learn(&left(&zero, frame(1e-3)), 30.0, 2e-3);
        }
        assert!(zero.left().unwrap() < 0.05);
        assert!(left(&zero, frame(1e-3)).iter().all(|v| v.abs() < 1e-4));
        let before = zero.clone();
        zero.learn(&frame(5e-3), 1.0, 2e-3);
        assert_eq!(left(&before, frame(1e-3)), left(&zero, frame(1e-3)));
        for _ in 0..1000 {
            zero.learn(&left(&zero, frame(5e-3)), 30.0, 2e-3);
        }
        assert!((left(&zero, frame(5e-3))[0] - 3e-3).abs() < 1e-9, "it is bounded");
    }

    #[test]
    fn a_zero_that_does_not_learn_ages() {
        let mut zero = Zero::default();
        zero.pass(1.0);
        assert_eq!(zero.share_of_day(), None);
        (0..400).for_each(|_| zero.learn(&frame(0.0), 30.0, 2e-3));
        assert!(zero.hours() == 0.0 && zero.share_of_day().unwrap() < 0.05);
        // Something rests on the skin for six hours: half of the drift of a day.
        zero.pass(6.0 * 3600.0);
        let share = zero.share_of_day().unwrap();
        assert!((zero.hours() - 6.0).abs() < 1e-9 && (share - 0.5).abs() < 0.01, "{share}");
        zero.learn(&frame(0.0), 1.0, 2e-3);
        assert!(zero.hours() > 5.9, "one frame may hide a light touch");
        (0..WAITING_FRAMES).for_each(|_| zero.learn(&frame(0.0), 30.0, 2e-3));
        assert!(zero.hours() > 5.9, "so may the newest of several");
        zero.learn(&frame(0.0), 30.0, 2e-3);
        assert_eq!(zero.hours(), 0.0);
    }

    #[test]
    fn the_frames_before_a_touch_is_found_are_not_in_the_zero() {
        let mut zero = Zero::default();
        (0..1000).for_each(|_| zero.learn(&left(&zero, frame(1e-3)), 30.0, 2e-3));
        let before = left(&zero, frame(0.0));
        // The mean shows a light touch only after some frames with it.
        for _ in 0..WAITING_FRAMES {
            zero.learn(&left(&zero, frame(1.5e-3)), 30.0, 2e-3);
        }
        zero.touched();
        // Those were frames without it.
        let change_v = (left(&zero, frame(0.0))[0] - before[0]).abs();
        assert!(change_v < 1e-6, "{change_v}");
        // It is lifted: nothing of it is left in what the zero follows.
        (0..=WAITING_FRAMES).for_each(|_| zero.learn(&left(&zero, frame(1e-3)), 30.0, 2e-3));
        let change_v = (left(&zero, frame(0.0))[0] - before[0]).abs();
        assert!(change_v < 1e-6, "{change_v}");
        // One that is never found is the zero in the end.
        (0..3000).for_each(|_| zero.learn(&left(&zero, frame(1.5e-3)), 30.0, 2e-3));
        assert!(left(&zero, frame(1.5e-3))[0].abs() < 1e-6);
    }

    #[test]
    fn an_untouched_frame_is_the_zero_of_its_pairs_and_keeps_what_differs_between_injections() {
        let zero = Zero::of(&frame(2e-3));
        assert!(zero.left() == Some(0.0) && left(&zero, frame(2e-3)) == [0.0; 4]);
        let zero = Zero::of(&[1e-3, 0.0, -1e-3, 0.0]);
        assert_eq!(left(&zero, frame(2e-3)), frame(2e-3));
        assert_eq!(Zero::default().left(), None);
        assert_eq!(left(&Zero::default(), frame(2e-3)), frame(2e-3));
    }
}
