//! The input modules of the load cells, one file each; [`MODULES`] is the only list of them.
//! Uses: `device`. Never: requests, ports.

use serde::de::{Deserialize, Deserializer};

use super::device::{CellsDevice, by_name};

pub mod adam_6017;
pub mod waveshare_8ch;

/// Supported analog input modules.
pub const MODULES: &[CellsDevice] = &[adam_6017::MODULE, waveshare_8ch::MODULE];

impl<'de> Deserialize<'de> for CellsDevice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        by_name(&String::deserialize(deserializer)?, MODULES, Self::as_str)
    }
}
