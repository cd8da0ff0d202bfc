//! An axis on a register map, as far as all drives have it in common: soft limits, the permit that
//! a stop withdraws, a status check before a motion is sent again, the detection of motion, and the
//! steps in which a drive is taken over.
//! Uses: `device`, `profile`, `station`, `motion`, `link`. Never: register addresses (each device knows its own).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use parking_lot::Mutex;
use tokio::time::Instant;

use super::device::AxisParts;
use super::error::{RigError, Severity};
use super::guard::Guard;
use super::link::{MotionGate, MotionPermit, Request};
use super::motion::{AxisMotion, Command, Going, MotionWatch, Seen};
use super::profile::AxisProfile;
use super::station::Station;
use super::traits::{Axis, AxisStatus, Found};
use crate::clock::Clock;

/// Longest wait until a drive that was taken over has its motor on, wall time.
const ENABLE_DEADLINE: Duration = Duration::from_secs(2);
/// Period at which this is checked.
const ENABLE_POLL: Duration = Duration::from_millis(10);

/// An absolute motion in the counts of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoveOrder {
    /// Target position, counts.
    pub target: i32,
    /// Speed, counts/s.
    pub speed: f64,
    /// Acceleration and deceleration, counts/s^2.
    pub acceleration: f64,
    /// Distance from the target that counts as arrived, counts.
    pub tolerance: f64,
    /// Torque limit, %; absent: none. Only for drives with this guard.
    pub torque_percent: Option<u32>,
}

/// A guard value to be written to a drive and read back; both must be equal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GuardRequest {
    /// Key of the value in the rig file.
    pub key: &'static str,
    /// Request that writes the value.
    pub write: Request,
    /// Request that reads it back.
    pub read: Request,
    /// Registers that the reading must return.
    pub words: Vec<u16>,
}

/// State of a drive according to its registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DriveState {
    /// Measured position, counts.
    pub counts: i32,
    /// State of its motion according to the drive.
    pub going: Going,
    /// Whether homing has been completed since power-up.
    pub homed: bool,
    /// Whether the motor is on and a motion would be executed.
    pub enabled: bool,
    /// Whether the drive is powered, ready and free of alarms.
    pub ready: bool,
    /// Whether an alarm is active.
    pub fault: bool,
    /// Alarm code, if the status registers contain it.
    pub alarm: Option<u32>,
    /// Whether the emergency stop of the drive is pressed, if the drive reports it.
    pub emergency_stop: bool,
    /// Whether the drive accepts commands from this wire, and not from a panel or inputs; `None`:
    /// not reported.
    pub in_command: Option<bool>,
}

/// Register map of a drive as sequences of requests and the meaning of replies. A sequence is sent in
/// order and may be repeated from its start.
///
/// # Errors
/// `identity` returns `RigError::WrongDevice` if the device is a wrong one.
pub trait Drive: Send + Sync + 'static {
    /// Requests whose replies state which device answers; none if it does not report that.
    fn identity_requests(&self) -> Vec<Request> {
        Vec::new()
    }
    /// Make of the device and its relevant settings, from these replies, one block of words per request.
    fn identity(&self, blocks: &[Vec<u16>], station: &Station) -> Result<String, RigError>;
    /// Requests whose replies together contain the state.
    fn status_requests(&self) -> Vec<Request>;
    /// Parses the state from the replies, one block of words per request; `None` if a block is
    /// short.
    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState>;
    /// Request for the alarm code, if the status registers do not contain it.
    fn alarm_request(&self) -> Option<Request> {
        None
    }
    /// Requests that take control and switch the motor on, without motion. Each is sent only if the
    /// drive reports no fault after the one before.
    fn prepare_requests(&self) -> Vec<Request>;
    /// Requests that prepare and start an absolute motion.
    fn move_requests(&self, order: &MoveOrder) -> Vec<Request>;
    /// Slowest motion that it can be commanded, and step of its speeds, counts/s.
    fn slowest(&self) -> f64 {
        1.0
    }
    /// Requests that start homing.
    fn home_requests(&self) -> Vec<Request>;
    /// Requests that decelerate to standstill.
    fn stop_requests(&self) -> Vec<Request>;
    /// Requests that end the state after a stop; they must not move the axis.
    fn release_requests(&self) -> Vec<Request>;
    /// Requests that clear an alarm.
    fn reset_requests(&self) -> Vec<Request>;
    /// Requests that set the guards of a rig file; none for a drive without guards.
    fn guard_requests(&self, _guard: &Guard) -> Vec<GuardRequest> {
        Vec::new()
    }
}

/// Result of one status check of a drive.
struct Look {
    state: DriveState,
    seen: Seen,
    at: Instant,
}

/// An axis of the rig, on a drive with a Modbus register map.
#[derive(Debug)]
struct ModbusAxis<D> {
    name: &'static str,
    drive: D,
    station: Station,
    profile: AxisProfile,
    gate: MotionGate,
    clock: Clock,
    watch: Mutex<MotionWatch>,
    /// Whether a stop may be in effect, which must be released before the next motion. True at
    /// start, since an earlier service may have stopped the axis.
    held: AtomicBool,
}

impl AxisParts {
    /// The axis on a drive.
    pub fn on<D: Drive>(self, drive: D) -> Arc<dyn Axis> {
        let Self { name, station, profile, gate, clock } = self;
        let motion = AxisMotion { tolerance: profile.tolerance, speed: profile.speed };
        let watch = Mutex::new(MotionWatch::new(motion));
        let held = AtomicBool::new(true);
        Arc::new(ModbusAxis { name, drive, station, profile, gate, clock, watch, held })
    }
}

impl<D: Drive> ModbusAxis<D> {
    fn told(&self, command: Command) {
        self.watch.lock().commanded(command, self.clock.process_s());
    }

    fn permit(&self, operation: &str) -> Result<MotionPermit, RigError> {
        self.gate.permit().map_err(|e| self.station.named(operation, e))
    }

    /// Reads one block of words per request.
    async fn blocks(
        &self,
        operation: &str,
        requests: Vec<Request>,
    ) -> Result<Vec<Vec<u16>>, RigError> {
        let mut blocks = Vec::with_capacity(requests.len());
        for request in requests {
            blocks.push(self.station.read(operation, request).await?);
        }
        Ok(blocks)
    }

    /// Reads the state of the drive once.
    async fn look(&self) -> Result<Look, RigError> {
        let asked_s = self.clock.process_s();
        let blocks = self.blocks("status", self.drive.status_requests()).await?;
        let at = self.clock.now();
        let state = self.drive.parse_status(&blocks);
        let state =
            state.ok_or_else(|| self.station.garbled("status", "too few registers".into()))?;
        let seen = Seen {
            asked_s,
            arrived_s: self.clock.process_s_at(at),
            going: state.going,
            position: f64::from(state.counts) / self.profile.counts_per_unit,
            homed: state.homed,
        };
        Ok(Look { state, seen, at })
    }

    /// Alarm code of a drive with this state; 0 if the drive does not report the code.
    async fn alarm(&self, state: DriveState) -> Result<Option<u32>, RigError> {
        if !state.fault || state.alarm.is_some() {
            return Ok(state.alarm);
        }
        match self.drive.alarm_request() {
            Some(request) => {
                let words = self.station.read("alarm code", request).await?;
                Ok(Some(words.first().map_or(0, |&w| u32::from(w))))
            }
            None => Ok(Some(0)),
        }
    }

    /// Reads which device answers.
    async fn device(&self) -> Result<String, RigError> {
        let blocks = self.blocks("identity", self.drive.identity_requests()).await?;
        self.drive.identity(&blocks, &self.station)
    }

    /// Reads the state of the device with this name.
    async fn found(&self, device: &str) -> Result<Found, RigError> {
        let state = self.look().await?.state;
        let alarm = self.alarm(state).await?;
        let DriveState { enabled, homed, emergency_stop, in_command, .. } = state;
        Ok(Found { device: device.to_owned(), enabled, homed, alarm, emergency_stop, in_command })
    }

    /// As [`Self::found`]; a fault of the drive is an error.
    async fn sound(&self, device: &str) -> Result<Found, RigError> {
        let found = self.found(device).await?;
        let faults = found.faults();
        if faults.is_empty() {
            return Ok(found);
        }
        Err(self.station.not_ready("motion", faults.join(", ")))
    }

    /// Takes control of the drive and waits until its motor is on.
    async fn take_over(&self) -> Result<Found, RigError> {
        let device = self.device().await?;
        for (sent, request) in self.drive.prepare_requests().into_iter().enumerate() {
            if sent > 0 {
                self.sound(&device).await?;
            }
            self.station.write("taking control", request).await?;
        }
        let deadline = self.clock.now() + ENABLE_DEADLINE;
        loop {
            let found = self.sound(&device).await?;
            if found.enabled {
                return Ok(found);
            }
            if self.clock.now() >= deadline {
                let why = format!("its motor is not on after {} s", ENABLE_DEADLINE.as_secs());
                return Err(self.station.not_ready("motion", why));
            }
            tokio::time::sleep(ENABLE_POLL).await;
        }
    }

    async fn send(
        &self,
        operation: &str,
        permit: &MotionPermit,
        requests: &[Request],
    ) -> Result<(), RigError> {
        if self.held.swap(false, Ordering::SeqCst) {
            for request in self.drive.release_requests() {
                if let Err(error) = self.station.write_motion("release", request, permit).await {
                    self.held.store(true, Ordering::SeqCst);
                    return Err(error);
                }
            }
        }
        for request in requests {
            self.station.write_motion(operation, request.clone(), permit).await?;
        }
        Ok(())
    }

    /// Writes the guards and reads them back.
    async fn set_guards(&self) -> Result<(), RigError> {
        for GuardRequest { key, write, read, words } in
            self.drive.guard_requests(&self.profile.guard)
        {
            self.station.write(key, write).await?;
            let found = self.station.read(key, read).await?;
            if found != words {
                let found = format!("guard.{key} reads back as {found:?}");
                return Err(self.station.wrong(found, format!("{words:?}, as it was written")));
            }
        }
        Ok(())
    }

    /// Sends a motion. After a lost reply the state of the drive is checked before anything is sent
    /// again: a command that was received is not repeated, and one that was not received is
    /// absolute.
    async fn command(
        &self,
        operation: &str,
        command: Command,
        requests: &[Request],
    ) -> Result<(), RigError> {
        let permit = self.permit(operation)?;
        let stood = self.watch.lock().stood();
        let mut failures = 0;
        loop {
            let Err(error) = self.send(operation, &permit, requests).await else { break };
            failures += 1;
            let last = failures >= self.station.line().policy().attempts;
            if last || error.severity() != Severity::Transient {
                return Err(error);
            }
            let now = self.status().await?;
            let arrived = match command {
                Command::Move(target) => (now.position - target).abs() <= self.profile.tolerance,
                Command::Home | Command::Stop => false,
            };
            // While the release of a stop is not complete, a motion is that of the travel which the stop left.
            let is_released = !self.held.load(Ordering::SeqCst);
            if is_released && (arrived || (stood && now.moving)) {
                break;
            }
        }
        self.told(command);
        Ok(())
    }
}

#[async_trait]
impl<D: Drive> Axis for ModbusAxis<D> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn travel(&self) -> [f64; 2] {
        self.profile.travel
    }

    fn guard(&self) -> Guard {
        self.profile.guard
    }

    fn slowest(&self) -> f64 {
        self.drive.slowest() / self.profile.counts_per_unit
    }

    async fn identify(&self) -> Result<Found, RigError> {
        let device = self.device().await?;
        self.found(&device).await
    }

    async fn prepare(&self) -> Result<String, RigError> {
        let found = self.take_over().await?;
        self.set_guards().await?;
        let guard = self.profile.guard;
        Ok(if guard.is_none() { found.to_string() } else { format!("{found}, {guard}") })
    }

    async fn start_home(&self) -> Result<(), RigError> {
        self.command("homing", Command::Home, &self.drive.home_requests()).await
    }

    async fn start_move(&self, target: f64, speed: f64) -> Result<(), RigError> {
        let [min, max] = self.profile.travel;
        if !(min..=max).contains(&target) {
            let device = self.station.device().to_owned();
            return Err(RigError::OutsideTravel { device, target, min, max });
        }
        // The smaller of NaN and the travelling speed is the travelling speed.
        if speed.is_nan() || speed <= 0.0 {
            return Err(self.station.not_ready("move", format!("its speed is {speed}")));
        }
        let scale = self.profile.counts_per_unit;
        let order = MoveOrder {
            target: (target * scale).round() as i32,
            speed: speed.min(self.profile.speed) * scale,
            acceleration: self.profile.acceleration * scale,
            tolerance: self.profile.tolerance * scale,
            torque_percent: self.profile.guard.torque_percent,
        };
        self.command("move", Command::Move(target), &self.drive.move_requests(&order)).await
    }

    async fn status(&self) -> Result<AxisStatus, RigError> {
        let mut look = self.look().await?;
        let suspicious = self.watch.lock().implausible(look.seen);
        if suspicious {
            // Modbus TCP has no checksum; a flipped bit does not recur.
            look = self.look().await?;
        }
        let Look { state, seen, at } = look;
        let alarm = self.alarm(state).await?;
        let position = seen.position;
        let moving = self.watch.lock().observe(seen) && !state.fault;
        let (homed, ready) = (state.homed, state.ready);
        Ok(AxisStatus { position, moving, homed, ready, alarm, at })
    }

    async fn stop(&self) -> Result<(), RigError> {
        self.gate.void();
        self.held.store(true, Ordering::SeqCst);
        for request in self.drive.stop_requests() {
            self.station.write_urgent("stop", request).await?;
        }
        self.told(Command::Stop);
        Ok(())
    }

    async fn reset_alarm(&self) -> Result<(), RigError> {
        for request in self.drive.reset_requests() {
            self.station.write("alarm reset", request).await?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::RigConfig;
    use crate::rig::link::{LineCounts, StopLatch};
    use crate::rig::registry;

    #[tokio::test]
    async fn a_motion_without_a_speed_or_to_a_target_outside_the_travel_is_not_sent() {
        let text = include_str!("../../../experiments/rigs/virtual.toml");
        // Nobody listens there.
        let text = text.replace("\"127.0.0.1:50", "\"127.0.0.1:1");
        let config = RigConfig::from_toml("virtual.toml", &text).unwrap();
        let open = registry::open(&config, &Clock::new(1.0), &StopLatch::default()).unwrap();
        for axis in open.bench.axes() {
            let [min, max] = axis.travel();
            for speed in [f64::NAN, 0.0, -1.0] {
                let refused = axis.start_move(max, speed).await;
                assert!(matches!(refused, Err(RigError::NotReady { .. })), "{refused:?}");
            }
            for target in [f64::NAN, f64::INFINITY, min - 0.1, max + 0.1] {
                let refused = axis.start_move(target, 1.0).await;
                assert!(matches!(refused, Err(RigError::OutsideTravel { .. })), "{refused:?}");
            }
        }
        assert!(open.lines.values().all(|line| line.counts() == LineCounts::default()));
    }
}
