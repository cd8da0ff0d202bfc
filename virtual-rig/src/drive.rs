//! One motor with its counter, servo, homing and alarms, as used by every register map.
//! PURE. Uses: `kinematics`. Never: registers, clocks (times are passed in).
//!
//! Positions of the motor are true positions in the axis's unit (mm or degrees). The counter reads
//! zero at power-up at any position of the motor, and true positions once homed.

use std::ops::RangeInclusive;

use crate::kinematics::{Pace, Start, Trajectory};

/// Distance of the mechanical end stops from the soft travel, units.
const HARD_STOP_MARGIN: f64 = 2.0;
/// Duration of the search for the index mark at the end of homing, s.
const INDEX_SEARCH_S: f64 = 0.3;
/// Speed of homing, as a fraction of the travelling speed.
const HOMING_SPEED_PART: f64 = 0.25;

/// Reason why a drive has stopped its motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Alarm {
    /// A motion was commanded with the motor off.
    ServoOff,
    /// A motion was commanded before homing.
    NotHomed,
    /// A target or a speed is outside the range of the drive.
    BadCommand,
    /// The motor does not follow, or has reached a mechanical end stop.
    Deviation,
    /// Raised by a fault script, with the code of the device.
    Scripted(u16),
}

/// Limits and speeds of the mechanics, in the axis's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanism {
    /// Travel, lower and upper end, units.
    pub travel: [f64; 2],
    /// Travelling speed of the rig file, units/s; the motor can reach 1.5 times as much.
    pub speed: f64,
    /// Acceleration of the rig file, units/s^2; the motor can reach twice as much.
    pub acceleration: f64,
}

impl Mechanism {
    /// Largest speed of the motor, units/s.
    pub fn top_speed(&self) -> f64 {
        1.5 * self.speed
    }

    /// Largest acceleration of the motor, units/s^2.
    pub fn top_acceleration(&self) -> f64 {
        2.0 * self.acceleration
    }

    /// Pace of the rig file.
    fn pace(&self) -> Pace {
        let a = self.acceleration;
        Pace { speed: self.speed, acceleration: a, deceleration: a }
    }

    /// Positions of the mechanical end stops, units.
    fn iron(&self) -> [f64; 2] {
        [self.travel[0] - HARD_STOP_MARGIN, self.travel[1] + HARD_STOP_MARGIN]
    }
}

/// State of the motor's servo.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Servo {
    /// The motor holds its position.
    On,
    /// The motor is free.
    Off,
}

impl Servo {
    /// On under a condition, otherwise off.
    pub fn on_if(condition: bool) -> Self {
        if condition { Self::On } else { Self::Off }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Jam {
    position: f64,
    since_s: f64,
    alarm_after_s: Option<f64>,
}

/// A motor, its counter and its state.
#[derive(Debug, Clone)]
pub struct Drive {
    mechanism: Mechanism,
    motion: Trajectory,
    pace: Pace,
    /// True position at which the counter reads zero.
    counter_zero: f64,
    servo: Servo,
    servo_at_power_up: Servo,
    homed: bool,
    homing_until_s: Option<f64>,
    crash_at_s: Option<f64>,
    alarm: Option<Alarm>,
    jam: Option<Jam>,
    motions: u64,
    stops: u64,
}

impl Drive {
    /// Creates a drive at power-up: at `position`, not homed, the counter at zero, the motor in the
    /// state `servo_at_power_up`.
    pub fn power_up(mechanism: Mechanism, position: f64, servo_at_power_up: Servo) -> Self {
        Self {
            mechanism,
            motion: Trajectory::at_rest(position),
            pace: mechanism.pace(),
            counter_zero: position,
            servo: servo_at_power_up,
            servo_at_power_up,
            homed: false,
            homing_until_s: None,
            crash_at_s: None,
            alarm: None,
            jam: None,
            motions: 0,
            stops: 0,
        }
    }

    /// Applies changes that depend on time: end of homing, detection of a jam or of an end stop.
    pub fn refresh(&mut self, t_s: f64) {
        if self.homing_until_s.is_some_and(|end| t_s >= end) && self.jam.is_none() {
            self.homing_until_s = None;
            self.homed = true;
            self.counter_zero = 0.0;
        }
        if self.crash_at_s.is_some_and(|at| t_s >= at) {
            self.crash_at_s = None;
            self.trip(t_s, Alarm::Deviation);
        }
        let overdue = |j: &Jam| j.alarm_after_s.is_some_and(|s| t_s >= j.since_s + s);
        if self.jam.as_ref().is_some_and(overdue) && self.moving(t_s) {
            self.trip(t_s, Alarm::Deviation);
        }
    }

    /// True position, units.
    pub fn position(&self, t_s: f64) -> f64 {
        self.jam.map_or_else(|| self.motion.position(t_s), |j| j.position)
    }

    /// True velocity, units/s.
    pub fn velocity(&self, t_s: f64) -> f64 {
        if self.jam.is_some() { 0.0 } else { self.motion.velocity(t_s) }
    }

    /// Smallest and largest true position in an interval of time without a command, s; units.
    pub fn range(&self, times_s: RangeInclusive<f64>) -> [f64; 2] {
        self.jam.map_or_else(|| self.motion.range(times_s), |j| [j.position; 2])
    }

    /// Position at which the present motion will end, units.
    pub fn resting_position(&self) -> f64 {
        self.jam.map_or_else(|| self.motion.target(), |j| j.position)
    }

    /// Value of the motor's counter, units.
    pub fn counter(&self, t_s: f64) -> f64 {
        self.position(t_s) - self.counter_zero
    }

    /// Counter value that is commanded at this time, units.
    pub fn commanded_counter(&self, t_s: f64) -> f64 {
        self.motion.position(t_s) - self.counter_zero
    }

    /// Counter value at which the present command will end, units.
    pub fn commanded_end_counter(&self) -> f64 {
        self.motion.target() - self.counter_zero
    }

    /// Whether the drive considers the motor to be moving.
    pub fn moving(&self, t_s: f64) -> bool {
        let jammed_short =
            self.jam.is_some_and(|j| (j.position - self.motion.target()).abs() > 1e-6);
        self.motion.moving(t_s) || jammed_short || self.homing_until_s.is_some()
    }

    /// Whether the motor turns at any time after `from_s`, without a command in between.
    pub fn turns_between(&self, from_s: f64) -> bool {
        self.jam.is_none() && self.motion.moving(from_s)
    }

    /// Whether the motor is on.
    pub fn servo(&self) -> bool {
        self.servo == Servo::On
    }

    /// Whether homing is complete.
    pub fn homed(&self) -> bool {
        self.homed
    }

    /// Whether homing is active.
    pub fn homing(&self) -> bool {
        self.homing_until_s.is_some()
    }

    /// Active alarm; none without one.
    pub fn alarm(&self) -> Option<Alarm> {
        self.alarm
    }

    /// Number of motions started, which distinguishes one motion from the next.
    pub fn motions(&self) -> u64 {
        self.motions
    }

    /// Number of stop commands received.
    pub fn stops(&self) -> u64 {
        self.stops
    }

    /// Limits and speeds of the mechanics.
    pub fn mechanism(&self) -> &Mechanism {
        &self.mechanism
    }

    /// Switches the motor on or off; a moving motor brakes first.
    pub fn set_servo(&mut self, t_s: f64, servo: Servo) {
        if self.servo == Servo::On && servo == Servo::Off {
            self.brake(t_s);
        }
        self.servo = servo;
    }

    /// Starts an absolute motion to a counter value.
    pub fn start_move(&mut self, t_s: f64, counter: f64, pace: Pace) {
        let target = counter + self.counter_zero;
        let top = self.mechanism.top_acceleration();
        let pace = Pace {
            speed: pace.speed.clamp(1e-4, self.mechanism.top_speed()),
            acceleration: pace.acceleration.clamp(1e-3, top),
            deceleration: pace.deceleration.clamp(1e-3, top),
        };
        let [low, high] = self.mechanism.iron();
        let reached = target.clamp(low, high);
        self.homing_until_s = None;
        self.begin(t_s, reached, pace);
        self.crash_at_s = (reached != target).then(|| self.motion.end_s());
    }

    /// Starts homing: to the sensor at 0, then the index search.
    pub fn start_home(&mut self, t_s: f64) {
        let pace =
            Pace { speed: HOMING_SPEED_PART * self.mechanism.speed, ..self.mechanism.pace() };
        self.homed = false;
        self.begin(t_s, 0.0, pace);
        self.homing_until_s = Some(self.motion.end_s() + INDEX_SEARCH_S);
    }

    /// Executes a stop command and counts it.
    pub fn stop(&mut self, t_s: f64) {
        self.stops += 1;
        self.brake(t_s);
    }

    /// Makes the present position the zero of the counter.
    pub fn set_zero(&mut self, t_s: f64) {
        self.counter_zero = self.position(t_s);
        self.homed = true;
    }

    /// Stops and latches an alarm; a serious one switches the motor off.
    pub fn trip(&mut self, t_s: f64, alarm: Alarm) {
        self.brake(t_s);
        if matches!(alarm, Alarm::Deviation | Alarm::Scripted(_)) {
            self.servo = Servo::Off;
        }
        self.alarm = Some(alarm);
    }

    /// Clears the alarm.
    pub fn reset_alarm(&mut self) {
        self.alarm = None;
    }

    /// Blocks the motor, unless it is blocked. `alarm_after_s`: duration of a jam after which the
    /// drive raises an alarm, s; without it none is raised.
    pub fn jam(&mut self, t_s: f64, alarm_after_s: Option<f64>) {
        if self.jam.is_none() {
            let position = self.motion.position(t_s);
            self.jam = Some(Jam { position, since_s: t_s, alarm_after_s });
        }
    }

    /// Frees a blocked motor, which continues to its target.
    pub fn free(&mut self, t_s: f64) {
        if let Some(Jam { position, .. }) = self.jam.take() {
            let (target, homing) = (self.motion.target(), self.homing_until_s.is_some());
            let start = Start { t_s, position, velocity: 0.0 };
            self.motion = Trajectory::to_target(start, target, self.pace);
            self.homing_until_s = homing.then(|| self.motion.end_s() + INDEX_SEARCH_S);
            self.motions += 1;
        }
    }

    /// Simulates a loss and return of power: same position, not homed, the counter at zero.
    pub fn power_cycle(&mut self, t_s: f64) {
        let position = self.position(t_s);
        let kept = (self.motions + 1, self.stops);
        *self = Self::power_up(self.mechanism, position, self.servo_at_power_up);
        (self.motions, self.stops) = kept;
    }

    /// True position and velocity at a time.
    fn state(&self, t_s: f64) -> Start {
        Start { t_s, position: self.position(t_s), velocity: self.velocity(t_s) }
    }

    fn begin(&mut self, t_s: f64, target: f64, pace: Pace) {
        self.motion = Trajectory::to_target(self.state(t_s), target, pace);
        self.pace = pace;
        self.crash_at_s = None;
        self.motions += 1;
    }

    /// Decelerates to standstill, without a command.
    pub fn brake(&mut self, t_s: f64) {
        self.motion = Trajectory::to_stand(self.state(t_s), self.pace.deceleration);
        self.homing_until_s = None;
        self.crash_at_s = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAGE: Mechanism = Mechanism { travel: [0.0, 560.0], speed: 250.0, acceleration: 1500.0 };
    const PACE: Pace = Pace { speed: 250.0, acceleration: 1500.0, deceleration: 1500.0 };

    #[test]
    fn homing_takes_time_and_makes_the_counter_true() {
        let mut drive = Drive::power_up(STAGE, 200.0, Servo::On);
        assert_eq!(drive.counter(0.0), 0.0);
        drive.start_home(0.0);
        drive.refresh(1.0);
        assert!(!drive.homed() && drive.moving(1.0));
        drive.refresh(10.0);
        assert!(drive.homed() && !drive.moving(10.0));
        assert_eq!((drive.position(10.0), drive.counter(10.0)), (0.0, 0.0));
    }

    #[test]
    fn a_stopped_homing_is_no_homing() {
        let mut drive = Drive::power_up(STAGE, 200.0, Servo::On);
        drive.start_home(0.0);
        drive.stop(1.0);
        drive.refresh(20.0);
        assert!(!drive.homed());
        assert_eq!(drive.stops(), 1);
    }

    #[test]
    fn a_jammed_axis_stands_still_and_stays_under_way_until_freed() {
        let mut drive = Drive::power_up(STAGE, 0.0, Servo::On);
        drive.start_move(0.0, 100.0, PACE);
        drive.jam(0.2, None);
        let stuck = drive.position(0.2);
        assert!(stuck > 1.0 && stuck < 99.0);
        assert_eq!(drive.position(50.0), stuck);
        assert!(drive.moving(50.0));
        drive.free(50.0);
        assert_eq!(drive.position(60.0), 100.0);
        assert!(!drive.moving(60.0));
    }

    #[test]
    fn the_iron_raises_an_alarm_and_drops_the_servo() {
        let mut drive = Drive::power_up(STAGE, 500.0, Servo::On);
        drive.start_move(0.0, 300.0, PACE);
        drive.refresh(10.0);
        assert_eq!(drive.alarm(), Some(Alarm::Deviation));
        assert_eq!(drive.position(10.0), 562.0);
        assert!(!drive.servo());
    }
}
