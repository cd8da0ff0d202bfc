//! The stopping distance: how far z travels, and how much force that may add, between a sample over
//! its limit and standstill. It is computed from the rig file and the measured times of the wires
//! before a run is armed, and measured at each stop; the status shows both.
//! PURE. Uses: `rig::config`. Never: wires, clocks.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::rig::config::RigConfig;

/// Pause between two polls of a motion, process s.
pub const POLL_S: f64 = 0.010;
/// Assumed scheduling delay of the computer between two polls, wall s.
const LATE_WALL_S: f64 = 0.005;
/// Factor by which the slowest poll decays with each further poll.
const POLL_MEMORY: f64 = 0.99;
/// Multiple of the slowest of the newest polls above which the slowest poll is one of an earlier time.
const EARLIER_POLL: f64 = 2.0;
/// Slowest usable press, mm/s.
const SLOWEST_MM_S: f64 = 0.02;

/// Bound of the force increase between a sample and the stop that follows it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StoppingDistance {
    /// Speed of the fastest press, mm/s.
    pub speed_mm_s: f64,
    /// Longest time from a force to the stop command of z on the wire, process ms: update period of
    /// the cells, two polls, and the scheduling delay of the computer.
    pub blind_ms: f64,
    /// Part of it from the arrival of a sample to the stop command of z on the wire, wall ms.
    /// Compare with `measured_ms`.
    pub sample_to_stop_ms: f64,
    /// Travel in that time and during the deceleration of z, mm.
    pub travel_mm: f64,
    /// Force on one tip that this travel may add, N: travel x `limits.stiffness_n_per_mm`.
    pub added_n: f64,
    /// Limit of `added_n` from the rig file, N: `limits.force_margin_n`.
    pub margin_n: f64,
    /// Number of pressing tips for which the figures hold.
    pub tips: u8,
    /// Sum of forces that the travel may add, N: `added_n` x `tips`.
    pub added_sum_n: f64,
    /// Limit of `added_sum_n` from the rig file, N: `limits.force_sum_margin_n`.
    pub margin_sum_n: f64,
    /// Force on one tip that the travel adds if the skin is as stiff as `limits.corridor_n_per_mm`
    /// allows, N. No limit applies: a stiffer skin than stated is a fault of the rig file.
    pub added_steepest_n: f64,
    /// Number of stops measured in this run.
    pub stops: u64,
    /// Longest measured time from a sample to the acknowledged stop of z, wall ms; absent before
    /// the first stop.
    pub measured_ms: Option<f64>,
    /// Longest measured travel of z from a sample to its deepest position after the stop, mm; absent
    /// before the first stop of a moving z.
    pub measured_mm: Option<f64>,
}

/// Tracks the durations of polls and the delays and travels of stops.
#[derive(Debug, Clone, Default)]
pub struct Stopping {
    slowest_poll_s: f64,
    stops: u64,
    longest: Option<Duration>,
    farthest_mm: Option<f64>,
}

impl Stopping {
    /// Records the duration of one polling round, process s. The effect of a slow round decays over
    /// a few hundred rounds.
    pub fn note_poll(&mut self, took_s: f64) {
        self.slowest_poll_s = took_s.max(self.slowest_poll_s * POLL_MEMORY);
    }

    /// Whether the slowest poll is much slower than the newest ones, the slowest of which took this time, process s: then
    /// it was before them.
    pub fn is_slower_than(&self, newest_s: f64) -> bool {
        self.slowest_poll_s > EARLIER_POLL * newest_s.max(POLL_S)
    }

    /// Records the time from a sample to the acknowledgement of the stop that followed; none is
    /// ignored.
    pub fn note_stop(&mut self, after: Option<Duration>) {
        if let Some(after) = after {
            self.stops += 1;
            self.longest = self.longest.max(Some(after));
        }
    }

    /// Records the travel of z from that sample to standstill, mm; none is ignored.
    pub fn note_travel(&mut self, travel_mm: Option<f64>) {
        if let Some(travel_mm) = travel_mm {
            self.farthest_mm = Some(self.farthest_mm.unwrap_or(0.0).max(travel_mm));
        }
    }

    /// Starts the counts and maxima of a newly armed run; the slowest poll is kept.
    pub fn begin(&mut self) {
        *self = Self { slowest_poll_s: self.slowest_poll_s, ..Self::default() };
    }

    /// Longest time between a force and the stop that it requires, process s. A wire shared by
    /// several devices and a fast clock make the polls longer.
    pub fn blind_s(&self, rig: &RigConfig) -> f64 {
        let late_s = LATE_WALL_S * rig.clock_rate;
        rig.cells.update_ms / 1e3 + 2.0 * self.slowest_poll_s.max(POLL_S) + late_s
    }

    /// Speed of a press with `tips` tips, mm/s: the added forces stay within their margins, and the
    /// approach speed of the rig file is not exceeded.
    pub fn press_speed_mm_s(&self, rig: &RigConfig, tips: u8) -> f64 {
        let travel_mm = rig.limits.margin_travel_mm(tips);
        // v blind + v^2 / 2a = travel, solved for v.
        let (a, blind_s) = (rig.axes.z.rounded_mm_s2(), self.blind_s(rig));
        let speed = a * ((blind_s * blind_s + 2.0 * travel_mm / a).sqrt() - blind_s);
        speed.min(rig.approach_speed_mm_s())
    }

    /// Age of the newest sample, process s from its request, at which a press at this speed must be stopped, so that the
    /// added forces stay within their margins. A slower press has more time.
    pub fn sample_age_s(&self, rig: &RigConfig, tips: u8, speed_mm_s: f64) -> f64 {
        let brakes_s = speed_mm_s / (2.0 * rig.axes.z.rounded_mm_s2());
        rig.limits.margin_travel_mm(tips) / speed_mm_s - brakes_s - rig.cells.update_ms / 1e3
    }

    /// Stopping distance of a press with `tips` tips at the present pace of the wires, with the
    /// measured values. `drive_mm_s`: slowest motion of the drive of z, mm/s.
    ///
    /// # Errors
    /// No usable press is slow enough for the margin; the message names the key and the speed
    /// required.
    pub fn distance(
        &self,
        rig: &RigConfig,
        tips: u8,
        drive_mm_s: f64,
    ) -> Result<StoppingDistance, String> {
        let (speed, blind_s) = (self.press_speed_mm_s(rig, tips), self.blind_s(rig));
        let travel_mm = speed * blind_s + speed * speed / (2.0 * rig.axes.z.rounded_mm_s2());
        let limits = &rig.limits;
        let slowest = SLOWEST_MM_S.max(drive_mm_s);
        if speed < slowest {
            let (key, margin_n) = match limits.force_margin_n * f64::from(tips) {
                sum_n if sum_n <= limits.sum_margin_n() => {
                    ("force_margin_n", limits.force_margin_n)
                }
                _ => ("force_sum_margin_n", limits.sum_margin_n()),
            };
            return Err(format!(
                "limits.{key} = {margin_n}: with {tips} tips, {:.0} ms from a force to its stop \
                 (slowest poll of the wires {:.0} ms) and {} N/mm, a press must not exceed \
                 {speed:.4} mm/s; the slowest press of axes.z is {slowest:.4}",
                blind_s * 1e3,
                self.slowest_poll_s.max(POLL_S) * 1e3,
                limits.stiffness_n_per_mm
            ));
        }
        let mut distance = StoppingDistance {
            speed_mm_s: speed,
            blind_ms: blind_s * 1e3,
            sample_to_stop_ms: (self.slowest_poll_s.max(POLL_S) / rig.clock_rate + LATE_WALL_S)
                * 1e3,
            travel_mm,
            added_n: travel_mm * limits.stiffness_n_per_mm,
            margin_n: limits.force_margin_n,
            tips,
            added_sum_n: travel_mm * limits.stiffness_n_per_mm * f64::from(tips),
            margin_sum_n: limits.sum_margin_n(),
            added_steepest_n: travel_mm * limits.corridor_n_per_mm[1],
            stops: 0,
            measured_ms: None,
            measured_mm: None,
        };
        self.show_measured(&mut distance);
        Ok(distance)
    }

    /// Replaces the measured values of a computed stopping distance with the present ones.
    pub fn show_measured(&self, distance: &mut StoppingDistance) {
        distance.stops = self.stops;
        distance.measured_ms = self.longest.map(|d| d.as_secs_f64() * 1e3);
        distance.measured_mm = self.farthest_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in::config as rig;

    #[test]
    fn what_a_stop_may_add_stays_within_both_margins_however_slow_the_wire() {
        let mut rig = rig();
        rig.limits.force_sum_margin_n = Some(20.0);
        for poll_s in [0.0, 0.01, 0.1, 0.5, 2.0] {
            for tips in 1..=6 {
                let mut stopping = Stopping::default();
                stopping.note_poll(poll_s);
                let distance = stopping.distance(&rig, tips, 0.0).unwrap();
                let within = |added: f64, margin: f64| added <= margin * (1.0 + 1e-9);
                assert!(within(distance.added_n, distance.margin_n), "{distance:?}");
                assert!(within(distance.added_sum_n, distance.margin_sum_n), "{distance:?}");
                assert!(distance.speed_mm_s <= rig.approach_speed_mm_s());
            }
        }
    }

    #[test]
    fn a_press_that_is_stopped_at_this_age_of_its_sample_stays_within_its_margin() {
        let (rig, mut stopping) = (rig(), Stopping::default());
        for poll_s in [0.0, 0.1, 2.0] {
            stopping.note_poll(poll_s);
            let fastest = stopping.press_speed_mm_s(&rig, 2);
            let age_s = stopping.sample_age_s(&rig, 2, fastest);
            let polls_s = 2.0 * poll_s.max(POLL_S) + LATE_WALL_S;
            assert!((age_s - polls_s).abs() < 1e-9, "{age_s} s, two polls {polls_s} s");
            for speed in [fastest, fastest / 3.0] {
                let age_s = stopping.sample_age_s(&rig, 2, speed);
                let seconds = age_s + rig.cells.update_ms / 1e3;
                let brakes_mm = speed * speed / (2.0 * rig.axes.z.rounded_mm_s2());
                let travel_mm = speed * seconds + brakes_mm;
                assert!((travel_mm - rig.limits.margin_travel_mm(2)).abs() < 1e-9, "{travel_mm}");
            }
        }
    }

    #[test]
    fn a_stop_is_as_weak_as_the_acceleration_to_which_the_drive_of_z_rounds() {
        let mut rig = rig();
        rig.axes.z.acceleration_mm_s2 = 190.0;
        let distance = Stopping::default().distance(&rig, 1, 0.0).unwrap();
        let (speed, blind_s) = (distance.speed_mm_s, distance.blind_ms / 1e3);
        // 0.0194 G: it is commanded 0.01 G.
        let travel_mm = speed * blind_s + speed * speed / (2.0 * 98.0665);
        assert!((distance.travel_mm - travel_mm).abs() < 1e-9, "{travel_mm}: {distance:?}");
        assert!(travel_mm < rig.limits.margin_travel_mm(1) + 1e-9, "{travel_mm}");
    }

    #[test]
    fn more_tips_press_more_slowly_only_if_the_margin_of_the_sum_requires_it() {
        let (mut rig, stopping) = (rig(), Stopping::default());
        let speed = |rig: &RigConfig, tips| stopping.press_speed_mm_s(rig, tips);
        assert_eq!(speed(&rig, 6), speed(&rig, 1));
        rig.limits.force_sum_margin_n = Some(24.0);
        assert_eq!(speed(&rig, 3), speed(&rig, 1));
        assert!(speed(&rig, 6) < 0.6 * speed(&rig, 3));
    }

    #[test]
    fn a_margin_that_no_press_keeps_is_refused_and_named() {
        let mut stopping = Stopping::default();
        stopping.note_poll(100.0);
        let mut rig = rig();
        let refused = stopping.distance(&rig, 6, 0.0).unwrap_err();
        assert!(refused.starts_with("limits.force_margin_n = 8"), "{refused}");
        rig.limits.force_sum_margin_n = Some(20.0);
        let refused = stopping.distance(&rig, 6, 0.0).unwrap_err();
        assert!(refused.starts_with("limits.force_sum_margin_n = 20: with 6 tips"), "{refused}");
    }

    #[test]
    fn a_slow_poll_decays_with_the_polls_after_it_and_never_below_the_slowest_of_them() {
        let (rig, mut stopping) = (rig(), Stopping::default());
        stopping.note_poll(100.0);
        for polls in 0.. {
            assert!(polls < 1000, "it stays slow");
            if !stopping.is_slower_than(0.2) {
                break;
            }
            stopping.note_poll(if polls % 2 == 0 { 0.2 } else { 0.02 });
        }
        stopping.distance(&rig, 6, 0.0).unwrap();
        let polls_s = (stopping.blind_s(&rig) - Stopping::default().blind_s(&rig)) / 2.0 + POLL_S;
        assert!((0.2..=0.4).contains(&polls_s), "{polls_s} s");
    }

    #[test]
    fn a_press_that_is_slower_than_the_drive_of_z_can_move_is_refused() {
        let (rig, stopping) = (rig(), Stopping::default());
        let press_mm_s = stopping.press_speed_mm_s(&rig, 1);
        stopping.distance(&rig, 1, press_mm_s).unwrap();
        let refused = stopping.distance(&rig, 1, 5.0).unwrap_err();
        assert!(refused.starts_with("limits.force_margin_n = 8: with 1 tips"), "{refused}");
        assert!(refused.ends_with("the slowest press of axes.z is 5.0000"), "{refused}");
    }

    #[test]
    fn the_longest_stop_and_the_farthest_travel_are_kept() {
        let mut stopping = Stopping::default();
        for ms in [3, 9, 5] {
            stopping.note_stop(Some(Duration::from_millis(ms)));
        }
        stopping.note_stop(None);
        stopping.note_travel(Some(0.2));
        stopping.note_travel(Some(0.1));
        stopping.note_travel(None);
        let distance = stopping.distance(&rig(), 1, 0.0).unwrap();
        assert_eq!((distance.stops, distance.measured_mm), (3, Some(0.2)));
        assert_eq!(distance.measured_ms, Some(9.0));
        stopping.begin();
        assert_eq!(stopping.distance(&rig(), 1, 0.0).unwrap().stops, 0);
    }
}
