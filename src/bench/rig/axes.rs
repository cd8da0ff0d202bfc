//! The axes of a rig file: the drive of each, how far and how fast it may move, and its guards.
//! PURE. Uses: `problem`, `device`, `guard`, `profile`, `wires`. Never: registers, ports, files.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::device::AxisDevice;
use super::guard::Guard;
use super::profile::AxisProfile;
use super::wires::LineConfig;
use crate::problem::Checks;

/// The four actuators of the paper's rig (II-B).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxesConfig {
    /// Stage axis along the width of the skin.
    pub x: LinearAxis,
    /// Stage axis along the height of the skin.
    pub y: LinearAxis,
    /// Stage axis toward the skin, positive downward.
    pub z: LinearAxis,
    /// Rotary actuator that spreads the six arms.
    pub radial: RotaryAxis,
}

impl AxesConfig {
    /// Checks the values of the axes, and that `lines` has their wires.
    pub(super) fn check(&self, lines: &BTreeMap<String, LineConfig>, c: &mut Checks<'_>) {
        let profiles = [
            ("x", "mm", self.x.device, self.x.profile()),
            ("y", "mm", self.y.device, self.y.profile()),
            ("z", "mm", self.z.device, self.z.profile()),
            ("radial", "deg", self.radial.device, self.radial.profile()),
        ];
        for (name, unit, device, p) in &profiles {
            let key = |k: &str| format!("axes.{name}.{}", k.replace('*', unit));
            let known = lines.contains_key(&p.line);
            c.require(known, &key("line"), &p.line, "must be one of [lines]");
            let unit_ok = (1..=247).contains(&p.address);
            c.require(unit_ok, &key("unit"), p.address, "must be 1 to 247");
            c.within(&key("counts_per_*"), p.counts_per_unit, 1e-3..=1e7);
            c.within(&key("speed_*_s"), p.speed, 1e-3..=5000.0);
            c.within(&key("acceleration_*_s2"), p.acceleration, 1e-3..=1e5);
            c.within(&key("tolerance_*"), p.tolerance, 1e-4..=5.0);
            let ordered = p.travel[0].is_finite() && p.travel[0] < p.travel[1];
            let shown = format!("[{}, {}]", p.travel[0], p.travel[1]);
            c.require(ordered, &key("travel_*"), &shown, "must be [lower, upper]");
            let counts = p.travel.map(|t| (t * p.counts_per_unit).abs());
            let fits = counts.iter().all(|&n| n < f64::from(i32::MAX));
            c.require(fits, &key("travel_*"), shown, "must fit 32 bits of counts_per_*");
            device.check_guard(&p.guard, key, c);
        }
    }
}

/// Settings of a linear axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearAxis {
    /// Register map of the drive.
    pub device: AxisDevice,
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the drive.
    pub unit: u8,
    /// Device counts per millimetre.
    pub counts_per_mm: f64,
    /// Soft limits of commanded and measured positions, mm.
    pub travel_mm: [f64; 2],
    /// Travelling speed, mm/s.
    pub speed_mm_s: f64,
    /// Acceleration and deceleration, mm/s^2.
    pub acceleration_mm_s2: f64,
    /// Distance from the target that counts as arrived, mm.
    pub tolerance_mm: f64,
    /// Guards of the drive; absent: none.
    #[serde(default, skip_serializing_if = "Guard::is_none")]
    pub guard: Guard,
}

/// Settings of the rotary axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotaryAxis {
    /// Register map of the drive.
    pub device: AxisDevice,
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the drive.
    pub unit: u8,
    /// Device counts per degree.
    pub counts_per_deg: f64,
    /// Soft limits of commanded and measured positions, degrees.
    pub travel_deg: [f64; 2],
    /// Travelling speed, degrees/s.
    pub speed_deg_s: f64,
    /// Acceleration and deceleration, degrees/s^2.
    pub acceleration_deg_s2: f64,
    /// Distance from the target that counts as arrived, degrees.
    pub tolerance_deg: f64,
    /// Guards of the drive; absent: none.
    #[serde(default, skip_serializing_if = "Guard::is_none")]
    pub guard: Guard,
}

impl LinearAxis {
    /// Acceleration and deceleration to which the drive rounds the stated ones, mm/s^2.
    pub fn rounded_mm_s2(&self) -> f64 {
        self.device.acceleration(self.acceleration_mm_s2 * self.counts_per_mm) / self.counts_per_mm
    }

    /// Settings in the axis's unit, millimetres.
    pub fn profile(&self) -> AxisProfile {
        AxisProfile {
            line: self.line.clone(),
            address: self.unit,
            counts_per_unit: self.counts_per_mm,
            travel: self.travel_mm,
            speed: self.speed_mm_s,
            acceleration: self.acceleration_mm_s2,
            tolerance: self.tolerance_mm,
            guard: self.guard,
        }
    }
}

impl RotaryAxis {
    /// Settings in the axis's unit, degrees.
    pub fn profile(&self) -> AxisProfile {
        AxisProfile {
            line: self.line.clone(),
            address: self.unit,
            counts_per_unit: self.counts_per_deg,
            travel: self.travel_deg,
            speed: self.speed_deg_s,
            acceleration: self.acceleration_deg_s2,
            tolerance: self.tolerance_deg,
            guard: self.guard,
        }
    }
}
