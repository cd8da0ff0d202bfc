//! An axis on a register map: what all drives have in common. Soft limits, the permit that a stop
//! voids, a look at the drive before a motion is sent again, and when an axis counts as moving.
//! Uses: `station`, `motion`, `link`. Never: register addresses (those are each device's `codec`).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use async_trait::async_trait;
use tokio::time::Instant;

use super::config::{AxisProfile, Guard};
use super::error::{RigError, Severity};
use super::link::{MotionGate, MotionPermit, Request};
use super::motion::{Command, Going, MotionWatch, Seen};
use super::station::Station;
use super::traits::{Axis, AxisStatus, Found};
use crate::clock::Clock;

/// An absolute move in the counts of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoveOrder {
    /// Where to, counts.
    pub target: i32,
    /// How fast, counts/s.
    pub speed: f64,
    /// Acceleration and deceleration, counts/s^2.
    pub acceleration: f64,
    /// How close counts as arrived, counts.
    pub tolerance: f64,
    /// Most torque, %; all of it if absent. Only drives with that guard are asked for it.
    pub torque_percent: Option<u32>,
}

/// A guard's value on its way into a drive: written, then read back, and both must be the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GuardRequest {
    /// The rig file's key.
    pub key: &'static str,
    /// Writes the value.
    pub write: Request,
    /// Reads it back.
    pub read: Request,
    /// Registers that the reading must give.
    pub words: Vec<u16>,
}

/// A drive's state as its registers tell it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DriveState {
    /// Measured position, counts.
    pub counts: i32,
    /// What it says of its motion.
    pub going: Going,
    /// Homing has been done since power-up.
    pub homed: bool,
    /// Powered, ready and free of alarms.
    pub ready: bool,
    /// An alarm is up.
    pub fault: bool,
    /// The alarm's code, where the state's own registers hold it.
    pub alarm: Option<u32>,
}

/// A drive's register map as sequences of requests. The codec of a device fills it; the sequences
/// are sent in order, and each may be sent again from its start.
pub trait Drive: Send + Sync + 'static {
    /// Reads that together give the state.
    fn status_requests(&self) -> Vec<Request>;
    /// The state in their replies, one block of words for each read; `None` if a block is short.
    fn parse_status(&self, blocks: &[Vec<u16>]) -> Option<DriveState>;
    /// Reads the alarm's code, where the state's registers do not hold it; and its place there.
    fn alarm_request(&self) -> Option<Request> {
        None
    }
    /// Sets an absolute move up and starts it.
    fn move_requests(&self, order: &MoveOrder) -> Vec<Request>;
    /// Starts homing.
    fn home_requests(&self) -> Vec<Request>;
    /// Decelerates to a stand.
    fn stop_requests(&self) -> Vec<Request>;
    /// Ends the state that a stop leaves behind; must not move the axis.
    fn release_requests(&self) -> Vec<Request>;
    /// Clears an alarm.
    fn reset_requests(&self) -> Vec<Request>;
    /// Sets the guards of a rig file up; nothing for a drive without any.
    fn guard_requests(&self, _guard: &Guard) -> Vec<GuardRequest> {
        Vec::new()
    }
    /// Says what is there; reads only.
    fn identify(&self, station: &Station) -> impl Future<Output = Result<Found, RigError>> + Send;
    /// Takes control without moving anything. Says what was found.
    fn prepare(
        &self,
        station: &Station,
        clock: &Clock,
    ) -> impl Future<Output = Result<String, RigError>> + Send;
}

/// One look at a drive.
struct Look {
    state: DriveState,
    seen: Seen,
    at: Instant,
}

/// An axis of the rig on a drive.
#[derive(Debug)]
pub struct ModbusAxis<D> {
    name: &'static str,
    drive: D,
    station: Station,
    profile: AxisProfile,
    gate: MotionGate,
    clock: Clock,
    watch: Mutex<MotionWatch>,
    /// A stop may be in force: it must be released before the next motion. True at start, since
    /// an earlier service may have stopped the axis.
    held: AtomicBool,
}

impl<D: Drive> ModbusAxis<D> {
    /// An axis of that name on a drive.
    pub fn new(
        name: &'static str,
        drive: D,
        station: Station,
        profile: AxisProfile,
        gate: MotionGate,
        clock: Clock,
    ) -> Self {
        let watch = Mutex::new(MotionWatch::new(profile.tolerance, profile.speed));
        let held = AtomicBool::new(true);
        Self { name, drive, station, profile, gate, clock, watch, held }
    }

    fn watch(&self) -> MutexGuard<'_, MotionWatch> {
        self.watch.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn told(&self, command: Command) {
        self.watch().commanded(command, self.clock.process_s());
    }

    fn permit(&self, operation: &str) -> Result<MotionPermit, RigError> {
        self.gate.permit().map_err(|e| self.station.named(operation, e))
    }

    /// Reads the drive once.
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

    /// Sends a motion. After a lost reply the drive is looked at before anything is sent again:
    /// a command that was received is not repeated, and one that was not is absolute.
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
            // Modbus TCP has no checksum: a flipped bit does not come twice.
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
