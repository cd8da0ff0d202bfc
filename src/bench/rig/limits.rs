//! Limits of the rig file that trip the rig, and the margins that set the speed of a press.
//! PURE. Uses: `problem`. Never: the comparison with a sample (`campaign::bench`).

use serde::{Deserialize, Serialize};

use crate::problem::Checks;
use crate::record::ARMS;

/// Limits that trip the rig. They are compared with every sample; a stale sample exceeds its limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigLimits {
    /// Limit of the force on one cell, N.
    pub force_n: f64,
    /// Limit of the sum of forces, N.
    pub force_sum_n: f64,
    /// Allowed increase of the force between a sample and the stop that follows it, N. The approach
    /// speed is derived from it.
    pub force_margin_n: f64,
    /// Allowed increase of the sum of forces in the same time, N; absent: six times `force_margin_n`, at
    /// most `force_sum_n`.
    #[serde(default)]
    pub force_sum_margin_n: Option<f64>,
    /// Stiffness of one tip on the skin, N/mm, from which the approach speed is derived.
    pub stiffness_n_per_mm: f64,
    /// Longest time without a frame, wall ms.
    pub frame_age_ms: u64,
    /// Longest time without a fresh sample of cells and positions while pressing, wall ms; absent: of one lost reply
    /// (`RigConfig::sample_age_ms`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample_age_ms: Option<u64>,
    /// Largest change of a cell's zero between two tares, and largest force below zero, N.
    pub tare_drift_n: f64,
    /// RMS change of the skin from untouched over its channels, beyond their noise, V. A larger
    /// change while no cell measures a touch trips the rig.
    #[serde(default = "default_skin_touch_v")]
    pub skin_touch_v: f64,
    /// Range of the slope of force against depth between two steps, N/mm. A lower slope in contact,
    /// or a higher slope, trips the rig.
    #[serde(default = "default_corridor_n_per_mm")]
    pub corridor_n_per_mm: [f64; 2],
    /// Depth below the touch height of a tip from which its cell must measure a force, mm.
    #[serde(default = "default_must_press_mm")]
    pub must_press_mm: f64,
}

impl RigLimits {
    /// Allowed increase of the sum of forces between a sample and the stop that follows it, N.
    pub fn sum_margin_n(&self) -> f64 {
        let six_n = ARMS as f64 * self.force_margin_n;
        self.force_sum_margin_n.unwrap_or(six_n.min(self.force_sum_n))
    }

    /// Travel of z that keeps the increase of each force and of their sum within its margin, mm, if
    /// `tips` tips press on a skin of the stated stiffness.
    pub fn margin_travel_mm(&self, tips: u8) -> f64 {
        let sum_n = self.sum_margin_n() / f64::from(tips.max(1));
        self.force_margin_n.min(sum_n) / self.stiffness_n_per_mm
    }

    /// Checks every limit; `full_scale_n` is the range of a cell.
    pub(super) fn check(&self, c: &mut Checks<'_>, full_scale_n: f64) {
        c.within("limits.force_n", self.force_n, 1.0..=0.8 * full_scale_n);
        c.within("limits.force_sum_n", self.force_sum_n, 1.0..=5000.0);
        c.within("limits.force_margin_n", self.force_margin_n, 0.1..=self.force_n);
        c.within("limits.force_sum_margin_n", self.sum_margin_n(), 0.1..=self.force_sum_n);
        c.within("limits.stiffness_n_per_mm", self.stiffness_n_per_mm, 0.1..=1000.0);
        c.within("limits.tare_drift_n", self.tare_drift_n, 0.01..=50.0);
        c.within("limits.skin_touch_v", self.skin_touch_v, 1e-6..=10.0);
        c.within("limits.must_press_mm", self.must_press_mm, 0.1..=20.0);
        let [low, high] = self.corridor_n_per_mm;
        let shown = format!("[{low}, {high}]");
        let ordered = low >= 0.0 && low < high && high.is_finite();
        c.require(ordered, "limits.corridor_n_per_mm", shown, "must be [lower, upper], from 0");
        check_frame_age(self.frame_age_ms, c);
    }
}

/// Checks the longest time without a frame.
pub(super) fn check_frame_age(age_ms: u64, c: &mut Checks<'_>) {
    let ok = (50..=10_000).contains(&age_ms);
    c.require(ok, "limits.frame_age_ms", age_ms, "must be from 50 to 10000");
}

/// Response of the paper's skin to about 10 N on one tip: five times drift and noise.
fn default_skin_touch_v() -> f64 {
    0.003
}

/// Wide: the upper end detects a wall, the lower end a cell that hardly responds.
fn default_corridor_n_per_mm() -> [f64; 2] {
    [0.2, 150.0]
}

fn default_must_press_mm() -> f64 {
    2.5
}
