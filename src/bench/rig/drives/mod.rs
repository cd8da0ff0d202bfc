//! The drives, one file each; [`DRIVES`] is the only list of them.
//! Uses: `device`. Never: requests, ports.

use serde::de::{Deserialize, Deserializer};

use super::device::{AxisDevice, by_name};

pub mod iai;
pub mod leadshine_em2rs;
pub mod oriental_az;

/// Drives that a rig file can name.
pub const DRIVES: &[AxisDevice] = &[iai::DRIVE, leadshine_em2rs::DRIVE, oriental_az::DRIVE];

impl<'de> Deserialize<'de> for AxisDevice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        by_name(&String::deserialize(deserializer)?, DRIVES, Self::as_str)
    }
}
