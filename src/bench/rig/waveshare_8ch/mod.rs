//! Waveshare Modbus RTU Analog Input 8CH (version A): eight 12-bit inputs, used for the load cells.
//! Uses: `rig::device`, `rig::station`. Never: newtons (the tare belongs to the campaign).
//!
//! Source: `docs/references.md`, "Waveshare 8CH". 9600 8N1 and address 1 from the factory; the
//! jumper is open for volts.

pub mod codec;
mod driver;

pub use driver::Waveshare8ch;

use std::sync::Arc;

use super::device::CellsDevice;

/// 12 bits: a step is 0.034 N, 55 % of the values: 41 repeats occur once in 6 x 10^10 values, once in
/// 20,000 nights.
const REPEATS_MAX: u32 = 40;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice::new("waveshare_8ch", REPEATS_MAX, |station, cells, clock| {
        Arc::new(Waveshare8ch::new(station, cells, clock))
    });
