//! The bench under guard: what was read last, which limits hold, where the tips may go.
//! Uses: `rig::traits`, `campaign::{bench::interlock, bench::evidence, bench::stopping}`. Never: the plan, storage.
//!
//! Motions are in `travel`. Every sample of the cells goes through `check`.

use std::time::Duration;

use futures::future::join_all;
use tokio::time::Instant;

use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::evidence::{FELT_FRAMES, SilentArms, SkinWatch};
use crate::campaign::bench::interlock::{self, ForceLimits, TripKind};
use crate::campaign::bench::stopping::{POLL_S, Stopping};
use crate::campaign::bench::stuck::StuckChannels;
use crate::campaign::kept::record::{Pose, TouchOffRecord};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::safe_end::Height;
use crate::clock::Clock;
use crate::rig::config::{ARMS, RigConfig};
use crate::rig::error::RigError;
use crate::rig::traits::{Axis, Bench, CellVolts};

/// Shortest pause between two polls, wall s: an accelerated rig is not polled to death.
const POLL_WALL_S: f64 = 200e-6;
/// Wall time granted to a motion beyond its predicted duration.
pub(super) const GRACE: Duration = Duration::from_secs(3);

/// Which axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisName {
    /// Stage, along the width.
    X,
    /// Stage, along the height.
    Y,
    /// Stage, downward.
    Z,
    /// The slots' actuator.
    Radial,
}

/// The bench, its limits and what it last said.
pub struct Stage {
    /// The devices.
    pub bench: Bench,
    /// Their file.
    pub config: RigConfig,
    /// Wall and process time.
    pub clock: Clock,
    /// Tips mounted, on arms 1 to n.
    pub tips: u8,
    /// Limits in force.
    pub limits: ForceLimits,
    /// Zeros of the cells, V.
    pub tare_v: [f64; ARMS],
    /// The surface, once touched.
    pub surface: Option<TouchOffRecord>,
    /// Channels that have stopped moving.
    pub stuck: StuckChannels,
    /// Arms that weigh nothing where they must.
    pub silent: SilentArms,
    /// The untouched skin, from the last tare on; none after a lateral motion.
    pub skin: Option<SkinWatch>,
    /// Largest force on a cell since it was last cleared, N.
    pub peak_n: f64,
    /// How long polls take, how far stops travel.
    pub stopping: Stopping,
    /// The last sample of the motion or the hold that is being watched.
    last_sample: Option<Instant>,
    /// Since when z has been held still under watch.
    pub(super) held_since: Option<Instant>,
}

/// An axis with what a motion needs to know of it, in the axis's unit.
pub(in crate::campaign) struct Driven<'a> {
    pub axis: &'a dyn Axis,
    pub tolerance: f64,
    pub speed: f64,
    pub acceleration: f64,
}

impl Stage {
    /// A stage around an open bench.
    pub fn new(bench: Bench, config: RigConfig, clock: Clock) -> Self {
        let limits = ForceLimits {
            each_n: config.limits.force_n,
            sum_n: config.limits.force_sum_n,
            below_n: config.limits.tare_drift_n,
        };
        let tare_v = [config.cells.zero_v(); ARMS];
        Self {
            bench,
            config,
            clock,
            tips: 0,
            limits,
            tare_v,
            surface: None,
            stuck: StuckChannels::default(),
            silent: SilentArms::default(),
            skin: None,
            peak_n: 0.0,
            stopping: Stopping::default(),
            last_sample: None,
            held_since: None,
        }
    }

    pub(in crate::campaign) fn driven(&self, name: AxisName) -> Driven<'_> {
        let axes = &self.config.axes;
        let (axis, p) = match name {
            AxisName::X => (&self.bench.x, axes.x.profile()),
            AxisName::Y => (&self.bench.y, axes.y.profile()),
            AxisName::Z => (&self.bench.z, axes.z.profile()),
            AxisName::Radial => (&self.bench.radial, axes.radial.profile()),
        };
        let (tolerance, speed, acceleration) = (p.tolerance, p.speed, p.acceleration);
        Driven { axis: axis.as_ref(), tolerance, speed, acceleration }
    }

    /// Height at which lateral motion is allowed: fully raised until the surface is known.
    pub fn clear_z_mm(&self) -> f64 {
        let place = &self.config.skin;
        match &self.surface {
            Some(found) => {
                let longest = found.tip_offset_mm.iter().map(|t| t.1).fold(0.0, f64::min);
                (found.surface_z_mm + longest - place.clearance_mm)
                    .max(self.config.axes.z.travel_mm[0])
            }
            None => place.surface_z_mm[0] - place.clearance_mm,
        }
    }

    /// How far each attached arm's tip is below where it touched in the touch-off, mm, at a z.
    pub fn below_touch_mm(&self, z_mm: f64) -> impl Iterator<Item = f64> + '_ {
        let surface = self.surface.as_ref();
        (1..=self.tips).map(move |arm| {
            let touched = surface.and_then(|s| {
                let offset = s.tip_offset_mm.iter().find(|(a, _)| *a == arm)?.1;
                Some(s.surface_z_mm + offset)
            });
            touched.map_or(f64::NEG_INFINITY, |at| z_mm - at)
        })
    }

    /// One pause between polls.
    pub async fn poll_pause(&self) {
        self.clock.sleep(POLL_S.max(POLL_WALL_S * self.clock.rate())).await;
    }

    /// Reads all four axes.
    pub async fn pose(&self) -> Result<Pose, Halt> {
        let b = &self.bench;
        let read = join_all([&b.x, &b.y, &b.z, &b.radial].map(|axis| axis.status())).await;
        let mut at = [0.0; 4];
        for (slot, status) in at.iter_mut().zip(read) {
            *slot = status?.position;
        }
        let radius_mm = self.config.slot.radius_mm(at[3]);
        Ok(Pose { x_mm: at[0], y_mm: at[1], z_mm: at[2], radius_mm })
    }

    /// Reads where all axes stand beside where they were sent. An axis that is elsewhere is read
    /// again, since Modbus TCP has no checksum and a flipped bit does not come twice.
    ///
    /// # Errors
    /// Trips when an axis is still off its target; z by more than `Z_OFF_MM`, since a step of less
    /// is kept and flagged.
    pub async fn reached(&self, target: &Pose) -> Result<Pose, Halt> {
        let mut pose = self.pose().await?;
        if self.off_target(&pose, target).is_some() {
            pose = self.pose().await?;
        }
        match self.off_target(&pose, target) {
            Some(words) => Err(Halt::trip(TripKind::Position, words)),
            None => Ok(pose),
        }
    }

    fn off_target(&self, pose: &Pose, target: &Pose) -> Option<String> {
        /// z may be off by this much before the trial is refused instead of flagged, mm.
        const Z_OFF_MM: f64 = 0.5;
        let axes = &self.config.axes;
        let radius_mm = 2.0 * axes.radial.tolerance_deg * self.config.slot.mm_per_deg.abs();
        [
            ("x", pose.x_mm, target.x_mm, 2.0 * axes.x.tolerance_mm),
            ("y", pose.y_mm, target.y_mm, 2.0 * axes.y.tolerance_mm),
            ("z", pose.z_mm, target.z_mm, Z_OFF_MM.max(2.0 * axes.z.tolerance_mm)),
            ("radius", pose.radius_mm, target.radius_mm, radius_mm),
        ]
        .into_iter()
        .find(|(_, at, to, allowed)| (at - to).abs() > *allowed)
        .map(|(name, at, to, allowed)| {
            format!("{name} measured at {at:.3} mm, sent to {to:.3} mm, allowed {allowed} mm")
        })
    }

    /// Reads the cells while z is held still, and checks every limit on them. A stream that gives no
    /// frame of a held load leaves the skin's witness out: it trips as well.
    pub async fn weigh(&mut self) -> Result<CellVolts, Halt> {
        let reading = self.bench.cells.read().await?;
        self.check(&reading)?;
        let limit = Duration::from_millis(self.config.limits.frame_age_ms);
        let held = self.held_since.get_or_insert_with(Instant::now).elapsed();
        let newest = self.bench.skin.latest().map(|frame| frame.received.elapsed());
        if held > limit && newest.is_none_or(|age| age > limit) {
            let limit_ms = limit.as_millis();
            let detail = format!("ert: no frame of a held load, limits.frame_age_ms = {limit_ms}");
            return Err(Halt::trip(TripKind::Stale, detail));
        }
        Ok(reading)
    }

    /// Begins a watched motion or hold: samples count from here.
    pub(in crate::campaign) fn begin_watch(&mut self) {
        self.last_sample = None;
    }

    /// When the last sample was taken, once: for the time from it to the stop that it led to.
    pub(in crate::campaign) fn take_last_sample(&mut self) -> Option<Instant> {
        self.last_sample.take()
    }

    /// Checks one sample: its age, the gap since the one before, every limit, and the skin beside it.
    pub(super) fn check(&mut self, reading: &CellVolts) -> Result<(), Halt> {
        let limit_ms = self.config.limits.sample_age_ms;
        let age = self.clock.now().saturating_duration_since(reading.at);
        let gap = self.last_sample.replace(reading.at).map(|last| reading.at - last);
        for (what, time) in [("sample", Some(age)), ("gap between samples", gap)] {
            if let Some(time) = time.filter(|t| *t > Duration::from_millis(limit_ms)) {
                let ms = time.as_millis();
                let detail = format!("cells: {what} {ms} ms, limits.sample_age_ms = {limit_ms}");
                return Err(Halt::trip(TripKind::Stale, detail));
            }
        }
        let cells = &self.config.cells;
        interlock::check_cells(cells, self.limits, self.tips, reading, &self.tare_v)?;
        let forces = self.forces_n(&reading.volts);
        let attached = &forces[..usize::from(self.tips)];
        self.peak_n = attached.iter().copied().fold(self.peak_n, f64::max);
        self.compare_with_skin(attached)
    }

    /// Frames of a held load after which the skin and the cells have witnessed against each other.
    pub fn witness_frames(&self) -> usize {
        (self.cells_see_s() * self.config.ert.frame_rate_hz()).ceil() as usize
            + FELT_FRAMES as usize
    }

    /// By then the cells have seen what the skin feels, process s.
    fn cells_see_s(&self) -> f64 {
        self.config.cells.update_ms / 1e3 + self.stopping.blind_s(&self.config)
    }

    fn compare_with_skin(&mut self, forces_n: &[f64]) -> Result<(), Halt> {
        let update_s = self.cells_see_s();
        let now_s = self.clock.process_s();
        let Some((watch, frame)) = self.skin.as_mut().zip(self.bench.skin.latest()) else {
            return Ok(());
        };
        let limits = &self.config.limits;
        match watch.unweighed_touch(&frame, forces_n, now_s, update_s, limits) {
            Some(words) => Err(Halt::trip(TripKind::Cell, words)),
            None => Ok(()),
        }
    }

    /// A stream that gives some frames fails the try; one that has stopped trips the rig.
    pub fn no_frames(&self, error: RigError) -> Halt {
        let limit = Duration::from_millis(self.config.limits.frame_age_ms);
        let newest = self.bench.skin.latest();
        match newest.map(|f| f.received.elapsed()) {
            Some(age) if age <= limit => error.into(),
            age => {
                let age = age.map_or("none yet".into(), |a| format!("{} ms old", a.as_millis()));
                let limit_ms = limit.as_millis();
                let detail = format!("ert: newest frame {age}, limit {limit_ms} ms ({error})");
                Halt::trip(TripKind::Stale, detail)
            }
        }
    }

    /// Forces over the tare, N.
    pub fn forces_n(&self, volts: &[f64; ARMS]) -> [f64; ARMS] {
        interlock::forces_n(&self.config.cells, volts, &self.tare_v)
    }

    /// Waits for work that moves nothing, such as a commit or frames, and watches forces and
    /// requests the while.
    pub async fn watch_while<T>(
        &mut self,
        control: &mut Control,
        work: impl Future<Output = T>,
    ) -> Result<T, Halt> {
        let mut work = std::pin::pin!(work);
        loop {
            tokio::select! {
                biased;
                done = &mut work => return Ok(done),
                () = self.poll_pause() => {}
            }
            control.attend()?;
            self.weigh().await?;
        }
    }

    /// The machine pose over a place on the skin.
    pub fn pose_over(&self, centre_mm: [f64; 2], radius_mm: f64, z_mm: f64) -> Pose {
        let place = &self.config.skin;
        Pose {
            x_mm: place.origin_x_mm + centre_mm[0],
            y_mm: place.origin_y_mm + centre_mm[1],
            z_mm,
            radius_mm,
        }
    }

    /// Raises z and waits until it stands there. `Ok(false)`: z does not know where it is.
    pub(in crate::campaign) async fn raise_once(
        &self,
        height: Height,
        estop: &StopSwitch,
    ) -> Result<bool, String> {
        let words = |e: crate::rig::error::RigError| e.to_string();
        let top = self.config.axes.z.travel_mm[0];
        let up = match height {
            Height::Clear => self.clear_z_mm(),
            Height::Top => top,
        };
        let z = self.driven(AxisName::Z);
        let from = z.axis.status().await.map_err(words)?;
        if !from.homed {
            return Ok(false);
        }
        if from.position > up + z.tolerance || from.moving {
            // Never down, also where z stands above already.
            let target = up.min(from.position).max(top);
            z.axis.start_move(target, z.speed).await.map_err(words)?;
        }
        let seconds = (from.position - up).abs() / z.speed + 1.0;
        let deadline = self.clock.now() + self.clock.wall(1.5 * seconds) + GRACE;
        loop {
            let now = z.axis.status().await.map_err(words)?;
            if let Some(alarm) = now.alarm {
                return Err(format!("z reports alarm {alarm:#x} at {:.3} mm", now.position));
            }
            if !now.moving && now.position <= up + z.tolerance {
                return Ok(true);
            }
            if estop.pressed().is_some() {
                return Err("the emergency stop is latched".into());
            }
            if self.clock.now() > deadline {
                return Err(format!("z at {:.3} mm, to be raised to {up:.3}", now.position));
            }
            self.poll_pause().await;
        }
    }
}
