//! Advantech ADAM-6017: eight 16-bit analog inputs over Modbus TCP, used for the six load cells.
//! Uses: `rig::device`, `rig::station`. Never: newtons (the tare belongs to the campaign).
//!
//! Source: `docs/references.md`, "ADAM-6017".

pub mod codec;
mod driver;

pub use driver::Adam6017;

use std::sync::Arc;

use super::device::CellsDevice;

/// A step is 0.002 N, which 4 % of the values fall into: 9 repeats occur once in 10^14 values.
const REPEATS_MAX: u32 = 8;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice::new("adam_6017", REPEATS_MAX, |station, cells, clock| {
        Arc::new(Adam6017::new(station, cells, clock))
    });
