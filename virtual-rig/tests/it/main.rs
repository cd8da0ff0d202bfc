//! The rig's wires from outside: independent Modbus clients, an independent reader of the stream.
//! Uses: tokio-modbus (which the crate itself does not use), sockets, pseudo-terminals.

mod calibrated_skin;
mod common;
mod control;
mod faults;
mod rtu;
mod stream;
mod tcp;
