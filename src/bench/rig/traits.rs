//! Capabilities of a bench, in its own units: move, spread, read forces, measure frames.
//! Uses: `rig::error`, `rig::guard`. Never: registers, ports, retries (the drivers have those).
//!
//! Methods take `&self`, so that a stop can be sent while a motion is supervised.

use std::fmt;
use std::sync::Arc;

use async_trait::async_trait;
use jiff::Timestamp;
use tokio::sync::broadcast;
use tokio::time::Instant;

use super::error::RigError;
use super::guard::Guard;
use crate::record::ARMS;

/// State of an axis in one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisStatus {
    /// Measured position in the axis's unit (mm or degrees).
    pub position: f64,
    /// Whether the axis moves.
    pub moving: bool,
    /// Whether homing has been completed since power-up.
    pub homed: bool,
    /// Whether the drive is ready and powered, with its motor on. At the end of a motion, and while the axis homes, it may
    /// be neither ready nor moving for a moment.
    pub ready: bool,
    /// Alarm code of the device, if it reports one.
    pub alarm: Option<u32>,
    /// Time at which the reading arrived.
    pub at: Instant,
}

/// State of a drive, read without a write to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Make of the drive, and its relevant settings.
    pub device: String,
    /// Whether the motor is on and a motion would be executed.
    pub enabled: bool,
    /// Whether homing has been completed since power-up.
    pub homed: bool,
    /// Alarm code; absent without an alarm.
    pub alarm: Option<u32>,
    /// Whether the emergency stop of the drive is pressed, if the drive reports it.
    pub emergency_stop: bool,
    /// Whether the drive accepts commands from this wire, and not from a panel or inputs; `None`:
    /// not reported.
    pub in_command: Option<bool>,
}

impl Found {
    /// Faults that enabling would not clear, as text.
    pub fn faults(&self) -> Vec<String> {
        let alarm = self.alarm.map(|code| format!("alarm 0x{code:02X}"));
        let stop = self.emergency_stop.then(|| "its emergency stop is pressed".to_owned());
        stop.into_iter().chain(alarm).collect()
    }

    /// Properties that cannot be checked in the present state, as text; empty for a drive in use.
    pub fn untried(&self) -> Vec<String> {
        let servo = (!self.enabled).then_some("servo is off: not switched on");
        let command = (self.in_command == Some(false))
            .then_some("its panel or inputs are in control: control was not taken");
        [command, servo].into_iter().flatten().map(str::to_owned).collect()
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let servo = if self.enabled { "servo on" } else { "servo off" };
        let homed = if self.homed { "homed" } else { "not homed" };
        write!(f, "{}, {servo}, {homed}", self.device)?;
        self.faults().iter().try_for_each(|fault| write!(f, ", {fault}"))
    }
}

/// A positioning axis: a stage axis (mm) or the rotary actuator (degrees).
///
/// # Errors
/// Methods return `RigError` if the wire fails beyond its retries or the device refuses. Motions
/// also return `Latched` or `Withdrawn` after an e-stop or a stop.
#[async_trait]
pub trait Axis: Send + Sync {
    /// Name: `x`, `y`, `z` or `radial`.
    fn name(&self) -> &'static str;
    /// Soft limits in the axis's unit.
    fn travel(&self) -> [f64; 2];
    /// Guards that `prepare` writes to the drive.
    fn guard(&self) -> Guard;
    /// Slowest motion of the drive that was identified, units/s: what is slower moves at this speed. It also is the step
    /// of its speeds, which it rounds down.
    fn slowest(&self) -> f64;
    /// Identifies the device and its faults. Writes no coil and no register.
    async fn identify(&self) -> Result<Found, RigError>;
    /// Takes control of the drive: mode switches, guards, servo on. Moves nothing. Returns a
    /// description of the device. An alarm or a pressed emergency stop is `RigError::NotReady`.
    /// After `reset_alarm` it restores a drive that had an alarm or lost its power, but not its
    /// homing.
    async fn prepare(&self) -> Result<String, RigError>;
    /// Starts homing, which finds the zero of the axis; does not wait for its end.
    async fn start_home(&self) -> Result<(), RigError>;
    /// Starts an absolute motion. A target outside the soft limits, or a speed that is not positive, is refused before any
    /// byte is sent.
    async fn start_move(&self, target: f64, speed: f64) -> Result<(), RigError>;
    /// Reads position and state.
    async fn status(&self) -> Result<AxisStatus, RigError>;
    /// Decelerates to standstill; sent before all queued requests on the wire.
    async fn stop(&self) -> Result<(), RigError>;
    /// Clears an alarm whose cause has been removed.
    async fn reset_alarm(&self) -> Result<(), RigError>;
}

/// One reading of the outputs of the load cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellVolts {
    /// Outputs of the cells of arms 1 to 6, V.
    pub volts: [f64; ARMS],
    /// Number of update periods over which each input has repeated its value while it was read (see
    /// `rig::repeats`); 0 after a change. `CellsConfig::is_hung` states the limit for a working
    /// cell; a dead cell repeats 0 V forever.
    pub repeats: [u32; ARMS],
    /// Time at which the reading arrived.
    pub at: Instant,
}

/// The load cells behind one analog input module.
///
/// # Errors
/// Methods return `RigError` if the wire fails beyond its retries or the module is a wrong one.
#[async_trait]
pub trait LoadCells: Send + Sync {
    /// Checks model and range. Returns a description of the module. Writes nothing.
    async fn prepare(&self) -> Result<String, RigError>;
    /// Reads the cells of all arms.
    async fn read(&self) -> Result<CellVolts, RigError>;
}

/// One frame as received.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Sequence number from the device; gaps are dropped frames.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Voltage of one count, V.
    pub volts_per_count: f32,
    /// Raw counts, injection-major, electrodes squared.
    pub counts: Vec<i16>,
    /// Time at which the last byte arrived.
    pub received: Instant,
}

impl Frame {
    /// Voltages, V, injection-major.
    pub fn voltages_v(&self) -> Vec<f32> {
        self.counts.iter().map(|&c| f32::from(c) * self.volts_per_count).collect()
    }

    /// Largest magnitude of an injection sum, V: zero up to noise, because the values are
    /// differences around a ring.
    pub fn largest_injection_sum_v(&self) -> f64 {
        let electrodes = (self.counts.len() as f64).sqrt().round() as usize;
        self.counts
            .chunks(electrodes.max(1))
            .map(|c| c.iter().map(|&v| i64::from(v)).sum::<i64>().unsigned_abs() as f64)
            .fold(0.0, f64::max)
            * f64::from(self.volts_per_count)
    }

    /// Indices of the saturated channels.
    pub fn saturated(&self) -> impl Iterator<Item = usize> {
        let is_saturated =
            |(channel, &c): (usize, &i16)| (c == i16::MAX || c == i16::MIN).then_some(channel);
        self.counts.iter().enumerate().filter_map(is_saturated)
    }

    /// Number of saturated channels.
    pub fn saturated_channels(&self) -> usize {
        self.saturated().count()
    }
}

/// Counters of the reader of the stream.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StreamCounters {
    /// Number of valid frames.
    pub frames: u64,
    /// Number of frames missing according to the sequence numbers.
    pub missed: u64,
    /// Number of packets with a wrong length, version, electrode count or checksum.
    pub garbled: u64,
    /// Number of times the wire was reopened.
    pub reconnects: u64,
    /// Wall time since which the wire is open and its device has not restarted; none before it was open.
    pub since: Option<Timestamp>,
}

impl StreamCounters {
    /// Wall time since which the stream of some frames was open: `requested` if it was that already when they were
    /// requested. Otherwise `at`, at which they had arrived: they may be frames of both streams, and are in no mean with
    /// others.
    pub fn since_of_frames(
        &self,
        requested: Option<Timestamp>,
        at: Timestamp,
    ) -> Option<Timestamp> {
        if self.since == requested { requested } else { Some(at) }
    }
}

/// The voltage stream of the skin.
///
/// # Errors
/// `take` returns `RigError::NoFrames` if the frames do not arrive in time.
#[async_trait]
pub trait SkinReader: Send + Sync {
    /// Newest frame, for the age check; none before the first.
    fn latest(&self) -> Option<Arc<Frame>>;
    /// Subscribes to all frames from now on, for live views; a slow receiver loses frames.
    fn follow(&self) -> broadcast::Receiver<Arc<Frame>>;
    /// Returns the counters.
    fn counters(&self) -> StreamCounters;
    /// Takes `count` complete frames whose first sample was taken after `not_before`. Buffered
    /// frames are dropped, and so is the first complete packet.
    async fn take(&self, not_before: Instant, count: usize) -> Result<Vec<Arc<Frame>>, RigError>;
}

/// The devices of a bench.
#[derive(Clone)]
pub struct Bench {
    /// Stage axis along the width of the skin.
    pub x: Arc<dyn Axis>,
    /// Stage axis along the height of the skin.
    pub y: Arc<dyn Axis>,
    /// Stage axis toward the skin, positive downward.
    pub z: Arc<dyn Axis>,
    /// Rotary actuator of the slots, degrees.
    pub radial: Arc<dyn Axis>,
    /// Load cells of the six arms.
    pub cells: Arc<dyn LoadCells>,
    /// Frames of the skin, from the voltage stream.
    pub skin: Arc<dyn SkinReader>,
}

impl Bench {
    /// The axes in the order of a stop: z first, which presses. On a wire that they share, each waits for the
    /// ones before it.
    pub fn axes(&self) -> [&Arc<dyn Axis>; 4] {
        [&self.z, &self.x, &self.y, &self.radial]
    }
}
