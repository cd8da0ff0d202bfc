//! The drives, one folder each; [`DRIVES`] is the only list of them.
//! Uses: `device`. Never: requests, ports.

use super::device::AxisDevice;

pub mod iai;
pub mod leadshine_em2rs;
pub mod oriental_az;

/// Drives that a rig file can name.
pub const DRIVES: &[AxisDevice] = &[iai::DRIVE, leadshine_em2rs::DRIVE, oriental_az::DRIVE];
