//! Leadshine / StepperOnline EM2RS, DM556RS, DM882RS: stepping drives in PR mode over RS-485.
//! Uses: `codec`, `rig::device`, `rig::axis`, `rig::station`. Never: register
//! addresses, another device's registers.
//!
//! Source: `docs/references.md`, "Leadshine EM2RS drives". RTU, 38400 baud, 8N1 from the factory.

pub mod codec;

use std::sync::atomic::{AtomicU16, Ordering};
use std::time::Duration;

use crate::clock::Clock;
use crate::rig::axis::{Drive, DriveState, MoveOrder};
use crate::rig::device::AxisDevice;
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::station::Station;
use crate::rig::traits::Found;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("leadshine_em2rs", |parts| parts.on(LeadshineEm2rs::default()));

/// Pulses per revolution as set at the factory.
const FACTORY_PULSES_PER_REV: u16 = 10_000;
/// Longest wait until the motor is enabled, wall time.
const ENABLE_DEADLINE: Duration = Duration::from_secs(1);
/// Period at which the enabled state is checked.
const ENABLE_POLL: Duration = Duration::from_millis(10);

/// A Leadshine EM2RS drive.
#[derive(Debug)]
pub struct LeadshineEm2rs {
    /// Pulses per revolution as reported by the drive in `prepare`.
    pulses_per_rev: AtomicU16,
}

impl Default for LeadshineEm2rs {
    fn default() -> Self {
        Self { pulses_per_rev: AtomicU16::new(FACTORY_PULSES_PER_REV) }
    }
}

impl LeadshineEm2rs {
    async fn word(station: &Station, what: &str, address: u16) -> Result<u16, RigError> {
        let words = station.read(what, codec::read_one(address)).await?;
        words.first().copied().ok_or_else(|| station.garbled(what, "no register".into()))
    }

    /// Reads the pulses per revolution; a value outside the range of an EM2RS is an error.
    async fn pulses(station: &Station) -> Result<u16, RigError> {
        let pulses = Self::word(station, "pulses per revolution", codec::PULSES_PER_REV).await?;
        if codec::PULSES_RANGE.contains(&pulses) {
            return Ok(pulses);
        }
        let needed = "200 to 51200 (is this an EM2RS?)".into();
        Err(station.wrong(format!("{pulses} pulses per revolution"), needed))
    }

    /// State from the status word alone; the position is not read.
    async fn state(station: &Station) -> Result<DriveState, RigError> {
        let status = station.read("status", codec::read_one(codec::STATUS)).await?;
        let state = codec::parse(&status, &[0, 0]);
        state.ok_or_else(|| station.garbled("status", "no register".into()))
    }
}

impl Drive for LeadshineEm2rs {
    fn status_requests(&self) -> Vec<Request> {
        vec![codec::read_one(codec::STATUS), codec::read_feedback()]
    }

    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState> {
        codec::parse(blocks.first()?, blocks.get(1)?)
    }

    fn alarm_request(&self) -> Option<Request> {
        Some(codec::read_one(codec::ALARM))
    }

    fn move_requests(&self, order: &MoveOrder) -> Vec<Request> {
        codec::move_by_path(order, self.pulses_per_rev.load(Ordering::Relaxed)).to_vec()
    }

    fn home_requests(&self) -> Vec<Request> {
        vec![codec::home()]
    }

    fn stop_requests(&self) -> Vec<Request> {
        vec![codec::stop()]
    }

    fn release_requests(&self) -> Vec<Request> {
        Vec::new()
    }

    fn reset_requests(&self) -> Vec<Request> {
        vec![codec::clear_alarm()]
    }

    async fn identify(&self, station: &Station) -> Result<Found, RigError> {
        let pulses = Self::pulses(station).await?;
        let state = Self::state(station).await?;
        let alarm = match state.fault {
            true => Some(Self::word(station, "alarm code", codec::ALARM).await?),
            false => None,
        };
        Ok(Found {
            device: format!("Leadshine EM2RS, {pulses} pulses/rev"),
            enabled: state.ready,
            homed: state.homed,
            alarm: alarm.map(u32::from),
            // Its status reports neither a hardware stop nor who else is in control.
            emergency_stop: false,
            in_command: None,
        })
    }

    async fn prepare(&self, station: &Station, clock: &Clock) -> Result<String, RigError> {
        let pulses = Self::pulses(station).await?;
        self.pulses_per_rev.store(pulses, Ordering::Relaxed);
        station.write("enable", codec::enable()).await?;
        let deadline = clock.now() + ENABLE_DEADLINE;
        loop {
            let state = Self::state(station).await?;
            if state.fault {
                let alarm = Self::word(station, "alarm code", codec::ALARM).await?;
                return Err(station.not_ready("motion", format!("alarm 0x{alarm:03X}")));
            }
            if state.ready {
                let homed = if state.homed { "homed" } else { "not homed" };
                return Ok(format!("Leadshine EM2RS, enabled, {pulses} pulses/rev, {homed}"));
            }
            if clock.now() >= deadline {
                let why = format!("not enabled within {} s", ENABLE_DEADLINE.as_secs());
                return Err(station.not_ready("motion", why));
            }
            tokio::time::sleep(ENABLE_POLL).await;
        }
    }
}
