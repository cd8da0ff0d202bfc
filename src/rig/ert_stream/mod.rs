//! The voltage stream of the skin's readout: packets over TCP or a serial port, never asked for.
//! Uses: `rig::link` (ports), `clock`. Never: sends a byte, keeps anything but the newest frames.
//!
//! Source: `docs/references.md`, "ERT stream packets".

pub mod codec;
mod driver;
pub mod timing;

#[cfg(test)]
mod tests;

pub use driver::ErtStream;
