//! An axis on a register map, as far as all drives have it in common: soft limits, the permit that
//! a stop withdraws, a status check before a motion is sent again, and the detection of motion.
//! Uses: `device`, `profile`, `station`, `motion`, `link`. Never: register addresses (those are each device's `codec`).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use async_trait::async_trait;
use parking_lot::{Mutex, MutexGuard};
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
    /// Whether the drive is powered, ready and free of alarms.
    pub ready: bool,
    /// Whether an alarm is active.
    pub fault: bool,
    /// Alarm code, if the status registers contain it.
    pub alarm: Option<u32>,
}

/// Register map of a drive as sequences of requests. The codec of a device implements it. A
/// sequence is sent in order and may be repeated from its start.
///
/// # Errors
/// `identify` and `prepare` return `RigError` if the wire fails or the device is a wrong one;
/// `prepare` also if the drive cannot be used in its present state.
pub trait Drive: Send + Sync + 'static {
    /// Requests whose replies together contain the state.
    fn status_requests(&self) -> Vec<Request>;
    /// Parses the state from the replies, one block of words per request; `None` if a block is
    /// short.
    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState>;
    /// Request for the alarm code, if the status registers do not contain it.
    fn alarm_request(&self) -> Option<Request> {
        None
    }
    /// Requests that prepare and start an absolute motion.
    fn move_requests(&self, order: &MoveOrder) -> Vec<Request>;
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
    /// Identifies the device; only reads.
    fn identify(&self, station: &Station) -> impl Future<Output = Result<Found, RigError>> + Send;
    /// Takes control without motion. Returns a description of the device.
    fn prepare(
        &self,
        station: &Station,
        clock: &Clock,
    ) -> impl Future<Output = Result<String, RigError>> + Send;
}

/// Result of one status check of a drive.
struct Look {
    state: DriveState,
    seen: Seen,
    at: Instant,
}

/// An axis of the rig, on a drive with a Modbus register map.
#[derive(Debug)]
pub struct ModbusAxis<D> {
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
        Arc::new(ModbusAxis::new(name, drive, station, profile, gate, clock))
    }
}

impl<D: Drive> ModbusAxis<D> {
    /// Creates an axis with this name on a drive.
    pub fn new(
        name: &'static str,
        drive: D,
        station: Station,
        profile: AxisProfile,
        gate: MotionGate,
        clock: Clock,
    ) -> Self {
        let motion = AxisMotion { tolerance: profile.tolerance, speed: profile.speed };
        let watch = Mutex::new(MotionWatch::new(motion));
        let held = AtomicBool::new(true);
        Self { name, drive, station, profile, gate, clock, watch, held }
    }

    fn watch(&self) -> MutexGuard<'_, MotionWatch> {
        self.watch.lock()
    }

    fn told(&self, command: Command) {
        self.watch().commanded(command, self.clock.process_s());
    }

    fn permit(&self, operation: &str) -> Result<MotionPermit, RigError> {
        self.gate.permit().map_err(|e| self.station.named(operation, e))
    }

    /// Reads the state of the drive once.
    async fn look(&self) -> Result<Look, RigError> {
        let asked_s = self.clock.process_s();
        let requests = self.drive.status_requests();
        let mut blocks = Vec::with_capacity(requests.len());
        for request in requests {
            blocks.push(self.station.read("status", request).await?);
        }
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
        let stood = self.watch().stood();
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
            if arrived || (stood && now.moving) {
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

    async fn identify(&self) -> Result<Found, RigError> {
        self.drive.identify(&self.station).await
    }

    async fn prepare(&self) -> Result<String, RigError> {
        let found = self.drive.prepare(&self.station, &self.clock).await?;
        self.set_guards().await?;
        let guard = self.profile.guard;
        Ok(if guard.is_none() { found } else { format!("{found}, {guard}") })
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
        let suspicious = self.watch().implausible(look.seen);
        if suspicious {
            // Modbus TCP has no checksum; a flipped bit does not recur.
            look = self.look().await?;
        }
        let Look { state, seen, at } = look;
        let mut alarm = state.alarm;
        if state.fault && alarm.is_none() {
            alarm = match self.drive.alarm_request() {
                Some(request) => {
                    let words = self.station.read("alarm code", request).await?;
                    words.first().map(|&w| u32::from(w))
                }
                None => Some(0),
            };
        }
        let position = seen.position;
        let moving = self.watch().observe(seen) && !state.fault;
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
