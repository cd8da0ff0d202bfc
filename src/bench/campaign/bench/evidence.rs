//! Two cross-checks of a touch: the skin's voltages against the load cells, and force against
//! depth. Returns contradictions as values.
//! PURE. Uses: `rig::{config, traits}`. Never: motion, wires, clocks.
//!
//! A cell that reports zero while its tip presses would let z continue, and a large force would be
//! stored as none. The cell's own voltage does not show this; the skin's voltages do, and so does
//! the depth.

use std::sync::Arc;

use crate::record::ARMS;
use crate::rig::config::RigLimits;
use crate::rig::traits::Frame;

/// Force on any attached arm from which a touch counts as measured by the cells, N.
const MEASURED_N: f64 = 1.0;
/// Sum of forces to which the skin must respond, N.
const MUST_FEEL_N: f64 = 20.0;
/// A skin whose change beyond its noise is less than this fraction of the noise does not respond.
const QUIET_SHARE: f64 = 0.5;
/// Consecutive frames that must show a touch before it counts.
pub const FELT_FRAMES: u32 = 3;
/// Force from which a tip is in contact, so that more depth must increase it, N.
const IN_CONTACT_N: f64 = 5.0;
/// Force up to which an arm counts as silent, N.
const SILENT_N: f64 = 0.5;
/// Consecutive configurations in which an attached arm may be silent at the deepest step.
const SILENT_CONFIGURATIONS: u32 = 3;

/// Newest forces of the attached arms, and when they were compared with the skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredForces<'a> {
    /// Newest force of each attached arm, N, in the order of the arms.
    pub forces_n: &'a [f64],
    /// Time of the comparison, process s.
    pub now_s: f64,
    /// Process time after which the cells show a load that the skin shows, s.
    pub update_s: f64,
}

/// Reference frame of the untouched skin, and the touches detected since.
#[derive(Debug, Clone)]
pub struct SkinWatch {
    untouched_v: Vec<f64>,
    /// Expected RMS difference of a noisy frame from the untouched mean, V.
    noise_v: f64,
    sequence: u32,
    /// Number of consecutive touched frames that no cell explains, and the process time of the
    /// first, s.
    unmeasured: Option<(u32, f64)>,
}

impl SkinWatch {
    /// Averages frames taken while the tips are in the air. Returns none for fewer than two frames
    /// or frames of different sizes.
    pub fn untouched(frames: &[Arc<Frame>]) -> Option<Self> {
        let channels = frames.first()?.counts.len();
        let even = frames.len() >= 2 && frames.iter().all(|f| f.counts.len() == channels);
        if !even {
            return None;
        }
        let n = frames.len() as f64;
        let volts: Vec<Vec<f32>> = frames.iter().map(|f| f.voltages_v()).collect();
        let untouched_v: Vec<f64> =
            (0..channels).map(|c| volts.iter().map(|v| f64::from(v[c])).sum::<f64>() / n).collect();
        let square: f64 = volts
            .iter()
            .flat_map(|v| {
                v.iter().zip(&untouched_v).map(|(v, mean)| (f64::from(*v) - mean).powi(2))
            })
            .sum();
        let of_one = square / ((n - 1.0) * channels.max(1) as f64);
        let noise_v = (of_one * (1.0 + 1.0 / n)).sqrt();
        Some(Self { untouched_v, noise_v, sequence: 0, unmeasured: None })
    }

    /// Mean voltages of the untouched skin, V, injection-major.
    pub fn untouched_v(&self) -> Vec<f32> {
        self.untouched_v.iter().map(|v| *v as f32).collect()
    }

    /// RMS difference of a frame from the untouched skin over its channels, with the noise
    /// subtracted, V. Returns none if the number of channels differs.
    fn touch_v(&self, frame: &Frame) -> Option<f64> {
        let voltages = frame.voltages_v();
        if voltages.len() != self.untouched_v.len() || voltages.is_empty() {
            return None;
        }
        let square: f64 = voltages
            .iter()
            .zip(&self.untouched_v)
            .map(|(v, before)| (f64::from(*v) - before).powi(2))
            .sum();
        let beyond = square / voltages.len() as f64 - self.noise_v * self.noise_v;
        Some(beyond.max(0.0).sqrt())
    }

    /// Compares the newest frame with the newest forces. Returns a message if the skin has shown a
    /// touch that no cell measures for longer than `update_s`.
    pub fn unmeasured_touch(
        &mut self,
        frame: &Frame,
        measured: &MeasuredForces<'_>,
        limits: &RigLimits,
    ) -> Option<String> {
        let MeasuredForces { forces_n, now_s, update_s } = *measured;
        if frame.sequence == self.sequence {
            return None;
        }
        self.sequence = frame.sequence;
        let (touch_v, limit_v) = (self.touch_v(frame)?, limits.skin_touch_v);
        let explained = forces_n.iter().any(|&f| f > MEASURED_N);
        if touch_v < limit_v || explained {
            self.unmeasured = None;
            return None;
        }
        let (frames, since_s) = self.unmeasured.map_or((1, now_s), |(n, since)| (n + 1, since));
        self.unmeasured = Some((frames, since_s));
        (frames >= FELT_FRAMES && now_s - since_s > update_s).then(|| {
            let most = forces_n.iter().copied().fold(0.0, f64::max);
            format!(
                "the skin detects a touch ({:.1} mV from untouched, limits.skin_touch_v = \
                 {:.1} mV) and no cell measures one (largest force {most:.2} N): does a cell stay \
                 at zero?",
                touch_v * 1e3,
                limit_v * 1e3
            )
        })
    }

    /// Whether the skin does not respond although the forces are large enough.
    pub fn is_silent(&self, frame: &Frame, forces_n: &[f64]) -> bool {
        let quiet = self.touch_v(frame).is_some_and(|touch_v| touch_v < QUIET_SHARE * self.noise_v);
        quiet && forces_n.iter().sum::<f64>() > MUST_FEEL_N
    }
}

/// Settled forces at one depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// z, machine mm.
    pub z_mm: f64,
    /// Forces of the arms, N.
    pub forces_n: [f64; ARMS],
}

/// Checks that the force of each of the first `tips` arms grows between two depths within the
/// corridor of the rig file. Returns a message for the first arm outside it.
pub fn outside_corridor(
    before: &Held,
    after: &Held,
    tips: u8,
    limits: &RigLimits,
) -> Option<String> {
    let [low, high] = limits.corridor_n_per_mm;
    let step_mm = after.z_mm - before.z_mm;
    if step_mm <= 0.0 {
        return None;
    }
    (0..usize::from(tips)).find_map(|i| {
        let (from_n, to_n) = (before.forces_n[i], after.forces_n[i]);
        let slope = (to_n - from_n) / step_mm;
        let shallow = from_n > IN_CONTACT_N && slope < low;
        (shallow || slope > high).then(|| {
            format!(
                "force on arm {} went from {from_n:.2} to {to_n:.2} N over {step_mm:.2} mm: \
                 {slope:.2} N/mm, limits.corridor_n_per_mm = [{low}, {high}]",
                i + 1
            )
        })
    })
}

/// Force on an attached arm, and the depth of its tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PressedArm {
    /// Force on the load cell of the arm, N.
    pub force_n: f64,
    /// Distance of the tip below its touch height of the touch-off, mm.
    pub below_touch_mm: f64,
}

impl PressedArm {
    /// Whether the arm measures no force although its tip must press.
    pub fn is_silent(&self, limits: &RigLimits) -> bool {
        self.force_n < SILENT_N && self.below_touch_mm >= limits.must_press_mm
    }
}

/// Counts, for each attached arm, the consecutive configurations without force where its tip must
/// press.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SilentArms {
    configurations: [u32; ARMS],
}

impl SilentArms {
    /// Records the deepest step of a configuration: the largest force of each attached arm. Returns
    /// a message if an arm has been silent in too many configurations.
    pub fn note(
        &mut self,
        arms: impl IntoIterator<Item = PressedArm>,
        limits: &RigLimits,
    ) -> Option<String> {
        let mut words = None;
        for (i, arm) in arms.into_iter().enumerate().take(ARMS) {
            let PressedArm { force_n, below_touch_mm } = arm;
            if arm.is_silent(limits) {
                self.configurations[i] += 1;
                if self.configurations[i] >= SILENT_CONFIGURATIONS {
                    let n = self.configurations[i];
                    words.get_or_insert(format!(
                        "arm {} has measured no force in {n} configurations, the last time \
                         {below_touch_mm:.1} mm below its touch height (limits.must_press_mm = \
                         {}): check that its tip is mounted and its cell responds",
                        i + 1,
                        limits.must_press_mm
                    ));
                }
            } else if force_n >= SILENT_N {
                self.configurations[i] = 0;
            }
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in;

    fn limits() -> RigLimits {
        stand_in::config().limits
    }

    fn frame(sequence: u32, level: i16) -> Arc<Frame> {
        let noise = |c: i16| (c * 7 + sequence as i16 * 13) % 5 - 2;
        let counts = (0..784).map(|c| noise(c) + if c % 2 == 0 { level } else { -level }).collect();
        stand_in::frame(sequence, counts)
    }

    fn watch() -> SkinWatch {
        SkinWatch::untouched(&[frame(1, 0), frame(2, 0), frame(3, 0)]).unwrap()
    }

    #[test]
    fn a_touch_that_no_cell_weighs_counts_after_the_cells_update() {
        let (mut watch, limits) = (watch(), limits());
        let mut look = |n: u32, level, force| {
            let now_s = f64::from(n) * 0.05;
            let measured = MeasuredForces { forces_n: &[force], now_s, update_s: 0.1 };
            watch.unmeasured_touch(&frame(n, level), &measured, &limits)
        };
        assert_eq!(look(4, 0, 0.0), None);
        assert_eq!(look(5, 40, 0.0), None);
        assert_eq!(look(6, 40, 0.0), None);
        assert_eq!(look(7, 40, 2.0), None, "a cell measures it");
        assert_eq!(look(8, 40, 0.0), None);
        assert_eq!(look(9, 40, 0.0), None);
        assert_eq!(look(10, 40, 0.0), None, "not longer than the update");
        let words = look(11, 40, 0.3).unwrap();
        assert!(words.contains("mV from untouched"), "{words}");
        assert!(words.contains("largest force 0.30 N"), "{words}");
    }

    #[test]
    fn a_silent_skin_under_a_load_is_seen() {
        let watch = watch();
        assert!(watch.is_silent(&frame(9, 0), &[15.0, 10.0]));
        assert!(!watch.is_silent(&frame(9, 40), &[15.0, 10.0]));
        assert!(!watch.is_silent(&frame(9, 0), &[5.0, 10.0]));
        assert!(SkinWatch::untouched(&[frame(1, 0)]).is_none());
    }

    #[test]
    fn force_must_grow_within_the_corridor_once_a_tip_is_in_contact() {
        let held = |z_mm, force| Held { z_mm, forces_n: [force, 0.0, 0.0, 0.0, 0.0, 0.0] };
        let limits = limits();
        let out = |a, b| outside_corridor(&held(60.0, a), &held(60.5, b), 2, &limits);
        assert_eq!(out(0.0, 0.0), None, "in the air");
        assert_eq!(out(6.0, 14.0), None);
        assert!(out(6.0, 6.01).unwrap().contains("force on arm 1 went from 6.00 to 6.01 N"));
        assert!(out(0.0, 80.0).is_some(), "a wall");
        assert_eq!(outside_corridor(&held(60.0, 6.0), &held(60.5, 6.0), 0, &limits), None);
    }

    #[test]
    fn an_arm_that_never_presses_is_named_after_three_configurations() {
        let (mut arms, limits) = (SilentArms::default(), limits());
        let deep = limits.must_press_mm + 0.5;
        let arm = |force_n| PressedArm { force_n, below_touch_mm: deep };
        let mut note = |a: f64, b: f64| arms.note([a, b].map(arm), &limits);
        assert_eq!(note(10.0, 0.1), None);
        assert_eq!(note(10.0, 0.1), None);
        assert_eq!(note(10.0, 4.0), None, "it presses");
        assert_eq!(note(10.0, 0.1), None);
        assert_eq!(note(10.0, 0.1), None);
        assert!(note(10.0, 0.1).unwrap().starts_with("arm 2 has measured no force in 3"));
    }
}
