//! The devices of the rig as register maps, written from their documents
//! (`docs/references.md`, "Devices").
//! A map converts requests to actions of a drive or an input module; it has no access to wires.
//! PURE. Uses: `drive`, `modbus`. Never: sockets, clocks, faults.

pub mod adam_6017;
pub mod em2rs;
pub mod iai;
pub mod oriental_az;
pub mod waveshare_8ch;

use crate::config::{AxisDevice, CellsDevice};
use crate::drive::Drive;
use crate::modbus::{Exception, Reply, Request};

/// Number of inputs of an analog module.
pub const INPUTS: usize = 8;

/// The register map of an axis.
#[derive(Debug, Clone)]
pub enum AxisMap {
    /// IAI SCON/PCON.
    Iai(iai::Iai),
    /// Oriental Motor AZ.
    OrientalAz(oriental_az::OrientalAz),
    /// Leadshine EM2RS.
    Em2rs(em2rs::Em2rs),
}

impl AxisMap {
    /// Creates the map of a device with `counts_per_unit` counts per axis unit. `clock_rate` is in
    /// process seconds per wall second: a watchdog runs in wall time.
    pub fn new(device: AxisDevice, counts_per_unit: f64, clock_rate: f64) -> Self {
        match device {
            AxisDevice::Iai => Self::Iai(iai::Iai::new(counts_per_unit)),
            AxisDevice::OrientalAz => {
                Self::OrientalAz(oriental_az::OrientalAz::new(counts_per_unit, clock_rate))
            }
            AxisDevice::LeadshineEm2rs => Self::Em2rs(em2rs::Em2rs::new(counts_per_unit)),
        }
    }

    /// Whether the motor is on at power-up: IAI requires a servo-on command, the others do not.
    pub fn servo_at_power_up(device: AxisDevice) -> bool {
        device != AxisDevice::Iai
    }

    /// Resets the state that a device does not keep without power.
    pub fn power_cycle(&mut self) {
        match self {
            AxisMap::Iai(map) => map.power_cycle(),
            AxisMap::OrientalAz(map) => map.power_cycle(),
            AxisMap::Em2rs(map) => map.power_cycle(),
        }
    }

    /// Records that a request has reached the device, whatever its result.
    pub fn hear(&mut self, t_s: f64) {
        if let AxisMap::OrientalAz(map) = self {
            map.hear(t_s);
        }
    }

    /// Process time at which the watchdog of the device expires unless a request arrives before, s.
    pub fn watchdog_s(&self) -> Option<f64> {
        match self {
            AxisMap::OrientalAz(map) => map.watchdog_s(),
            AxisMap::Iai(_) | AxisMap::Em2rs(_) => None,
        }
    }

    /// Lets an expired watchdog stop the motor.
    pub fn watch(&mut self, drive: &mut Drive, t_s: f64) {
        if let AxisMap::OrientalAz(map) = self {
            map.watch(drive, t_s);
        }
    }

    /// Executes one request at a process time.
    ///
    /// # Errors
    /// The Modbus exception that the device returns.
    pub fn serve(
        &mut self,
        request: &Request,
        drive: &mut Drive,
        t_s: f64,
    ) -> Result<Reply, Exception> {
        match self {
            AxisMap::Iai(map) => map.serve(request, drive, t_s),
            AxisMap::OrientalAz(map) => map.serve(request, drive, t_s),
            AxisMap::Em2rs(map) => map.serve(request, drive, t_s),
        }
    }
}

/// The register map of an analog input module.
#[derive(Debug, Clone)]
pub enum CellsMap {
    /// Advantech ADAM-6017.
    Adam6017(adam_6017::Adam6017),
    /// Waveshare Modbus RTU Analog Input 8CH.
    Waveshare8ch(waveshare_8ch::Waveshare8ch),
}

impl CellsMap {
    /// Creates the map of a module.
    pub fn new(device: CellsDevice) -> Self {
        match device {
            CellsDevice::Adam6017 => Self::Adam6017(adam_6017::Adam6017::default()),
            CellsDevice::Waveshare8ch => Self::Waveshare8ch(waveshare_8ch::Waveshare8ch::default()),
        }
    }

    /// Executes one request, given the voltages of the inputs at the last conversion, V.
    ///
    /// # Errors
    /// The Modbus exception that the module returns.
    pub fn serve(&mut self, request: &Request, volts: &[f64; INPUTS]) -> Result<Reply, Exception> {
        match self {
            CellsMap::Adam6017(map) => map.serve(request, volts),
            CellsMap::Waveshare8ch(map) => map.serve(request, volts),
        }
    }
}

/// Reads `count` registers one by one. If the device lacks one of them, the whole read is refused.
fn read_each(
    address: u16,
    count: u16,
    mut register: impl FnMut(u16) -> Option<u16>,
) -> Result<Reply, Exception> {
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
