//! Advantech ADAM-6017: eight 16-bit analog inputs over Modbus TCP.
//! PURE. Uses: `rig::inputs`, `rig::device`, `link::Request`. Never: ports, newtons.
//!
//! Source: `docs/references.md`, "ADAM-6017": values 0 to 65535 over the channel's range in
//! registers 0 to 7, type codes in 200 to 207, the model's number in 210.

use std::ops::RangeInclusive;

use crate::rig::device::CellsDevice;
use crate::rig::error::RigError;
use crate::rig::inputs::{InputModule, InputRange};
use crate::rig::link::Request;
use crate::rig::station::Station;

/// A step is 0.002 N, which 4 % of the values fall into: 9 repeats occur once in 10^14 values.
const REPEATS_MAX: u32 = 8;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice::new("adam_6017", REPEATS_MAX, |parts| parts.on(Adam6017));

/// Model number that the module reports.
const MODEL: u16 = 0x6017;
/// Number of analog inputs.
const CHANNELS: u16 = 8;

/// An ADAM-6017.
#[derive(Debug)]
struct Adam6017;

impl InputModule for Adam6017 {
    const SETTING: &'static str = "type";

    fn identity_request(&self) -> Request {
        Request::ReadHolding { address: 210, count: 1 }
    }

    fn identity(&self, words: &[u16], station: &Station) -> Result<String, RigError> {
        if words != [MODEL] {
            let found = format!("model {:04X}", words.first().copied().unwrap_or(0));
            return Err(station.wrong(found, "an ADAM-6017 (6017)".into()));
        }
        Ok("ADAM-6017".into())
    }

    fn settings_request(&self) -> Request {
        Request::ReadHolding { address: 200, count: CHANNELS }
    }

    fn range(&self, setting: u16) -> Option<InputRange> {
        let (low_v, high_v) = match setting {
            0x0147 => (0.0, 5.0),
            0x0148 => (0.0, 10.0),
            0x0142 => (-5.0, 5.0),
            0x0143 => (-10.0, 10.0),
            _ => return None,
        };
        Some(InputRange { low_v, high_v })
    }

    fn values_request(&self, used: RangeInclusive<u8>) -> (u8, Request) {
        let (first, last) = used.into_inner();
        let count = u16::from(last - first) + 1;
        (first, Request::ReadInput { address: u16::from(first), count })
    }

    fn volts(&self, raw: u16, InputRange { low_v, high_v }: InputRange) -> f64 {
        low_v + (high_v - low_v) * f64::from(raw) / f64::from(u16::MAX)
    }

    fn jump_v(&self) -> f64 {
        0.4
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_a_range_are_the_ends_of_the_raw_value() {
        for setting in [0x0142, 0x0143, 0x0147, 0x0148] {
            let range = Adam6017.range(setting).unwrap();
            let ends = [0, 65535].map(|raw| Adam6017.volts(raw, range));
            assert_eq!(ends, [range.low_v, range.high_v]);
        }
        assert_eq!(Adam6017.range(0x0180), None);
    }

    #[test]
    fn a_load_cell_without_load_reads_half_a_volt() {
        let volts = |setting, raw| Adam6017.volts(raw, Adam6017.range(setting).unwrap());
        assert!((volts(0x0147, 6554) - 0.5).abs() < 1e-4);
        assert!((volts(0x0142, 36044) - 0.5).abs() < 1e-4);
    }
}
