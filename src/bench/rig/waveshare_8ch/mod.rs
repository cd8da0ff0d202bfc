//! Waveshare Modbus RTU Analog Input 8CH (version A): eight 12-bit inputs, used for the load cells.
//! Uses: `rig::station`. Never: newtons (the tare belongs to the campaign).
//!
//! Source: `docs/references.md`, "Waveshare 8CH". 9600 8N1 and address 1 from the factory; the
//! jumper is open for volts.

pub mod codec;
mod driver;

pub use driver::Waveshare8ch;
