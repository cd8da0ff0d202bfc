//! The register map of the Waveshare 8CH: requests and the meaning of replies.
//! PURE. Uses: `link::Request`. Never: ports, newtons.
//!
//! Source: `docs/references.md`, "Waveshare 8CH": values in input registers 0 to 7, millivolts in
//! the voltage modes; mode of channel n in holding register 0x1000 + n; version in 0x8000.

use crate::rig::link::Request;

/// Number of analog inputs.
pub const CHANNELS: u16 = 8;
/// Mode 0 of version A: 0 to 5 V. Its values are millivolts.
pub const MODE_0_TO_5_V: u16 = 0;
/// Upper end of mode 0 of version A, V.
pub const FULL_SCALE_V: f64 = 5.0;

/// Requests the values of all channels in one reply, 35 ms at 9600 baud.
pub fn read_values() -> Request {
    Request::ReadInput { address: 0, count: CHANNELS }
}

/// Requests all modes.
pub fn read_modes() -> Request {
    Request::ReadHolding { address: 0x1000, count: CHANNELS }
}

/// Requests the version.
pub fn read_version() -> Request {
    Request::ReadHolding { address: 0x8000, count: 1 }
}

/// Voltage of a value in mode 0, V.
pub fn volts(millivolts: u16) -> f64 {
    f64::from(millivolts) / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_millivolts() {
        assert_eq!(volts(500), 0.5);
        assert_eq!(read_values(), Request::ReadInput { address: 0, count: 8 });
    }
}
