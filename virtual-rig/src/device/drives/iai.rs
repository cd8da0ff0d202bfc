//! IAI SCON/PCON: positions in hundredths, coils for servo, homing and pause, one block of
//! registers whose low position word starts the motion.
//! Registers from `docs/references.md`, "IAI controllers"; values known only from memory are marked
//! (unverified). PURE.
//! Never: clocks, wires; push motion, position tables and PIO patterns are omitted.

use crate::device::{Answer, AxisDevice, AxisMap, counts, high, long, low, serve_registers};
use crate::drive::{Alarm, Drive, Servo};
use crate::kinematics::Pace;
use crate::modbus::{Exception, Reply, Request};

/// Standard gravity, mm/s^2; accelerations are in 0.01 G.
const GRAVITY: f64 = 9806.65;

const SERVO: u16 = 0x0403;
const ALARM_RESET: u16 = 0x0407;
const PAUSE: u16 = 0x040A;
const HOME: u16 = 0x040B;
/// PIO/Modbus switch (unverified): until it is on, motion commands are acknowledged and ignored.
const MODBUS_COMMANDS: u16 = 0x0427;
/// Deceleration stop (unverified): clears itself.
const DECELERATION_STOP: u16 = 0x042C;

const PNOW: u16 = 0x9000;
const ALARM_CODE: u16 = 0x9002;
const DSS1: u16 = 0x9005;
const DSSE: u16 = 0x9007;
const STAT: u16 = 0x9008;
const VNOW: u16 = 0x900A;
const DEVI: u16 = 0x900E;
const MONITOR_END: u16 = 0x9015;

/// First register of a direct command, and its number of registers.
const PCMD: u16 = 0x9900;
const COMMAND_WORDS: usize = 9;
/// Offsets in the command.
const PCMD_LOW: usize = 1;
const FLAGS: usize = 8;
/// Relative motion (unverified).
const FLAG_RELATIVE: u16 = 1 << 3;

/// The drive as rig files name it.
pub const DRIVE: AxisDevice = AxisDevice {
    name: "iai",
    servo_at_power_up: Servo::Off,
    map: |counts_per_unit, _| Box::new(Iai::new(counts_per_unit)),
};

/// State of the register map.
#[derive(Debug, Clone)]
pub struct Iai {
    counts_per_unit: f64,
    /// Last written position, band, speed, acceleration, push and flags.
    block: [u16; COMMAND_WORDS],
    modbus_commands: bool,
    pause: bool,
    home_coil: bool,
    reset_coil: bool,
    /// Remaining action when the pause ends.
    held: Option<Held>,
}

#[derive(Debug, Clone, Copy)]
enum Held {
    Move(f64, Pace),
    Home,
}

impl Iai {
    /// Creates a controller at power-up: servo off, PIO in control.
    pub fn new(counts_per_unit: f64) -> Self {
        let mut block = [0; COMMAND_WORDS];
        block[3] = 10;
        Self {
            counts_per_unit,
            block,
            modbus_commands: false,
            pause: false,
            home_coil: false,
            reset_coil: false,
            held: None,
        }
    }
}

impl AxisMap for Iai {
    fn copy(&self) -> Box<dyn AxisMap> {
        Box::new(self.clone())
    }

    fn power_cycle(&mut self) {
        *self = Self::new(self.counts_per_unit);
    }

    fn register(&self, address: u16, drive: &Drive, t_s: f64) -> Option<u16> {
        if let Some(offset) = address.checked_sub(PCMD).map(usize::from) {
            return self.block.get(offset).copied();
        }
        let pair = |value: i32, base: u16| if address == base { high(value) } else { low(value) };
        Some(match address {
            PNOW | 0x9001 => pair(counts(drive.counter(t_s), self.counts_per_unit), PNOW),
            ALARM_CODE => drive.alarm().map_or(0, alarm_code),
            DSS1 => self.dss1(drive, t_s),
            DSSE => self.dsse(drive, t_s),
            STAT => 0,
            0x9009 => {
                1 | u16::from(drive.servo()) << 1
                    | u16::from(drive.servo()) << 2
                    | u16::from(drive.homed()) << 3
            }
            VNOW | 0x900B => pair(counts(drive.velocity(t_s), self.counts_per_unit), VNOW),
            DEVI | 0x900F => {
                let off = drive.commanded_counter(t_s) - drive.counter(t_s);
                pair(counts(off, self.counts_per_unit), DEVI)
            }
            _ if (PNOW..=MONITOR_END).contains(&address) => 0,
            _ => return None,
        })
    }

    fn write(&mut self, address: u16, values: &[u16], drive: &mut Drive, t_s: f64) -> Answer {
        let first = address.checked_sub(PCMD).map(usize::from);
        let first =
            first.filter(|f| f + values.len() <= COMMAND_WORDS).ok_or(Exception::IllegalAddress)?;
        self.block[first..first + values.len()].copy_from_slice(values);
        if (first..first + values.len()).contains(&PCMD_LOW) && self.modbus_commands {
            let (mut target, pace) = (self.commanded(), self.pace());
            if self.block[FLAGS] & FLAG_RELATIVE != 0 {
                target += drive.counter(t_s);
            }
            self.go(Held::Move(target, pace), drive, t_s);
        }
        Ok(Reply::Written)
    }

    fn serve(&mut self, request: &Request, drive: &mut Drive, t_s: f64) -> Answer {
        match *request {
            Request::ReadBits { function: 1, address, count } => {
                let bits: Option<Vec<bool>> = (0..count)
                    .map(|i| address.checked_add(i).and_then(|a| self.bit(a, drive, t_s)))
                    .collect();
                bits.map(Reply::Bits).ok_or(Exception::IllegalAddress)
            }
            Request::WriteCoil { address, on } => self.write_coil(address, on, drive, t_s),
            _ => serve_registers(self, request, drive, t_s),
        }
    }
}

impl Iai {
    fn write_coil(&mut self, address: u16, on: bool, drive: &mut Drive, t_s: f64) -> Answer {
        match address {
            MODBUS_COMMANDS => self.modbus_commands = on,
            SERVO if self.modbus_commands && !(on && drive.alarm().is_some()) => {
                drive.set_servo(t_s, Servo::on_if(on));
            }
            ALARM_RESET => {
                if on && !self.reset_coil {
                    drive.reset_alarm();
                    self.held = None;
                }
                self.reset_coil = on;
            }
            PAUSE if on != self.pause => self.set_pause(on, drive, t_s),
            PAUSE if on => drive.stop(t_s),
            HOME => {
                if on && !self.home_coil && self.modbus_commands {
                    self.go(Held::Home, drive, t_s);
                }
                self.home_coil = on;
            }
            DECELERATION_STOP => {
                if on {
                    self.held = None;
                    drive.stop(t_s);
                }
            }
            SERVO | PAUSE => {}
            _ => return Err(Exception::IllegalAddress),
        }
        Ok(Reply::Written)
    }

    fn set_pause(&mut self, on: bool, drive: &mut Drive, t_s: f64) {
        self.pause = on;
        if on {
            if drive.homing() {
                self.held = Some(Held::Home);
            } else if drive.moving(t_s) {
                let target = self.commanded();
                self.held = Some(Held::Move(target, self.pace()));
            }
            drive.stop(t_s);
        } else if let Some(held) = self.held.take() {
            self.go(held, drive, t_s);
        }
    }

    /// Executes a motion, or raises an alarm with the reason.
    fn go(&mut self, what: Held, drive: &mut Drive, t_s: f64) {
        if drive.alarm().is_some() {
            return;
        }
        if !drive.servo() {
            return drive.trip(t_s, Alarm::ServoOff);
        }
        if self.pause {
            self.held = Some(what);
            return;
        }
        match what {
            Held::Home => drive.start_home(t_s),
            Held::Move(..) if !drive.homed() => drive.trip(t_s, Alarm::NotHomed),
            Held::Move(target, pace) => {
                let mechanism = *drive.mechanism();
                let [lower, upper] = mechanism.travel;
                let within = (lower - 1e-9..=upper + 1e-9).contains(&target)
                    && pace.speed > 0.0
                    && pace.speed <= mechanism.top_speed()
                    && pace.acceleration > 0.0
                    && pace.acceleration <= mechanism.top_acceleration();
                if within {
                    drive.start_move(t_s, target, pace);
                } else {
                    drive.trip(t_s, Alarm::BadCommand);
                }
            }
        }
    }

    /// Commanded position in the axis's unit.
    fn commanded(&self) -> f64 {
        f64::from(long(self.block[0], self.block[PCMD_LOW])) / self.counts_per_unit
    }

    fn pace(&self) -> Pace {
        let acceleration = f64::from(self.block[6]) * 0.01 * GRAVITY;
        Pace {
            speed: f64::from(long(self.block[4], self.block[5])) / self.counts_per_unit,
            acceleration,
            deceleration: acceleration,
        }
    }

    fn in_position(&self, drive: &Drive, t_s: f64) -> bool {
        let band = f64::from(long(self.block[2], self.block[3])) / self.counts_per_unit;
        let left = drive.commanded_end_counter() - drive.counter(t_s);
        !drive.homing() && self.held.is_none() && left.abs() <= band.max(0.5 / self.counts_per_unit)
    }

    fn dss1(&self, drive: &Drive, t_s: f64) -> u16 {
        let major = drive.alarm().is_some();
        u16::from(!major) << 13
            | u16::from(drive.servo()) << 12
            | u16::from(major) << 10
            | u16::from(self.pause) << 5
            | u16::from(drive.homed()) << 4
            | u16::from(self.in_position(drive, t_s)) << 3
    }

    /// Expansion status (unverified): enabled, Modbus in control, moving.
    fn dsse(&self, drive: &Drive, t_s: f64) -> u16 {
        1 << 15 | u16::from(self.modbus_commands) << 8 | u16::from(drive.moving(t_s)) << 5
    }

    fn bit(&self, address: u16, drive: &Drive, t_s: f64) -> Option<bool> {
        let of = |word: u16, base: u16| word >> (15 - (address - base)) & 1 == 1;
        Some(match address {
            0x0100..=0x010F => of(self.dss1(drive, t_s), 0x0100),
            0x0120..=0x012F => of(self.dsse(drive, t_s), 0x0120),
            SERVO => drive.servo(),
            ALARM_RESET => self.reset_coil,
            PAUSE => self.pause,
            HOME => self.home_coil,
            MODBUS_COMMANDS => self.modbus_commands,
            DECELERATION_STOP => false,
            _ => return None,
        })
    }
}

/// Alarm code of IAI.
fn alarm_code(alarm: Alarm) -> u16 {
    match alarm {
        Alarm::ServoOff => 0x080,
        Alarm::NotHomed => 0x083,
        Alarm::BadCommand => 0x0A3,
        Alarm::Deviation => 0x0D8,
        Alarm::Scripted(code) => code,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::on_a_stage::{self, STAGE};

    struct Rig {
        map: Iai,
        drive: Drive,
    }

    impl Rig {
        fn new() -> Self {
            Self { map: Iai::new(100.0), drive: Drive::power_up(STAGE, 40.0, Servo::Off) }
        }

        fn ready() -> Self {
            let mut rig = Self::new();
            for coil in [MODBUS_COMMANDS, SERVO, HOME] {
                rig.coil(coil, true, 0.0);
            }
            rig.drive.refresh(20.0);
            assert!(rig.drive.homed());
            rig
        }

        fn coil(&mut self, address: u16, on: bool, t_s: f64) {
            let request = Request::WriteCoil { address, on };
            assert_eq!(self.map.serve(&request, &mut self.drive, t_s), Ok(Reply::Written));
        }

        fn go(&mut self, hundredths: i32, t_s: f64) {
            let values = vec![high(hundredths), low(hundredths), 0, 10, 0, 25_000, 15, 0, 0];
            let request = Request::WriteRegisters { address: PCMD, values };
            assert_eq!(self.map.serve(&request, &mut self.drive, t_s), Ok(Reply::Written));
        }

        fn read(&mut self, address: u16, t_s: f64) -> u16 {
            let [word] = on_a_stage::read(&mut self.map, &mut self.drive, address, t_s);
            word
        }
    }

    #[test]
    fn nothing_moves_before_modbus_has_command_and_the_servo_is_on() {
        let mut rig = Rig::new();
        rig.coil(SERVO, true, 0.0);
        assert!(!rig.drive.servo());
        rig.coil(MODBUS_COMMANDS, true, 0.0);
        rig.go(1000, 0.0);
        assert_eq!(rig.read(ALARM_CODE, 0.0), 0x080);
        rig.coil(ALARM_RESET, true, 0.0);
        rig.coil(SERVO, true, 0.0);
        rig.go(1000, 0.0);
        assert_eq!(rig.read(ALARM_CODE, 0.0), 0x083);
        assert!(!rig.drive.moving(0.0));
    }

    #[test]
    fn the_low_word_starts_the_move_and_the_status_follows() {
        let mut rig = Rig::ready();
        rig.go(20_000, 30.0);
        assert_eq!(rig.read(DSS1, 30.1) & 1 << 3, 0);
        assert_eq!(rig.read(DSSE, 30.1) & (1 << 8 | 1 << 5), 1 << 8 | 1 << 5);
        assert_eq!(rig.read(DSS1, 40.0), 1 << 13 | 1 << 12 | 1 << 4 | 1 << 3);
        assert_eq!(rig.read(0x9001, 40.0), 20_000);
        let high_only = Request::WriteRegister { address: PCMD, value: 0 };
        rig.map.serve(&high_only, &mut rig.drive, 41.0).unwrap();
        assert!(!rig.drive.moving(41.0));
    }

    #[test]
    fn a_pause_holds_the_rest_of_the_move_unless_it_is_reset() {
        let mut rig = Rig::ready();
        rig.go(50_000, 30.0);
        rig.coil(PAUSE, true, 31.0);
        assert!(rig.drive.position(35.0) < 300.0 && !rig.drive.moving(35.0));
        assert_eq!(rig.read(DSS1, 35.0) & 1 << 3, 0);
        rig.coil(PAUSE, false, 36.0);
        assert_eq!(rig.drive.position(50.0), 500.0);
        rig.go(0, 60.0);
        rig.coil(PAUSE, true, 61.0);
        rig.coil(ALARM_RESET, true, 62.0);
        rig.coil(PAUSE, false, 63.0);
        assert!(rig.drive.position(80.0) > 100.0);
        assert_eq!(rig.drive.stops(), 2);
    }

    #[test]
    fn a_reset_that_is_still_on_cancels_the_rest_only_after_it_was_off() {
        let mut rig = Rig::ready();
        rig.coil(ALARM_RESET, true, 25.0);
        rig.go(50_000, 30.0);
        rig.coil(PAUSE, true, 31.0);
        rig.coil(ALARM_RESET, true, 35.0);
        rig.coil(PAUSE, false, 36.0);
        assert_eq!(rig.drive.position(50.0), 500.0);
        rig.go(0, 60.0);
        rig.coil(PAUSE, true, 61.0);
        rig.coil(ALARM_RESET, false, 62.0);
        rig.coil(ALARM_RESET, true, 62.0);
        rig.coil(PAUSE, false, 63.0);
        assert!(rig.drive.position(80.0) > 100.0);
    }

    #[test]
    fn a_target_beyond_the_stroke_is_an_alarm_and_no_motion() {
        let mut rig = Rig::ready();
        rig.go(60_000, 30.0);
        assert_eq!(rig.read(ALARM_CODE, 30.0), 0x0A3);
        assert!(!rig.drive.moving(30.0));
    }

    #[test]
    fn addresses_and_functions_it_does_not_have_are_refused() {
        let Rig { mut map, mut drive } = Rig::new();
        let coil = Request::WriteCoil { address: 0x0500, on: true };
        assert_eq!(map.serve(&coil, &mut drive, 0.0), Err(Exception::IllegalAddress));
        let read = Request::ReadRegisters { function: 3, address: 0x9010, count: 40 };
        assert_eq!(map.serve(&read, &mut drive, 0.0), Err(Exception::IllegalAddress));
        let input = Request::ReadRegisters { function: 4, address: PNOW, count: 1 };
        assert_eq!(map.serve(&input, &mut drive, 0.0), Err(Exception::IllegalFunction));
        let long = Request::WriteRegisters { address: 0x9905, values: vec![0; 5] };
        assert_eq!(map.serve(&long, &mut drive, 0.0), Err(Exception::IllegalAddress));
    }
}
