//! The input modules of the load cells, one folder each; [`MODULES`] is the only list of them.
//! Uses: `device`. Never: requests, ports.

use super::device::CellsDevice;

pub mod adam_6017;
pub mod waveshare_8ch;

/// Supported analog input modules.
pub const MODULES: &[CellsDevice] = &[adam_6017::MODULE, waveshare_8ch::MODULE];
