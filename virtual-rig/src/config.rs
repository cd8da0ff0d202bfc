//! The parts of a rig file that the virtual rig needs: wires, devices, geometry. Written only for
//! this crate; keys that only the service needs are ignored.
//! Uses: serde, toml, `device`. Never: the service's types, ports, clocks.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::device::{AxisDevice, CellsDevice};

/// Number of arms of the indenter (paper II-B).
pub const ARMS: usize = 6;

/// Error in a rig file, as far as the virtual rig reads it.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ConfigError {
    #[error("rig file: {0}")]
    Syntax(#[from] toml::de::Error),
    #[error("{device}.line = {line}: must be one of [lines]")]
    UnknownLine { device: String, line: String },
    #[error("{first} and {second} share unit {unit} on line {line}")]
    SharedUnit { first: String, second: String, line: String, unit: u8 },
    #[error("{key} = {value}: {limit}")]
    Value { key: String, value: String, limit: &'static str },
}

/// Sections that only a bench has.
const OF_A_BENCH: [&str; 5] = ["lines", "axes", "slot", "skin", "cells"];

/// What stands in for the bench of a file that describes a skin alone: no wire leads to it, its tips stay
/// up.
const BARE: &str = include_str!("bare_bench.toml");

/// Contents of a rig file, as far as the virtual rig needs them.
#[derive(Debug, Clone, Deserialize)]
pub struct RigFile {
    /// Process seconds per wall second; the command line can override it.
    #[serde(default = "one")]
    pub clock_rate: f64,
    /// Wires by name; none for a skin alone.
    #[serde(default)]
    pub lines: BTreeMap<String, Line>,
    /// The four actuators.
    pub axes: Axes,
    /// Law of the slots of the rotary actuator.
    pub slot: Slot,
    /// Position of the skin on the stage.
    pub skin: Placement,
    /// Module of the load cells.
    pub cells: Cells,
    /// The voltage stream.
    pub ert: Ert,
}

/// One Modbus wire.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Line {
    /// Modbus TCP: the rig listens at an address.
    ModbusTcp {
        /// `host:port`.
        address: String,
    },
    /// Modbus RTU: the rig serves a pseudo-terminal.
    ModbusRtu {
        /// Path of the serial device.
        path: String,
    },
}

/// The four actuators.
#[derive(Debug, Clone, Deserialize)]
pub struct Axes {
    /// Stage axis along the width of the skin.
    pub x: AxisFile,
    /// Stage axis along the height of the skin.
    pub y: AxisFile,
    /// Stage axis toward the skin, positive downward.
    pub z: AxisFile,
    /// The rotary actuator.
    pub radial: AxisFile,
}

/// An axis in its own unit: mm, or degrees for the rotary one.
#[derive(Debug, Clone, Deserialize)]
pub struct AxisFile {
    /// Register map of the drive.
    pub device: AxisDevice,
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the drive.
    pub unit: u8,
    /// Device counts per unit.
    #[serde(alias = "counts_per_mm", alias = "counts_per_deg")]
    pub counts_per_unit: f64,
    /// Travel, lower and upper end, units.
    #[serde(alias = "travel_mm", alias = "travel_deg")]
    pub travel: [f64; 2],
    /// Travelling speed, units/s.
    #[serde(alias = "speed_mm_s", alias = "speed_deg_s")]
    pub speed: f64,
    /// Acceleration, units/s^2.
    #[serde(alias = "acceleration_mm_s2", alias = "acceleration_deg_s2")]
    pub acceleration: f64,
}

/// Law of the slots with backlash: radius = radius at zero + slope x angle.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct Slot {
    /// Radius at angle 0, mm.
    pub radius_at_zero_mm: f64,
    /// Slope, mm/deg.
    pub mm_per_deg: f64,
    /// Slack of the slot, mm of radius.
    pub backlash_mm: f64,
}

/// Position of the skin on the stage.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct Placement {
    /// Machine x of the corner of the skin, mm.
    pub origin_x_mm: f64,
    /// Machine y of the corner of the skin, mm.
    pub origin_y_mm: f64,
    /// Range of machine z that contains the surface, mm.
    pub surface_z_mm: [f64; 2],
}

/// Module of the load cells.
#[derive(Debug, Clone, Deserialize)]
pub struct Cells {
    /// Register map of the module.
    pub device: CellsDevice,
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the module.
    pub unit: u8,
    /// Input channels of arms 1 to 6.
    pub channels: [u8; ARMS],
    /// Update period, process ms.
    pub update_ms: f64,
    /// Supply voltage of the ratiometric cells, V.
    pub supply_v: f64,
    /// Full scale of a cell, N.
    pub full_scale_n: f64,
}

/// The voltage stream.
#[derive(Debug, Clone, Deserialize)]
pub struct Ert {
    /// Its connection.
    #[serde(flatten)]
    pub port: ErtPort,
    /// Number of electrodes in a packet.
    pub electrodes: u16,
    /// Frames per process second.
    pub frame_rate_hz: f64,
}

/// Connection of the voltage stream.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ErtPort {
    /// TCP listener of a serial server.
    Tcp {
        /// `host:port`.
        address: String,
    },
    /// Serial line: the rig serves a pseudo-terminal.
    Serial {
        /// Path of the serial device.
        path: String,
    },
}

/// The axes in index order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AxisName {
    /// Stage axis along the width of the skin.
    X,
    /// Stage axis along the height of the skin.
    Y,
    /// Stage axis toward the skin, positive downward.
    Z,
    /// Rotary actuator of the slots.
    Radial,
}

impl AxisName {
    /// All four axes, in index order.
    pub const ALL: [AxisName; 4] = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::Radial];

    /// Index in [`AxisName::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// Name of the axis, as in rig files and fault scripts.
    pub fn as_str(self) -> &'static str {
        match self {
            AxisName::X => "x",
            AxisName::Y => "y",
            AxisName::Z => "z",
            AxisName::Radial => "radial",
        }
    }
}

/// A Modbus device of a rig file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Device<'a> {
    /// Dotted key in the rig file.
    pub key: String,
    /// Name of its wire.
    pub line: &'a str,
    /// Modbus address of the device on its wire.
    pub unit: u8,
}

impl RigFile {
    /// Parses the text of a rig file and checks the values that the virtual rig needs.
    ///
    /// # Errors
    /// `ConfigError` for the first problem.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let mut table: toml::Table = toml::from_str(text)?;
        if OF_A_BENCH.iter().all(|key| !table.contains_key(*key)) {
            let bare: toml::Table = toml::from_str(BARE)?;
            table.extend(bare);
        }
        let file: Self = table.try_into()?;
        file.check()?;
        Ok(file)
    }

    /// Settings of one axis.
    pub fn axis(&self, name: AxisName) -> &AxisFile {
        match name {
            AxisName::X => &self.axes.x,
            AxisName::Y => &self.axes.y,
            AxisName::Z => &self.axes.z,
            AxisName::Radial => &self.axes.radial,
        }
    }

    /// All Modbus devices.
    pub fn devices(&self) -> Vec<Device<'_>> {
        if self.lines.is_empty() {
            return Vec::new();
        }
        let axis = |&name: &AxisName| {
            let axis = self.axis(name);
            Device { key: format!("axes.{}", name.as_str()), line: &axis.line, unit: axis.unit }
        };
        let mut devices: Vec<Device<'_>> = AxisName::ALL.iter().map(axis).collect();
        let cells = &self.cells;
        devices.push(Device { key: "cells".into(), line: &cells.line, unit: cells.unit });
        devices
    }

    fn check(&self) -> Result<(), ConfigError> {
        let devices = self.devices();
        for (i, Device { key, line, unit }) in devices.iter().enumerate() {
            if !self.lines.contains_key(*line) {
                let (device, line) = (key.clone(), (*line).to_owned());
                return Err(ConfigError::UnknownLine { device, line });
            }
            if let Some(first) = devices[..i].iter().find(|d| d.line == *line && d.unit == *unit) {
                return Err(ConfigError::SharedUnit {
                    first: first.key.clone(),
                    second: key.clone(),
                    line: (*line).to_owned(),
                    unit: *unit,
                });
            }
        }
        positive("clock_rate", self.clock_rate)?;
        positive("ert.frame_rate_hz", self.ert.frame_rate_hz)?;
        positive("cells.update_ms", self.cells.update_ms)?;
        positive("cells.supply_v", self.cells.supply_v)?;
        positive("cells.full_scale_n", self.cells.full_scale_n)?;
        for name in AxisName::ALL {
            let (axis, key) = (self.axis(name), name.as_str());
            positive(&format!("axes.{key}.counts"), axis.counts_per_unit)?;
            positive(&format!("axes.{key}.speed"), axis.speed)?;
            positive(&format!("axes.{key}.acceleration"), axis.acceleration)?;
            let [lower, upper] = axis.travel;
            let shown = format!("[{lower}, {upper}]");
            require(lower < upper, &format!("axes.{key}.travel"), shown, "must be [lower, upper]")?;
        }
        let [top, bottom] = self.skin.surface_z_mm;
        let shown = format!("[{top}, {bottom}]");
        require(top < bottom, "skin.surface_z_mm", shown, "must be [lower, upper]")?;
        for channel in self.cells.channels {
            require(channel < 8, "cells.channels", channel.to_string(), "must be 0 to 7")?;
        }
        Ok(())
    }
}

fn require(ok: bool, key: &str, value: String, limit: &'static str) -> Result<(), ConfigError> {
    if ok { Ok(()) } else { Err(ConfigError::Value { key: key.into(), value, limit }) }
}

fn positive(key: &str, value: f64) -> Result<(), ConfigError> {
    let ok = value.is_finite() && value > 0.0;
    require(ok, key, value.to_string(), "must be a positive number")
}

fn one() -> f64 {
    1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIRTUAL: &str = include_str!("../../experiments/rigs/virtual.toml");

    #[test]
    fn the_default_rig_file_is_read() {
        let file = RigFile::from_toml(VIRTUAL).unwrap();
        assert_eq!(file.axes.radial.counts_per_unit, 100.0);
        assert_eq!(file.devices().len(), 5);
    }

    #[test]
    fn a_skin_alone_has_no_devices() {
        let text = include_str!("../../experiments/rigs/skin-only.toml");
        let file = RigFile::from_toml(text).unwrap();
        assert!(file.devices().is_empty() && file.lines.is_empty());
        assert_eq!(file.ert.electrodes, 28);
    }

    #[test]
    fn two_devices_at_one_address_and_a_missing_line_are_refused() {
        for (from, to, words) in [
            ("unit = 2", "unit = 1", "axes.x and axes.y share unit 1 on line stage"),
            ("\"cells\"", "\"celsl\"", "cells.line = celsl: must be one of [lines]"),
        ] {
            let error = RigFile::from_toml(&VIRTUAL.replacen(from, to, 1)).unwrap_err();
            assert_eq!(error.to_string(), words);
        }
    }
}
