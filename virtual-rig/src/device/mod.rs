//! The devices of the rig as register maps, written from their documents
//! (`docs/references.md`, "Devices").
//! A map converts requests to actions of a drive or an input module; it has no access to wires.
//! Each map describes its device (`DRIVE` or `MODULE`); `drives` and `input_modules` list them.
//! PURE. Uses: `drive`, `modbus`. Never: sockets, clocks, faults.

pub mod drives;
pub mod input_modules;

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error};

use self::drives::DRIVES;
use self::input_modules::MODULES;
use crate::drive::{Drive, Servo};
use crate::modbus::{Exception, Reply, Request};

/// Number of inputs of an analog module.
pub const INPUTS: usize = 8;

/// Reply of a device to a request, or the exception that it returns.
pub type Answer = Result<Reply, Exception>;

/// The register map of an axis.
pub trait AxisMap: fmt::Debug + Send + Sync {
    /// A copy of the map with its present state.
    fn copy(&self) -> Box<dyn AxisMap>;

    /// Resets the state that a device does not keep without power.
    fn power_cycle(&mut self);

    /// Value of a register at a process time; `None` if the device does not have it.
    fn register(&self, address: u16, drive: &Drive, t_s: f64) -> Option<u16>;

    /// Writes consecutive registers at a process time.
    ///
    /// # Errors
    /// The Modbus exception that the device returns.
    fn write(&mut self, address: u16, values: &[u16], drive: &mut Drive, t_s: f64) -> Answer;

    /// Executes one request at a process time: here that of a device with holding registers alone.
    ///
    /// # Errors
    /// The Modbus exception that the device returns.
    fn serve(&mut self, request: &Request, drive: &mut Drive, t_s: f64) -> Answer {
        serve_registers(self, request, drive, t_s)
    }

    /// Records that a request has reached the device, whatever its result.
    fn hear(&mut self, _t_s: f64) {}

    /// Process time at which the watchdog of the device expires unless a request arrives before, s.
    fn watchdog_s(&self) -> Option<f64> {
        None
    }

    /// Lets an expired watchdog stop the motor; once, until the next request.
    fn watch(&mut self, _drive: &mut Drive, _t_s: f64) {}
}

/// The register map of an analog input module.
pub trait CellsMap: fmt::Debug + Send + Sync {
    /// Value of the register that a function (3 holding, 4 input) reads, given the voltages of the inputs at
    /// the last conversion, V; `None` if the module does not have it.
    fn register(&self, function: u8, address: u16, volts: &[f64; INPUTS]) -> Option<u16>;

    /// Writes a register.
    ///
    /// # Errors
    /// The Modbus exception that the module returns.
    fn set(&mut self, address: u16, value: u16) -> Result<(), Exception>;

    /// Executes one request.
    ///
    /// # Errors
    /// The Modbus exception that the module returns.
    fn serve(&mut self, request: &Request, volts: &[f64; INPUTS]) -> Answer {
        match *request {
            Request::ReadRegisters { function, address, count } => {
                return read_each(address, count, |a| self.register(function, a, volts));
            }
            Request::WriteRegister { address, value } => self.set(address, value)?,
            Request::WriteRegisters { address, ref values } => {
                for (a, &value) in (address..).zip(values) {
                    self.set(a, value)?;
                }
            }
            Request::ReadBits { .. } | Request::WriteCoil { .. } => {
                return Err(Exception::IllegalFunction);
            }
        }
        Ok(Reply::Written)
    }
}

/// A drive that a rig file can name.
#[derive(Clone, Copy)]
pub struct AxisDevice {
    /// Name in rig files.
    pub name: &'static str,
    /// State of the motor at power-up.
    pub servo_at_power_up: Servo,
    /// Creates the map at power-up, with counts per axis unit and process seconds per wall second
    /// (a watchdog runs in wall time).
    pub map: fn(f64, f64) -> Box<dyn AxisMap>,
}

/// An analog input module that a rig file can name.
#[derive(Clone, Copy)]
pub struct CellsDevice {
    /// Name in rig files.
    pub name: &'static str,
    /// Creates the map at power-up.
    pub map: fn() -> Box<dyn CellsMap>,
}

/// The device with a name, of a list.
fn by_name<T: Copy, E: Error>(
    name: &str,
    devices: &[T],
    name_of: fn(T) -> &'static str,
) -> Result<T, E> {
    devices.iter().copied().find(|&device| name_of(device) == name).ok_or_else(|| {
        let known: Vec<&str> = devices.iter().copied().map(name_of).collect();
        E::custom(format!("no register map for `{name}`, only for {}", known.join(", ")))
    })
}

impl<'de> Deserialize<'de> for AxisDevice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        by_name(&String::deserialize(deserializer)?, DRIVES, |device| device.name)
    }
}

impl<'de> Deserialize<'de> for CellsDevice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        by_name(&String::deserialize(deserializer)?, MODULES, |device| device.name)
    }
}

impl fmt::Debug for AxisDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl fmt::Debug for CellsDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// Executes a request to the holding registers of a map, and refuses all others.
fn serve_registers<M: AxisMap + ?Sized>(
    map: &mut M,
    request: &Request,
    drive: &mut Drive,
    t_s: f64,
) -> Answer {
    match *request {
        Request::ReadRegisters { function: 3, address, count } => {
            read_each(address, count, |a| map.register(a, drive, t_s))
        }
        Request::WriteRegister { address, value } => map.write(address, &[value], drive, t_s),
        Request::WriteRegisters { address, ref values } => map.write(address, values, drive, t_s),
        Request::ReadRegisters { .. } | Request::ReadBits { .. } | Request::WriteCoil { .. } => {
            Err(Exception::IllegalFunction)
        }
    }
}

/// Reads `count` registers one by one. If the device lacks one of them, the whole read is refused.
fn read_each(address: u16, count: u16, mut register: impl FnMut(u16) -> Option<u16>) -> Answer {
    let values: Option<Vec<u16>> =
        (0..count).map(|i| address.checked_add(i).and_then(&mut register)).collect();
    values.map(Reply::Registers).ok_or(Exception::IllegalAddress)
}

/// High word of a 32-bit value.
fn high(value: i32) -> u16 {
    (value as u32 >> 16) as u16
}

/// Low word of a 32-bit value.
fn low(value: i32) -> u16 {
    value as u32 as u16
}

/// A 32-bit value from its words.
fn long(high: u16, low: u16) -> i32 {
    (u32::from(high) << 16 | u32::from(low)) as i32
}

/// Counts of a value, as a 32-bit register pair holds them.
fn counts(value: f64, counts_per_unit: f64) -> i32 {
    (value * counts_per_unit).round() as i32
}

/// A drive as the tests of the maps use it.
#[cfg(test)]
mod on_a_stage {
    use super::{AxisMap, Reply, Request};
    use crate::drive::{Drive, Mechanism};

    pub const STAGE: Mechanism =
        Mechanism { travel: [0.0, 560.0], speed: 250.0, acceleration: 1500.0 };

    /// Consecutive registers.
    pub fn read<const N: usize>(
        map: &mut dyn AxisMap,
        drive: &mut Drive,
        address: u16,
        t_s: f64,
    ) -> [u16; N] {
        let request = Request::ReadRegisters { function: 3, address, count: N as u16 };
        match map.serve(&request, drive, t_s) {
            Ok(Reply::Registers(words)) => words.try_into().unwrap(),
            other => panic!("{other:?}"),
        }
    }
}
