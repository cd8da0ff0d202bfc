//! A supported device: its name in rig files, what a rig file may set in it, and its driver. The
//! file of a device describes its own; `drives` and `input_modules` list all of them, and find the one that a rig
//! file names.
//! Uses: `problem`, `guard`, `profile`, `station`, `link`, `traits`. Never: the name of a device, requests, ports.

use std::fmt;
use std::sync::Arc;

use serde::de::Error;
use serde::ser::{Serialize, Serializer};

use super::guard::Guard;
use super::link::MotionGate;
use super::profile::AxisProfile;
use super::station::Station;
use super::traits::{Axis, LoadCells};
use crate::clock::Clock;
use crate::problem::Checks;
use crate::record::ARMS;

/// What the driver of an axis is built from.
#[derive(Debug)]
pub struct AxisParts {
    /// Name of the axis, as in rig files.
    pub name: &'static str,
    /// Its drive, at its address on a wire.
    pub station: Station,
    /// Settings of the axis.
    pub profile: AxisProfile,
    /// Permits of its motions.
    pub gate: MotionGate,
    /// Clock of the rig.
    pub clock: Clock,
}

/// A supported drive.
#[derive(Clone, Copy)]
pub struct AxisDevice {
    name: &'static str,
    has_guards: bool,
    acceleration: fn(f64) -> f64,
    open: fn(AxisParts) -> Arc<dyn Axis>,
}

impl AxisDevice {
    /// Describes a drive without guards: its name in rig files, and how its driver is created.
    pub const fn new(name: &'static str, open: fn(AxisParts) -> Arc<dyn Axis>) -> Self {
        Self { name, has_guards: false, acceleration: std::convert::identity, open }
    }

    /// The same drive, which rounds accelerations, counts/s^2, in this way.
    pub const fn with_acceleration(self, acceleration: fn(f64) -> f64) -> Self {
        Self { acceleration, ..self }
    }

    /// The same drive, with a communication watchdog and a torque limit that can be set.
    pub const fn with_guards(self) -> Self {
        Self { has_guards: true, ..self }
    }

    /// Name of the device, as in rig files.
    pub const fn as_str(self) -> &'static str {
        self.name
    }

    /// Acceleration at which the drive moves and stops if this one is requested, counts/s^2.
    pub fn acceleration(self, requested: f64) -> f64 {
        (self.acceleration)(requested)
    }

    /// Checks the values of a guard, and that the drive supports them. `key` builds a dotted key.
    pub(super) fn check_guard(
        self,
        guard: &Guard,
        key: impl Fn(&str) -> String,
        c: &mut Checks<'_>,
    ) {
        let lacks = |what: &str| {
            format!("{} has no {what} that can be set over its wire: remove it", self.as_str())
        };
        let has = self.has_guards;
        if let Some(ms) = guard.watchdog_ms {
            let key = key("guard.watchdog_ms");
            c.require(has, &key, ms, &lacks("communication watchdog"));
            c.require((100..=10_000).contains(&ms), &key, ms, "must be from 100 to 10000");
        }
        if let Some(percent) = guard.torque_percent {
            let key = key("guard.torque_percent");
            c.require(has, &key, percent, &lacks("torque limit"));
            c.require((5..=100).contains(&percent), &key, percent, "must be from 5 to 100");
        }
    }

    /// Creates the driver of an axis; sends nothing.
    pub fn open(self, parts: AxisParts) -> Arc<dyn Axis> {
        (self.open)(parts)
    }
}

/// What the driver of the load cells is built from.
#[derive(Debug)]
pub struct CellsParts {
    /// Their module, at its address on a wire.
    pub station: Station,
    /// Input channels of arms 1 to 6.
    pub channels: [u8; ARMS],
    /// Actual update period of the module, process ms.
    pub update_ms: f64,
    /// Full output of a cell, V.
    pub full_output_v: f64,
    /// Clock of the rig.
    pub clock: Clock,
}

/// A supported analog input module.
#[derive(Clone, Copy)]
pub struct CellsDevice {
    name: &'static str,
    repeats_max: u32,
    open: fn(CellsParts) -> Arc<dyn LoadCells>,
}

impl CellsDevice {
    /// Describes a module: its name in rig files, its longest run of equal values
    /// ([`CellsDevice::repeats_max`]), and how its driver is created.
    pub const fn new(
        name: &'static str,
        repeats_max: u32,
        open: fn(CellsParts) -> Arc<dyn LoadCells>,
    ) -> Self {
        Self { name, repeats_max, open }
    }

    /// Name of the device, as in rig files.
    pub const fn as_str(self) -> &'static str {
        self.name
    }

    /// Longest run of equal values of a working cell, in update periods, above which the module
    /// hangs; derived from the step of the module and the noise of a 25 lbf cell (sd 0.022 N), with
    /// the mean in the middle of a step, where values repeat longest.
    pub const fn repeats_max(self) -> u32 {
        self.repeats_max
    }

    /// Creates the driver of the load cells; sends nothing.
    pub fn open(self, parts: CellsParts) -> Arc<dyn LoadCells> {
        (self.open)(parts)
    }
}

/// The device with a name, of a list.
pub(super) fn by_name<T: Copy, E: Error>(
    found: &str,
    devices: &[T],
    name: fn(T) -> &'static str,
) -> Result<T, E> {
    devices.iter().copied().find(|&device| name(device) == found).ok_or_else(|| {
        let names: Vec<String> = devices.iter().map(|&d| format!("`{}`", name(d))).collect();
        let names = names.join(", ");
        E::custom(format!("unknown device `{found}`, expected one of {names}"))
    })
}

/// Writes, compares and shows devices by their names.
macro_rules! by_its_name {
    ($($device:ty),*) => {$(
        impl Serialize for $device {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name)
            }
        }

        impl PartialEq for $device {
            fn eq(&self, other: &Self) -> bool {
                self.name == other.name
            }
        }

        impl Eq for $device {}

        impl fmt::Debug for $device {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name)
            }
        }
    )*};
}

by_its_name!(AxisDevice, CellsDevice);

#[cfg(test)]
mod tests {
    use crate::rig::config::RigConfig;
    use crate::rig::drives::DRIVES;
    use crate::rig::input_modules::MODULES;

    const FILE: &str = include_str!("../../../experiments/rigs/virtual.toml");

    fn problem(from: &str, to: &str) -> String {
        assert!(FILE.contains(from), "{from}");
        RigConfig::from_toml("r.toml", &FILE.replacen(from, to, 1)).unwrap_err()[0].to_string()
    }

    #[test]
    fn an_unknown_device_is_refused_with_the_names_of_the_supported_ones() {
        let drive = problem("device = \"iai\"", "device = \"iia\"");
        assert!(drive.starts_with("r.toml: axes.x.device = \"iia\": must be one of"), "{drive}");
        let module = problem("device = \"adam_6017\"", "device = \"adam\"");
        assert!(module.starts_with("r.toml: cells.device = \"adam\": must be one of"), "{module}");
        for device in DRIVES {
            assert!(drive.contains(device.as_str()), "{drive}");
        }
        for device in MODULES {
            assert!(module.contains(device.as_str()), "{module}");
        }
    }

    #[test]
    fn a_device_is_written_as_it_is_read() {
        let config = RigConfig::from_toml("r.toml", FILE).unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(RigConfig::from_toml("r.toml", &text).unwrap(), config);
        assert!(text.contains("device = \"iai\"") && text.contains("device = \"adam_6017\""));
    }
}
