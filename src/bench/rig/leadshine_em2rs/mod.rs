//! Leadshine / StepperOnline EM2RS, DM556RS, DM882RS: stepping drives in PR mode over RS-485.
//! Uses: `rig::device`, `rig::axis`, `rig::station`. Never: another device's registers.
//!
//! Source: `docs/references.md`, "Leadshine EM2RS drives". RTU, 38400 baud, 8N1 from the factory.

pub mod codec;
mod driver;

pub use driver::LeadshineEm2rs;

use super::device::AxisDevice;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("leadshine_em2rs", |parts| parts.on(LeadshineEm2rs::default()));
