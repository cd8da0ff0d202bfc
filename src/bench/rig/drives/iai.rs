//! IAI SCON/PCON/ERC2 electric actuators: stage axes in 0.01 mm (0.01 degree on a rotary).
//! PURE. Uses: `rig::axis`, `rig::device`, `link::Request`, `words`. Never: ports, waits, units other
//! than counts of 0.01 mm.
//!
//! Source: `docs/references.md`, "IAI controllers". Values that are unverified there are marked
//! `[unverified]` here and must be checked against the manual before the drive is trusted: the word
//! order (high first), the alarm code at 0x9002, the coil 0x0427 that transfers control from the
//! PIO to Modbus, the DSSE bit that reports who is in control, and what ends a pause.
//!
//! The map documents no deceleration stop except the pause, which holds the remaining travel and
//! resumes it when it ends. Before the next motion, the travel is therefore cancelled by an alarm
//! reset while paused `[unverified]`, then the pause is ended, then the new target replaces the old
//! one.

use crate::rig::axis::{Drive, DriveState, MoveOrder};
use crate::rig::device::AxisDevice;
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::motion::Going;
use crate::rig::station::Station;
use crate::rig::words::{bit, from_words, to_count, to_words};

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("iai", |parts| parts.on(Iai)).with_acceleration(rounded);

/// First register of the status block: PNOW (2), alarm code `[unverified]`, DIPM, DOPM, DSS1, DSS2,
/// DSSE, STAT (2).
const STATUS: u16 = 0x9000;
/// Number of registers of the status block.
const STATUS_COUNT: u16 = 10;
/// First register of the move block.
const MOVE: u16 = 0x9900;
/// Coil: servo on.
const COIL_SERVO: u16 = 0x0403;
/// Coil: alarm reset, by the change from off to on. While paused it also cancels the remaining travel `[unverified]`.
const COIL_ALARM_RESET: u16 = 0x0407;
/// Coil: pause. While it is on, the axis decelerates and holds.
const COIL_PAUSE: u16 = 0x040A;
/// Coil: homing, started by the change from off to on.
const COIL_HOME: u16 = 0x040B;
/// Coil: control by Modbus instead of the PIO `[unverified]`.
const COIL_MODBUS: u16 = 0x0427;

/// Counts of 0.01 mm/s^2 in 0.01 G of acceleration.
const COUNTS_PER_CENTI_G: f64 = 9806.65;
/// Largest value of the acceleration register, 0.01 G.
const ACCELERATION_MAX: i32 = 300;
/// Largest value of the speed register, 0.01 mm/s.
const SPEED_MAX: i32 = 999_999;

/// Switches a coil on.
fn on(address: u16) -> Request {
    Request::WriteCoil { address, on: true }
}

/// Switches a coil off.
fn off(address: u16) -> Request {
    Request::WriteCoil { address, on: false }
}

/// Parses the status block; `None` if it is too short. The map has no bit for motion: "out of position"
/// also covers it.
fn parse(block: &[u16]) -> Option<DriveState> {
    let (dss1, dsse) = (*block.get(5)?, *block.get(7)?);
    // DSS1: emergency stop pressed, controller ready, servo on, major alarm, homing complete, in position.
    let (emergency_stop, controller_ready, servo) = (bit(dss1, 15), bit(dss1, 13), bit(dss1, 12));
    let (fault, homed, in_position) = (bit(dss1, 10), bit(dss1, 4), bit(dss1, 3));
    let code = *block.get(2)?;
    let enabled = servo && controller_ready;
    Some(DriveState {
        counts: from_words(block, 0)?,
        going: if in_position { Going::Standing } else { Going::Unsure },
        homed,
        enabled,
        ready: enabled && !fault && !emergency_stop,
        fault,
        alarm: fault.then_some(u32::from(code)),
        emergency_stop,
        // DSSE bit 8 `[unverified]`: Modbus is in control, not the PIO.
        in_command: Some(bit(dsse, 8)),
    })
}

/// Converts counts/s^2 to 0.01 G, at least 1. Rounded down, except for the error of the division: the stated
/// acceleration is not exceeded.
fn centi_g(acceleration: f64) -> i32 {
    to_count((acceleration / COUNTS_PER_CENTI_G + 1e-9).floor(), ACCELERATION_MAX)
}

/// Acceleration to which the drive rounds this one, counts/s^2.
fn rounded(acceleration: f64) -> f64 {
    f64::from(centi_g(acceleration)) * COUNTS_PER_CENTI_G
}

/// The move block: target, band, speed, acceleration, no push, absolute positioning. Writing the
/// low word of the target starts the motion, so the block is written in one request.
fn move_block(order: &MoveOrder) -> Request {
    let band = to_count(order.tolerance, 999_999);
    // Rounded down: the stopping distance of a press allows no more.
    let speed = to_count(order.speed.floor(), SPEED_MAX);
    let long = [order.target, band, speed].into_iter().flat_map(to_words);
    let words = long.chain([centi_g(order.acceleration) as u16, 0, 0]).collect();
    Request::WriteRegisters { address: MOVE, words }
}

/// Drive on an IAI SCON, PCON or ERC2 controller.
#[derive(Debug, Clone, Copy, Default)]
struct Iai;

impl Drive for Iai {
    fn identity(&self, _: &[Vec<u16>], _: &Station) -> Result<String, RigError> {
        Ok("IAI".into())
    }

    fn status_requests(&self) -> Vec<Request> {
        vec![Request::ReadHolding { address: STATUS, count: STATUS_COUNT }]
    }

    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState> {
        parse(blocks.first()?)
    }

    fn prepare_requests(&self) -> Vec<Request> {
        vec![on(COIL_MODBUS), on(COIL_SERVO)]
    }

    fn move_requests(&self, order: &MoveOrder) -> Vec<Request> {
        vec![move_block(order)]
    }

    fn home_requests(&self) -> Vec<Request> {
        vec![off(COIL_HOME), on(COIL_HOME)]
    }

    fn stop_requests(&self) -> Vec<Request> {
        vec![on(COIL_PAUSE)]
    }

    /// The reset cancels the remaining travel, which would otherwise be resumed when the pause ends.
    fn release_requests(&self) -> Vec<Request> {
        let mut requests = self.reset_requests();
        requests.push(off(COIL_PAUSE));
        requests
    }

    /// The coil goes off first: it is still on if the end of an earlier reset was lost, and then has no edge.
    fn reset_requests(&self) -> Vec<Request> {
        vec![off(COIL_ALARM_RESET), on(COIL_ALARM_RESET), off(COIL_ALARM_RESET)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_is_one_block_in_hundredths() {
        let (speed, acceleration) = (25_000.9, 150e3);
        let (target, tolerance, torque_percent) = (12_345, 5.0, None);
        let order = MoveOrder { target, speed, acceleration, tolerance, torque_percent };
        // 1500 mm/s^2 = 0.153 G.
        let words = vec![0, 12345, 0, 5, 0, 25000, 15, 0, 0];
        assert_eq!(move_block(&order), Request::WriteRegisters { address: 0x9900, words });
    }

    #[test]
    fn slow_and_gentle_still_moves() {
        let (speed, acceleration) = (0.2, 10.0);
        let (target, tolerance, torque_percent) = (-1, 0.0, None);
        let order = MoveOrder { target, speed, acceleration, tolerance, torque_percent };
        let words = vec![0xFFFF, 0xFFFF, 0, 1, 0, 1, 1, 0, 0];
        assert_eq!(move_block(&order), Request::WriteRegisters { address: 0x9900, words });
    }

    #[test]
    fn an_acceleration_is_not_exceeded() {
        assert_eq!([98_066.5, 98_066.0, 19_000.0, 1e9].map(centi_g), [10, 9, 1, 300]);
        assert_eq!(DRIVE.acceleration(19_000.0), 9806.65);
    }

    /// Number of edges of the reset coil, and whether it is on at the end, after an earlier reset whose end was lost.
    fn resets(requests: Vec<Request>) -> (u32, bool) {
        // As the lost request has left it.
        let (mut is_on, mut edges) = (true, 0);
        for request in requests {
            let Request::WriteCoil { address: COIL_ALARM_RESET, on } = request else {
                panic!("{request}");
            };
            edges += u32::from(on && !is_on);
            is_on = on;
        }
        (edges, is_on)
    }

    #[test]
    fn an_alarm_reset_has_an_edge_although_the_end_of_the_last_one_was_lost() {
        assert_eq!(resets(Iai.reset_requests()), (1, false));
    }

    #[test]
    fn a_release_cancels_the_travel_although_the_end_of_the_last_reset_was_lost() {
        let mut requests = Iai.release_requests();
        assert_eq!(requests.pop(), Some(off(COIL_PAUSE)), "only after the reset");
        assert_eq!(resets(requests), (1, false));
    }

    #[test]
    fn the_status_block_is_read_bit_by_bit() {
        // -0.50 mm, alarm 0x0CC, DSS1 = servo + alarm + homed, DSSE = Modbus in command.
        let block = [0xFFFF, 0xFFCE, 0x00CC, 0, 0, 0x1410, 0, 0x0100, 0, 0];
        let state = parse(&block).unwrap();
        assert_eq!((state.counts, state.alarm, state.going), (-50, Some(0xCC), Going::Unsure));
        assert!(state.fault && state.homed && state.in_command == Some(true));
        assert!(!state.enabled && !state.ready && !state.emergency_stop);
        assert!(parse(&block[..7]).is_none());
    }

    #[test]
    fn an_axis_at_rest_in_position_is_ready() {
        let block = [0, 1000, 0, 0, 0, 0x3018, 0, 0, 0, 0x000D];
        let state = parse(&block).unwrap();
        assert!(state.ready && state.homed && !state.fault);
        assert_eq!((state.going, state.counts, state.alarm), (Going::Standing, 1000, None));
    }
}
