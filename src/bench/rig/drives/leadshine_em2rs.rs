//! Leadshine / StepperOnline EM2RS, DM556RS, DM882RS: stepping drives in PR mode over RS-485.
//! PURE. Uses: `rig::axis`, `rig::device`, `link::Request`, `words`. Never: ports, waits, units other
//! than pulses and rpm.
//!
//! Source: `docs/references.md`, "Leadshine EM2RS drives". RTU, 38400 baud, 8N1 from the factory.
//! Positions are pulses, high word first; speeds are whole rpm; accelerations are milliseconds per
//! 1000 rpm.

use std::sync::atomic::{AtomicU16, Ordering};

use crate::rig::axis::{Drive, DriveState, MoveOrder};
use crate::rig::device::AxisDevice;
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::motion::Going;
use crate::rig::station::Station;
use crate::rig::words::{bit, from_words, to_count, to_words};

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("leadshine_em2rs", |parts| parts.on(LeadshineEm2rs::default()));

/// Register: pulses per revolution.
const PULSES_PER_REV: u16 = 0x0001;
/// Register: software enable.
const ENABLE: u16 = 0x000F;
/// Register: status word.
const STATUS: u16 = 0x1003;
/// Registers: feedback position, pulses.
const FEEDBACK: u16 = 0x1014;
/// Register: control word. The drive needs 50 ms between two writes to it.
const CONTROL: u16 = 0x1801;
/// Register: alarm code.
const ALARM: u16 = 0x2203;
/// Register: trigger of paths, homing and the quick stop.
const TRIGGER: u16 = 0x6002;
/// Registers of path 0: mode, position (2), rpm, acceleration, deceleration, pause, special.
const PATH_0: u16 = 0x6200;

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
const PULSES_RANGE: std::ops::RangeInclusive<u16> = 200..=51_200;

/// Pulses per revolution as set at the factory.
const FACTORY_PULSES_PER_REV: u16 = 10_000;

/// Requests a single register.
fn read_one(address: u16) -> Request {
    Request::ReadHolding { address, count: 1 }
}

/// Triggers a path, homing or the quick stop.
fn trigger(word: u16) -> Request {
    Request::WriteRegister { address: TRIGGER, word }
}

/// Converts pulses/s to whole rpm, at least 1. Rounded down: the stopping distance of a press allows no more.
fn rpm(pulses_per_s: f64, pulses_per_rev: u16) -> u16 {
    to_count((pulses_per_s * 60.0 / f64::from(pulses_per_rev)).floor(), RPM_MAX) as u16
}

/// Converts pulses/s^2 to milliseconds per 1000 rpm, at least 1.
fn ms_per_1000_rpm(pulses_per_s2: f64, pulses_per_rev: u16) -> u16 {
    let rpm_per_s = pulses_per_s2 * 60.0 / f64::from(pulses_per_rev);
    to_count(1e6 / rpm_per_s, 65_535) as u16
}

/// An absolute motion: writes path 0, then triggers it.
fn move_by_path(order: &MoveOrder, pulses_per_rev: u16) -> [Request; 2] {
    let [high, low] = to_words(order.target);
    let ramp = ms_per_1000_rpm(order.acceleration, pulses_per_rev);
    let speed = rpm(order.speed, pulses_per_rev);
    let words = vec![MODE_ABSOLUTE, high, low, speed, ramp, ramp, 0, 0];
    [Request::WriteRegisters { address: PATH_0, words }, trigger(RUN_PATH_0)]
}

/// Parses status word and feedback position; `None` if a block is short.
fn parse(status: &[u16], feedback: &[u16]) -> Option<DriveState> {
    let word = *status.first()?;
    let fault = bit(word, 0);
    Some(DriveState {
        counts: from_words(feedback, 0)?,
        going: if bit(word, 2) { Going::Moving } else { Going::Standing },
        homed: bit(word, 6),
        enabled: bit(word, 1) && !fault,
        ready: bit(word, 1) && !fault,
        fault,
        alarm: None,
        // Its status reports neither a hardware stop nor who else is in control.
        emergency_stop: false,
        in_command: None,
    })
}

/// A Leadshine EM2RS drive.
#[derive(Debug)]
struct LeadshineEm2rs {
    /// Pulses per revolution as last reported by the drive.
    pulses_per_rev: AtomicU16,
}

impl Default for LeadshineEm2rs {
    fn default() -> Self {
        Self { pulses_per_rev: AtomicU16::new(FACTORY_PULSES_PER_REV) }
    }
}

impl Drive for LeadshineEm2rs {
    fn identity_requests(&self) -> Vec<Request> {
        vec![read_one(PULSES_PER_REV)]
    }

    fn identity(&self, blocks: &[Vec<u16>], station: &Station) -> Result<String, RigError> {
        let pulses = blocks.iter().flatten().next().copied().unwrap_or(0);
        if !PULSES_RANGE.contains(&pulses) {
            let needed = "200 to 51200 (is this an EM2RS?)".into();
            return Err(station.wrong(format!("{pulses} pulses per revolution"), needed));
        }
        self.pulses_per_rev.store(pulses, Ordering::Relaxed);
        Ok(format!("Leadshine EM2RS, {pulses} pulses/rev"))
    }

    fn status_requests(&self) -> Vec<Request> {
        vec![read_one(STATUS), Request::ReadHolding { address: FEEDBACK, count: 2 }]
    }

    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState> {
        parse(blocks.first()?, blocks.get(1)?)
    }

    fn alarm_request(&self) -> Option<Request> {
        Some(read_one(ALARM))
    }

    fn prepare_requests(&self) -> Vec<Request> {
        vec![Request::WriteRegister { address: ENABLE, word: 1 }]
    }

    fn move_requests(&self, order: &MoveOrder) -> Vec<Request> {
        move_by_path(order, self.pulses_per_rev.load(Ordering::Relaxed)).to_vec()
    }

    /// One rpm.
    fn slowest(&self) -> f64 {
        f64::from(self.pulses_per_rev.load(Ordering::Relaxed)) / 60.0
    }

    fn home_requests(&self) -> Vec<Request> {
        vec![trigger(HOME)]
    }

    fn stop_requests(&self) -> Vec<Request> {
        vec![trigger(QUICK_STOP)]
    }

    fn release_requests(&self) -> Vec<Request> {
        Vec::new()
    }

    fn reset_requests(&self) -> Vec<Request> {
        vec![Request::WriteRegister { address: CONTROL, word: CLEAR_ALARM }]
    }
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
    fn a_speed_is_not_exceeded_and_is_at_least_one_rpm() {
        assert_eq!(rpm(10.0, 10_000), 1);
        assert_eq!(rpm(6600.0, 10_000), 39, "of 39.6");
        assert_eq!(rpm(200_000.0, 10_000), 1200);
        assert_eq!(rpm(1e9, 10_000), 3000);
        assert_eq!(ms_per_1000_rpm(1.0, 10_000), 65_535);
    }

    #[test]
    fn its_slowest_motion_is_one_rpm_of_the_pulses_that_it_has_reported() {
        let drive = LeadshineEm2rs::default();
        assert_eq!(rpm(drive.slowest(), 10_000), 1);
        drive.pulses_per_rev.store(600, Ordering::Relaxed);
        assert_eq!(drive.slowest(), 10.0);
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
