//! The voltage stream: packets, and the thread that creates and sends them.
//! Uses: `bench`, `solver`, `skin`. Never: Modbus.

pub mod packet;
pub mod sinks;
pub mod stream;
