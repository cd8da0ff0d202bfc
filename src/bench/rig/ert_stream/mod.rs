//! The voltage stream of the skin's readout: unsolicited packets over TCP or a serial port.
//! Uses: `rig::link` (ports), `clock`. Never: sends a byte, stores more than the newest frames.
//!
//! Source: `docs/references.md`, "ERT stream packets".

pub mod codec;
mod driver;
pub mod timing;

#[cfg(test)]
mod tests;

pub use driver::ErtStream;
