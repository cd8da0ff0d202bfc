//! Waveshare Modbus RTU Analog Input 8CH (version A): eight 12-bit inputs.
//! PURE. Uses: `rig::inputs`, `rig::device`, `link::Request`. Never: ports, newtons.
//!
//! Source: `docs/references.md`, "Waveshare 8CH": values in input registers 0 to 7, millivolts in
//! the voltage modes; mode of channel n in holding register 0x1000 + n; version in 0x8000. 9600 8N1 and
//! address 1 from the factory; the jumper is open for volts.

use std::ops::RangeInclusive;

use crate::rig::device::CellsDevice;
use crate::rig::error::RigError;
use crate::rig::inputs::{InputModule, InputRange};
use crate::rig::link::Request;
use crate::rig::station::Station;

/// 12 bits: a step is 0.034 N, 55 % of the values: 41 repeats occur once in 6 x 10^10 values, once in
/// 20,000 nights.
const REPEATS_MAX: u32 = 40;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice::new("waveshare_8ch", REPEATS_MAX, |parts| parts.on(Waveshare8ch));

/// Number of analog inputs.
const CHANNELS: u16 = 8;
/// Mode 0 of version A: 0 to 5 V. Its values are millivolts.
const MODE_0_TO_5_V: u16 = 0;

/// A Waveshare 8CH, version A.
#[derive(Debug)]
struct Waveshare8ch;

impl InputModule for Waveshare8ch {
    const SETTING: &'static str = "mode";

    fn identity_request(&self) -> Request {
        Request::ReadHolding { address: 0x8000, count: 1 }
    }

    fn identity(&self, words: &[u16], _station: &Station) -> Result<String, RigError> {
        let version = words.first().copied().unwrap_or(0);
        Ok(format!("Waveshare 8CH, version {}.{:02}", version / 100, version % 100))
    }

    fn settings_request(&self) -> Request {
        Request::ReadHolding { address: 0x1000, count: CHANNELS }
    }

    fn range(&self, setting: u16) -> Option<InputRange> {
        (setting == MODE_0_TO_5_V).then_some(InputRange { low_v: 0.0, high_v: 5.0 })
    }

    // All channels in one reply, 35 ms at 9600 baud.
    fn values_request(&self, _used: RangeInclusive<u8>) -> (u8, Request) {
        (0, Request::ReadInput { address: 0, count: CHANNELS })
    }

    fn volts(&self, raw: u16, _range: InputRange) -> f64 {
        f64::from(raw) / 1e3
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_millivolts() {
        let range = Waveshare8ch.range(MODE_0_TO_5_V).unwrap();
        assert_eq!(Waveshare8ch.volts(500, range), 0.5);
        let all = Request::ReadInput { address: 0, count: 8 };
        assert_eq!(Waveshare8ch.values_request(2..=7), (0, all));
    }

    #[test]
    fn only_the_mode_of_0_to_5_v_is_accepted() {
        assert_eq!([1, 2, 3, 4].map(|mode| Waveshare8ch.range(mode)), [None; 4]);
    }
}
