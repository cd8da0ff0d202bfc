//! The rig file: which device is connected to which wire at which address, how far and how fast it
//! may move, and the limits that trip it. It is parsed and checked here; nothing is opened.
//! PURE. Uses: `problem`, `cells`, `device`, `guard`, `limits`. Never: ports, files (the text is passed in).
//!
//! Machine coordinates: x and y increase along the stage, z increases downward from the raised home
//! position 0. The slot converts the angle of the rotary actuator to a radius.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use super::cells::CellsConfig;
pub use super::device::{AxisDevice, CellsDevice};
pub use super::guard::Guard;
pub use super::limits::RigLimits;
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

/// Connection of one Modbus wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LineConfig {
    /// Modbus TCP connection.
    ModbusTcp {
        /// `host:port`.
        address: String,
        /// Longest wait for one reply, wall ms.
        #[serde(default = "default_timeout_ms")]
        timeout_ms: u64,
        /// Consecutive failed attempts of a request after which the rig trips, 1 to 10.
        #[serde(default = "default_retries")]
        retries: u32,
    },
    /// Modbus RTU on a serial port, shared by several addresses.
    ModbusRtu {
        /// Path of the serial device.
        path: String,
        /// Baud rate, bits per second.
        baud: u32,
        /// Parity: `none`, `even` or `odd`.
        #[serde(default)]
        parity: Parity,
        /// Silence between a reply and the next request, wall us. Absent: the standard value of 3.5
        /// characters, or 1750 us above 19200 baud.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        silence_us: Option<u64>,
        /// Longest wait for one reply, wall ms.
        #[serde(default = "default_timeout_ms")]
        timeout_ms: u64,
        /// Consecutive failed attempts of a request after which the rig trips, 1 to 10.
        #[serde(default = "default_retries")]
        retries: u32,
    },
}

/// Parity of a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    /// No parity, 8N1.
    #[default]
    None,
    /// Even parity, 8E1.
    Even,
    /// Odd parity, 8O1.
    Odd,
}

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

/// Settings of an axis in its own unit (mm or degrees), for its driver.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisProfile {
    /// Register map of the drive.
    pub device: AxisDevice,
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the drive.
    pub address: u8,
    /// Device counts per unit.
    pub counts_per_unit: f64,
    /// Soft limits, units.
    pub travel: [f64; 2],
    /// Travelling speed, units/s.
    pub speed: f64,
    /// Acceleration, units/s^2.
    pub acceleration: f64,
    /// Distance from the target that counts as arrived, units.
    pub tolerance: f64,
    /// Guards of the drive.
    pub guard: Guard,
}

impl LinearAxis {
    /// Settings in the axis's unit, millimetres.
    pub fn profile(&self) -> AxisProfile {
        AxisProfile {
            device: self.device,
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
            device: self.device,
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

/// Connection of the voltage stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ErtConfig {
    /// TCP connection to a serial server.
    Tcp {
        /// `host:port`.
        address: String,
        /// Number of electrodes; packets with another number are rejected.
        electrodes: u16,
        /// Frames per process second.
        frame_rate_hz: f64,
    },
    /// Serial port.
    Serial {
        /// Path of the serial device.
        path: String,
        /// Baud rate, bits per second.
        baud: u32,
        /// Number of electrodes; packets with another number are rejected.
        electrodes: u16,
        /// Frames per process second.
        frame_rate_hz: f64,
    },
}

impl ErtConfig {
    /// Number of electrodes; packets with another number are rejected.
    pub fn electrodes(&self) -> u16 {
        match self {
            ErtConfig::Tcp { electrodes, .. } | ErtConfig::Serial { electrodes, .. } => *electrodes,
        }
    }

    /// Frames per process second.
    pub fn frame_rate_hz(&self) -> f64 {
        match self {
            ErtConfig::Tcp { frame_rate_hz, .. } | ErtConfig::Serial { frame_rate_hz, .. } => {
                *frame_rate_hz
            }
        }
    }

    /// Checks rate and electrodes.
    pub(super) fn check(&self, c: &mut Checks<'_>) {
        c.within("ert.frame_rate_hz", self.frame_rate_hz(), 0.1..=1000.0);
        let electrodes = self.electrodes();
        let ok = (2..=64).contains(&electrodes);
        c.require(ok, "ert.electrodes", electrodes, "must be 2 to 64");
    }
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

    fn check_lines(&self, c: &mut Checks<'_>) {
        for (name, line) in &self.lines {
            let key = |k: &str| format!("lines.{name}.{k}");
            let (timeout_ms, retries) = match line {
                LineConfig::ModbusTcp { timeout_ms, retries, .. } => (*timeout_ms, *retries),
                LineConfig::ModbusRtu { baud, timeout_ms, retries, .. } => {
                    let ok = (1200..=4_000_000).contains(baud);
                    c.require(ok, &key("baud"), baud, "must be from 1200 to 4000000");
                    (*timeout_ms, *retries)
                }
            };
            let ok = (5..=10_000).contains(&timeout_ms);
            c.require(ok, &key("timeout_ms"), timeout_ms, "must be from 5 to 10000");
            c.require((1..=10).contains(&retries), &key("retries"), retries, "must be 1 to 10");
        }
    }

    fn check(&self, file: &str) -> Result<(), Vec<Problem>> {
        let mut c = Checks::of(file);
        c.within("clock_rate", self.clock_rate, 0.01..=2000.0);
        self.check_lines(&mut c);
        let profiles = [
            ("x", "mm", self.axes.x.profile()),
            ("y", "mm", self.axes.y.profile()),
            ("z", "mm", self.axes.z.profile()),
            ("radial", "deg", self.axes.radial.profile()),
        ];
        for (name, unit, p) in &profiles {
            let key = |k: &str| format!("axes.{name}.{}", k.replace('*', unit));
            let known = self.lines.contains_key(&p.line);
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
            p.guard.check(p.device, key, &mut c);
        }
        let known = self.lines.contains_key(&self.cells.line);
        c.require(known, "cells.line", &self.cells.line, "must be one of [lines]");
        self.cells.check(&mut c);
        let (low, high) = (self.slot.radius_mm[0], self.slot.radius_mm[1]);
        c.require(
            low > 0.0 && low < high,
            "slot.radius_mm",
            format!("[{low}, {high}]"),
            "must be [lower, upper], positive",
        );
        c.require(
            self.slot.mm_per_deg != 0.0,
            "slot.mm_per_deg",
            self.slot.mm_per_deg,
            "must not be 0",
        );
        let [deg_min, deg_max] = self.axes.radial.travel_deg;
        for r in self.slot.radius_mm {
            let a = self.slot.angle_deg(r);
            let limit = format!("needs {a:.2} deg, outside axes.radial.travel_deg");
            c.require((deg_min..=deg_max).contains(&a), "slot.radius_mm", r, &limit);
        }
        let [top, bottom] = self.skin.surface_z_mm;
        let z = self.axes.z.travel_mm;
        c.require(
            z[0] <= top - self.skin.clearance_mm && top < bottom && bottom <= z[1],
            "skin.surface_z_mm",
            format!("[{top}, {bottom}]"),
            "must be [lower, upper] within axes.z.travel_mm, with clearance_mm above",
        );
        c.within("skin.search_below_mm", self.skin.search_below_mm, 0.5..=20.0);
        if let Some(expected) = self.skin.expected_z_mm {
            c.within("skin.expected_z_mm", expected, top..=bottom);
        }
        c.within("skin.clearance_mm", self.skin.clearance_mm, 0.5..=100.0);
        self.limits.check(&mut c, self.cells.full_scale_n);
        self.ert.check(&mut c);
        c.done()
    }
}

pub(super) fn one() -> f64 {
    1.0
}

fn default_search_below_mm() -> f64 {
    4.0
}

fn default_timeout_ms() -> u64 {
    300
}

fn default_retries() -> u32 {
    3
}
