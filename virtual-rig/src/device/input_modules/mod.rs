//! Register maps of analog input modules, one file each; [`MODULES`] is the only list of them.
//! PURE. Uses: `device`. Never: sockets, clocks, faults.

use super::CellsDevice;

pub mod adam_6017;
pub mod waveshare_8ch;

/// Register maps of analog input modules.
pub const MODULES: &[CellsDevice] = &[adam_6017::MODULE, waveshare_8ch::MODULE];
