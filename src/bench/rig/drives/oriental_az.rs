//! Oriental Motor AZ (AZD-KD): absolute-encoder stepping motors, driven by direct data operation.
//! PURE. Uses: `rig::axis`, `rig::device`, `link::Request`, `words`. Never: ports, waits, units other
//! than steps.
//!
//! Source: `docs/references.md`, "Oriental Motor AZ drivers". RTU, 115200 baud and even parity from
//! the factory; all values are 32-bit, high word at the lower address. Bits of the output status are
//! the default remote outputs of the drive `[unverified]`: check them against the manual and the
//! setup of the drive before use. The register of the communication timeout is unverified too, and
//! that it takes effect immediately and until power-off.

use crate::rig::axis::{Drive, DriveState, GuardRequest, MoveOrder};
use crate::rig::config::Guard;
use crate::rig::device::AxisDevice;
use crate::rig::error::RigError;
use crate::rig::link::Request;
use crate::rig::motion::Going;
use crate::rig::station::Station;
use crate::rig::words::{bit, from_words, to_count, to_words};

/// The drive as rig files name it.
pub const DRIVE: AxisDevice =
    AxisDevice::new("oriental_az", |parts| parts.on(OrientalAz)).with_guards();

/// Direct data operation: data number, type, position, speed, start rate, stop rate, current,
/// trigger; sixteen registers, written as one block.
const OPERATION: u16 = 0x0058;
/// Registers: current of the direct data operation, 0.1 %, which limits the torque.
const CURRENT: u16 = 0x0064;
/// Registers: driver input command.
const INPUT: u16 = 0x007C;
/// Registers: driver output status, followed by the present alarm.
const OUTPUT: u16 = 0x007E;
/// Registers: feedback position, steps.
const FEEDBACK: u16 = 0x00CC;
/// Registers: communication timeout, ms; 0 disables it `[unverified]`.
const TIMEOUT: u16 = 0x138A;

/// Input command bit 4, homing: by default ZHOME `[unverified]`, a return to the home that the drive
/// already has, instead of a search for one.
const IN_HOME: i32 = 1 << 4;
/// Input command bit 5: stop.
const IN_STOP: i32 = 1 << 5;
/// Input command bit 7: alarm reset.
const IN_ALARM_RESET: i32 = 1 << 7;

/// Output status bits in the low word at 0x007F `[unverified]`.
mod output {
    /// HOME-END: homing is complete.
    pub const HOME_END: u32 = 4;
    /// READY: the drive accepts a command. Off while it moves.
    pub const READY: u32 = 5;
    /// ALM-A: an alarm is active.
    pub const ALARM: u32 = 7;
    /// MOVE: the motor moves.
    pub const MOVE: u32 = 13;
}

/// Operation type: absolute positioning.
const ABSOLUTE: i32 = 1;
/// Counts of the current per percent.
const CURRENT_PER_PERCENT: u32 = 10;
/// Trigger: all registers of the block.
const TRIGGER_ALL: i32 = 1;
/// Largest speed, Hz.
const SPEED_MAX: i32 = 4_000_000;
/// Largest rate, 0.001 kHz/s = Hz/s.
const RATE_MAX: i32 = 1_000_000_000;

/// Writes the input command.
fn input(bits: i32) -> Request {
    Request::WriteRegisters { address: INPUT, words: to_words(bits).to_vec() }
}

/// Register value of the current for a torque limit; 100 % without one.
fn current(torque_percent: Option<u32>) -> i32 {
    (torque_percent.unwrap_or(100) * CURRENT_PER_PERCENT) as i32
}

/// An absolute motion as direct data operation.
fn move_block(order: &MoveOrder) -> Request {
    let rate = to_count(order.acceleration, RATE_MAX);
    let values = [
        0,
        ABSOLUTE,
        order.target,
        // Rounded down: the stopping distance of a press allows no more.
        to_count(order.speed.floor(), SPEED_MAX),
        rate,
        rate,
        current(order.torque_percent),
        TRIGGER_ALL,
    ];
    let words = values.into_iter().flat_map(to_words).collect();
    Request::WriteRegisters { address: OPERATION, words }
}

/// Parses output status, alarm and feedback position; `None` if a block is short.
fn parse(output: &[u16], feedback: &[u16]) -> Option<DriveState> {
    let low = *output.get(1)?;
    let code = from_words(output, 2)? as u32;
    let (moving, alarm) = (bit(low, output::MOVE), bit(low, output::ALARM));
    let ready = (bit(low, output::READY) || moving) && !alarm;
    Some(DriveState {
        counts: from_words(feedback, 0)?,
        going: if moving { Going::Moving } else { Going::Standing },
        homed: bit(low, output::HOME_END),
        enabled: ready,
        ready,
        fault: alarm,
        alarm: alarm.then_some(code),
        // Its outputs report neither a hardware stop nor who else is in control.
        emergency_stop: false,
        in_command: None,
    })
}

/// An Oriental Motor AZ driver.
#[derive(Debug, Clone, Copy, Default)]
struct OrientalAz;

impl Drive for OrientalAz {
    fn identity(&self, _: &[Vec<u16>], _: &Station) -> Result<String, RigError> {
        Ok("Oriental Motor AZ".into())
    }

    fn status_requests(&self) -> Vec<Request> {
        vec![
            Request::ReadHolding { address: OUTPUT, count: 4 },
            Request::ReadHolding { address: FEEDBACK, count: 2 },
        ]
    }

    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState> {
        parse(blocks.first()?, blocks.get(1)?)
    }

    /// The motor is excited from power-up. FREE, STOP and the other bits of the input command are
    /// cleared; then the outputs must report READY.
    fn prepare_requests(&self) -> Vec<Request> {
        vec![input(0)]
    }

    fn move_requests(&self, order: &MoveOrder) -> Vec<Request> {
        vec![move_block(order)]
    }

    fn home_requests(&self) -> Vec<Request> {
        vec![input(0), input(IN_HOME), input(0)]
    }

    fn stop_requests(&self) -> Vec<Request> {
        vec![input(IN_STOP), input(0)]
    }

    fn release_requests(&self) -> Vec<Request> {
        vec![input(0)]
    }

    /// The bit goes off first: it is still on if the end of an earlier reset was lost, and then has no edge.
    fn reset_requests(&self) -> Vec<Request> {
        vec![input(0), input(IN_ALARM_RESET), input(0)]
    }

    /// The current is also part of the block of each motion; homing has its own current, which these do not limit.
    fn guard_requests(&self, guard: &Guard) -> Vec<GuardRequest> {
        let request = |key, address, value: i32| {
            let words = to_words(value).to_vec();
            let write = Request::WriteRegisters { address, words: words.clone() };
            GuardRequest { key, write, read: Request::ReadHolding { address, count: 2 }, words }
        };
        let watchdog = guard.watchdog_ms.map(|ms| request("watchdog_ms", TIMEOUT, ms as i32));
        let torque = guard.torque_percent;
        let torque = torque.map(|p| request("torque_percent", CURRENT, current(Some(p))));
        watchdog.into_iter().chain(torque).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_is_one_block_of_sixteen() {
        let (speed, acceleration) = (2000.9, 1.5e5);
        let (target, tolerance, torque_percent) = (-70_000, 5.0, None);
        let order = MoveOrder { target, speed, acceleration, tolerance, torque_percent };
        let Request::WriteRegisters { address, words } = move_block(&order) else {
            panic!("a block write");
        };
        assert_eq!(address, 0x0058);
        let expected = [0, 0, 0, 1, 0xFFFE, 0xEE90, 0, 2000, 2, 0x49F0, 2, 0x49F0, 0, 1000, 0, 1];
        assert_eq!(words, expected);
        let Request::WriteRegisters { words, .. } = move_block(&MoveOrder { speed: 0.2, ..order })
        else {
            panic!("a block write");
        };
        assert_eq!(words[6..8], [0, 1], "the slowest");
        let weak = move_block(&MoveOrder { torque_percent: Some(60), ..order });
        let Request::WriteRegisters { words, .. } = weak else { panic!("a block write") };
        assert_eq!(words[12..], [0, 600, 0, 1]);
    }

    #[test]
    fn a_guard_is_written_and_the_same_words_are_expected_back() {
        assert_eq!(OrientalAz.guard_requests(&Guard::default()), []);
        let guard = Guard { watchdog_ms: Some(70_000), torque_percent: Some(60) };
        let requests = OrientalAz.guard_requests(&guard);
        let keys: Vec<_> = requests.iter().map(|r| r.key).collect();
        assert_eq!(keys, ["watchdog_ms", "torque_percent"]);
        assert_eq!(requests[0].words, [1, 4464]);
        let write = Request::WriteRegisters { address: 0x0064, words: vec![0, 600] };
        assert_eq!(requests[1].write, write);
        assert_eq!(requests[1].read, Request::ReadHolding { address: 0x0064, count: 2 });
    }

    #[test]
    fn the_outputs_are_read_bit_by_bit() {
        let moving = parse(&[0, 0x2010, 0, 0], &[0, 500]).unwrap();
        assert_eq!((moving.going, moving.homed, moving.ready), (Going::Moving, true, true));
        let standing = parse(&[0, 0x4020, 0, 0], &[0xFFFF, 0xFFFF]).unwrap();
        assert_eq!((standing.going, standing.homed), (Going::Standing, false));
        assert_eq!((standing.ready, standing.counts), (true, -1));
        let alarm = parse(&[0, 0x00A0, 0, 0x30], &[0, 0]).unwrap();
        assert_eq!((alarm.ready, alarm.alarm), (false, Some(0x30)));
        assert_eq!(parse(&[0, 0x20, 0], &[0, 0]), None);
    }
}
