//! The register map of IAI controllers: requests and the meaning of replies.
//! PURE. Uses: `link::Request`, `words`. Never: ports, waits, units other than counts of 0.01 mm.
//!
//! Source: `docs/references.md`, "IAI controllers". Values that are unverified there are marked
//! `[unverified]` here and must be checked against the manual before the drive is trusted: the word
//! order (high first), the alarm code at 0x9002, the coil 0x0427 that transfers control from the
//! PIO to Modbus, the DSSE bit that reports who is in control, and what ends a pause.

use crate::rig::axis::{DriveState, MoveOrder};
use crate::rig::link::Request;
use crate::rig::motion::Going;
use crate::rig::words::{bit, from_words, to_count, to_words};

/// First register of the status block: PNOW (2), alarm code `[unverified]`, DIPM, DOPM, DSS1, DSS2,
/// DSSE, STAT (2).
pub const STATUS: u16 = 0x9000;
/// Number of registers of the status block.
pub const STATUS_COUNT: u16 = 10;
/// First register of the move block.
pub const MOVE: u16 = 0x9900;
/// Coil: servo on.
pub const COIL_SERVO: u16 = 0x0403;
/// Coil: alarm reset. While paused it also cancels the remaining travel `[unverified]`.
pub const COIL_ALARM_RESET: u16 = 0x0407;
/// Coil: pause. While it is on, the axis decelerates and holds.
pub const COIL_PAUSE: u16 = 0x040A;
/// Coil: homing, started by the change from off to on.
pub const COIL_HOME: u16 = 0x040B;
/// Coil: control by Modbus instead of the PIO `[unverified]`.
pub const COIL_MODBUS: u16 = 0x0427;

/// Counts of 0.01 mm/s^2 in 0.01 G of acceleration.
const COUNTS_PER_CENTI_G: f64 = 9806.65;
/// Largest value of the acceleration register, 0.01 G.
const ACCELERATION_MAX: i32 = 300;
/// Largest value of the speed register, 0.01 mm/s.
const SPEED_MAX: i32 = 999_999;

/// Switches a coil on.
pub fn on(address: u16) -> Request {
    Request::WriteCoil { address, on: true }
}

/// Switches a coil off.
pub fn off(address: u16) -> Request {
    Request::WriteCoil { address, on: false }
}

/// Requests the status block.
pub fn read_status() -> Request {
    Request::ReadHolding { address: STATUS, count: STATUS_COUNT }
}

/// Values of the status block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status {
    /// PNOW: measured position, 0.01 mm.
    pub position: i32,
    /// Alarm code; 0 without an alarm.
    pub alarm_code: u16,
    /// DSS1 bit 15: the emergency stop of the controller is pressed.
    pub emergency: bool,
    /// DSS1 bit 13: the controller is ready.
    pub ready: bool,
    /// DSS1 bit 12: the servo is on.
    pub servo: bool,
    /// DSS1 bit 10: a major alarm is active.
    pub alarm: bool,
    /// DSS1 bit 4: homing is complete.
    pub homed: bool,
    /// DSS1 bit 3: the axis is in position.
    pub in_position: bool,
    /// DSSE bit 8 `[unverified]`: Modbus is in control, not the PIO.
    pub modbus: bool,
}

impl Status {
    /// Parses the status block; `None` if it is too short.
    pub fn parse(block: &[u16]) -> Option<Self> {
        let (dss1, dsse) = (*block.get(5)?, *block.get(7)?);
        Some(Self {
            position: from_words(block, 0)?,
            alarm_code: *block.get(2)?,
            emergency: bit(dss1, 15),
            ready: bit(dss1, 13),
            servo: bit(dss1, 12),
            alarm: bit(dss1, 10),
            homed: bit(dss1, 4),
            in_position: bit(dss1, 3),
            modbus: bit(dsse, 8),
        })
    }

    /// State for the axis. The map has no bit for motion: "out of position" also covers it.
    pub fn state(&self) -> DriveState {
        DriveState {
            counts: self.position,
            going: if self.in_position { Going::Standing } else { Going::Unsure },
            homed: self.homed,
            ready: self.servo && self.ready && !self.alarm && !self.emergency,
            fault: self.alarm,
            alarm: self.alarm.then_some(u32::from(self.alarm_code)),
        }
    }
}

/// The move block: target, band, speed, acceleration, no push, absolute positioning. Writing the
/// low word of the target starts the motion, so the block is written in one request.
pub fn move_block(order: &MoveOrder) -> Request {
    let [target_high, target_low] = to_words(order.target);
    let [band_high, band_low] = to_words(to_count(order.tolerance, 999_999));
    let [speed_high, speed_low] = to_words(to_count(order.speed, SPEED_MAX));
    let acceleration = to_count(order.acceleration / COUNTS_PER_CENTI_G, ACCELERATION_MAX);
    let words = vec![
        target_high,
        target_low,
        band_high,
        band_low,
        speed_high,
        speed_low,
        acceleration as u16,
        0,
        0,
    ];
    Request::WriteRegisters { address: MOVE, words }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_is_one_block_in_hundredths() {
        let (speed, acceleration) = (25e3, 150e3);
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
    fn the_status_block_is_read_bit_by_bit() {
        // -0.50 mm, alarm 0x0CC, DSS1 = servo + alarm + homed, DSSE = Modbus in command.
        let block = [0xFFFF, 0xFFCE, 0x00CC, 0, 0, 0x1410, 0, 0x0100, 0, 0];
        let status = Status::parse(&block).unwrap();
        assert_eq!(status.position, -50);
        assert!(status.servo && status.alarm && status.homed && status.modbus);
        assert!(!status.ready && !status.emergency && !status.in_position);
        assert_eq!(status.state().alarm, Some(0xCC));
        assert_eq!(status.state().going, Going::Unsure);
        assert!(Status::parse(&block[..7]).is_none());
    }

    #[test]
    fn an_axis_at_rest_in_position_is_ready() {
        let block = [0, 1000, 0, 0, 0, 0x3018, 0, 0, 0, 0x000D];
        let state = Status::parse(&block).unwrap().state();
        assert!(state.ready && state.homed && !state.fault);
        assert_eq!((state.going, state.counts, state.alarm), (Going::Standing, 1000, None));
    }
}
