//! The bench: capabilities in units, and the drivers that implement them. One device, one folder;
//! [`DRIVES`] and [`MODULES`] are the only lists of the devices.
//! Uses: `clock`, `problem`. Never: campaigns, trials, storage, HTTP.

pub mod cells;
pub mod guard;
pub mod limits;
pub mod config;
pub mod setup;
pub mod reach;
pub mod error;
pub mod traits;

pub mod link;
pub mod motion;
pub mod repeats;
pub mod station;
pub mod words;

pub mod axis;
pub mod device;
pub mod iai;
pub mod leadshine_em2rs;
pub mod oriental_az;

pub mod adam_6017;
pub mod waveshare_8ch;

pub mod ert_stream;

pub mod check;
pub mod registry;

use device::{AxisDevice, CellsDevice};

/// Drives that a rig file can name.
pub const DRIVES: &[AxisDevice] = &[iai::DRIVE, oriental_az::DRIVE, leadshine_em2rs::DRIVE];

/// Supported analog input modules.
pub const MODULES: &[CellsDevice] = &[adam_6017::MODULE, waveshare_8ch::MODULE];
