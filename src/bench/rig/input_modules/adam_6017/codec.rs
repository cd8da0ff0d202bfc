//! The register map of the ADAM-6017: requests and the meaning of replies.
//! PURE. Uses: `link::Request`. Never: ports, newtons.
//!
//! Source: `docs/references.md`, "ADAM-6017": values 0 to 65535 over the channel's range in
//! registers 0 to 7, type codes in 200 to 207, the model's number in 210.

use std::fmt;

use crate::rig::link::Request;

/// Model number that the module reports.
pub const MODEL: u16 = 0x6017;
/// Number of analog inputs.
pub const CHANNELS: u16 = 8;

/// Range of an input, by its type code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Range {
    /// 0 to 5 V, type code 0x0147.
    Volts0To5,
    /// 0 to 10 V, type code 0x0148.
    Volts0To10,
    /// -5 to 5 V, type code 0x0142.
    PlusMinus5,
    /// -10 to 10 V, type code 0x0143.
    PlusMinus10,
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.ends_v();
        write!(f, "{low} to {high} V")
    }
}

impl Range {
    /// Range of a type code; `None` for currents and unknown codes.
    pub fn of_code(code: u16) -> Option<Self> {
        match code {
            0x0147 => Some(Range::Volts0To5),
            0x0148 => Some(Range::Volts0To10),
            0x0142 => Some(Range::PlusMinus5),
            0x0143 => Some(Range::PlusMinus10),
            _ => None,
        }
    }

    /// Lower and upper end of the range, V.
    pub fn ends_v(self) -> [f64; 2] {
        match self {
            Range::Volts0To5 => [0.0, 5.0],
            Range::Volts0To10 => [0.0, 10.0],
            Range::PlusMinus5 => [-5.0, 5.0],
            Range::PlusMinus10 => [-10.0, 10.0],
        }
    }

    /// Voltage of a raw value, V.
    pub fn volts(self, raw: u16) -> f64 {
        let [low, high] = self.ends_v();
        low + (high - low) * f64::from(raw) / f64::from(u16::MAX)
    }
}

/// Requests the values of `count` channels, starting with `first`.
pub fn read_values(first: u16, count: u16) -> Request {
    Request::ReadInput { address: first, count }
}

/// Requests all type codes.
pub fn read_types() -> Request {
    Request::ReadHolding { address: 200, count: CHANNELS }
}

/// Requests the model number.
pub fn read_model() -> Request {
    Request::ReadHolding { address: 210, count: 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_a_range_are_the_ends_of_the_raw_value() {
        for code in [0x0142, 0x0143, 0x0147, 0x0148] {
            let range = Range::of_code(code).unwrap();
            assert_eq!([range.volts(0), range.volts(65535)], range.ends_v());
        }
        assert_eq!(Range::of_code(0x0180), None);
    }

    #[test]
    fn a_load_cell_without_load_reads_half_a_volt() {
        assert!((Range::Volts0To5.volts(6554) - 0.5).abs() < 1e-4);
        assert!((Range::PlusMinus5.volts(36044) - 0.5).abs() < 1e-4);
    }
}
