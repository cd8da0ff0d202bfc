//! The bench under guard: every motion is watched, every sample is checked, everything is raised.
//! Uses: `rig::traits`, `campaign::{interlock, control, halt}`. Never: the plan, storage.
//!
//! No lateral or radial motion unless z is measured clear of the surface (`design.md` 8, law 2).

use std::time::Duration;

use futures::future::{join_all, try_join_all};
use tokio::time::Instant;

use super::control::Control;
use super::halt::Halt;
use super::interlock::{self, ForceLimits, TripKind};
use super::record::{Pose, TouchOffRecord};
use super::stuck::StuckChannels;
use crate::clock::Clock;
use crate::rig::config::{ARMS, RigConfig};
use crate::rig::traits::{Axis, AxisStatus, Bench, CellVolts};

/// Pause between two polls of a motion, process s.
const POLL_S: f64 = 0.010;
/// Shortest pause between two polls, wall s: an accelerated rig is not polled to death.
const POLL_WALL_S: f64 = 200e-6;
/// Share of the slowest poll that is remembered after one more.
const POLL_MEMORY: f64 = 0.99;
/// How late this computer may be between two polls, wall s.
const LATE_WALL_S: f64 = 0.005;
/// Wall time granted to a motion beyond its predicted duration.
const GRACE: Duration = Duration::from_secs(3);
/// Longest homing of one axis, process s.
const HOMING_S: f64 = 180.0;
/// Tries at raising the tips before a person must look.
const RAISE_TRIES: u32 = 3;

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
    /// Largest force on a cell since it was last cleared, N.
    pub peak_n: f64,
    /// Slowest round of polling of late, process s.
    slowest_poll_s: f64,
}

/// What one poll read.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// z, machine mm.
    pub z_mm: f64,
    /// Outputs of the cells, V.
    pub volts: [f64; ARMS],
}

impl Stage {
    /// A stage around an open bench.
    pub fn new(bench: Bench, config: RigConfig, clock: Clock) -> Self {
        let limits =
            ForceLimits { each_n: config.limits.force_n, sum_n: config.limits.force_sum_n };
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
            peak_n: 0.0,
            slowest_poll_s: 0.0,
        }
    }

    fn axis(&self, name: AxisName) -> (&dyn Axis, f64, f64, f64) {
        let axes = &self.config.axes;
        let (axis, p) = match name {
            AxisName::X => (&self.bench.x, axes.x.profile()),
            AxisName::Y => (&self.bench.y, axes.y.profile()),
            AxisName::Z => (&self.bench.z, axes.z.profile()),
            AxisName::Radial => (&self.bench.radial, axes.radial.profile()),
        };
        (axis.as_ref(), p.tolerance, p.speed, p.acceleration)
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

    /// Reads the cells and checks every limit on them.
    pub async fn weigh(&mut self) -> Result<CellVolts, Halt> {
        let reading = self.bench.cells.read().await?;
        self.check(&reading)?;
        Ok(reading)
    }

    fn check(&mut self, reading: &CellVolts) -> Result<(), Halt> {
        let cells = &self.config.cells;
        let limit_ms = self.config.limits.sample_age_ms;
        let age = self.clock.now().saturating_duration_since(reading.at);
        if age > Duration::from_millis(limit_ms) {
            let detail = format!("cells: sample {} ms old, limit {limit_ms} ms", age.as_millis());
            return Err(Halt::trip(TripKind::Stale, detail));
        }
        interlock::check_cells(cells, self.limits, self.tips, &reading.volts, &self.tare_v)?;
        let forces = self.forces_n(&reading.volts);
        self.peak_n = forces[..usize::from(self.tips)].iter().copied().fold(self.peak_n, f64::max);
        Ok(())
    }

    /// Forces over the tare, N.
    pub fn forces_n(&self, volts: &[f64; ARMS]) -> [f64; ARMS] {
        interlock::forces_n(&self.config.cells, volts, &self.tare_v)
    }

    /// Moves axes together and watches them to their targets; cells are checked at every poll when
    /// `weighing`.
    pub async fn travel(
        &mut self,
        control: &mut Control,
        targets: &[(AxisName, f64)],
        weighing: bool,
    ) -> Result<(), Halt> {
        let speeds: Vec<_> = targets.iter().map(|&(n, t)| (n, t, self.axis(n).2)).collect();
        self.travel_at(control, &speeds, weighing, |_| false).await.map(|_| ())
    }

    /// As `travel`, at given speeds, ending early (with a stop) once `until` holds for a sample.
    /// Returns whether it ended early.
    pub async fn travel_at(
        &mut self,
        control: &mut Control,
        targets: &[(AxisName, f64, f64)],
        weighing: bool,
        mut until: impl FnMut(&Sample) -> bool,
    ) -> Result<bool, Halt> {
        let lateral = targets.iter().any(|t| t.0 != AxisName::Z);
        if lateral {
            self.require_clear().await?;
        }
        let deadline = self.start(targets).await?;
        let mut polled_s = self.clock.process_s();
        loop {
            control.attend().await?;
            let (statuses, reading) = self.watch(targets, weighing).await?;
            let now_s = self.clock.process_s();
            self.note_poll(now_s - polled_s);
            polled_s = now_s;
            let mut arrived = true;
            for (&(name, target, _), status) in targets.iter().zip(&statuses) {
                let (axis, tolerance, ..) = self.axis(name);
                interlock::check_position(axis.name(), status.position, axis.travel(), tolerance)?;
                if let Some(alarm) = status.alarm {
                    let detail = format!("{} reports alarm {alarm:#x}", axis.name());
                    return Err(Halt::trip(TripKind::Device, detail));
                }
                arrived &= !status.moving && (status.position - target).abs() <= tolerance;
            }
            if let (Some(reading), Some(z)) = (reading, statuses.last()) {
                self.check(&reading)?;
                if until(&Sample { z_mm: z.position, volts: reading.volts }) {
                    self.bench.z.stop().await?;
                    self.wait_still(control).await?;
                    return Ok(true);
                }
            }
            if arrived {
                return Ok(false);
            }
            if self.clock.now() > deadline {
                return Err(self.did_not_arrive(targets, &statuses));
            }
            self.poll_pause().await;
        }
    }

    async fn start(&self, targets: &[(AxisName, f64, f64)]) -> Result<Instant, Halt> {
        let mut longest_s = 0.0f64;
        for &(name, target, speed) in targets {
            let (axis, _, _, acceleration) = self.axis(name);
            let from = axis.status().await?.position;
            longest_s = longest_s.max((target - from).abs() / speed + 2.0 * speed / acceleration);
            axis.start_move(target, speed).await?;
        }
        Ok(self.clock.now() + self.clock.wall(1.5 * longest_s + 0.5) + GRACE)
    }

    async fn watch(
        &self,
        targets: &[(AxisName, f64, f64)],
        weighing: bool,
    ) -> Result<(Vec<AxisStatus>, Option<CellVolts>), Halt> {
        let axes = try_join_all(targets.iter().map(|t| self.axis(t.0).0.status()));
        if weighing {
            let (statuses, reading) = futures::join!(axes, self.bench.cells.read());
            Ok((statuses?, Some(reading?)))
        } else {
            Ok((axes.await?, None))
        }
    }

    fn did_not_arrive(&self, targets: &[(AxisName, f64, f64)], statuses: &[AxisStatus]) -> Halt {
        let words: Vec<String> = targets
            .iter()
            .zip(statuses)
            .map(|(t, s)| format!("{} at {:.3} of {:.3}", self.axis(t.0).0.name(), s.position, t.1))
            .collect();
        Halt::trip(TripKind::Position, format!("did not arrive in time: {}", words.join(", ")))
    }

    async fn require_clear(&self) -> Result<(), Halt> {
        let z = self.bench.z.status().await?;
        let (_, tolerance, ..) = self.axis(AxisName::Z);
        let clear = self.clear_z_mm();
        if z.moving || z.position > clear + tolerance {
            let detail =
                format!("lateral motion refused: z at {:.3} mm, clear at {clear:.3}", z.position);
            return Err(Halt::trip(TripKind::Position, detail));
        }
        Ok(())
    }

    async fn wait_still(&self, control: &mut Control) -> Result<(), Halt> {
        let deadline = self.clock.now() + self.clock.wall(2.0) + GRACE;
        while self.bench.z.status().await?.moving {
            control.attend().await?;
            if self.clock.now() > deadline {
                return Err(Halt::trip(TripKind::Position, "z did not stop"));
            }
            self.poll_pause().await;
        }
        Ok(())
    }

    /// Moves to a place over the skin (skin coordinates) with the arms at a radius. The radius is
    /// always approached from below, so that the slot's play does not show.
    pub async fn go_over(
        &mut self,
        control: &mut Control,
        centre_mm: [f64; 2],
        radius_mm: f64,
    ) -> Result<Pose, Halt> {
        let target = self.pose_over(centre_mm, radius_mm, self.clear_z_mm());
        let slot = self.config.slot.clone();
        let angle = slot.angle_deg(radius_mm);
        let here = slot.radius_mm(self.bench.radial.status().await?.position);
        let (x, y) = ((AxisName::X, target.x_mm), (AxisName::Y, target.y_mm));
        if here > radius_mm {
            let low = self.config.axes.radial.travel_deg;
            let below = slot.angle_deg((radius_mm - slot.backlash_mm).max(slot.radius_mm[0]));
            let below = below.clamp(low[0], low[1]);
            self.travel(control, &[x, y, (AxisName::Radial, below)], false).await?;
            self.travel(control, &[(AxisName::Radial, angle)], false).await?;
        } else {
            self.travel(control, &[x, y, (AxisName::Radial, angle)], false).await?;
        }
        Ok(target)
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

    /// Longest time between a force and the stop that it asks for, process s: the cells' update, two
    /// polls as slow as the slowest of late (a wire that several devices share, or a fast clock,
    /// makes them long), and what this computer may be late besides.
    pub fn blind_s(&self) -> f64 {
        let late_s = LATE_WALL_S * self.clock.rate();
        self.config.cells.update_ms / 1e3 + 2.0 * self.slowest_poll_s.max(POLL_S) + late_s
    }

    /// Notes how long one round of polling took; a slow one is forgotten within some hundred.
    fn note_poll(&mut self, took_s: f64) {
        self.slowest_poll_s = took_s.max(self.slowest_poll_s * POLL_MEMORY);
    }

    /// Speed at which a surface may be looked for whose height is not known, mm/s: what is felt
    /// after `blind_s` stays within the margin of the force limit.
    pub fn search_speed_mm_s(&self) -> f64 {
        let limits = &self.config.limits;
        let speed = limits.force_margin_n / (limits.stiffness_n_per_mm * self.blind_s());
        speed.min(self.config.approach_speed_mm_s())
    }

    /// Moves z at the approach speed, weighing at every poll.
    pub async fn press_to(&mut self, control: &mut Control, z_mm: f64) -> Result<(), Halt> {
        let speed = self.config.approach_speed_mm_s();
        self.travel_at(control, &[(AxisName::Z, z_mm, speed)], true, |_| false).await?;
        Ok(())
    }

    /// Stops x, y and the radius, then raises z. Not interruptible; tried a few times. After an
    /// e-stop nothing moves until it is released, and the tips stay where they are.
    pub async fn raise(&mut self) -> Result<(), String> {
        self.raise_to(self.clear_z_mm()).await
    }

    /// As `raise`, up to the top of the travel: room for a person's hands.
    pub async fn raise_fully(&mut self) -> Result<(), String> {
        self.raise_to(self.config.axes.z.travel_mm[0]).await
    }

    async fn raise_to(&self, clear: f64) -> Result<(), String> {
        let mut last = String::new();
        for _ in 0..RAISE_TRIES {
            match self.try_raise(clear).await {
                Ok(()) => return Ok(()),
                Err(error) => last = error,
            }
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        Err(last)
    }

    async fn try_raise(&self, clear: f64) -> Result<(), String> {
        let words = |e: crate::rig::error::RigError| e.to_string();
        let b = &self.bench;
        for stopped in join_all([&b.x, &b.y, &b.radial].map(|axis| axis.stop())).await {
            stopped.map_err(words)?;
        }
        let (z, tolerance, speed, _) = self.axis(AxisName::Z);
        let from = z.status().await.map_err(words)?;
        if from.position > clear + tolerance || from.moving {
            z.start_move(clear, speed).await.map_err(words)?;
        }
        let seconds = (from.position - clear).abs() / speed + 1.0;
        let deadline = self.clock.now() + self.clock.wall(1.5 * seconds) + GRACE;
        loop {
            let now = z.status().await.map_err(words)?;
            if !now.moving && now.position <= clear + tolerance {
                return Ok(());
            }
            if self.clock.now() > deadline {
                return Err(format!("z at {:.3} mm, to be raised to {clear:.3}", now.position));
            }
            self.poll_pause().await;
        }
    }

    /// Homes every axis: z first and alone, so that the first motion is up.
    pub async fn home(&mut self, control: &mut Control) -> Result<(), Halt> {
        self.surface = None;
        let z = self.bench.z.clone();
        if z.status().await?.homed {
            let top = self.config.axes.z.travel_mm[0];
            self.travel(control, &[(AxisName::Z, top)], false).await?;
        }
        self.home_axes(control, &[AxisName::Z]).await?;
        self.home_axes(control, &[AxisName::X, AxisName::Y, AxisName::Radial]).await
    }

    async fn home_axes(&self, control: &mut Control, names: &[AxisName]) -> Result<(), Halt> {
        for &name in names {
            self.axis(name).0.start_home().await?;
        }
        let deadline = self.clock.now() + self.clock.wall(HOMING_S) + GRACE;
        // A drive that was homed before needs a moment to take the command up.
        self.clock.sleep(0.1).await;
        loop {
            control.attend().await?;
            let read = try_join_all(names.iter().map(|&n| self.axis(n).0.status())).await?;
            if read.iter().all(|s| s.homed && !s.moving) {
                return Ok(());
            }
            if let Some((name, s)) = names.iter().zip(&read).find(|(_, s)| s.alarm.is_some()) {
                let axis = self.axis(*name).0.name();
                let detail = format!("{axis} reports alarm {:#x}", s.alarm.unwrap_or_default());
                return Err(Halt::trip(TripKind::Device, detail));
            }
            if self.clock.now() > deadline {
                let left: Vec<&str> = names
                    .iter()
                    .zip(&read)
                    .filter(|(_, s)| !s.homed || s.moving)
                    .map(|(&n, _)| self.axis(n).0.name())
                    .collect();
                let detail = format!("homing did not end within {HOMING_S} s: {left:?}");
                return Err(Halt::trip(TripKind::Position, detail));
            }
            self.poll_pause().await;
        }
    }
}
