//! Driving an AZ: operation data in one block, homing and stop by the input command's edges.
//! Uses: `codec`, `rig::axis`. Never: register addresses.

use super::codec;
use crate::clock::Clock;
use crate::rig::axis::{Drive, DriveState, MoveOrder};
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::station::Station;

/// An Oriental Motor AZ driver.
#[derive(Debug, Clone, Copy, Default)]
pub struct OrientalAz;

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

    /// The motor is excited from power-up; FREE, STOP and the rest of the input command are
    /// cleared, and the outputs must say ready.
    async fn prepare(&self, station: &Station, _clock: &Clock) -> Result<String, RigError> {
        station.write("clear the input command", codec::input(0)).await?;
        let output = station.read("output status", codec::read_output()).await?;
        let feedback = station.read("feedback position", codec::read_feedback()).await?;
        let state = codec::parse(&output, &feedback)
            .ok_or_else(|| station.garbled("output status", "too few registers".into()))?;
        if let Some(code) = state.alarm {
            return Err(station.not_ready("motion", format!("alarm 0x{code:02X}")));
        }
        if !state.ready {
            return Err(station.not_ready("motion", "its READY output is off".into()));
        }
        let homed = if state.homed { "homed" } else { "not homed" };
        Ok(format!("Oriental Motor AZ, ready, {homed}"))
    }
}
