//! The register map of Leadshine EM2RS drives: requests and the meaning of replies.
//! PURE. Uses: `link::Request`, `words`. Never: ports, waits, units other than pulses and rpm.
//!
//! Source: `docs/references.md`, "Leadshine EM2RS drives". Positions are pulses, high word first;
//! speeds are whole rpm; accelerations are milliseconds per 1000 rpm.

use crate::rig::axis::{DriveState, MoveOrder};
use crate::rig::link::Request;
use crate::rig::motion::Going;
use crate::rig::words::{bit, from_words, to_count, to_words};

/// Register: pulses per revolution.
pub const PULSES_PER_REV: u16 = 0x0001;
/// Register: software enable.
pub const ENABLE: u16 = 0x000F;
/// Register: status word.
pub const STATUS: u16 = 0x1003;
/// Registers: feedback position, pulses.
pub const FEEDBACK: u16 = 0x1014;
/// Register: control word. The drive needs 50 ms between two writes to it.
pub const CONTROL: u16 = 0x1801;
/// Register: alarm code.
pub const ALARM: u16 = 0x2203;
/// Register: trigger of paths, homing and the quick stop.
pub const TRIGGER: u16 = 0x6002;
/// Registers of path 0: mode, position (2), rpm, acceleration, deceleration, pause, special.
pub const PATH_0: u16 = 0x6200;

/// Trigger: run path 0.
const RUN_PATH_0: u16 = 0x10;
/// Trigger: homing.
const HOME: u16 = 0x20;
/// Trigger: quick stop.
const QUICK_STOP: u16 = 0x40;
/// Control word: clear the alarm.
const CLEAR_ALARM: u16 = 0x1111;
/// Path mode: absolute positioning.
const MODE_ABSOLUTE: u16 = 1;
/// Largest speed of a path, rpm.
const RPM_MAX: i32 = 3000;
/// Range of the pulses per revolution that the drive can be set to.
pub const PULSES_RANGE: std::ops::RangeInclusive<u16> = 200..=51_200;

/// Requests a single register.
pub fn read_one(address: u16) -> Request {
    Request::ReadHolding { address, count: 1 }
}

/// Requests the feedback position.
pub fn read_feedback() -> Request {
    Request::ReadHolding { address: FEEDBACK, count: 2 }
}

/// Switches the motor on.
pub fn enable() -> Request {
    Request::WriteRegister { address: ENABLE, word: 1 }
}

/// Returns the request that starts homing.
pub fn home() -> Request {
    Request::WriteRegister { address: TRIGGER, word: HOME }
}

/// Starts a quick stop.
pub fn stop() -> Request {
    Request::WriteRegister { address: TRIGGER, word: QUICK_STOP }
}

/// Clears the alarm.
pub fn clear_alarm() -> Request {
    Request::WriteRegister { address: CONTROL, word: CLEAR_ALARM }
}

/// Converts pulses/s to whole rpm, at least 1.
pub fn rpm(pulses_per_s: f64, pulses_per_rev: u16) -> u16 {
    to_count(pulses_per_s * 60.0 / f64::from(pulses_per_rev), RPM_MAX) as u16
}

/// Converts pulses/s^2 to milliseconds per 1000 rpm, at least 1.
pub fn ms_per_1000_rpm(pulses_per_s2: f64, pulses_per_rev: u16) -> u16 {
    let rpm_per_s = pulses_per_s2 * 60.0 / f64::from(pulses_per_rev);
    to_count(1e6 / rpm_per_s, 65_535) as u16
}

/// An absolute motion: writes path 0, then triggers it.
pub fn move_by_path(order: &MoveOrder, pulses_per_rev: u16) -> [Request; 2] {
    let [high, low] = to_words(order.target);
    let ramp = ms_per_1000_rpm(order.acceleration, pulses_per_rev);
    let speed = rpm(order.speed, pulses_per_rev);
    let words = vec![MODE_ABSOLUTE, high, low, speed, ramp, ramp, 0, 0];
    [
        Request::WriteRegisters { address: PATH_0, words },
        Request::WriteRegister { address: TRIGGER, word: RUN_PATH_0 },
    ]
}

/// Parses status word and feedback position; `None` if a block is short.
pub fn parse(status: &[u16], feedback: &[u16]) -> Option<DriveState> {
    let word = *status.first()?;
    let fault = bit(word, 0);
    Some(DriveState {
        counts: from_words(feedback, 0)?,
        going: if bit(word, 2) { Going::Moving } else { Going::Standing },
        homed: bit(word, 6),
        ready: bit(word, 1) && !fault,
        fault,
        alarm: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2000 pulses/mm: 10000 pulses/rev on a 5 mm lead.
    #[test]
    fn a_move_is_a_path_and_its_trigger() {
        let (speed, acceleration) = (100_000.0, 2e6);
        let (target, tolerance, torque_percent) = (100_000, 40.0, None);
        let order = MoveOrder { target, speed, acceleration, tolerance, torque_percent };
        let [path, trigger] = move_by_path(&order, 10_000);
        // 600 rpm; 12000 rpm/s take 83 ms to 1000 rpm.
        let words = vec![1, 1, 0x86A0, 600, 83, 83, 0, 0];
        assert_eq!(path, Request::WriteRegisters { address: 0x6200, words });
        assert_eq!(trigger, Request::WriteRegister { address: 0x6002, word: 0x10 });
    }

    #[test]
    fn slow_speeds_keep_at_least_one_rpm() {
        assert_eq!(rpm(10.0, 10_000), 1);
        assert_eq!(rpm(6600.0, 10_000), 40);
        assert_eq!(rpm(1e9, 10_000), 3000);
        assert_eq!(ms_per_1000_rpm(1.0, 10_000), 65_535);
    }

    #[test]
    fn the_status_word_is_read_bit_by_bit() {
        let moving = parse(&[0b0000_0110], &[0, 7]).unwrap();
        assert_eq!((moving.going, moving.homed, moving.ready), (Going::Moving, false, true));
        let done = parse(&[0b0111_0010], &[0xFFFF, 0xFFF9]).unwrap();
        assert_eq!((done.going, done.homed, done.counts), (Going::Standing, true, -7));
        let fault = parse(&[0b11], &[0, 0]).unwrap();
        assert_eq!((fault.ready, fault.fault, fault.alarm), (false, true, None));
        assert_eq!(parse(&[2], &[0]), None);
    }
}
