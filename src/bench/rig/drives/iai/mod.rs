//! IAI SCON/PCON/ERC2 electric actuators: stage axes in 0.01 mm (0.01 degree on a rotary).
//! Uses: `codec`, `rig::device`, `rig::axis`, `rig::station`. Never: register
//! addresses, another device's registers.
//!
//! Source: `docs/references.md`, "IAI controllers".
//!
//! The map documents no deceleration stop except the pause, which holds the remaining travel and
//! resumes it when it ends. Before the next motion, the travel is therefore cancelled by an alarm
//! reset while paused `[unverified]`, then the pause is ended, then the new target replaces the old
//! one.

pub mod codec;

use std::time::Duration;

use self::codec::{Status, off, on};
use crate::clock::Clock;
use crate::rig::axis::{Drive, DriveState, MoveOrder};
use crate::rig::device::AxisDevice;
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::station::Station;
use crate::rig::traits::Found;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice = AxisDevice::new("iai", |parts| parts.on(Iai));

/// Longest wait until the servo is on, wall time.
const SERVO_DEADLINE: Duration = Duration::from_secs(2);
/// Period at which the servo state is checked.
const SERVO_POLL: Duration = Duration::from_millis(10);

/// Drive on an IAI SCON, PCON or ERC2 controller.
#[derive(Debug, Clone, Copy, Default)]
pub struct Iai;

impl Iai {
    async fn status(station: &Station) -> Result<Status, RigError> {
        let block = station.read("status", codec::read_status()).await?;
        let status = Status::parse(&block);
        status.ok_or_else(|| station.garbled("status", "too few registers".into()))
    }
}

impl Drive for Iai {
    fn status_requests(&self) -> Vec<Request> {
        vec![codec::read_status()]
    }

    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState> {
        Some(Status::parse(blocks.first()?)?.state())
    }

    fn move_requests(&self, order: &MoveOrder) -> Vec<Request> {
        vec![codec::move_block(order)]
    }

    fn home_requests(&self) -> Vec<Request> {
        vec![off(codec::COIL_HOME), on(codec::COIL_HOME)]
    }

    fn stop_requests(&self) -> Vec<Request> {
        vec![on(codec::COIL_PAUSE)]
    }

    fn release_requests(&self) -> Vec<Request> {
        vec![on(codec::COIL_ALARM_RESET), off(codec::COIL_ALARM_RESET), off(codec::COIL_PAUSE)]
    }

    fn reset_requests(&self) -> Vec<Request> {
        vec![on(codec::COIL_ALARM_RESET), off(codec::COIL_ALARM_RESET)]
    }

    async fn identify(&self, station: &Station) -> Result<Found, RigError> {
        let status = Self::status(station).await?;
        Ok(Found {
            device: "IAI".into(),
            enabled: status.servo && status.ready,
            homed: status.homed,
            alarm: status.alarm.then_some(u32::from(status.alarm_code)),
            emergency_stop: status.emergency,
            in_command: Some(status.modbus),
        })
    }

    async fn prepare(&self, station: &Station, clock: &Clock) -> Result<String, RigError> {
        station.write("switch to Modbus", on(codec::COIL_MODBUS)).await?;
        let status = Self::status(station).await?;
        if status.emergency {
            return Err(station.not_ready("servo on", "its emergency stop is pressed".into()));
        }
        if status.alarm {
            let why = format!("alarm 0x{:03X}", status.alarm_code);
            return Err(station.not_ready("servo on", why));
        }
        station.write("servo on", on(codec::COIL_SERVO)).await?;
        let deadline = clock.now() + SERVO_DEADLINE;
        loop {
            let status = Self::status(station).await?;
            if status.servo && status.ready {
                let homed = if status.homed { "homed" } else { "not homed" };
                return Ok(format!("IAI, servo on, {homed}"));
            }
            if clock.now() >= deadline {
                let why = format!("servo not on within {} s", SERVO_DEADLINE.as_secs());
                return Err(station.not_ready("servo on", why));
            }
            tokio::time::sleep(SERVO_POLL).await;
        }
    }
}
