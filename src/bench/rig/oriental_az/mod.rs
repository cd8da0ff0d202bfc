//! Oriental Motor AZ (AZD-KD): absolute-encoder stepping motors, driven by direct data operation.
//! Uses: `rig::device`, `rig::axis`, `rig::station`. Never: another device's registers.
//!
//! Source: `docs/references.md`, "Oriental Motor AZ drivers". RTU, 115200 baud and even parity from
//! the factory.

pub mod codec;
mod driver;

pub use driver::OrientalAz;

use super::device::AxisDevice;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("oriental_az", |parts| parts.on(OrientalAz)).with_guards();
