//! IAI SCON/PCON/ERC2 electric actuators: stage axes in 0.01 mm (0.01 degree on a rotary).
//! Uses: `rig::device`, `rig::axis`, `rig::station`. Never: another device's registers.
//!
//! Source: `docs/references.md`, "IAI controllers".

pub mod codec;
mod driver;

pub use driver::Iai;

use super::device::AxisDevice;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice = AxisDevice::new("iai", |parts| parts.on(Iai));
