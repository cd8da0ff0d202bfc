//! Waveshare Modbus RTU Analog Input 8CH, version A: 12 bit, values in millivolts.
//! Registers from `docs/references.md`, "Waveshare 8CH": FC04 0x0000 to 0x0007 values; FC03, FC06,
//! FC16 0x1000 + channel the mode (0 is 0 to 5 V, 1 is 1 to 5 V, 2 and 3 currents, 4 raw counts);
//! 0x4000 address; 0x8000 version. PURE. Never: the meaning of the inputs.

use crate::device::{CellsDevice, CellsMap, INPUTS};
use crate::modbus::Exception;

const MODE_BASE: u16 = 0x1000;
const UART_AT: u16 = 0x2000;
const ADDRESS_AT: u16 = 0x4000;
const VERSION_AT: u16 = 0x8000;
const VERSION: u16 = 200;
/// Mode: raw counts instead of a scaled value.
const MODE_RAW: u16 = 4;
const FULL_SCALE_V: f64 = 5.0;
const COUNTS: f64 = 4096.0;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice { name: "waveshare_8ch", map: || Box::new(Waveshare8ch::default()) };

/// Settings of the module.
#[derive(Debug, Clone, Default)]
pub struct Waveshare8ch {
    modes: [u16; INPUTS],
}

impl CellsMap for Waveshare8ch {
    fn register(&self, function: u8, address: u16, volts: &[f64; INPUTS]) -> Option<u16> {
        if function == 4 { self.value(address, volts) } else { self.setting(address) }
    }

    fn set(&mut self, address: u16, value: u16) -> Result<(), Exception> {
        let channel = address.checked_sub(MODE_BASE).map(usize::from);
        let mode = channel.and_then(|c| self.modes.get_mut(c));
        let mode = mode.ok_or(Exception::IllegalAddress)?;
        if value > MODE_RAW {
            return Err(Exception::IllegalValue);
        }
        *mode = value;
        Ok(())
    }
}

impl Waveshare8ch {
    fn value(&self, address: u16, volts: &[f64; INPUTS]) -> Option<u16> {
        let v = *volts.get(usize::from(address))?;
        let raw = (v / FULL_SCALE_V * COUNTS).round().clamp(0.0, COUNTS - 1.0);
        let millivolts = (raw / COUNTS * FULL_SCALE_V * 1e3).round();
        match self.modes[usize::from(address)] {
            MODE_RAW => Some(raw as u16),
            0 => Some(millivolts as u16),
            1 => Some(if millivolts < 1000.0 { 0 } else { millivolts as u16 }),
            _ => Some(0),
        }
    }

    fn setting(&self, address: u16) -> Option<u16> {
        match address {
            UART_AT => Some(0x0001),
            ADDRESS_AT => Some(1),
            VERSION_AT => Some(VERSION),
            _ => self.modes.get(usize::from(address.checked_sub(MODE_BASE)?)).copied(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modbus::{Reply, Request};

    const VOLTS: [f64; INPUTS] = [0.0, 0.5, 2.5, 4.5, 5.0, 0.501, 0.5006, 0.5];

    #[test]
    fn values_are_millivolts_in_steps_of_twelve_bits() {
        let read = Request::ReadRegisters { function: 4, address: 0, count: 8 };
        let reply = Waveshare8ch::default().serve(&read, &VOLTS).unwrap();
        let expected = vec![0, 500, 2500, 4500, 4999, 500, 500, 500];
        assert_eq!(reply, Reply::Registers(expected));
    }

    #[test]
    fn modes_are_holding_registers_and_raw_is_counts() {
        let mut module = Waveshare8ch::default();
        let write = Request::WriteRegisters { address: 0x1001, values: vec![4, 0] };
        assert_eq!(module.serve(&write, &VOLTS), Ok(Reply::Written));
        let modes = Request::ReadRegisters { function: 3, address: 0x1000, count: 3 };
        assert_eq!(module.serve(&modes, &VOLTS), Ok(Reply::Registers(vec![0, 4, 0])));
        let read = Request::ReadRegisters { function: 4, address: 1, count: 2 };
        assert_eq!(module.serve(&read, &VOLTS), Ok(Reply::Registers(vec![410, 2500])));
        let wrong = Request::WriteRegister { address: 0x1000, value: 9 };
        assert_eq!(module.serve(&wrong, &VOLTS), Err(Exception::IllegalValue));
        let beyond = Request::ReadRegisters { function: 4, address: 4, count: 5 };
        assert_eq!(module.serve(&beyond, &VOLTS), Err(Exception::IllegalAddress));
    }
}
