//! The register map of IAI controllers, as requests and meanings.
//! PURE. Uses: `link::Request`, `words`. Never: ports, waits, units other than counts of 0.01 mm.
//!
//! Source: `docs/references.md`, "IAI controllers". What is unverified there is marked
//! `[unverified]` here and must be checked against the manual before the drive is trusted: the word
//! order (high first), the alarm code at 0x9002, the coil 0x0427 that hands control from the PIO to
//! Modbus and the bit of DSSE that says who has it, and what ends a pause.

use crate::rig::axis::{DriveState, MoveOrder};
use crate::rig::link::Request;
use crate::rig::motion::Going;
use crate::rig::words::{bit, from_words, to_count, to_words};

/// First register of the status block: PNOW (2), alarm code `[unverified]`, DIPM, DOPM, DSS1, DSS2,
/// DSSE, STAT (2).
pub const STATUS: u16 = 0x9000;
/// Registers of the status block.
pub const STATUS_COUNT: u16 = 10;
/// First register of the move block.
pub const MOVE: u16 = 0x9900;
/// Coil: servo on.
pub const COIL_SERVO: u16 = 0x0403;
/// Coil: alarm reset. While paused it also cancels the travel that is left `[unverified]`.
pub const COIL_ALARM_RESET: u16 = 0x0407;
/// Coil: pause. On, the axis decelerates and holds.
pub const COIL_PAUSE: u16 = 0x040A;
/// Coil: homing, at the change from off to on.
pub const COIL_HOME: u16 = 0x040B;
/// Coil: control by Modbus instead of the PIO `[unverified]`.
pub const COIL_MODBUS: u16 = 0x0427;

/// Counts of 0.01 mm/s^2 in 0.01 G of acceleration.
const COUNTS_PER_CENTI_G: f64 = 9806.65;
/// Most that the acceleration register takes, 0.01 G.
const ACCELERATION_MAX: i32 = 300;
/// Most that the speed register takes, 0.01 mm/s.
const SPEED_MAX: i32 = 999_999;

/// A coil switched on or off.
pub fn coil(address: u16, on: bool) -> Request {
    Request::WriteCoil { address, on }
}

/// Reads the status block.
pub fn read_status() -> Request {
    Request::ReadHolding { address: STATUS, count: STATUS_COUNT }
}

/// What the status block says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status {
    /// PNOW: position, 0.01 mm.
    pub position: i32,
    /// Alarm code; 0 without an alarm.
    pub alarm_code: u16,
    /// DSS1 bit 15: the controller's own emergency stop is pressed.
    pub emergency: bool,
    /// DSS1 bit 13: controller ready.
    pub ready: bool,
    /// DSS1 bit 12: servo on.
    pub servo: bool,
    /// DSS1 bit 10: major alarm.
    pub alarm: bool,
    /// DSS1 bit 4: homing done.
    pub homed: bool,
    /// DSS1 bit 3: in position.
    pub in_position: bool,
    /// DSSE bit 8 `[unverified]`: Modbus is in command, not the PIO.
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

    /// The state that the axis needs. The map has no bit for "moves": out of position is both.
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

/// The move block: target, band, speed, acceleration, no push, plain absolute positioning. Writing
/// the target's low word starts the move, and the block is written at once.
pub fn move_block(order: &MoveOrder) -> Request {
    let [target_high, target_low] = to_words(order.target);
    let [band_high, band_low] = to_words(to_count(order.tolerance, 1, 999_999));
    let [speed_high, speed_low] = to_words(to_count(order.speed, 1, SPEED_MAX));
    let acceleration = to_count(order.acceleration / COUNTS_PER_CENTI_G, 1, ACCELERATION_MAX);
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
