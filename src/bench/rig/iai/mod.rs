//! IAI SCON/PCON/ERC2 electric actuators: stage axes in 0.01 mm (0.01 degree on a rotary).
//! Uses: `rig::axis`, `rig::station`. Never: another device's registers.
//!
//! Source: `docs/references.md`, "IAI controllers".

pub mod codec;
mod driver;

pub use driver::Iai;
