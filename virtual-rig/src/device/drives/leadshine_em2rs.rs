//! Leadshine EM2RS (StepperOnline DM556RS and DM882RS): PR mode, positions in pulses.
//! Registers from `docs/references.md`, "Leadshine EM2RS drives"; the high word of a position is
//! first. The value read back from the trigger register is (unverified). PURE.
//! Never: clocks, wires; jog, velocity paths, chained paths and saved parameters are omitted.

use crate::device::{Answer, AxisDevice, AxisMap, counts, high, long, low};
use crate::drive::{Alarm, Drive, Servo};
use crate::kinematics::Pace;
use crate::modbus::{Exception, Reply};

const PULSES_PER_TURN: u16 = 0x0001;
const DIRECTION: u16 = 0x0007;
const ENABLE: u16 = 0x000F;
const BAUD: u16 = 0x01BD;
const STATION: u16 = 0x01BF;
const DATA_TYPE: u16 = 0x01C1;
const STATUS: u16 = 0x1003;
const FOLLOWING_ERROR: u16 = 0x1010;
const COMMANDED: u16 = 0x1012;
const FEEDBACK: u16 = 0x1014;
const VELOCITY: u16 = 0x1046;
const CONTROL: u16 = 0x1801;
const PRESENT_ALARM: u16 = 0x2203;
const GLOBAL: u16 = 0x6000;
const TRIGGER: u16 = 0x6002;
const SOFT_LIMITS: u16 = 0x6006;
const HOME: u16 = 0x600A;
const HOME_WORDS: usize = 9;
const PATHS: u16 = 0x6200;
const PATH_COUNT: usize = 16;
const PATH_WORDS: usize = 8;

const CONTROL_CLEAR_ALARM: u16 = 0x1111;
const CONTROL_SAVE: u16 = 0x2211;
const TRIGGER_HOME: u16 = 0x20;
const TRIGGER_SET_ZERO: u16 = 0x21;
const TRIGGER_STOP: u16 = 0x40;
/// Value read back while a path runs: this plus the low byte of the trigger.
const TRIGGER_RUNNING: u16 = 0x100;
/// Global bit that enables the soft limits (unverified).
const GLOBAL_SOFT_LIMITS: u16 = 1 << 1;

const MODE_KIND: u16 = 0x0F;
const MODE_POSITION: u16 = 1;
const MODE_HOME: u16 = 3;
const MODE_RELATIVE: u16 = 0x40;

/// Pulses per revolution at the factory setting, to which the scale of the rig file refers.
const FACTORY_PULSES: u16 = 10_000;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice = AxisDevice {
    name: "leadshine_em2rs",
    servo_at_power_up: Servo::On,
    map: |counts_per_unit, _| Box::new(Em2rs::new(counts_per_unit)),
};

/// State of the register map.
#[derive(Debug, Clone)]
pub struct Em2rs {
    /// Axis units per revolution: the lead of the screw.
    units_per_turn: f64,
    pulses_per_turn: u16,
    direction: u16,
    enable: u16,
    global: u16,
    soft_limits: [u16; 4],
    home: [u16; HOME_WORDS],
    paths: Vec<[u16; PATH_WORDS]>,
    /// Last trigger, for reading it back.
    trigger: u16,
    path_commanded: bool,
}

impl Em2rs {
    /// Creates a drive at power-up: enabled, factory settings.
    pub fn new(counts_per_unit: f64) -> Self {
        Self {
            units_per_turn: f64::from(FACTORY_PULSES) / counts_per_unit,
            pulses_per_turn: FACTORY_PULSES,
            direction: 0,
            enable: 1,
            global: 0,
            soft_limits: [0; 4],
            home: [0, 0, 0, 0, 0, 200, 50, 100, 100],
            paths: vec![[0, 0, 0, 60, 100, 100, 0, 0]; PATH_COUNT],
            trigger: 0,
            path_commanded: false,
        }
    }
}

impl AxisMap for Em2rs {
    fn copy(&self) -> Box<dyn AxisMap> {
        Box::new(self.clone())
    }

    // Nothing was saved: all values return to the factory settings.
    fn power_cycle(&mut self) {
        *self = Self::new(f64::from(FACTORY_PULSES) / self.units_per_turn);
    }

    fn register(&self, address: u16, drive: &Drive, t_s: f64) -> Option<u16> {
        if let Some((path, word)) = path_word(address) {
            return Some(self.paths[path][word]);
        }
        let pair = |value: f64, base: u16| {
            let pulses = counts(value, self.pulses_per_unit());
            if address == base { high(pulses) } else { low(pulses) }
        };
        let (counter, commanded) = (drive.counter(t_s), drive.commanded_counter(t_s));
        Some(match address {
            PULSES_PER_TURN => self.pulses_per_turn,
            DIRECTION => self.direction,
            ENABLE => self.enable,
            BAUD => 4,
            STATION => 1,
            DATA_TYPE => 4,
            STATUS => self.status(drive, t_s),
            FOLLOWING_ERROR | 0x1011 => pair(commanded - counter, FOLLOWING_ERROR),
            COMMANDED | 0x1013 => pair(commanded, COMMANDED),
            FEEDBACK | 0x1015 => pair(counter, FEEDBACK),
            VELOCITY => {
                let rpm = drive.velocity(t_s) / self.units_per_turn * 60.0;
                (rpm.round() as i32) as u16
            }
            CONTROL => 0,
            PRESENT_ALARM => drive.alarm().map_or(0, alarm_code),
            GLOBAL => self.global,
            TRIGGER => match self.trigger {
                running if drive.moving(t_s) && running < TRIGGER_STOP => {
                    TRIGGER_RUNNING | running & 0x2F
                }
                done => done & 0x0F,
            },
            0x6006..=0x6009 => self.soft_limits[usize::from(address - SOFT_LIMITS)],
            0x600A..=0x6012 => self.home[usize::from(address - HOME)],
            _ => return None,
        })
    }

    fn write(&mut self, address: u16, values: &[u16], drive: &mut Drive, t_s: f64) -> Answer {
        for (i, &value) in values.iter().enumerate() {
            let a = address.checked_add(i as u16).ok_or(Exception::IllegalAddress)?;
            self.set(a, value, drive, t_s)?;
        }
        Ok(Reply::Written)
    }
}

impl Em2rs {
    fn pulses_per_unit(&self) -> f64 {
        f64::from(self.pulses_per_turn) / self.units_per_turn
    }

    fn set(
        &mut self,
        address: u16,
        value: u16,
        drive: &mut Drive,
        t_s: f64,
    ) -> Result<(), Exception> {
        if let Some((path, word)) = path_word(address) {
            self.paths[path][word] = value;
            return Ok(());
        }
        let offset = |base: u16, words: usize| {
            address.checked_sub(base).map(usize::from).filter(|&o| o < words)
        };
        if let Some(o) = offset(SOFT_LIMITS, 4) {
            self.soft_limits[o] = value;
            return Ok(());
        }
        if let Some(o) = offset(HOME, HOME_WORDS) {
            self.home[o] = value;
            return Ok(());
        }
        match address {
            PULSES_PER_TURN if (200..=51_200).contains(&value) => self.pulses_per_turn = value,
            DIRECTION if value <= 1 => self.direction = value,
            ENABLE if value <= 1 => {
                self.enable = value;
                drive.set_servo(t_s, Servo::on_if(value == 1 && drive.alarm().is_none()));
            }
            GLOBAL => self.global = value,
            CONTROL => match value {
                CONTROL_CLEAR_ALARM => {
                    drive.reset_alarm();
                    drive.set_servo(t_s, Servo::on_if(self.enable == 1));
                }
                CONTROL_SAVE => {}
                _ => return Err(Exception::IllegalValue),
            },
            TRIGGER => self.trigger(value, drive, t_s)?,
            PULSES_PER_TURN | DIRECTION | ENABLE => return Err(Exception::IllegalValue),
            _ => return Err(Exception::IllegalAddress),
        }
        Ok(())
    }

    fn trigger(&mut self, value: u16, drive: &mut Drive, t_s: f64) -> Result<(), Exception> {
        match value {
            0x10..=0x1F => {
                self.trigger = value;
                self.run(usize::from(value - 0x10), drive, t_s)
            }
            TRIGGER_HOME => {
                self.trigger = value;
                self.home(drive, t_s)
            }
            TRIGGER_SET_ZERO => {
                drive.set_zero(t_s);
                self.trigger = 0;
                Ok(())
            }
            TRIGGER_STOP => {
                drive.stop(t_s);
                self.trigger = value;
                self.path_commanded = false;
                Ok(())
            }
            _ => Err(Exception::IllegalValue),
        }
    }

    fn able(&self, drive: &Drive) -> Result<(), Exception> {
        let able = drive.alarm().is_none() && drive.servo() && self.enable == 1;
        if able { Ok(()) } else { Err(Exception::DeviceFailure) }
    }

    fn home(&mut self, drive: &mut Drive, t_s: f64) -> Result<(), Exception> {
        self.able(drive)?;
        self.path_commanded = false;
        drive.start_home(t_s);
        Ok(())
    }

    fn run(&mut self, path: usize, drive: &mut Drive, t_s: f64) -> Result<(), Exception> {
        let [mode, high, low, rpm, acc, dec, ..] = self.paths[path];
        match mode & MODE_KIND {
            MODE_HOME => return self.home(drive, t_s),
            MODE_POSITION => {}
            _ => return Err(Exception::DeviceFailure),
        }
        self.able(drive)?;
        let mut pulses = long(high, low);
        if mode & MODE_RELATIVE != 0 {
            pulses += counts(drive.commanded_counter(t_s), self.pulses_per_unit());
        }
        if self.global & GLOBAL_SOFT_LIMITS != 0 {
            let [ph, pl, nh, nl] = self.soft_limits;
            pulses = pulses.min(long(ph, pl)).max(long(nh, nl));
        }
        // Ramps are stated as ms per 1000 rpm.
        let ramp = |ms: u16| 1000.0 / 60.0 / (f64::from(ms.max(1)) / 1e3) * self.units_per_turn;
        let speed = f64::from(rpm.max(1)) / 60.0 * self.units_per_turn;
        let pace = Pace { speed, acceleration: ramp(acc), deceleration: ramp(dec) };
        self.path_commanded = true;
        drive.start_move(t_s, f64::from(pulses) / self.pulses_per_unit(), pace);
        Ok(())
    }

    fn status(&self, drive: &Drive, t_s: f64) -> u16 {
        let idle = !drive.moving(t_s);
        u16::from(drive.alarm().is_some())
            | u16::from(drive.servo()) << 1
            | u16::from(!idle) << 2
            | u16::from(idle) << 4
            | u16::from(idle && self.path_commanded) << 5
            | u16::from(drive.homed()) << 6
    }
}

fn path_word(address: u16) -> Option<(usize, usize)> {
    let offset = usize::from(address.checked_sub(PATHS)?);
    (offset < PATH_COUNT * PATH_WORDS).then_some((offset / PATH_WORDS, offset % PATH_WORDS))
}

/// Alarm code of Leadshine.
fn alarm_code(alarm: Alarm) -> u16 {
    match alarm {
        Alarm::ServoOff | Alarm::NotHomed | Alarm::BadCommand => 0x40,
        Alarm::Deviation => 0x80,
        Alarm::Scripted(code) => code,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::on_a_stage::{self, STAGE};
    use crate::modbus::Request;

    fn ready() -> (Em2rs, Drive) {
        let (mut map, mut drive) = (Em2rs::new(2000.0), Drive::power_up(STAGE, 40.0, Servo::On));
        map.serve(&set(TRIGGER, TRIGGER_HOME), &mut drive, 0.0).unwrap();
        drive.refresh(20.0);
        (map, drive)
    }

    fn set(address: u16, value: u16) -> Request {
        Request::WriteRegister { address, value }
    }

    fn path(pulses: i32) -> Request {
        let values = vec![MODE_POSITION, high(pulses), low(pulses), 1200, 80, 80, 0, 0];
        Request::WriteRegisters { address: PATHS, values }
    }

    fn read(map: &mut Em2rs, drive: &mut Drive, address: u16, t_s: f64) -> u16 {
        let [word] = on_a_stage::read(map, drive, address, t_s);
        word
    }

    #[test]
    fn a_path_runs_only_when_triggered() {
        let (mut map, mut drive) = ready();
        map.serve(&path(200_000), &mut drive, 30.0).unwrap();
        assert!(!drive.moving(30.0));
        map.serve(&set(TRIGGER, 0x10), &mut drive, 30.0).unwrap();
        assert_eq!(read(&mut map, &mut drive, STATUS, 30.1), 1 << 1 | 1 << 2 | 1 << 6);
        assert_eq!(read(&mut map, &mut drive, TRIGGER, 30.1), 0x100);
        let done = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 6;
        assert_eq!(read(&mut map, &mut drive, STATUS, 40.0), done);
        assert_eq!(read(&mut map, &mut drive, TRIGGER, 40.0), 0);
        let words =
            [FEEDBACK, FEEDBACK + 1].map(|address| read(&mut map, &mut drive, address, 40.0));
        assert_eq!(long(words[0], words[1]), 200_000);
        assert_eq!(drive.position(40.0), 100.0);
    }

    #[test]
    fn a_quick_stop_ends_the_path_and_does_not_hold() {
        let (mut map, mut drive) = ready();
        map.serve(&path(200_000), &mut drive, 30.0).unwrap();
        map.serve(&set(TRIGGER, 0x10), &mut drive, 30.0).unwrap();
        map.serve(&set(TRIGGER, TRIGGER_STOP), &mut drive, 30.5).unwrap();
        assert!(drive.position(35.0) < 100.0);
        assert_eq!(read(&mut map, &mut drive, STATUS, 35.0) & 1 << 5, 0);
        map.serve(&set(TRIGGER, 0x10), &mut drive, 35.0).unwrap();
        assert_eq!(drive.position(60.0), 100.0);
        assert_eq!(drive.stops(), 1);
    }

    #[test]
    fn more_pulses_in_a_turn_make_shorter_pulses() {
        let (mut map, mut drive) = ready();
        map.serve(&set(PULSES_PER_TURN, 20_000), &mut drive, 30.0).unwrap();
        map.serve(&path(200_000), &mut drive, 30.0).unwrap();
        map.serve(&set(TRIGGER, 0x10), &mut drive, 30.0).unwrap();
        assert_eq!(drive.position(60.0), 50.0);
    }

    #[test]
    fn what_it_does_not_have_is_refused() {
        let (mut map, mut drive) = ready();
        let at = |map: &mut Em2rs, drive: &mut Drive, r: Request| map.serve(&r, drive, 0.0);
        let illegal_value = Err(Exception::IllegalValue);
        assert_eq!(at(&mut map, &mut drive, set(TRIGGER, 0x99)), illegal_value);
        assert_eq!(at(&mut map, &mut drive, set(PULSES_PER_TURN, 100)), illegal_value);
        assert_eq!(at(&mut map, &mut drive, set(0x3000, 1)), Err(Exception::IllegalAddress));
        assert_eq!(at(&mut map, &mut drive, set(STATUS, 1)), Err(Exception::IllegalAddress));
        drive.trip(0.0, Alarm::Deviation);
        let refused = at(&mut map, &mut drive, set(TRIGGER, 0x20));
        assert_eq!(refused, Err(Exception::DeviceFailure));
    }
}
