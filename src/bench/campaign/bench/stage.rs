//! The guarded bench: last readings, active limits, allowed positions of the tips.
//! Uses: `rig::traits`, `schedule::configuration`, `campaign::{bench::interlock, bench::evidence,
//! bench::sound, bench::stopping}`. Never: the plan, storage.
//!
//! Motions are in `travel` and `descent`. Every sample of the cells goes through `check`.

use std::time::Duration;

use tokio::time::Instant;

use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::evidence::{
    FELT_FRAMES, Held, MeasuredForces, PressedArm, SilentArms, SkinWatch,
};
use crate::campaign::bench::interlock::{self, ForceLimits, Outputs, TripKind};
use crate::campaign::bench::sound::{RAISE_READY_WITHIN_S, SoundWatch};
use crate::campaign::bench::stopping::{POLL_S, Stopping};
use crate::campaign::bench::stuck::StuckChannels;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::samples::{ForceSample, Samples};
use crate::clock::Clock;
use crate::record::{ARMS, Pose, TouchOffRecord};
use crate::rig::config::RigConfig;
use crate::rig::error::RigError;
use crate::rig::traits::{Axis, Bench, CellVolts};
use crate::schedule::configuration::Stand;

/// Shortest pause between two polls, wall s, so that an accelerated rig is not polled continuously.
const POLL_WALL_S: f64 = 200e-6;
/// Distance beyond its travel at which no axis can be, in its unit: the drive has lost its zero, or the homing has ended
/// elsewhere.
pub(super) const BEYOND_TRAVEL: f64 = 1.0;
/// Wall time allowed for a motion beyond its predicted duration.
pub(super) const GRACE: Duration = Duration::from_secs(3);

/// Axes of the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisName {
    /// Stage axis along the width of the skin.
    X,
    /// Stage axis along the height of the skin.
    Y,
    /// Stage axis toward the skin, positive downward.
    Z,
    /// Rotary actuator of the slots, which sets the radius.
    Radial,
}

/// Height to which the tips are raised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Height {
    /// Clear of the skin, as for travelling.
    Clear,
    /// Top of the travel: room for a person's hands.
    Top,
}

/// The bench, its limits and its last readings.
pub struct Stage {
    /// Devices behind their capability traits.
    pub bench: Bench,
    /// Rig file of the bench.
    pub config: RigConfig,
    /// Wall and process time of the rig.
    pub clock: Clock,
    /// Number of tips mounted, on arms 1 to n.
    pub tips: u8,
    /// Force limits in effect.
    pub limits: ForceLimits,
    /// Outputs of the cells without load, V.
    pub tare_v: [f64; ARMS],
    /// Result of the touch-off; none until the surface is known.
    pub surface: Option<TouchOffRecord>,
    /// Voltage channels that return the same count in every trial.
    pub stuck: StuckChannels,
    /// Attached arms without force where their tips must press.
    pub silent: SilentArms,
    /// Untouched skin, from the last tare; none after a lateral motion.
    pub skin: Option<SkinWatch>,
    /// Largest force on one cell since the value was last cleared, N.
    pub peak_n: f64,
    /// Measured durations of polls and travels of stops.
    pub stopping: Stopping,
    /// Where every sample of the cells is published.
    pub samples: Samples,
    /// Last sample of the motion or hold that is watched.
    pub(super) last_sample: Option<LastSample>,
    /// Time since which z has been held at rest under watch.
    pub(super) held_since: Option<Instant>,
    /// Radius at which the last approach from below ended, mm; none once the slots have moved since.
    pub(super) approached_mm: Option<f64>,
}

/// When and where the cells were last read in a watched motion or hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::campaign) struct LastSample {
    /// Time of the reading.
    pub at: Instant,
    /// Position of z at that time, machine mm; none unless z was moving.
    pub z_mm: Option<f64>,
}

/// Result of one attempt to raise z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::campaign) enum Raised {
    /// z is up; the deepest position that was read on the way, machine mm.
    Up { deepest_mm: f64 },
    /// z has lost its zero: it is not moved, or is where its drive lost it.
    NotHomed,
}

/// An axis with its motion parameters, in the axis's unit.
pub(in crate::campaign) struct Driven<'a> {
    pub axis: &'a dyn Axis,
    pub tolerance: f64,
    pub speed: f64,
    pub acceleration: f64,
}

impl Stage {
    /// Creates a stage around an open bench, with no tips and no known surface.
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
            samples: Samples::default(),
            last_sample: None,
            held_since: None,
            approached_mm: None,
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

    /// Height at which lateral motion is allowed, machine mm: above the median surface for the longest tip, and
    /// above the highest touch. Until the surface is known, it is derived from the upper end of the search
    /// window.
    pub fn clear_z_mm(&self) -> f64 {
        let place = &self.config.skin;
        match &self.surface {
            Some(found) => {
                let longest = found.tip_offset_mm.iter().map(|t| t.1).fold(0.0, f64::min);
                let highest = found.touches.iter().map(|t| t.z_mm).fold(f64::INFINITY, f64::min);
                (highest.min(found.surface_z_mm + longest) - place.clearance_mm)
                    .max(self.config.axes.z.travel_mm[0])
            }
            None => place.surface_z_mm[0] - place.clearance_mm,
        }
    }

    /// Takes the number of tips that a person has entered; without one, a tip on each leading arm with a connected cell.
    ///
    /// # Errors
    /// Halts if the cells do not reply.
    pub async fn assume_tips(&mut self, entered: Option<u8>) -> Result<(), Halt> {
        let (volts, cells) = (self.bench.cells.read().await?.volts, &self.config.cells);
        let leading = volts.iter().take_while(|&&v| cells.is_live(v)).count() as u8;
        self.tips = entered.unwrap_or(leading);
        Ok(())
    }

    /// Forces of the attached arms, and the depths of their tips.
    pub fn pressed_arms(&self, held: &Held) -> impl Iterator<Item = PressedArm> + use<'_> {
        let (surface, z_mm) = (self.surface.as_ref(), held.z_mm);
        (1..=self.tips).zip(held.forces_n).map(move |(arm, force_n)| {
            let touched = surface.and_then(|s| {
                let offset = s.tip_offset_mm.iter().find(|(a, _)| *a == arm)?.1;
                Some(s.surface_z_mm + offset)
            });
            let below_touch_mm = touched.map_or(f64::NEG_INFINITY, |at| z_mm - at);
            PressedArm { force_n, below_touch_mm }
        })
    }

    /// Waits for one pause between polls.
    pub async fn poll_pause(&self) {
        self.clock.sleep(POLL_S.max(POLL_WALL_S * self.clock.rate())).await;
    }

    /// Reads the cells while z is at rest, and checks every limit.
    ///
    /// # Errors
    /// Halts on a request; trips on a limit, on a wire, and if the stream returns no frame while the load is held:
    /// without frames the skin cannot cross-check the cells.
    pub async fn read_cells(&mut self, control: &mut Control) -> Result<CellVolts, Halt> {
        let reading = control.attending(self.bench.cells.read()).await??;
        self.check(&reading, None)?;
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

    /// Publishes one sample, read with z at `z_mm` if z was read; does not wait for followers.
    pub(in crate::campaign) fn publish(&self, reading: &CellVolts, z_mm: Option<f64>) {
        let age = self.clock.now().saturating_duration_since(reading.at);
        let at = self.clock.timestamp() - age;
        let forces_n = self.live_forces_n(&reading.volts);
        self.samples.publish(ForceSample { at_ms: at.as_millisecond(), z_mm, forces_n });
    }

    /// Begins a watched motion or hold: the gap between samples counts from here.
    pub(in crate::campaign) fn begin_watch(&mut self) {
        self.last_sample = None;
    }

    /// Takes the last sample, from which the delay and travel of the resulting stop are measured.
    pub(in crate::campaign) fn take_last_sample(&mut self) -> Option<LastSample> {
        self.last_sample.take()
    }

    /// Checks one sample, taken with z at `z_mm` if z was moving: its age, the gap since the previous sample, every limit, and the
    /// cross-check with the skin.
    ///
    /// # Errors
    /// Trips on a stale sample, a limit, or a touch of the skin that no cell measures.
    pub(super) fn check(&mut self, reading: &CellVolts, z_mm: Option<f64>) -> Result<(), Halt> {
        self.publish(reading, z_mm);
        let limit_ms = self.config.sample_age_ms();
        let age = self.clock.now().saturating_duration_since(reading.at);
        let sample = LastSample { at: reading.at, z_mm };
        let gap = self.last_sample.replace(sample).map(|last| reading.at - last.at);
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

    /// Number of frames of a held load that suffices for the cross-check of skin and cells.
    pub fn cross_check_frames(&self) -> usize {
        (self.detection_s() * self.config.ert.frame_rate_hz()).ceil() as usize
            + FELT_FRAMES as usize
    }

    /// Process time after which the cells show a load that the skin shows, s.
    fn detection_s(&self) -> f64 {
        self.config.cells.update_ms / 1e3 + self.stopping.blind_s(&self.config)
    }

    fn compare_with_skin(&mut self, forces_n: &[f64]) -> Result<(), Halt> {
        let update_s = self.detection_s();
        let now_s = self.clock.process_s();
        let Some((watch, frame)) = self.skin.as_mut().zip(self.bench.skin.latest()) else {
            return Ok(());
        };
        let limits = &self.config.limits;
        let measured = MeasuredForces { forces_n, now_s, update_s };
        match watch.unmeasured_touch(&frame, &measured, limits) {
            Some(words) => Err(Halt::trip(TripKind::Cell, words)),
            None => Ok(()),
        }
    }

    /// Halt for missing frames: an interrupted stream fails the attempt, a stopped stream trips the
    /// rig.
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

    /// Forces of the arms after subtraction of the tare, N.
    pub fn forces_n(&self, volts: &[f64; ARMS]) -> [f64; ARMS] {
        Outputs { volts, tare_v: &self.tare_v }.forces_n(&self.config.cells)
    }

    /// Forces of the arms with a connected cell, as `forces_n`.
    pub fn live_forces_n(&self, volts: &[f64; ARMS]) -> [Option<f64>; ARMS] {
        let (cells, forces) = (&self.config.cells, self.forces_n(volts));
        std::array::from_fn(|i| cells.is_live(volts[i]).then_some(forces[i]))
    }

    /// Waits for work without motion, such as a commit or frames, and meanwhile checks forces and
    /// requests.
    ///
    /// # Errors
    /// Halts on a limit, a fault or a request; the work is dropped.
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
            self.read_cells(control).await?;
        }
    }

    /// Machine pose over a stand, at a machine z.
    pub fn pose_over(&self, stand: &Stand, z_mm: f64) -> Pose {
        let place = &self.config.skin;
        Pose {
            x_mm: place.origin_x_mm + stand.centre_mm[0],
            y_mm: place.origin_y_mm + stand.centre_mm[1],
            z_mm,
            radius_mm: stand.radius_mm,
        }
    }

    /// Raises z and waits until it has arrived, unless it has lost its zero.
    ///
    /// # Errors
    /// A message if a device does not reply, z reports an alarm, has its motor off or does not arrive in time, or an
    /// e-stop is latched.
    pub(in crate::campaign) async fn raise_once(
        &self,
        height: Height,
        estop: &StopSwitch,
    ) -> Result<Raised, String> {
        let words = |e: crate::rig::error::RigError| e.to_string();
        let top = self.config.axes.z.travel_mm[0];
        let up = match height {
            Height::Clear => self.clear_z_mm(),
            Height::Top => top,
        };
        let z = self.driven(AxisName::Z);
        let from = z.axis.status().await.map_err(words)?;
        if !from.homed {
            return Ok(Raised::NotHomed);
        }
        require_height(from.position, top)?;
        let is_down = from.position > up + z.tolerance || from.moving;
        // Also where z reports to be up: a drive that repeats an old position is down. One that is up may refuse it, and
        // would raise an alarm without its motor.
        if is_down || from.ready {
            // Never down in the travel, even if z is already higher.
            let target = up.min(from.position).max(top);
            let started = z.axis.start_move(target, z.speed).await;
            if is_down {
                started.map_err(words)?;
            }
        }
        let seconds = (from.position - up).abs() / z.speed + 1.0;
        let deadline = self.clock.now() + self.clock.wall(1.5 * seconds) + GRACE;
        let (mut deepest_mm, mut sound) = (from.position, SoundWatch::default());
        loop {
            let now = z.axis.status().await.map_err(words)?;
            deepest_mm = deepest_mm.max(now.position);
            if let Some(alarm) = now.alarm {
                return Err(format!("z reports alarm {alarm:#x} at {:.3} mm", now.position));
            }
            // A drive that has restarted reports the position of its new zero.
            if !now.homed {
                return Ok(Raised::NotHomed);
            }
            if !now.moving && now.position <= up + z.tolerance {
                require_height(now.position, top)?;
                return Ok(Raised::Up { deepest_mm });
            }
            if estop.pressed().is_some() {
                return Err("the emergency stop is latched".into());
            }
            let on = sound.take_ready_or_moving(&self.clock, z.axis, &now, RAISE_READY_WITHIN_S);
            let why = on.err().and_then(|off| off.as_trip().map(|trip| trip.detail.clone()));
            if why.is_some() || self.clock.now() > deadline {
                let why = why.map_or_else(String::new, |why| format!(": {why}"));
                return Err(format!("z at {:.3} mm, to be raised to {up:.3}{why}", now.position));
            }
            self.poll_pause().await;
        }
    }
}

/// Checks that a position of z can be one: far above the travel the zero is lost.
fn require_height(z_mm: f64, top_mm: f64) -> Result<(), String> {
    if z_mm >= top_mm - BEYOND_TRAVEL {
        return Ok(());
    }
    Err(format!("z measured at {z_mm:.3} mm, above its travel from {top_mm:.3} mm"))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::campaign::bench::stand_in::StandIns;
    use crate::rig::traits::AxisStatus;

    #[tokio::test]
    async fn a_drive_that_restarts_while_it_raises_the_tips_has_not_raised_them() {
        let axes = StandIns::default();
        let (stage, stop) = (axes.stage(), StopSwitch::default());
        axes.z.status.lock().position = 60.0;
        // Its position counts from where it restarted: it looks as if z were at the top.
        let restarted = AxisStatus { position: 0.0, homed: false, ..axes.z.present() };
        *axes.z.after_start.lock() = Some(restarted);
        assert_eq!(stage.raise_once(Height::Clear, &stop).await, Ok(Raised::NotHomed));
        // A drive that keeps its zero does raise them.
        *axes.z.status.lock() = AxisStatus { position: 60.0, homed: true, ..restarted };
        let raised = stage.raise_once(Height::Clear, &stop).await;
        assert_eq!(raised, Ok(Raised::Up { deepest_mm: 60.0 }));
        // No height is above the travel.
        axes.z.status.lock().position = -300.0;
        let words = stage.raise_once(Height::Clear, &stop).await.unwrap_err();
        assert!(words.starts_with("z measured at -300.000 mm, above its travel"), "{words}");
    }

    #[tokio::test]
    async fn z_is_commanded_up_also_where_it_reports_to_be_up_already() {
        let axes = StandIns::default();
        let (stage, stop) = (axes.stage(), StopSwitch::default());
        axes.z.status.lock().position = 10.0;
        let is_up = Ok(Raised::Up { deepest_mm: 10.0 });
        assert_eq!(stage.raise_once(Height::Clear, &stop).await, is_up);
        assert_eq!((axes.z.starts.load(Ordering::SeqCst), axes.z.present().position), (1, 10.0));
        // A drive without power refuses it.
        axes.z.starts_fail.store(true, Ordering::SeqCst);
        assert_eq!(stage.raise_once(Height::Clear, &stop).await, is_up);
        // Within its tolerance above the travel, too.
        axes.z.starts_fail.store(false, Ordering::SeqCst);
        axes.z.status.lock().position = -0.01;
        assert!(stage.raise_once(Height::Top, &stop).await.is_ok());
        assert_eq!((axes.z.starts.load(Ordering::SeqCst), axes.z.present().position), (2, 0.0));
        // Not one whose motor is off.
        axes.z.status.lock().ready = false;
        assert!(stage.raise_once(Height::Top, &stop).await.is_ok());
        assert_eq!(axes.z.starts.load(Ordering::SeqCst), 2);
    }
}
