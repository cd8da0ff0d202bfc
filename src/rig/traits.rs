//! What a bench can do, in the bench's own units: move, spread, weigh, measure.
//! Uses: `rig::error`, `rig::config`. Never: registers, ports, retries (those are the drivers').
//!
//! Methods take `&self`, so that a stop can be sent while a move is being watched.

use std::fmt;
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::watch;
use tokio::time::Instant;

use super::config::{ARMS, Guard};
use super::error::RigError;

/// An axis as seen in one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisStatus {
    /// Measured position in the axis's unit (mm or degrees).
    pub position: f64,
    /// Motion is under way.
    pub moving: bool,
    /// Homing has been done since power-up.
    pub homed: bool,
    /// The drive is ready and powered.
    pub ready: bool,
    /// Alarm code of the device, if it reports one.
    pub alarm: Option<u32>,
    /// When the reading arrived.
    pub at: Instant,
}

/// A drive as it stands, read without writing anything to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Make, and the settings that matter.
    pub device: String,
    /// The motor is on, and a motion would be carried out.
    pub enabled: bool,
    /// Homing has been done since power-up.
    pub homed: bool,
    /// Alarm code, if an alarm is up.
    pub alarm: Option<u32>,
    /// The drive's own emergency stop is pressed, as far as the drive tells.
    pub emergency_stop: bool,
    /// Commands are taken from this wire, and not from a panel or inputs; `None`: it does not tell.
    pub in_command: Option<bool>,
}

impl Found {
    /// What stands in the way and would not go away by enabling, in words.
    pub fn faults(&self) -> Vec<String> {
        let alarm = self.alarm.map(|code| format!("alarm 0x{code:02X}"));
        let stop = self.emergency_stop.then(|| "its emergency stop is pressed".to_owned());
        stop.into_iter().chain(alarm).collect()
    }

    /// What cannot be told of a drive as it stands, in words; empty for one that is in use.
    pub fn untried(&self) -> Vec<String> {
        let servo = (!self.enabled).then_some("servo is off: not switched on");
        let command = (self.in_command == Some(false))
            .then_some("its panel or inputs are in command: control was not taken");
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

/// Something that moves to positions: a stage axis (mm), or the rotary actuator (degrees).
#[async_trait]
pub trait Axis: Send + Sync {
    /// `x`, `y`, `z` or `radial`.
    fn name(&self) -> &'static str;
    /// Soft limits in the axis's unit.
    fn travel(&self) -> [f64; 2];
    /// What the drive was told to do by itself (`prepare` writes it).
    fn guard(&self) -> Guard;
    /// Says what is there and what stands in the way. Writes nothing: no coil, no register.
    async fn identify(&self) -> Result<Found, RigError>;
    /// Takes control of the drive: mode switches, guards, servo on. Moves nothing. Says what was
    /// found. An alarm or a pressed emergency stop is `RigError::NotReady`; after `reset_alarm` it
    /// brings back a drive that had an alarm or lost its power, but not its homing.
    async fn prepare(&self) -> Result<String, RigError>;
    /// Starts homing.
    async fn start_home(&self) -> Result<(), RigError>;
    /// Starts an absolute move. Refuses a target outside the soft limits before any byte is sent.
    async fn start_move(&self, target: f64, speed: f64) -> Result<(), RigError>;
    /// Reads position and state.
    async fn status(&self) -> Result<AxisStatus, RigError>;
    /// Decelerates to a stand; ahead of every queued request on the wire.
    async fn stop(&self) -> Result<(), RigError>;
    /// Clears an alarm after its cause is gone.
    async fn reset_alarm(&self) -> Result<(), RigError>;
}

/// One reading of the load cells' outputs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellVolts {
    /// Output of the cell of arms 1 to 6, V.
    pub volts: [f64; ARMS],
    /// Over how many update periods each input has given this very value while it was read (see
    /// `rig::repeats`); 0 after a change. `CellsConfig::is_hung` says how many are too many of a live
    /// cell; a dead one repeats its 0 V for ever.
    pub repeats: [u32; ARMS],
    /// When the reading arrived.
    pub at: Instant,
}

/// The load cells behind one analog input module.
#[async_trait]
pub trait LoadCells: Send + Sync {
    /// Checks model and range. Says what was found. Writes nothing.
    async fn prepare(&self) -> Result<String, RigError>;
    /// Reads all arms.
    async fn read(&self) -> Result<CellVolts, RigError>;
}

/// One frame as it came over the wire.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Counter of the device; gaps are dropped frames.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Scale of the counts, V.
    pub volts_per_count: f32,
    /// Raw counts, injection-major, electrodes squared.
    pub counts: Vec<i16>,
    /// When its last byte arrived.
    pub received: Instant,
}

impl Frame {
    /// The voltages, V, injection-major.
    pub fn voltages_v(&self) -> Vec<f32> {
        self.counts.iter().map(|&c| f32::from(c) * self.volts_per_count).collect()
    }

    /// Largest magnitude of the sum over one injection's values, V: zero up to noise, because the
    /// values are differences around a ring.
    pub fn largest_injection_sum_v(&self) -> f64 {
        let electrodes = (self.counts.len() as f64).sqrt().round() as usize;
        self.counts
            .chunks(electrodes.max(1))
            .map(|c| c.iter().map(|&v| i64::from(v)).sum::<i64>().unsigned_abs() as f64)
            .fold(0.0, f64::max)
            * f64::from(self.volts_per_count)
    }

    /// Channels that sit at the converter's end.
    pub fn saturated_channels(&self) -> usize {
        self.counts.iter().filter(|&&c| c == i16::MAX || c == i16::MIN).count()
    }
}

/// What the reader of the stream has seen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StreamCounters {
    /// Frames accepted.
    pub frames: u64,
    /// Frames that the sequence numbers say are missing.
    pub missed: u64,
    /// Packets with a wrong length, version, electrode count or checksum.
    pub garbled: u64,
    /// Times the wire was opened again.
    pub reconnects: u64,
}

/// The voltage stream.
#[async_trait]
pub trait SkinReader: Send + Sync {
    /// The newest frame, for the age check.
    fn latest(&self) -> Option<Arc<Frame>>;
    /// Follows the newest frame, for a live view.
    fn follow(&self) -> watch::Receiver<Option<Arc<Frame>>>;
    /// What has been seen so far.
    fn counters(&self) -> StreamCounters;
    /// Takes `count` consecutive complete frames whose first sample was taken after `not_before`.
    /// What is buffered is dropped, and so is the first complete packet.
    async fn take(&self, not_before: Instant, count: usize) -> Result<Vec<Arc<Frame>>, RigError>;
}

/// The whole bench.
#[derive(Clone)]
pub struct Bench {
    /// Stage, along the skin's width.
    pub x: Arc<dyn Axis>,
    /// Stage, along the skin's height.
    pub y: Arc<dyn Axis>,
    /// Stage, downward.
    pub z: Arc<dyn Axis>,
    /// Rotary actuator of the slots, degrees.
    pub radial: Arc<dyn Axis>,
    /// Load cells of the six arms.
    pub cells: Arc<dyn LoadCells>,
    /// The voltage stream.
    pub skin: Arc<dyn SkinReader>,
}

impl Bench {
    /// The axes in the order in which a safe stop treats them: lateral and radial, then z.
    pub fn axes(&self) -> [&Arc<dyn Axis>; 4] {
        [&self.x, &self.y, &self.radial, &self.z]
    }
}
