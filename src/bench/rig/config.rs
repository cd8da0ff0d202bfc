//! The rig file: which device is connected to which wire at which address, how far and how fast it
//! may move, and the limits that trip it. It is parsed and checked here; nothing is opened.
//! PURE. Uses: `problem`, `wires`, `axes`, `cells`, `limits`. Never: ports, files (the text is passed in).
//!
//! Machine coordinates: x and y increase along the stage, z increases downward from the raised home
//! position 0. The slot converts the angle of the rotary actuator to a radius.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use super::axes::{AxesConfig, LinearAxis, RotaryAxis};
pub use super::cells::CellsConfig;
pub use super::device::{AxisDevice, CellsDevice};
pub use super::guard::Guard;
pub use super::limits::RigLimits;
pub use super::profile::AxisProfile;
pub use super::wires::{ErtConfig, LineConfig, Parity};
use crate::problem::{Checks, Problem};
use crate::record::Label;
use crate::syntax::parse_toml;

/// Contents of a rig file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigConfig {
    /// Name of the rig, stored with each run.
    pub name: String,
    /// Label of all data of this rig.
    pub label: RigLabel,
    /// Process seconds per wall second: 1 on a real bench.
    #[serde(default = "one")]
    pub clock_rate: f64,
    /// Wires by name; several devices may share one wire.
    pub lines: BTreeMap<String, LineConfig>,
    /// The four actuators.
    pub axes: AxesConfig,
    /// Conversion of the angle of the rotary actuator to a radius.
    pub slot: SlotConfig,
    /// Position of the skin on the stage.
    pub skin: SkinPlacement,
    /// Load cells of the six arms.
    pub cells: CellsConfig,
    /// The voltage stream.
    pub ert: ErtConfig,
    /// Limits that trip the rig.
    pub limits: RigLimits,
}

/// Label of everything measured with a rig: a rig measures, so that it cannot be [`Label::Simulated`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RigLabel {
    /// Measured on a real bench.
    Measured,
    /// Measured on a virtual rig.
    Virtual,
}

impl From<RigLabel> for Label {
    fn from(label: RigLabel) -> Self {
        match label {
            RigLabel::Measured => Self::Measured,
            RigLabel::Virtual => Self::Virtual,
        }
    }
}

/// Law of the helical slots: radius = radius at zero + slope x angle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlotConfig {
    /// Radius at angle 0, mm.
    pub radius_at_zero_mm: f64,
    /// Slope, mm/deg.
    pub mm_per_deg: f64,
    /// Range of radii that the slots allow, mm.
    pub radius_mm: [f64; 2],
    /// Backlash of the slots, mm: every radius is approached from below by at least this.
    pub backlash_mm: f64,
}

impl SlotConfig {
    /// Angle that produces a radius, degrees.
    pub fn angle_deg(&self, radius_mm: f64) -> f64 {
        (radius_mm - self.radius_at_zero_mm) / self.mm_per_deg
    }

    /// Radius at an angle, mm.
    pub fn radius_mm(&self, angle_deg: f64) -> f64 {
        self.radius_at_zero_mm + self.mm_per_deg * angle_deg
    }
}

/// Position of the skin on the stage, and the range in which its surface is searched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinPlacement {
    /// Machine x of the corner of the skin, mm.
    pub origin_x_mm: f64,
    /// Machine y of the corner of the skin, mm.
    pub origin_y_mm: f64,
    /// Range of machine z in which the touch-off must find the surface, mm.
    pub surface_z_mm: [f64; 2],
    /// Machine z at which the surface is expected, mm; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_z_mm: Option<f64>,
    /// Distance below the expected surface (entered, or found at an earlier place) within which it
    /// is searched, and below the first touch within which later touches are accepted, mm.
    #[serde(default = "default_search_below_mm")]
    pub search_below_mm: f64,
    /// Clearance to the surface in lateral and radial motion, mm.
    pub clearance_mm: f64,
}

impl RigConfig {
    /// Parses and checks the text of a rig file. `file` is its name in the problems.
    ///
    /// # Errors
    /// All problems of the text or, if it has none, of its values.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let config: Self = parse_toml(file, text)?;
        config.check(file)?;
        Ok(config)
    }

    /// Approach speed that keeps the force increase between sample and stop within the margin,
    /// mm/s: speed x (update + poll) x stiffness <= margin, at most the travelling speed of z.
    pub fn approach_speed_mm_s(&self) -> f64 {
        let blind_s = (self.cells.update_ms + 20.0) / 1e3;
        let speed = self.limits.force_margin_n / (self.limits.stiffness_n_per_mm * blind_s);
        speed.min(self.axes.z.speed_mm_s)
    }

    /// Longest time without a fresh sample of cells and positions in a motion and while pressing, wall ms. By default
    /// one reply may be lost, also in a lateral motion, which reads each axis and the cells: the longest wait for it, and
    /// three updates of the cells, at least 300 ms, for its repetition and the other readings.
    pub fn sample_age_ms(&self) -> u64 {
        let wait_ms = self.lines.values().map(LineConfig::timeout_ms).max().unwrap_or(0);
        let updates_ms = 3.0 * self.cells.update_ms / self.clock_rate;
        self.limits.sample_age_ms.unwrap_or(wait_ms + updates_ms.clamp(300.0, 1e6) as u64)
    }

    fn check(&self, file: &str) -> Result<(), Vec<Problem>> {
        let mut c = Checks::of(file);
        match self.label {
            RigLabel::Virtual => c.within("clock_rate", self.clock_rate, 0.01..=2000.0),
            // Polls, deadlines and stopping distances use process time, and a real axis moves in wall time.
            RigLabel::Measured => {
                let limit = "must be 1 on a bench (label = \"measured\")";
                c.require(self.clock_rate == 1.0, "clock_rate", self.clock_rate, limit);
            }
        }
        for (name, line) in &self.lines {
            line.check(name, &mut c);
        }
        self.axes.check(&self.lines, &mut c);
        let known = self.lines.contains_key(&self.cells.line);
        c.require(known, "cells.line", &self.cells.line, "must be one of [lines]");
        self.cells.check(&mut c);
        self.check_shared(&mut c);
        let (low, high) = (self.slot.radius_mm[0], self.slot.radius_mm[1]);
        let (ok, shown) = (low > 0.0 && low < high, format!("[{low}, {high}]"));
        c.require(ok, "slot.radius_mm", shown, "must be [lower, upper], positive");
        let slope = self.slot.mm_per_deg;
        let ok = (1e-3..=1000.0).contains(&slope.abs());
        c.require(ok, "slot.mm_per_deg", slope, "must be from 0.001 to 1000, or its negative");
        c.within("slot.backlash_mm", self.slot.backlash_mm, 0.0..=20.0);
        let [deg_min, deg_max] = self.axes.radial.travel_deg;
        for r in self.slot.radius_mm {
            let a = self.slot.angle_deg(r);
            let limit = format!("needs {a:.2} deg, outside axes.radial.travel_deg");
            c.require((deg_min..=deg_max).contains(&a), "slot.radius_mm", r, &limit);
        }
        c.within("skin.origin_x_mm", self.skin.origin_x_mm, -1e4..=1e4);
        c.within("skin.origin_y_mm", self.skin.origin_y_mm, -1e4..=1e4);
        let [top, bottom] = self.skin.surface_z_mm;
        let z = self.axes.z.travel_mm;
        let ok = z[0] <= top - self.skin.clearance_mm && top < bottom && bottom <= z[1];
        let limit = "must be [lower, upper] within axes.z.travel_mm, with clearance_mm above";
        c.require(ok, "skin.surface_z_mm", format!("[{top}, {bottom}]"), limit);
        c.within("skin.search_below_mm", self.skin.search_below_mm, 0.5..=20.0);
        if let Some(expected) = self.skin.expected_z_mm {
            c.within("skin.expected_z_mm", expected, top..=bottom);
        }
        c.within("skin.clearance_mm", self.skin.clearance_mm, 0.5..=100.0);
        // With the distance that z may sink during a lateral motion the tips still are above the skin.
        let most = self.skin.clearance_mm / 2.0;
        let tolerance = self.axes.z.tolerance_mm;
        let limit = format!("must be at most {most}, half of skin.clearance_mm");
        c.require(tolerance <= most, "axes.z.tolerance_mm", tolerance, &limit);
        self.limits.check(&mut c, self.cells.full_scale_n);
        let age_ms = self.sample_age_ms();
        // With an invalid clock rate its default has no meaning.
        let ok = self.clock_rate <= 0.0 || (20..=5000).contains(&age_ms);
        c.require(ok, "limits.sample_age_ms", age_ms, "must be from 20 to 5000");
        self.ert.check(&mut c);
        c.done()
    }

    /// Checks that no two devices have one address, since what is sent to one would also reach the other, and that no
    /// serial port is named twice.
    fn check_shared(&self, c: &mut Checks<'_>) {
        let axes = &self.axes;
        let devices = [
            ("axes.x", &axes.x.line, axes.x.unit),
            ("axes.y", &axes.y.line, axes.y.unit),
            ("axes.z", &axes.z.line, axes.z.unit),
            ("axes.radial", &axes.radial.line, axes.radial.unit),
            ("cells", &self.cells.line, self.cells.unit),
        ];
        let devices = devices
            .map(|(device, line, unit)| (device, self.lines.get(line).map(LineConfig::port), unit));
        for (n, (device, port, unit)) in devices.iter().enumerate() {
            let earlier = devices[..n].iter();
            let same = earlier.filter(|(_, p, u)| port.is_some() && (p, u) == (port, unit));
            for (other, ..) in same {
                let limit = format!("must not be that of {other}, which is on the same wire");
                c.require(false, &format!("{device}.unit"), unit, &limit);
            }
        }
        let mut serial: Vec<&str> = self.ert.serial_path().into_iter().collect();
        for (name, line) in &self.lines {
            if let LineConfig::ModbusRtu { path, .. } = line {
                let ok = !serial.contains(&path.as_str());
                let limit = "must not be that of another line or of [ert]";
                c.require(ok, &format!("lines.{name}.path"), path, limit);
                serial.push(path);
            }
        }
    }
}

pub(super) fn one() -> f64 {
    1.0
}

fn default_search_below_mm() -> f64 {
    4.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_may_be_as_old_as_one_lost_reply_makes_it() {
        let text = include_str!("../../../experiments/rigs/iai-modbus-tcp.toml");
        let mut rig = RigConfig::from_toml("r.toml", text).unwrap();
        assert_eq!(rig.sample_age_ms(), 600, "300 ms of a wire and three updates of 100 ms");
        rig.cells.update_ms = 250.0;
        assert_eq!(rig.sample_age_ms(), 1050);
        rig.cells.update_ms = 10.0;
        assert_eq!(rig.sample_age_ms(), 600);
        rig.limits.sample_age_ms = Some(120);
        assert_eq!(rig.sample_age_ms(), 120);
    }

    #[test]
    fn two_devices_have_no_common_address_and_two_wires_no_common_port() {
        let tcp = include_str!("../../../experiments/rigs/virtual.toml");
        let rtu = include_str!("../../../experiments/rigs/leadshine-rtu.toml");
        for (text, from, to, words) in [
            (tcp, "unit = 2", "unit = 1", "axes.y.unit = 1: must not be that of axes.x"),
            (tcp, "unit = 4", "unit = 3", "axes.radial.unit = 3: must not be that of axes.z"),
            // The module of the cells, through the gateway of the stage.
            (tcp, ":5021", ":5020", "cells.unit = 1: must not be that of axes.x"),
            (
                rtu,
                "usb-skin-readout",
                "usb-stage-rs485",
                "lines.stage.path = /dev/serial/by-id/usb-stage-rs485: must not be that of another",
            ),
        ] {
            assert!(text.contains(from), "{from}");
            let problems = RigConfig::from_toml("r.toml", &text.replacen(from, to, 1)).unwrap_err();
            assert_eq!(problems.len(), 1, "{problems:?}");
            assert!(
                problems[0].to_string().starts_with(&format!("r.toml: {words}")),
                "{problems:?}"
            );
        }
    }

    #[test]
    fn a_silence_that_would_delay_a_stop_is_refused() {
        let text = include_str!("../../../experiments/rigs/leadshine-rtu.toml");
        let parsed = |silence_us: u64| {
            let text = text.replacen("baud = ", &format!("silence_us = {silence_us}\nbaud = "), 1);
            RigConfig::from_toml("r.toml", &text).map_err(|problems| problems[0].to_string())
        };
        assert!(parsed(100_000).is_ok());
        assert_eq!(
            parsed(5_000_000).unwrap_err(),
            "r.toml: lines.cells.silence_us = 5000000: must be at most 100000"
        );
    }

    #[test]
    fn a_value_that_would_disable_a_check_of_a_motion_is_refused() {
        let text = include_str!("../../../experiments/rigs/virtual.toml");
        for (from, to, words) in [
            ("clock_rate = 1.0", "clock_rate = 0.0", "clock_rate = 0: must be from 0.01 to 2000"),
            (
                "label = \"virtual\"\nclock_rate = 1.0",
                "label = \"measured\"\nclock_rate = 0.1",
                "clock_rate = 0.1: must be 1 on a bench",
            ),
            (
                "tolerance_mm = 0.02",
                "tolerance_mm = 2.6",
                "axes.z.tolerance_mm = 2.6: must be at most",
            ),
            (
                "sample_age_ms = 1500",
                "sample_age_ms = 60000",
                "limits.sample_age_ms = 60000: must be",
            ),
            ("mm_per_deg = 1.0", "mm_per_deg = inf", "slot.mm_per_deg = inf: must be from 0.001"),
            ("mm_per_deg = 1.0", "mm_per_deg = nan", "slot.mm_per_deg = NaN: must be from 0.001"),
            ("backlash_mm = 0.3", "backlash_mm = nan", "slot.backlash_mm = NaN: must be from 0"),
            ("backlash_mm = 0.3", "backlash_mm = -0.3", "slot.backlash_mm = -0.3: must be from 0"),
            ("backlash_mm = 0.3", "backlash_mm = 1e6", "slot.backlash_mm = 1000000: must be from"),
            ("origin_x_mm = 10.0", "origin_x_mm = nan", "skin.origin_x_mm = NaN: must be from"),
            ("origin_y_mm = 10.0", "origin_y_mm = -inf", "skin.origin_y_mm = -inf: must be from"),
            (
                "force_noise_n = 0.1",
                "force_noise_n = 30.0",
                "cells.force_noise_n = 30: must be from",
            ),
        ] {
            assert!(text.contains(from), "{from}");
            let problems = RigConfig::from_toml("r.toml", &text.replacen(from, to, 1)).unwrap_err();
            assert!(
                problems[0].to_string().starts_with(&format!("r.toml: {words}")),
                "{problems:?}"
            );
        }
    }
}
