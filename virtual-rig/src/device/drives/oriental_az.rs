//! Oriental Motor AZ: direct data operation in one block of eight 32-bit values.
//! Registers from `docs/references.md`, "Oriental Motor AZ drivers"; the high word is at the lower
//! address. Output and input bits have the factory assignment (unverified). Also unverified are the
//! register of the communication timeout and its effect: the motor decelerates to standstill; the
//! alarm that a driver may raise in addition is omitted. PURE.
//! Never: clocks, wires; stored data operation, push and wrap motion are omitted.

use crate::device::{Answer, AxisDevice, AxisMap, counts, high, long, low};
use crate::drive::{Alarm, Drive, Servo};
use crate::kinematics::Pace;
use crate::modbus::{Exception, Reply};

/// Direct data operation: data number, type, position, speed, start and stop rate, current,
/// trigger; each a 32-bit value.
const DIRECT_DATA: u16 = 0x0058;
const DIRECT_DATA_WORDS: usize = 16;
const TYPE: usize = 1;
const POSITION: usize = 2;
const SPEED: usize = 3;
const START_RATE: usize = 4;
const STOP_RATE: usize = 5;
const TRIGGER: usize = 7;

const TYPE_ABSOLUTE: i32 = 1;
const TYPE_RELATIVE_COMMAND: i32 = 2;
const TYPE_RELATIVE_FEEDBACK: i32 = 3;

const INPUT: u16 = 0x007C;
const IN_HOME: u16 = 1 << 4;
const IN_STOP: u16 = 1 << 5;
const IN_FREE: u16 = 1 << 6;
const IN_ALARM_RESET: u16 = 1 << 7;

const OUTPUT: u16 = 0x007E;
const OUT_HOME_END: u16 = 1 << 4;
const OUT_READY: u16 = 1 << 5;
const OUT_ALARM: u16 = 1 << 7;
const OUT_MOVE: u16 = 1 << 13;
const OUT_IN_POSITION: u16 = 1 << 14;

/// Communication timeout, wall ms; 0 disables it (unverified).
const TIMEOUT: u16 = 0x138A;
/// Largest communication timeout, ms.
const TIMEOUT_MAX_MS: i32 = 10_000;

const PRESENT_ALARM: u16 = 0x0080;
const COMMAND_POSITION: u16 = 0x00C6;
const FEEDBACK_POSITION: u16 = 0x00CC;
const FEEDBACK_RPM: u16 = 0x00CE;
const FEEDBACK_HZ: u16 = 0x00D0;
const TORQUE: u16 = 0x00D6;

/// Steps per revolution at the factory resolution.
const STEPS_PER_TURN: f64 = 1000.0;
/// Largest pulse rate of a driver, Hz.
const TOP_HZ: i32 = 4_000_000;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice = AxisDevice {
    name: "oriental_az",
    servo_at_power_up: Servo::On,
    map: |counts_per_unit, clock_rate| Box::new(OrientalAz::new(counts_per_unit, clock_rate)),
};

/// State of the register map.
#[derive(Debug, Clone)]
pub struct OrientalAz {
    counts_per_unit: f64,
    block: [u16; DIRECT_DATA_WORDS],
    input: [u16; 2],
    timeout: [u16; 2],
    /// Process seconds per wall second.
    clock_rate: f64,
    /// Process time of the last request, s; none before the first, or after the watchdog has
    /// expired.
    heard_s: Option<f64>,
}

impl OrientalAz {
    /// Creates a driver at power-up: motor excited, all values at the factory settings.
    pub fn new(counts_per_unit: f64, clock_rate: f64) -> Self {
        let mut az = Self {
            counts_per_unit,
            block: [0; DIRECT_DATA_WORDS],
            input: [0; 2],
            timeout: [0; 2],
            clock_rate,
            heard_s: None,
        };
        for (i, value) in
            [(TYPE, 2), (SPEED, 1000), (START_RATE, 1_000_000), (STOP_RATE, 1_000_000), (6, 1000)]
        {
            (az.block[2 * i], az.block[2 * i + 1]) = (high(value), low(value));
        }
        az
    }
}

impl AxisMap for OrientalAz {
    fn copy(&self) -> Box<dyn AxisMap> {
        Box::new(self.clone())
    }

    fn power_cycle(&mut self) {
        *self = Self::new(self.counts_per_unit, self.clock_rate);
    }

    fn hear(&mut self, t_s: f64) {
        self.heard_s = Some(t_s);
    }

    fn watchdog_s(&self) -> Option<f64> {
        let ms = long(self.timeout[0], self.timeout[1]);
        let after_s = f64::from(ms) * 1e-3 * self.clock_rate;
        self.heard_s.filter(|_| ms > 0).map(|heard_s| heard_s + after_s)
    }

    fn watch(&mut self, drive: &mut Drive, t_s: f64) {
        if self.watchdog_s().is_some_and(|end_s| t_s >= end_s) {
            self.heard_s = None;
            if drive.moving(t_s) {
                drive.brake(t_s);
            }
        }
    }

    fn register(&self, address: u16, drive: &Drive, t_s: f64) -> Option<u16> {
        if let Some(&word) =
            address.checked_sub(DIRECT_DATA).and_then(|offset| self.block.get(usize::from(offset)))
        {
            return Some(word);
        }
        let base = address & !1;
        let hertz = counts(drive.velocity(t_s), self.counts_per_unit);
        let value = match base {
            INPUT => return Some(self.input[usize::from(address - INPUT)]),
            OUTPUT => i32::from(self.output(drive, t_s)),
            PRESENT_ALARM => drive.alarm().map_or(0, |a| i32::from(alarm_code(a))),
            COMMAND_POSITION => counts(drive.commanded_counter(t_s), self.counts_per_unit),
            FEEDBACK_POSITION => counts(drive.counter(t_s), self.counts_per_unit),
            FEEDBACK_RPM => (f64::from(hertz) / STEPS_PER_TURN * 60.0).round() as i32,
            FEEDBACK_HZ => hertz,
            TORQUE => 0,
            TIMEOUT => long(self.timeout[0], self.timeout[1]),
            _ => return None,
        };
        Some(if address == base { high(value) } else { low(value) })
    }

    fn write(&mut self, address: u16, values: &[u16], drive: &mut Drive, t_s: f64) -> Answer {
        let end = usize::from(address) + values.len();
        if address >= DIRECT_DATA && end <= usize::from(DIRECT_DATA) + DIRECT_DATA_WORDS {
            let first = usize::from(address - DIRECT_DATA);
            self.block[first..first + values.len()].copy_from_slice(values);
            if end == usize::from(DIRECT_DATA) + DIRECT_DATA_WORDS {
                let trigger = self.value(TRIGGER);
                (self.block[14], self.block[15]) = (0, 0);
                return self.trigger(trigger, drive, t_s);
            }
            return Ok(Reply::Written);
        }
        if address >= INPUT && end <= usize::from(INPUT) + 2 {
            let mut input = self.input;
            let first = usize::from(address - INPUT);
            input[first..first + values.len()].copy_from_slice(values);
            self.set_input(input, drive, t_s);
            return Ok(Reply::Written);
        }
        if address == TIMEOUT && values.len() == 2 {
            if !(0..=TIMEOUT_MAX_MS).contains(&long(values[0], values[1])) {
                return Err(Exception::IllegalValue);
            }
            self.timeout = [values[0], values[1]];
            return Ok(Reply::Written);
        }
        Err(Exception::IllegalAddress)
    }
}

impl OrientalAz {
    /// The nth 32-bit value of the block.
    fn value(&self, n: usize) -> i32 {
        long(self.block[2 * n], self.block[2 * n + 1])
    }

    /// A trigger of 1 starts with all values; -1 to -7 update one value of the running operation,
    /// which here continues with the present block.
    fn trigger(&self, trigger: i32, drive: &mut Drive, t_s: f64) -> Answer {
        match trigger {
            0 => Ok(Reply::Written),
            1 => self.start(drive, t_s),
            -7..=-1 if drive.moving(t_s) => self.start(drive, t_s),
            -7..=-1 => Ok(Reply::Written),
            _ => Err(Exception::IllegalValue),
        }
    }

    fn start(&self, drive: &mut Drive, t_s: f64) -> Answer {
        if drive.alarm().is_some() || !drive.servo() || self.input[1] & IN_STOP != 0 {
            return Err(Exception::DeviceFailure);
        }
        let speed_hz = self.value(SPEED);
        let rates = [self.value(START_RATE), self.value(STOP_RATE)];
        if !(1..=TOP_HZ).contains(&speed_hz) || rates.iter().any(|&r| r < 1) {
            drive.trip(t_s, Alarm::BadCommand);
            return Ok(Reply::Written);
        }
        let step = f64::from(self.value(POSITION)) / self.counts_per_unit;
        let target = match self.value(TYPE) {
            TYPE_ABSOLUTE => step,
            TYPE_RELATIVE_COMMAND => drive.commanded_counter(t_s) + step,
            TYPE_RELATIVE_FEEDBACK => drive.counter(t_s) + step,
            _ => return Err(Exception::IllegalValue),
        };
        if self.value(TYPE) == TYPE_ABSOLUTE && !drive.homed() {
            drive.trip(t_s, Alarm::NotHomed);
            return Ok(Reply::Written);
        }
        // 0.001 kHz/s is 1 step/s^2.
        let pace = Pace {
            speed: f64::from(speed_hz) / self.counts_per_unit,
            acceleration: f64::from(rates[0]) / self.counts_per_unit,
            deceleration: f64::from(rates[1]) / self.counts_per_unit,
        };
        drive.start_move(t_s, target, pace);
        Ok(Reply::Written)
    }

    fn set_input(&mut self, input: [u16; 2], drive: &mut Drive, t_s: f64) {
        let rising = input[1] & !self.input[1];
        if rising & IN_ALARM_RESET != 0 {
            drive.reset_alarm();
            drive.set_servo(t_s, Servo::On);
        }
        if (input[1] ^ self.input[1]) & IN_FREE != 0 {
            drive.set_servo(t_s, Servo::on_if(input[1] & IN_FREE == 0));
        }
        if input[1] & IN_STOP != 0 {
            drive.stop(t_s);
        } else if rising & IN_HOME != 0 && drive.alarm().is_none() && drive.servo() {
            drive.start_home(t_s);
        }
        self.input = input;
    }

    fn output(&self, drive: &Drive, t_s: f64) -> u16 {
        let moving = drive.moving(t_s);
        let alarm = drive.alarm().is_some();
        let stopped = self.input[1] & IN_STOP != 0;
        let mut out = self.input[1] & 0b1111;
        let mut set = |on: bool, bit: u16| out |= if on { bit } else { 0 };
        set(drive.homed(), OUT_HOME_END);
        set(!moving && !alarm && !stopped && drive.servo(), OUT_READY);
        set(alarm, OUT_ALARM);
        set(moving, OUT_MOVE);
        set(!moving, OUT_IN_POSITION);
        out
    }
}

/// Alarm code of Oriental Motor.
fn alarm_code(alarm: Alarm) -> u16 {
    match alarm {
        Alarm::ServoOff => 0x6E,
        Alarm::NotHomed => 0x4A,
        Alarm::BadCommand => 0x70,
        Alarm::Deviation => 0x10,
        Alarm::Scripted(code) => code,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::on_a_stage::{STAGE, read};
    use crate::modbus::Request;

    fn ready() -> (OrientalAz, Drive) {
        let mut map = OrientalAz::new(200.0, 20.0);
        let mut drive = Drive::power_up(STAGE, 40.0, Servo::On);
        input(&mut map, &mut drive, IN_HOME, 0.0);
        input(&mut map, &mut drive, 0, 0.1);
        drive.refresh(20.0);
        (map, drive)
    }

    fn input(map: &mut OrientalAz, drive: &mut Drive, word: u16, t_s: f64) {
        let request = Request::WriteRegister { address: 0x007D, value: word };
        assert_eq!(map.serve(&request, drive, t_s), Ok(Reply::Written));
    }

    fn go(position: i32, speed_hz: i32) -> Request {
        let block = [0, TYPE_ABSOLUTE, position, speed_hz, 300_000, 300_000, 1000, 1];
        let values = block.iter().flat_map(|&v| [high(v), low(v)]).collect();
        Request::WriteRegisters { address: DIRECT_DATA, values }
    }

    fn read_long(map: &mut OrientalAz, drive: &mut Drive, address: u16, t_s: f64) -> i32 {
        let [high, low] = read(map, drive, address, t_s);
        long(high, low)
    }

    #[test]
    fn one_block_moves_the_axis() {
        let (mut map, mut drive) = ready();
        assert_eq!(map.serve(&go(40_000, 50_000), &mut drive, 30.0), Ok(Reply::Written));
        let moving = read_long(&mut map, &mut drive, OUTPUT, 30.2);
        assert_eq!(moving & i32::from(OUT_MOVE | OUT_READY | OUT_HOME_END), 0x2010);
        assert_eq!(read_long(&mut map, &mut drive, FEEDBACK_POSITION, 40.0), 40_000);
        let there = read_long(&mut map, &mut drive, OUTPUT, 40.0);
        assert_eq!(there, i32::from(OUT_READY | OUT_HOME_END | OUT_IN_POSITION));
    }

    #[test]
    fn a_held_stop_input_refuses_every_start() {
        let (mut map, mut drive) = ready();
        map.serve(&go(40_000, 50_000), &mut drive, 30.0).unwrap();
        input(&mut map, &mut drive, IN_STOP, 30.3);
        let refused = map.serve(&go(40_000, 50_000), &mut drive, 31.0);
        assert_eq!(refused, Err(Exception::DeviceFailure));
        input(&mut map, &mut drive, 0, 31.0);
        assert_eq!(map.serve(&go(0, 50_000), &mut drive, 31.0), Ok(Reply::Written));
        assert_eq!(drive.position(60.0), 0.0);
        assert_eq!(drive.stops(), 1);
    }

    #[test]
    fn an_absolute_move_before_homing_is_an_alarm() {
        let mut map = OrientalAz::new(200.0, 20.0);
        let mut drive = Drive::power_up(STAGE, 40.0, Servo::On);
        map.serve(&go(40_000, 50_000), &mut drive, 0.0).unwrap();
        assert_eq!(read_long(&mut map, &mut drive, PRESENT_ALARM, 0.0), 0x4A);
        assert!(!drive.moving(0.0));
        input(&mut map, &mut drive, IN_ALARM_RESET, 1.0);
        assert_eq!(read_long(&mut map, &mut drive, PRESENT_ALARM, 1.0), 0);
    }

    #[test]
    fn a_watchdog_stops_the_motor_when_no_request_has_come_for_so_long() {
        let (mut map, mut drive) = ready();
        assert_eq!(map.watchdog_s(), None);
        let set = |ms: u16| Request::WriteRegisters { address: TIMEOUT, values: vec![0, ms] };
        assert_eq!(map.serve(&set(20_000), &mut drive, 25.0), Err(Exception::IllegalValue));
        // 50 wall ms are one process second here.
        assert_eq!(map.serve(&set(50), &mut drive, 25.0), Ok(Reply::Written));
        assert_eq!(read_long(&mut map, &mut drive, TIMEOUT, 25.0), 50);
        map.serve(&go(100_000, 20_000), &mut drive, 30.0).unwrap();
        map.hear(30.0);
        map.hear(30.8);
        assert_eq!(map.watchdog_s(), Some(31.8));
        map.watch(&mut drive, 31.7);
        assert!(drive.velocity(31.7) > 90.0, "100 mm/s, undisturbed");
        map.watch(&mut drive, 31.8);
        assert!(!drive.moving(32.0) && drive.position(40.0) < 200.0);
        assert_eq!((drive.alarm(), drive.stops(), map.watchdog_s()), (None, 0, None));
        map.power_cycle();
        assert_eq!(read_long(&mut map, &mut drive, TIMEOUT, 41.0), 0, "not stored");
    }

    #[test]
    fn what_it_does_not_have_is_refused() {
        let (mut map, mut drive) = ready();
        let coil = Request::WriteCoil { address: 0, on: true };
        assert_eq!(map.serve(&coil, &mut drive, 0.0), Err(Exception::IllegalFunction));
        let read = Request::ReadRegisters { function: 3, address: 0x0100, count: 1 };
        assert_eq!(map.serve(&read, &mut drive, 0.0), Err(Exception::IllegalAddress));
        let write = Request::WriteRegister { address: FEEDBACK_POSITION, value: 1 };
        assert_eq!(map.serve(&write, &mut drive, 0.0), Err(Exception::IllegalAddress));
    }
}
