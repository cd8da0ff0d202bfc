//! Motions of the stage, each supervised to its end: positions, alarms, forces, requests.
//! Uses: `schedule::configuration`, `campaign::{bench::stage, run::control, bench::interlock, bench::sound}`.
//! Never: the plan, storage, a wait for the store.
//!
//! No lateral or radial motion unless z is measured clear of the surface (`clear`).

use std::time::Duration;

use futures::future::try_join_all;
use tokio::time::Instant;

use crate::campaign::bench::interlock::{self, TripKind};
use crate::campaign::bench::sound::{
    HOMING_READY_WITHIN_S, SoundWatch, read_ready, require_no_alarm, require_on, require_zero,
};
use crate::campaign::bench::stage::{AxisName, BEYOND_TRAVEL, Driven, GRACE, Stage};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::record::{ARMS, Pose};
use crate::rig::traits::{AxisStatus, CellVolts};
use crate::schedule::configuration::Stand;

/// Longest homing of one axis, process s.
const HOMING_S: f64 = 180.0;
/// Longest time until a drive that was homed before begins to home, process s: it may still report its old zero.
const HOMING_BEGINS_S: f64 = 0.2;
/// Longest time for which polls are timed before a run is armed, wall time: its request waits for the answer.
const TIMED_WITHIN: Duration = Duration::from_secs(3);
/// Longest wait of those who request homing until all axes are homed, wall time: z homes first, then the others, each
/// within their limit of 183 s.
pub const HOMING_WAIT: Duration = Duration::from_secs(400);

/// Target of one axis.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Axis to move.
    pub axis: AxisName,
    /// Target position, in the axis's unit.
    pub position: f64,
    /// Speed of a press, mm/s; absent: the travelling speed of the axis.
    pub speed: Option<f64>,
}

impl Target {
    /// Target at the travelling speed.
    pub fn of(axis: AxisName, position: f64) -> Self {
        Self { axis, position, speed: None }
    }
}

/// Values read by one poll of a press.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// z, machine mm.
    pub z_mm: f64,
    /// Outputs of the cells, V.
    pub volts: [f64; ARMS],
}

/// Devices that are read at every poll of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Polled {
    /// The moving axes.
    Axes,
    /// The moving axes and the load cells, whose forces are checked.
    AxesAndCells,
}

/// How a motion ended.
#[derive(Debug, Clone, Copy)]
pub(super) enum Ended {
    /// Each axis is at its target.
    Arrived,
    /// A sample at this height of z, machine mm, and time met the condition: z moves until it is stopped.
    Met { z_mm: f64, at: Instant },
    /// A sample, or the reply to the start, came late: z was stopped before it arrived.
    Late,
}

impl Stage {
    /// Moves axes together through the air and supervises them until they arrive.
    ///
    /// # Errors
    /// Halts on a position outside the travel, an alarm, a late arrival, z not clear, a wire fault
    /// or a request.
    pub async fn travel(&mut self, control: &mut Control, targets: &[Target]) -> Result<(), Halt> {
        self.watched_travel(control, targets, Polled::Axes, |_| false).await.map(|_| ())
    }

    /// Like `travel`, but reads and checks the cells at every poll.
    ///
    /// # Errors
    /// As `travel`, and on every limit of a sample.
    pub async fn checked_travel(
        &mut self,
        control: &mut Control,
        target: Target,
    ) -> Result<(), Halt> {
        self.watched_travel(control, &[target], Polled::AxesAndCells, |_| false).await.map(|_| ())
    }

    /// Moves axes and supervises them until they arrive, or until `until` holds for a sample of z.
    ///
    /// # Errors
    /// As `travel` and, if the cells are polled, `checked_travel`.
    pub(super) async fn watched_travel(
        &mut self,
        control: &mut Control,
        targets: &[Target],
        polled: Polled,
        mut until: impl FnMut(&Sample) -> bool,
    ) -> Result<Ended, Halt> {
        let is_lateral = targets.iter().any(|t| t.axis != AxisName::Z);
        if is_lateral {
            self.require_clear(control).await?;
            self.skin = None;
        }
        if targets.iter().any(|t| t.axis == AxisName::Radial) {
            self.approached_mm = None;
        }
        if polled == Polled::Axes {
            self.begin_watch();
        } else if self.last_sample.is_none() {
            // Nothing moves before the first sample, and the second must not be late.
            let reading = control.attending(self.bench.cells.read()).await??;
            self.check(&reading, None)?;
        }
        self.held_since = None;
        let z_place = targets.iter().position(|t| t.axis == AxisName::Z);
        let ready = self.require_ready(targets);
        let longest_s = match self.last_sample.filter(|_| !is_lateral) {
            // It must not become too old before the start.
            Some(last) => self.in_time(control, Some(last.at), ready).await?,
            None => control.attending(ready).await??,
        };
        let mut clear_at = is_lateral.then(|| self.clock.now());
        let (began, began_s) = (self.clock.now(), self.clock.process_s());
        let (age, mut is_late) = (self.sample_age(targets), false);
        for target in targets {
            self.require_still_clear(control, &mut clear_at).await?;
            // What was requested since the last poll must not be answered by one more motion.
            control.attend()?;
            // It may move although the reply is lost.
            let start = self.start_or_stop(target, age.map(|age| began + age));
            is_late |= !self.in_time(control, self.oldest(clear_at), start).await?;
        }
        let mut polled_s = self.clock.process_s();
        if age.is_some() {
            // The first sample must be on time although it follows the start: that counts as a poll.
            self.stopping.note_poll(polled_s - began_s);
        }
        if is_late {
            return Ok(Ended::Late);
        }
        let deadline = self.clock.now() + self.clock.wall(1.5 * longest_s + 0.5) + GRACE;
        let mut sound = vec![SoundWatch::default(); targets.len()];
        // The newest sample is as old as its request, since its reply may have been late. z may move since the start was
        // sent.
        let mut sampled = began;
        loop {
            control.attend()?;
            let checked_s = self.clock.process_s();
            self.require_still_clear(control, &mut clear_at).await?;
            // No press is polled like this: the stopping distance does not depend on it.
            polled_s += self.clock.process_s() - checked_s;
            let asked = self.clock.now();
            let poll = self.poll_or_stop(targets, polled, age.map(|age| sampled + age));
            let (statuses, reading, is_late) =
                self.in_time(control, self.oldest(clear_at), poll).await?;
            sampled = asked;
            let now_s = self.clock.process_s();
            self.stopping.note_poll(now_s - polled_s);
            polled_s = now_s;
            let mut arrived = true;
            for ((target, status), sound) in targets.iter().zip(&statuses).zip(&mut sound) {
                arrived &= self.check_axis(target, status)?;
                sound.take(&self.clock, self.driven(target.axis).axis, status)?;
            }
            if let Some(reading) = reading {
                let z_mm = z_place.map(|i| statuses[i].position);
                self.check(&reading, z_mm)?;
                if let Some(z) = z_mm
                    && until(&Sample { z_mm: z, volts: reading.volts })
                {
                    return Ok(Ended::Met { z_mm: z, at: reading.at });
                }
            }
            if arrived {
                return Ok(Ended::Arrived);
            }
            if self.clock.now() > deadline {
                return Err(self.did_not_arrive(targets, &statuses));
            }
            if is_late {
                return Ok(Ended::Late);
            }
            self.poll_pause().await;
        }
    }

    /// Checks one reading of a moving axis. Returns whether it has arrived; without its zero it is somewhere else.
    fn check_axis(&self, target: &Target, status: &AxisStatus) -> Result<bool, Halt> {
        let driven = self.driven(target.axis);
        self.require_within(target.axis, status, driven.tolerance)?;
        require_no_alarm(driven.axis, status)?;
        let is_there = (status.position - target.position).abs() <= driven.tolerance;
        Ok(is_there && !status.moving && status.homed)
    }

    /// Checks that each axis is homed, within its travel, with its motor on and without an alarm, which the release of a
    /// stop could clear. Returns the longest duration of the motions, process s.
    async fn require_ready(&self, targets: &[Target]) -> Result<f64, Halt> {
        let names: Vec<AxisName> = targets.iter().map(|t| t.axis).collect();
        let statuses = self.read_ready(&names).await?;
        let mut longest_s = 0.0f64;
        for (target, status) in targets.iter().zip(&statuses) {
            let driven = self.driven(target.axis);
            require_zero(driven.axis, status)?;
            self.check_axis(target, status)?;
            require_on(driven.axis, status)?;
            longest_s = longest_s.max(predicted_s(&driven, target, status.position));
        }
        Ok(longest_s)
    }

    /// Reads axes before they move or home, and z before a tare on request.
    pub(super) async fn read_ready(&self, names: &[AxisName]) -> Result<Vec<AxisStatus>, Halt> {
        let read = || try_join_all(names.iter().map(|&n| self.driven(n).axis.status()));
        Ok(read_ready(&self.clock, read).await?)
    }

    /// Checks that an axis is within its travel, or beyond it by no more than this, in its unit.
    pub(super) fn require_within(
        &self,
        name: AxisName,
        status: &AxisStatus,
        beyond: f64,
    ) -> Result<(), Halt> {
        let axis = self.driven(name).axis;
        interlock::check_position(axis.name(), status.position, axis.travel(), beyond)?;
        Ok(())
    }

    /// Waits for readings while an axis moves or homes, or for the reply to its start, and meanwhile accepts requests.
    /// `last`: the oldest of the readings before on which the motion depends; none if it was just now.
    ///
    /// # Errors
    /// Trips once that is too old, although a wire still waits for a reply; otherwise as the readings and as
    /// [`Control::attend`].
    pub(super) async fn in_time<T>(
        &self,
        control: &mut Control,
        last: Option<Instant>,
        readings: impl Future<Output = Result<T, Halt>>,
    ) -> Result<T, Halt> {
        let limit_ms = self.config.sample_age_ms();
        let due = last.unwrap_or_else(|| self.clock.now()) + Duration::from_millis(limit_ms);
        let readings = control.attending(tokio::time::timeout_at(due, readings)).await?;
        readings.unwrap_or_else(|_late| {
            let detail = format!("no sample of cells and axes, limits.sample_age_ms = {limit_ms}");
            Err(Halt::trip(TripKind::Stale, detail))
        })
    }

    async fn poll(
        &self,
        targets: &[Target],
        polled: Polled,
    ) -> Result<(Vec<AxisStatus>, Option<CellVolts>), Halt> {
        let axes = try_join_all(targets.iter().map(|t| self.driven(t.axis).axis.status()));
        match polled {
            Polled::Axes => Ok((axes.await?, None)),
            Polled::AxesAndCells => {
                let (statuses, reading) = futures::join!(axes, self.bench.cells.read());
                Ok((statuses?, Some(reading?)))
            }
        }
    }

    /// As `poll`, and stops z if there is no reply until `due`. Returns whether it did as well.
    async fn poll_or_stop(
        &self,
        targets: &[Target],
        polled: Polled,
        due: Option<Instant>,
    ) -> Result<(Vec<AxisStatus>, Option<CellVolts>, bool), Halt> {
        let mut poll = std::pin::pin!(self.poll(targets, polled));
        let on_time = match due {
            Some(due) => tokio::time::timeout_at(due, &mut poll).await.ok(),
            None => Some(poll.as_mut().await),
        };
        let is_late = on_time.is_none();
        let (statuses, reading) = match on_time {
            Some(read) => read?,
            None => {
                let (stopped, read) = futures::join!(self.bench.z.stop(), poll);
                stopped?;
                read?
            }
        };
        Ok((statuses, reading, is_late))
    }

    /// Reads axes and cells several times at rest, so that the stopping distance uses the measured
    /// times of the wires before the first press. The effect of a much slower poll before these decays over further ones,
    /// within 3 s: no other polls are counted at rest.
    ///
    /// # Errors
    /// Halts if a device does not reply.
    pub async fn time_polls(&mut self) -> Result<(), Halt> {
        const ROUNDS: usize = 5;
        let z = [Target::of(AxisName::Z, 0.0)];
        let until = self.clock.now() + TIMED_WITHIN;
        let (mut rounds, mut slowest_s) = (0, 0.0f64);
        while rounds < ROUNDS || self.stopping.is_slower_than(slowest_s) && self.clock.now() < until
        {
            let began_s = self.clock.process_s();
            self.poll_pause().await;
            let (statuses, reading) = self.poll(&z, Polled::AxesAndCells).await?;
            if let Some(reading) = reading {
                self.publish(&reading, statuses.first().map(|z| z.position));
            }
            let took_s = self.clock.process_s() - began_s;
            self.stopping.note_poll(took_s);
            slowest_s = slowest_s.max(took_s);
            rounds += 1;
        }
        Ok(())
    }

    fn did_not_arrive(&self, targets: &[Target], statuses: &[AxisStatus]) -> Halt {
        let words: Vec<String> = targets
            .iter()
            .zip(statuses)
            .map(|(t, s)| {
                let name = self.driven(t.axis).axis.name();
                format!("{name} at {:.3} of {:.3}", s.position, t.position)
            })
            .collect();
        Halt::trip(TripKind::Position, format!("did not arrive in time: {}", words.join(", ")))
    }

    /// Moves over a stand. The radius is always approached from below, by at least the backlash of the slot (less only at
    /// its lower end), so that it has no effect, also after a motion that was interrupted, a jog or a homing.
    ///
    /// # Errors
    /// As `travel`.
    pub async fn go_over(&mut self, control: &mut Control, stand: &Stand) -> Result<Pose, Halt> {
        let target = self.pose_over(stand, self.clear_z_mm());
        let radius_mm = stand.radius_mm;
        let slot = self.config.slot.clone();
        let angle = Target::of(AxisName::Radial, slot.angle_deg(radius_mm));
        let radial = control.attending(self.bench.radial.status()).await??;
        let here = slot.radius_mm(radial.position);
        let below_mm = (radius_mm - slot.backlash_mm).max(slot.radius_mm[0]);
        let off_mm = 2.0 * self.config.axes.radial.tolerance_deg * slot.mm_per_deg.abs();
        let is_approached = self.approached_mm.is_some_and(|at| (at - here).abs() <= off_mm);
        let x = Target::of(AxisName::X, target.x_mm);
        let y = Target::of(AxisName::Y, target.y_mm);
        if here > radius_mm || !is_approached && here > below_mm {
            let low = self.config.axes.radial.travel_deg;
            let below = slot.angle_deg(below_mm).clamp(low[0], low[1]);
            let below = Target::of(AxisName::Radial, below);
            self.travel(control, &[x, y, below]).await?;
            self.travel(control, &[angle]).await?;
        } else {
            self.travel(control, &[x, y, angle]).await?;
        }
        self.approached_mm = Some(radius_mm);
        Ok(target)
    }

    /// Homes every axis: z first and alone, so that the first motion is upward and waits for no cell. `entered`: number
    /// of tips, as for `assume_tips`.
    ///
    /// # Errors
    /// As `travel`; trips if an axis reports an alarm or homing does not end in time.
    pub async fn home(&mut self, control: &mut Control, entered: Option<u8>) -> Result<(), Halt> {
        self.surface = None;
        self.skin = None;
        self.approached_mm = None;
        let z = self.bench.z.clone();
        if control.attending(z.status()).await??.homed {
            let top = self.config.axes.z.travel_mm[0];
            self.travel(control, &[Target::of(AxisName::Z, top)]).await?;
        }
        self.home_axes(control, &[AxisName::Z]).await?;
        control.attending(self.assume_tips(entered)).await??;
        self.require_clear(control).await?;
        self.home_axes(control, &[AxisName::X, AxisName::Y, AxisName::Radial]).await
    }

    async fn home_axes(&mut self, control: &mut Control, names: &[AxisName]) -> Result<(), Halt> {
        let homes_z = names.contains(&AxisName::Z);
        // Before z moves: until a late reply to its start it may already go into a load.
        let mut first = match homes_z {
            true => control.attending(self.cells_in_time()).await?,
            false => None,
        };
        control.attending(self.require_on_to_home(names)).await??;
        let mut clear_at = (!homes_z).then(|| self.clock.now());
        for &name in names {
            self.require_still_clear(control, &mut clear_at).await?;
            control.attend()?;
            // It may home although the reply is lost.
            let start = async { Ok::<_, Halt>(self.driven(name).axis.start_home().await?) };
            self.in_time(control, clear_at, start).await?;
        }
        let begun = self.clock.now();
        let deadline = begun + self.clock.wall(HOMING_S) + GRACE;
        let mut sound = vec![SoundWatch::default(); names.len()];
        loop {
            control.attend()?;
            self.require_still_clear(control, &mut clear_at).await?;
            if homes_z && let Some(now) = control.attending(self.cells_in_time()).await? {
                interlock::check_rises(&self.config.cells, first.get_or_insert(now), &now)?;
            }
            let has_begun = self.clock.now() >= begun + self.clock.wall(HOMING_BEGINS_S);
            let read = self.in_time(control, clear_at, self.read_homing(names)).await?;
            // A drive whose motor is off may keep its earlier zero, as if it were homed.
            if has_begun && read.iter().all(|s| s.homed && !s.moving && s.ready) {
                let mut ends = names.iter().zip(&read);
                return ends.try_for_each(|(&n, s)| self.require_within(n, s, BEYOND_TRAVEL));
            }
            for ((&name, status), sound) in names.iter().zip(&read).zip(&mut sound) {
                let axis = self.driven(name).axis;
                sound.take_ready_or_moving(&self.clock, axis, status, HOMING_READY_WITHIN_S)?;
            }
            if self.clock.now() > deadline {
                let left: Vec<&str> = names
                    .iter()
                    .zip(&read)
                    .filter(|(_, s)| !s.homed || s.moving || !s.ready)
                    .map(|(&n, _)| self.driven(n).axis.name())
                    .collect();
                let detail = format!("homing did not end within {HOMING_S} s: {left:?}");
                return Err(Halt::trip(TripKind::Position, detail));
            }
            self.poll_pause().await;
        }
    }

    /// Reads the cells while z homes. Silent ones keep no tip down, and delay its status by `limits.sample_age_ms` at most.
    async fn cells_in_time(&self) -> Option<CellVolts> {
        let limit = Duration::from_millis(self.config.sample_age_ms());
        tokio::time::timeout(limit, self.bench.cells.read()).await.ok()?.ok()
    }

    /// Checks that axes have their motors on and no alarm before they home: the release of a stop could clear an alarm,
    /// and a drive that carries out no homing may keep its earlier zero, as if it were homed.
    async fn require_on_to_home(&self, names: &[AxisName]) -> Result<(), Halt> {
        let read = self.read_ready(names).await?;
        for (&name, status) in names.iter().zip(&read) {
            let axis = self.driven(name).axis;
            require_no_alarm(axis, status)?;
            require_on(axis, status)?;
        }
        Ok(())
    }

    /// Reads axes while they home: a drive in alarm is at rest, and may keep its earlier zero.
    async fn read_homing(&self, names: &[AxisName]) -> Result<Vec<AxisStatus>, Halt> {
        let read = try_join_all(names.iter().map(|&n| self.driven(n).axis.status())).await?;
        for (&name, status) in names.iter().zip(&read) {
            require_no_alarm(self.driven(name).axis, status)?;
        }
        Ok(read)
    }
}

/// Longest duration of a motion from this position, process s: its drive may round the speed down by its step.
pub(in crate::campaign) fn predicted_s(driven: &Driven<'_>, target: &Target, from: f64) -> f64 {
    let (speed, step) = (target.speed.unwrap_or(driven.speed), driven.axis.slowest());
    let rounded = (speed - step).max(step);
    (target.position - from).abs() / rounded + 2.0 * speed / driven.acceleration
}
