//! Stand-ins for unit tests: axes, cells and a skin that obey the test, without wires or time, and a journal
//! that takes everything.
//! Uses: `rig::traits`, `journal`, `run::job`, the plans of `schedule::tests`. Never: in a program.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use jiff::{SignedDuration, Timestamp};
use parking_lot::Mutex;
use serde_json::Value;
use tokio::sync::broadcast;
use tokio::time::Instant;

use crate::campaign::bench::stage::Stage;
use crate::campaign::run::job::{Beginning, Job};
use crate::clock::Clock;
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::{Event, ExitStatus, Journal, JournalError, Mounting, Progress};
use crate::record::{
    ARMS, AttemptRecord, Flag, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord, Untouched,
};
use crate::rig::config::{Guard, RigConfig};
use crate::rig::error::RigError;
use crate::rig::traits::{
    Axis, AxisStatus, Bench, CellVolts, Found, Frame, LoadCells, SkinReader, StreamCounters,
};
use crate::schedule::tests::{hex, planned};
use crate::state::StateChange;

/// The rig file of the stand-ins.
pub fn config() -> RigConfig {
    let text = include_str!("../../../../experiments/rigs/virtual.toml");
    RigConfig::from_toml("virtual.toml", text).expect("the virtual rig file is sound")
}

/// A run of one tip.
pub fn job() -> Job {
    Job {
        run: RunUid::new(),
        scan_id: 1,
        plan: planned(&hex(3, "tips = [1]\nconfigurations = 2\ndepths = 2\n")),
        predicted_trial_s: 1.0,
        auto_resume: true,
        has_waited: false,
        beginning: Beginning::OfPerson,
        bytes_per_trial: 4000,
    }
}

/// An axis that reaches each target at once.
#[derive(Debug)]
pub struct StandIn {
    name: &'static str,
    /// What it reports.
    pub status: Mutex<AxisStatus>,
    /// What it reports after the next motion that is started, in place of the target.
    pub after_start: Mutex<Option<AxisStatus>>,
    /// Whether it replies.
    pub replies: AtomicBool,
    /// Whether no motion can be started, for want of a reply.
    pub starts_fail: AtomicBool,
    /// Motions and homings that were started.
    pub starts: AtomicU64,
    /// Time until a motion or homing that has started is acknowledged, wall time.
    pub starts_take: Mutex<Duration>,
    /// Time that the reply to a reading of its status takes, wall time.
    pub status_takes: Mutex<Duration>,
    /// Slowest motion of its drive, units/s.
    pub slowest: Mutex<f64>,
    /// Speed of the last motion that was requested, units/s.
    pub speed: Mutex<f64>,
    /// Targets of the motions that were requested, in its unit.
    pub targets: Mutex<Vec<f64>>,
    /// Stops that it received.
    pub stops: AtomicU64,
    /// Whether its driver panics at a stop.
    pub stop_panics: AtomicBool,
}

impl StandIn {
    /// Creates an axis that is homed and at its zero.
    fn new(name: &'static str) -> Arc<Self> {
        let status = AxisStatus {
            position: 0.0,
            moving: false,
            homed: true,
            ready: true,
            alarm: None,
            at: Instant::now(),
        };
        Arc::new(Self {
            name,
            status: Mutex::new(status),
            after_start: Mutex::default(),
            replies: AtomicBool::new(true),
            starts_fail: AtomicBool::default(),
            starts: AtomicU64::default(),
            starts_take: Mutex::default(),
            status_takes: Mutex::default(),
            slowest: Mutex::default(),
            speed: Mutex::default(),
            targets: Mutex::default(),
            stops: AtomicU64::default(),
            stop_panics: AtomicBool::default(),
        })
    }

    /// What it reports at present.
    pub fn present(&self) -> AxisStatus {
        *self.status.lock()
    }

    /// The next motion or homing that is started continues until the test ends it.
    pub fn keep_moving(&self) {
        *self.after_start.lock() = Some(AxisStatus { moving: true, ..self.present() });
    }

    /// Waits until a motion or homing of it was started.
    pub async fn started(&self) {
        until(|| self.starts.load(Ordering::SeqCst) > 0).await;
    }

    fn reply(&self, operation: &str) -> Result<(), RigError> {
        if self.replies.load(Ordering::SeqCst) { Ok(()) } else { Err(self.silent(operation)) }
    }

    fn silent(&self, operation: &str) -> RigError {
        let (device, operation) = (self.name.into(), operation.into());
        RigError::NoReply { device, operation, timeout_ms: 300 }
    }

    fn start(&self, operation: &str, reached: AxisStatus) -> Result<(), RigError> {
        self.reply(operation)?;
        if self.starts_fail.load(Ordering::SeqCst) {
            return Err(self.silent(operation));
        }
        self.starts.fetch_add(1, Ordering::SeqCst);
        *self.status.lock() = self.after_start.lock().take().unwrap_or(reached);
        Ok(())
    }
}

/// The output of what must end, also on a loaded machine.
pub async fn soon<T>(work: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(60), work).await.expect("it ends in time")
}

/// Waits until this holds.
pub async fn until(holds: impl Fn() -> bool) {
    let wait = async {
        while !holds() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    soon(wait).await;
}

/// Waits for this time; does not yield if it is zero.
async fn wait(takes: &Mutex<Duration>) {
    let takes = *takes.lock();
    if !takes.is_zero() {
        tokio::time::sleep(takes).await;
    }
}

#[async_trait]
impl Axis for StandIn {
    fn name(&self) -> &'static str {
        self.name
    }

    fn travel(&self) -> [f64; 2] {
        [0.0, 600.0]
    }

    fn guard(&self) -> Guard {
        Guard::default()
    }

    fn slowest(&self) -> f64 {
        *self.slowest.lock()
    }

    async fn identify(&self) -> Result<Found, RigError> {
        self.reply("identify")?;
        let AxisStatus { homed, alarm, ready: enabled, .. } = self.present();
        let device = "stand-in".into();
        Ok(Found { device, enabled, homed, alarm, emergency_stop: false, in_command: None })
    }

    async fn prepare(&self) -> Result<String, RigError> {
        self.reply("prepare").map(|()| "stand-in".into())
    }

    async fn start_home(&self) -> Result<(), RigError> {
        self.start("homing", AxisStatus { position: 0.0, homed: true, ..self.present() })?;
        wait(&self.starts_take).await;
        Ok(())
    }

    async fn start_move(&self, target: f64, speed: f64) -> Result<(), RigError> {
        *self.speed.lock() = speed;
        self.targets.lock().push(target);
        self.start("move", AxisStatus { position: target, ..self.present() })?;
        wait(&self.starts_take).await;
        Ok(())
    }

    async fn status(&self) -> Result<AxisStatus, RigError> {
        wait(&self.status_takes).await;
        self.reply("status").map(|()| AxisStatus { at: Instant::now(), ..self.present() })
    }

    async fn stop(&self) -> Result<(), RigError> {
        assert!(!self.stop_panics.load(Ordering::SeqCst), "the driver of {} fails", self.name);
        self.reply("stop")?;
        self.stops.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }

    async fn reset_alarm(&self) -> Result<(), RigError> {
        self.reply("alarm reset")
    }
}

/// Cells that return what the test sets.
#[derive(Debug)]
pub struct Cells {
    /// Outputs of arms 1 to 6, V.
    pub volts: Mutex<[f64; ARMS]>,
    /// Whether they reply.
    pub replies: AtomicBool,
    /// Readings that were asked for.
    pub readings: AtomicU64,
    /// Time that a reply takes, wall time.
    pub takes: Mutex<Duration>,
    /// z, and the height from which on arm 1 touches the skin, machine mm; none: no arm does.
    pub surface: Mutex<Option<(Arc<StandIn>, f64)>>,
}

#[async_trait]
impl LoadCells for Cells {
    async fn prepare(&self) -> Result<String, RigError> {
        Ok("stand-in".into())
    }

    async fn read(&self) -> Result<CellVolts, RigError> {
        self.readings.fetch_add(1, Ordering::SeqCst);
        if !self.replies.load(Ordering::SeqCst) {
            let (device, operation) = ("cells".into(), "values".into());
            return Err(RigError::NoReply { device, operation, timeout_ms: 300 });
        }
        wait(&self.takes).await;
        let mut volts = *self.volts.lock();
        if let Some((z, at_mm)) = self.surface.lock().as_ref()
            && z.present().position >= *at_mm
        {
            // A few newtons.
            volts[0] += 0.1;
        }
        Ok(CellVolts { volts, repeats: [0; ARMS], at: Instant::now() })
    }
}

/// A frame that has just arrived, with counts of 1 mV.
pub fn frame(sequence: u32, counts: Vec<i16>) -> Arc<Frame> {
    let received = Instant::now();
    Arc::new(Frame { sequence, device_time_us: 0, volts_per_count: 1e-3, counts, received })
}

/// A skin that nothing touches; it sends frames when they are taken.
#[derive(Debug, Default)]
pub struct Skin {
    /// Time until they arrive, wall time.
    pub takes: Mutex<Duration>,
    /// Wall time since which its stream is open; none if it is not known.
    pub since: Mutex<Option<Timestamp>>,
}

#[async_trait]
impl SkinReader for Skin {
    fn latest(&self) -> Option<Arc<Frame>> {
        None
    }

    fn follow(&self) -> broadcast::Receiver<Arc<Frame>> {
        broadcast::channel(1).1
    }

    fn counters(&self) -> StreamCounters {
        StreamCounters { since: *self.since.lock(), ..StreamCounters::default() }
    }

    async fn take(&self, _: Instant, count: usize) -> Result<Vec<Arc<Frame>>, RigError> {
        wait(&self.takes).await;
        Ok((1..).take(count).map(|sequence| frame(sequence, vec![0; 784])).collect())
    }
}

/// The axes of a bench, and the journal of its runs.
#[derive(Debug)]
pub struct StandIns {
    /// Stage axis along the width of the skin.
    pub x: Arc<StandIn>,
    /// Stage axis along the height of the skin.
    pub y: Arc<StandIn>,
    /// Stage axis toward the skin.
    pub z: Arc<StandIn>,
    /// Rotary actuator of the slots.
    pub radial: Arc<StandIn>,
    /// Load cells, at first without a load.
    pub cells: Arc<Cells>,
    /// The skin.
    pub skin: Arc<Skin>,
    /// Where the records go.
    pub journal: Arc<Forgetful>,
}

impl Default for StandIns {
    fn default() -> Self {
        let [x, y, z, radial] = ["x", "y", "z", "radial"].map(StandIn::new);
        let (volts, replies) = (Mutex::new([0.5; ARMS]), AtomicBool::new(true));
        let cells = Arc::new(Cells {
            volts,
            replies,
            readings: AtomicU64::default(),
            takes: Mutex::default(),
            surface: Mutex::default(),
        });
        Self { x, y, z, radial, cells, skin: Arc::default(), journal: Arc::default() }
    }
}

impl StandIns {
    /// The bench of these axes, with cells and a skin.
    pub fn bench(&self) -> Bench {
        Bench {
            x: self.x.clone(),
            y: self.y.clone(),
            z: self.z.clone(),
            radial: self.radial.clone(),
            cells: self.cells.clone(),
            skin: self.skin.clone(),
        }
    }

    /// The guarded bench of these axes.
    pub fn stage(&self) -> Stage {
        Stage::new(self.bench(), config(), Clock::new(1.0))
    }

    /// Stops that all axes received together.
    pub fn stops(&self) -> u64 {
        let axes = [&self.x, &self.y, &self.z, &self.radial];
        axes.map(|axis| axis.stops.load(Ordering::SeqCst)).iter().sum()
    }
}

/// A journal that takes everything and keeps only the flags of the trials, and the kinds and times of the events; which
/// trials are stored a test states.
#[derive(Debug, Default)]
pub struct Forgetful {
    /// Keys of the trials that are stored.
    pub stored: Mutex<BTreeSet<TrialKey>>,
    /// Whether it discards none of them, as on a full disk.
    pub discards_fail: AtomicBool,
    /// Time that it takes to discard one, wall time.
    pub discards_take: Mutex<Duration>,
    /// Flags of each trial.
    pub flags: Mutex<Vec<Vec<Flag>>>,
    /// Kind of each event.
    pub events: Mutex<Vec<String>>,
    /// Data of each event.
    pub told: Mutex<Vec<Value>>,
    /// Wall time of each event.
    pub times: Mutex<Vec<Timestamp>>,
    /// When a person took the operator lock.
    pub locked_at: Mutex<Option<Timestamp>>,
}

impl Forgetful {
    /// A person has taken the operator lock at this time from now, s.
    pub fn lock(&self, from_now_s: i64) {
        *self.locked_at.lock() = Some(Timestamp::now() + SignedDuration::from_secs(from_now_s));
    }
}

#[async_trait]
impl Journal for Forgetful {
    async fn trial(&self, _: RunUid, trial: &TrialRecord) -> Result<TrialId, JournalError> {
        self.flags.lock().push(trial.flags.clone());
        Ok(TrialId(1))
    }

    async fn attempt(&self, _: RunUid, _: &AttemptRecord) -> Result<(), JournalError> {
        Ok(())
    }

    async fn tare(&self, _: RunUid, _: &TareRecord) -> Result<(), JournalError> {
        Ok(())
    }

    async fn untouched(&self, _: RunUid, _: &Untouched) -> Result<(), JournalError> {
        Ok(())
    }

    async fn reference(&self, _: RunUid, _: &ReferenceRecord) -> Result<(), JournalError> {
        Ok(())
    }

    async fn touch_off(&self, _: RunUid, _: &TouchOffRecord) -> Result<(), JournalError> {
        Ok(())
    }

    async fn skip(&self, _: RunUid, _: u32, _: &str, _: Timestamp) -> Result<(), JournalError> {
        Ok(())
    }

    async fn discard(&self, _: RunUid, key: TrialKey, _: &str) -> Result<(), JournalError> {
        if self.discards_fail.load(Ordering::SeqCst) {
            return Err(JournalError::of("a discarded trial", "database or disk is full"));
        }
        wait(&self.discards_take).await;
        self.stored.lock().remove(&key);
        Ok(())
    }

    async fn progress(&self, _: RunUid) -> Result<Progress, JournalError> {
        Ok(Progress { stored: self.stored.lock().clone(), ..Progress::default() })
    }

    async fn run_state(&self, _: RunUid, _: StateChange, _: Timestamp) -> Result<(), JournalError> {
        Ok(())
    }

    async fn end_run(
        &self,
        _: RunUid,
        _: ExitStatus,
        _: &str,
        _: Timestamp,
    ) -> Result<(), JournalError> {
        Ok(())
    }

    async fn event(
        &self,
        run: Option<RunUid>,
        kind: &str,
        data: Value,
        at: Timestamp,
    ) -> Result<Event, JournalError> {
        self.events.lock().push(kind.into());
        self.told.lock().push(data.clone());
        self.times.lock().push(at);
        Ok(Event { seq: 1, run, at, kind: kind.into(), data })
    }

    async fn lock_since(&self, at: Timestamp) -> Result<Option<String>, JournalError> {
        let locked_at = *self.locked_at.lock();
        Ok(locked_at.filter(|since| *since > at).map(|_| "ada: hands in the rig".into()))
    }

    async fn mounted(&self, _: &Mounting, _: Timestamp) -> Result<(), JournalError> {
        Ok(())
    }

    async fn last_mounted(&self) -> Result<Option<Mounting>, JournalError> {
        Ok(None)
    }

    async fn free_bytes(&self) -> Result<u64, JournalError> {
        Ok(u64::MAX)
    }
}
