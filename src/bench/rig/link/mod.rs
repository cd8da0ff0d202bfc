//! The wires: the only code that opens a port. A `Line` is one wire with one owner. A request
//! carries the address of its device, and a stop has priority.
//! Uses: `clock`, `rig::wires`, tokio-modbus, tokio-serial. Never: registers' meanings, units.

mod counts;
mod error;
mod exchange;
mod latch;
mod line;
mod pdu;
mod port;
mod swept;
mod wire;

#[cfg(test)]
mod tests;

pub use counts::LineCounts;
pub use error::LineError;
pub use exchange::LinePolicy;
pub use latch::{MotionGate, MotionPermit, StopLatch};
pub use line::Line;
pub use pdu::{Reply, Request};
pub use port::Port;
pub use wire::{Framing, Opener, SerialSettings, serial_opener, tcp_opener, tcp_stream_opener};
