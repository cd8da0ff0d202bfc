//! What the virtual rig takes from a rig file: wires, devices, geometry. Written for this crate
//! alone and read loosely: keys that only the service needs are ignored.
//! Uses: serde, toml. Never: the service's own types, ports, clocks.

use std::collections::BTreeMap;

use serde::Deserialize;

/// Number of arms of the indenter (paper II-B).
pub const ARMS: usize = 6;

/// What is wrong with a rig file, seen from the rig's side.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The text is not TOML or lacks a key.
    #[error("rig file: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A device names a wire that the file does not have.
    #[error("{device}.line = {line}: must be one of [lines]")]
    UnknownLine {
        /// Key of the device.
        device: String,
        /// Wire it names.
        line: String,
    },
    /// Two devices answer to one address on one wire.
    #[error("{first} and {second} share unit {unit} on line {line}")]
    SharedUnit {
        /// The one device.
        first: String,
        /// The other.
        second: String,
        /// Their wire.
        line: String,
        /// Their address.
        unit: u8,
    },
    /// A value that no bench could have.
    #[error("{key} = {value}: {limit}")]
    Value {
        /// Dotted key.
        key: String,
        /// The value found.
        value: String,
        /// What is allowed.
        limit: &'static str,
    },
}

/// The rig file, as far as the stand-in needs it.
#[derive(Debug, Clone, Deserialize)]
pub struct RigFile {
    /// Process seconds in a wall second, unless the command line says otherwise.
    #[serde(default = "one")]
    pub clock_rate: f64,
    /// Wires by name.
    pub lines: BTreeMap<String, Line>,
    /// The four actuators.
    pub axes: Axes,
    /// Law of the rotary actuator's slot.
    pub slot: Slot,
    /// Where the skin lies on the stage.
    pub skin: Placement,
    /// The load cells' module.
    pub cells: Cells,
    /// The voltage stream.
    pub ert: Ert,
}

/// One Modbus wire.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Line {
    /// A TCP listener.
    ModbusTcp {
        /// `host:port`.
        address: String,
    },
    /// A pseudo-terminal.
    ModbusRtu {
        /// Device path.
        path: String,
    },
}

/// The four actuators.
#[derive(Debug, Clone, Deserialize)]
pub struct Axes {
    /// Along the skin's width.
    pub x: AxisFile,
    /// Along the skin's height.
    pub y: AxisFile,
    /// Downward.
    pub z: AxisFile,
    /// The rotary actuator.
    pub radial: AxisFile,
}

/// An axis in its own unit: mm, or degrees for the rotary one.
#[derive(Debug, Clone, Deserialize)]
pub struct AxisFile {
    /// Register map.
    pub device: AxisDevice,
    /// Wire.
    pub line: String,
    /// Modbus address.
    pub unit: u8,
    /// Device counts in one unit.
    #[serde(alias = "counts_per_mm", alias = "counts_per_deg")]
    pub counts_per_unit: f64,
    /// Travel, lower and upper end.
    #[serde(alias = "travel_mm", alias = "travel_deg")]
    pub travel: [f64; 2],
    /// Travelling speed, units/s.
    #[serde(alias = "speed_mm_s", alias = "speed_deg_s")]
    pub speed: f64,
    /// Acceleration, units/s^2.
    #[serde(alias = "acceleration_mm_s2", alias = "acceleration_deg_s2")]
    pub acceleration: f64,
}

/// Register maps of axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisDevice {
    /// IAI SCON/PCON.
    Iai,
    /// Oriental Motor AZ.
    OrientalAz,
    /// Leadshine EM2RS.
    LeadshineEm2rs,
}

/// Radius = at zero + slope x angle, with play.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct Slot {
    /// Radius at angle 0, mm.
    pub radius_at_zero_mm: f64,
    /// Slope, mm per degree.
    pub mm_per_deg: f64,
    /// Play, mm.
    pub backlash_mm: f64,
}

/// Where the skin lies.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct Placement {
    /// Machine x of the skin's corner, mm.
    pub origin_x_mm: f64,
    /// Machine y of the skin's corner, mm.
    pub origin_y_mm: f64,
    /// Machine z between which the surface lies, mm.
    pub surface_z_mm: [f64; 2],
}

/// Analog input modules.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CellsDevice {
    /// Advantech ADAM-6017.
    #[serde(rename = "adam_6017")]
    Adam6017,
    /// Waveshare Modbus RTU Analog Input 8CH.
    #[serde(rename = "waveshare_8ch")]
    Waveshare8ch,
}

/// The load cells' module.
#[derive(Debug, Clone, Deserialize)]
pub struct Cells {
    /// Register map.
    pub device: CellsDevice,
    /// Wire.
    pub line: String,
    /// Modbus address.
    pub unit: u8,
    /// Input channel of arms 1 to 6.
    pub channels: [u8; ARMS],
    /// Update period, process ms.
    pub update_ms: f64,
    /// Supply of the ratiometric cells, V.
    pub supply_v: f64,
    /// Full scale of a cell, N.
    pub full_scale_n: f64,
}

/// The wire of the voltage stream.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Ert {
    /// A serial server.
    Tcp {
        /// `host:port`.
        address: String,
        /// Electrodes in a packet.
        electrodes: u16,
        /// Frames a process second.
        frame_rate_hz: f64,
    },
    /// A serial port.
    Serial {
        /// Device path.
        path: String,
        /// Electrodes in a packet.
        electrodes: u16,
        /// Frames a process second.
        frame_rate_hz: f64,
    },
}

impl Ert {
    /// Frames a process second.
    pub fn frame_rate_hz(&self) -> f64 {
        match self {
            Ert::Tcp { frame_rate_hz, .. } | Ert::Serial { frame_rate_hz, .. } => *frame_rate_hz,
        }
    }

    /// Electrodes in a packet.
    pub fn electrodes(&self) -> u16 {
        match self {
            Ert::Tcp { electrodes, .. } | Ert::Serial { electrodes, .. } => *electrodes,
        }
    }
}

/// The axes, in the order in which this crate counts them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AxisName {
    /// Along the skin's width.
    X,
    /// Along the skin's height.
    Y,
    /// Downward.
    Z,
    /// The rotary actuator.
    Radial,
}

impl AxisName {
    /// All four, in index order.
    pub const ALL: [AxisName; 4] = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::Radial];

    /// Index in [`AxisName::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// The axis as rig files and fault scripts write it.
    pub fn as_str(self) -> &'static str {
        match self {
            AxisName::X => "x",
            AxisName::Y => "y",
            AxisName::Z => "z",
            AxisName::Radial => "radial",
        }
    }
}

impl RigFile {
    /// Parses a rig file's text and checks what the stand-in relies on.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let file: Self = toml::from_str(text)?;
        file.check()?;
        Ok(file)
    }

    /// An axis's part of the file.
    pub fn axis(&self, name: AxisName) -> &AxisFile {
        match name {
            AxisName::X => &self.axes.x,
            AxisName::Y => &self.axes.y,
            AxisName::Z => &self.axes.z,
            AxisName::Radial => &self.axes.radial,
        }
    }

    /// Every Modbus device: its key, wire and address.
    pub fn devices(&self) -> Vec<(String, &str, u8)> {
        let mut devices: Vec<(String, &str, u8)> = AxisName::ALL
            .iter()
            .map(|&n| {
                (format!("axes.{}", n.as_str()), self.axis(n).line.as_str(), self.axis(n).unit)
            })
            .collect();
        devices.push(("cells".into(), self.cells.line.as_str(), self.cells.unit));
        devices
    }

    fn check(&self) -> Result<(), ConfigError> {
        let devices = self.devices();
        for (i, (device, line, unit)) in devices.iter().enumerate() {
            if !self.lines.contains_key(*line) {
                let (device, line) = (device.clone(), (*line).to_owned());
                return Err(ConfigError::UnknownLine { device, line });
            }
            if let Some(first) = devices[..i].iter().find(|d| d.1 == *line && d.2 == *unit) {
                return Err(ConfigError::SharedUnit {
                    first: first.0.clone(),
                    second: device.clone(),
                    line: (*line).to_owned(),
                    unit: *unit,
                });
            }
        }
        positive("clock_rate", self.clock_rate)?;
        positive("ert.frame_rate_hz", self.ert.frame_rate_hz())?;
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
    fn two_devices_at_one_address_are_refused() {
        let text = VIRTUAL.replacen("unit = 2", "unit = 1", 1);
        let error = RigFile::from_toml(&text).unwrap_err().to_string();
        assert_eq!(error, "axes.x and axes.y share unit 1 on line stage");
    }

    #[test]
    fn a_missing_line_is_named() {
        let text = VIRTUAL.replacen("line = \"cells\"", "line = \"celsl\"", 1);
        let error = RigFile::from_toml(&text).unwrap_err().to_string();
        assert_eq!(error, "cells.line = celsl: must be one of [lines]");
    }
}
