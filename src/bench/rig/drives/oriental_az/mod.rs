//! Oriental Motor AZ (AZD-KD): absolute-encoder stepping motors, driven by direct data operation.
//! Uses: `codec`, `rig::device`, `rig::axis`, `rig::station`. Never: register
//! addresses, another device's registers.
//!
//! Source: `docs/references.md`, "Oriental Motor AZ drivers". RTU, 115200 baud and even parity from
//! the factory.

pub mod codec;

use std::time::Duration;

use crate::clock::Clock;
use crate::rig::axis::{Drive, DriveState, GuardRequest, MoveOrder};
use crate::rig::config::Guard;
use crate::rig::device::AxisDevice;
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::station::Station;
use crate::rig::traits::Found;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("oriental_az", |parts| parts.on(OrientalAz)).with_guards();

/// Longest wait for READY after an alarm was reset or FREE ended, wall time.
const READY_DEADLINE: Duration = Duration::from_secs(1);
/// Period at which READY is checked.
const READY_POLL: Duration = Duration::from_millis(10);

/// An Oriental Motor AZ driver.
#[derive(Debug, Clone, Copy, Default)]
pub struct OrientalAz;

impl OrientalAz {
    async fn state(station: &Station) -> Result<DriveState, RigError> {
        let output = station.read("output status", codec::read_output()).await?;
        let feedback = station.read("feedback position", codec::read_feedback()).await?;
        let state = codec::parse(&output, &feedback);
        state.ok_or_else(|| station.garbled("output status", "too few registers".into()))
    }
}

impl Drive for OrientalAz {
    fn status_requests(&self) -> Vec<Request> {
        vec![codec::read_output(), codec::read_feedback()]
    }

    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState> {
        codec::parse(blocks.first()?, blocks.get(1)?)
    }

    fn move_requests(&self, order: &MoveOrder) -> Vec<Request> {
        vec![codec::move_block(order)]
    }

    fn home_requests(&self) -> Vec<Request> {
        vec![codec::input(0), codec::input(codec::IN_HOME), codec::input(0)]
    }

    fn stop_requests(&self) -> Vec<Request> {
        vec![codec::input(codec::IN_STOP), codec::input(0)]
    }

    fn release_requests(&self) -> Vec<Request> {
        vec![codec::input(0)]
    }

    fn reset_requests(&self) -> Vec<Request> {
        vec![codec::input(codec::IN_ALARM_RESET), codec::input(0)]
    }

    fn guard_requests(&self, guard: &Guard) -> Vec<GuardRequest> {
        codec::guard_requests(guard)
    }

    async fn identify(&self, station: &Station) -> Result<Found, RigError> {
        let state = Self::state(station).await?;
        Ok(Found {
            device: "Oriental Motor AZ".into(),
            enabled: state.ready,
            homed: state.homed,
            alarm: state.alarm,
            // Its outputs report neither a hardware stop nor who else is in control.
            emergency_stop: false,
            in_command: None,
        })
    }

    /// The motor is excited from power-up. FREE, STOP and the other bits of the input command are
    /// cleared; then the outputs must report READY.
    async fn prepare(&self, station: &Station, clock: &Clock) -> Result<String, RigError> {
        station.write("clear the input command", codec::input(0)).await?;
        let deadline = clock.now() + READY_DEADLINE;
        loop {
            let state = Self::state(station).await?;
            if let Some(code) = state.alarm {
                return Err(station.not_ready("motion", format!("alarm 0x{code:02X}")));
            }
            if state.ready {
                let homed = if state.homed { "homed" } else { "not homed" };
                return Ok(format!("Oriental Motor AZ, ready, {homed}"));
            }
            if clock.now() >= deadline {
                let why = format!("READY output off for {} s", READY_DEADLINE.as_secs());
                return Err(station.not_ready("motion", why));
            }
            tokio::time::sleep(READY_POLL).await;
        }
    }
}
