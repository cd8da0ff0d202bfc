//! Register maps of drives, one file each; [`DRIVES`] is the only list of them.
//! PURE. Uses: `device`. Never: sockets, clocks, faults.

use super::AxisDevice;

pub mod iai;
pub mod leadshine_em2rs;
pub mod oriental_az;

/// Register maps of drives.
pub const DRIVES: &[AxisDevice] = &[iai::DRIVE, leadshine_em2rs::DRIVE, oriental_az::DRIVE];
