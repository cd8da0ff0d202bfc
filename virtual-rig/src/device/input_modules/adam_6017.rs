//! Advantech ADAM-6017: eight analog inputs, 16 bit over the chosen range, Modbus TCP.
//! Registers from `docs/references.md`, "ADAM-6017": 0 to 7 the values (0 to 65535 over the range),
//! 200 + channel the range codes, 210 the model. PURE. Never: the meaning of the inputs.

use crate::device::{CellsDevice, CellsMap, INPUTS};
use crate::modbus::Exception;

/// Range codes: 0 to 5 V, 0 to 10 V, +-5 V, +-10 V.
const RANGES: [(u16, f64, f64); 4] =
    [(0x0147, 0.0, 5.0), (0x0148, 0.0, 10.0), (0x0142, -5.0, 5.0), (0x0143, -10.0, 10.0)];
/// First register of the range codes.
const RANGE_BASE: u16 = 200;
/// Register of the model number.
const MODEL_AT: u16 = 210;
const MODEL: u16 = 0x6017;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice { name: "adam_6017", map: || Box::new(Adam6017::default()) };

/// Settings of the module.
#[derive(Debug, Clone)]
pub struct Adam6017 {
    ranges: [u16; INPUTS],
}

impl Default for Adam6017 {
    /// All inputs at 0 to 5 V, as required for the FC22.
    fn default() -> Self {
        Self { ranges: [RANGES[0].0; INPUTS] }
    }
}

impl CellsMap for Adam6017 {
    fn register(&self, _function: u8, address: u16, volts: &[f64; INPUTS]) -> Option<u16> {
        if let Some(&v) = volts.get(usize::from(address)) {
            let code = self.ranges[usize::from(address)];
            let (_, low, high) = RANGES.into_iter().find(|r| r.0 == code)?;
            return Some(((v - low) / (high - low) * 65535.0).round().clamp(0.0, 65535.0) as u16);
        }
        if address == MODEL_AT {
            return Some(MODEL);
        }
        let channel = usize::from(address.checked_sub(RANGE_BASE)?);
        self.ranges.get(channel).copied()
    }

    fn set(&mut self, address: u16, code: u16) -> Result<(), Exception> {
        let channel = address.checked_sub(RANGE_BASE).map(usize::from);
        let range = channel.and_then(|c| self.ranges.get_mut(c));
        let range = range.ok_or(Exception::IllegalAddress)?;
        if !RANGES.iter().any(|r| r.0 == code) {
            return Err(Exception::IllegalValue);
        }
        *range = code;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modbus::{Reply, Request};

    const VOLTS: [f64; INPUTS] = [0.0, 0.5, 2.5, 4.5, 5.0, 6.0, -1.0, 0.5];

    fn read(address: u16, count: u16) -> Request {
        Request::ReadRegisters { function: 4, address, count }
    }

    #[test]
    fn values_span_the_range_and_stop_at_its_ends() {
        let reply = Adam6017::default().serve(&read(0, 8), &VOLTS).unwrap();
        let expected = vec![0, 6554, 32768, 58982, 65535, 65535, 0, 6554];
        assert_eq!(reply, Reply::Registers(expected));
    }

    #[test]
    fn the_range_code_changes_the_scale() {
        let mut module = Adam6017::default();
        let write = Request::WriteRegister { address: 202, value: 0x0148 };
        assert_eq!(module.serve(&write, &VOLTS), Ok(Reply::Written));
        assert_eq!(module.serve(&read(2, 1), &VOLTS), Ok(Reply::Registers(vec![16384])));
        let wrong = Request::WriteRegister { address: 202, value: 7 };
        assert_eq!(module.serve(&wrong, &VOLTS), Err(Exception::IllegalValue));
    }

    #[test]
    fn it_names_itself_and_refuses_what_it_does_not_have() {
        let mut module = Adam6017::default();
        assert_eq!(module.serve(&read(210, 1), &VOLTS), Ok(Reply::Registers(vec![0x6017])));
        assert_eq!(module.serve(&read(6, 3), &VOLTS), Err(Exception::IllegalAddress));
        let coil = Request::WriteCoil { address: 0, on: true };
        assert_eq!(module.serve(&coil, &VOLTS), Err(Exception::IllegalFunction));
    }
}
