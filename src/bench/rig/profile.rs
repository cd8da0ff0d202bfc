//! Settings of an axis in its own unit, as its driver uses them.
//! PURE. Uses: `guard`. Never: registers, ports, the keys of a rig file.

use super::guard::Guard;

/// Settings of an axis in its own unit (mm or degrees), for its driver.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisProfile {
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the drive.
    pub address: u8,
    /// Device counts per unit.
    pub counts_per_unit: f64,
    /// Soft limits, units.
    pub travel: [f64; 2],
    /// Travelling speed, units/s.
    pub speed: f64,
    /// Acceleration, units/s^2.
    pub acceleration: f64,
    /// Distance from the target that counts as arrived, units.
    pub tolerance: f64,
    /// Guards of the drive.
    pub guard: Guard,
}
