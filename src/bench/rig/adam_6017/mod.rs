//! Advantech ADAM-6017: eight 16-bit analog inputs over Modbus TCP, used for the six load cells.
//! Uses: `rig::station`. Never: newtons (the tare belongs to the campaign).
//!
//! Source: `docs/references.md`, "ADAM-6017".

pub mod codec;
mod driver;

pub use driver::Adam6017;
