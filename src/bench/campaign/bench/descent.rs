//! Descents of z at the speed of a press: z is stopped where a sample meets a condition, and where a sample, or the reply
//! to the start, comes late.
//! Uses: `campaign::{bench::stage, bench::travel, bench::interlock, bench::estop, run::control}`. Never: the plan,
//! storage, another axis.

use std::time::Duration;

use tokio::time::Instant;

use crate::campaign::bench::estop::{RestReadings, STAND_PAUSE};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stage::{AxisName, GRACE, Stage};
use crate::campaign::bench::travel::{Ended, Polled, Sample, Target};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;

/// Late samples and starts of one descent after which the rig trips. Each makes the descent slower, so that the next one
/// may be twice as old, except at the slowest motion of the drive.
const LATE_SAMPLES_MAX: u32 = 20;

/// Motion of z at a speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Descent {
    /// Target, machine mm.
    pub z_mm: f64,
    /// Largest speed, mm/s; slower if the stopping distance at the present pace of the wires requires it.
    pub speed_mm_s: f64,
}

impl Stage {
    /// Moves z, reads the cells at every poll, and stops z once `until` holds for a sample. Returns whether it did. If no
    /// sample, or no reply to the start, arrives while a stop would keep the margins of the force limits, z is stopped, and
    /// the descent continues after a sample that was read at rest, unless `until` holds for that one.
    ///
    /// # Errors
    /// As `checked_travel`; trips if samples come late again and again.
    pub async fn press_until(
        &mut self,
        control: &mut Control,
        descent: Descent,
        mut until: impl FnMut(&Sample) -> bool,
    ) -> Result<bool, Halt> {
        for _ in 0..LATE_SAMPLES_MAX {
            // The wires may have become slower since it was chosen, and during this descent.
            let speed = self.stopping.press_speed_mm_s(&self.config, self.tips);
            let speed = Some(speed.min(descent.speed_mm_s));
            let target = Target { axis: AxisName::Z, position: descent.z_mm, speed };
            let polled = Polled::AxesAndCells;
            match self.watched_travel(control, &[target], polled, &mut until).await? {
                Ended::Arrived => return Ok(false),
                Ended::Met { z_mm, at } => {
                    self.stop_z(control, z_mm, at).await?;
                    return Ok(true);
                }
                Ended::Late => {
                    let z_mm = self.z_at_rest(control).await?;
                    // A late one may show the force before the stop.
                    let volts = self.read_cells(control).await?.volts;
                    if until(&Sample { z_mm, volts }) {
                        return Ok(true);
                    }
                }
            }
        }
        let detail = format!("{LATE_SAMPLES_MAX} samples or starts of one descent came late");
        Err(Halt::trip(TripKind::Stale, detail))
    }

    /// Moves z at the press speed and reads the cells at every poll.
    ///
    /// # Errors
    /// As `press_until`.
    pub async fn press_to(&mut self, control: &mut Control, z_mm: f64) -> Result<(), Halt> {
        let descent = Descent { z_mm, speed_mm_s: f64::INFINITY };
        self.press_until(control, descent, |_| false).await.map(|_| ())
    }

    /// Stops z after a sample that met the condition, and records the delay and travel of the stop.
    async fn stop_z(
        &mut self,
        control: &mut Control,
        sampled_mm: f64,
        sampled: Instant,
    ) -> Result<(), Halt> {
        self.bench.z.stop().await?;
        self.stopping.note_stop(Some(self.clock.now().saturating_duration_since(sampled)));
        let z_mm = self.z_at_rest(control).await?;
        self.stopping.note_travel(Some((z_mm - sampled_mm).max(0.0)));
        Ok(())
    }

    /// Waits until two readings show z at rest after its stop, and checks every sample meanwhile. Returns its height,
    /// machine mm.
    async fn z_at_rest(&mut self, control: &mut Control) -> Result<f64, Halt> {
        let deadline = self.clock.now() + self.clock.wall(2.0) + GRACE;
        let apart = self.clock.wall(STAND_PAUSE.as_secs_f64());
        let mut readings = RestReadings::default();
        loop {
            let z = control.attending(self.bench.z.status()).await??;
            if readings.show_rest(&z, apart) {
                return Ok(z.position);
            }
            control.attend()?;
            self.read_cells(control).await?;
            if self.clock.now() > deadline {
                return Err(Halt::trip(TripKind::Position, "z did not stop"));
            }
            self.poll_pause().await;
        }
    }

    /// Starts the motion of an axis, and stops it if there is no reply until `due`: it may move although that is late.
    /// Returns whether there was one.
    pub(super) async fn start_or_stop(
        &self,
        target: &Target,
        due: Option<Instant>,
    ) -> Result<bool, Halt> {
        let driven = self.driven(target.axis);
        let start = driven.axis.start_move(target.position, target.speed.unwrap_or(driven.speed));
        let on_time = match due {
            Some(due) => tokio::time::timeout_at(due, start).await.ok(),
            None => Some(start.await),
        };
        let is_on_time = on_time.is_some();
        match on_time {
            Some(started) => started?,
            // It withdraws what was not sent yet.
            None => driven.axis.stop().await?,
        }
        Ok(is_on_time)
    }

    /// Age of the newest sample, from its request, at which z must be stopped, wall time; none unless it presses.
    pub(super) fn sample_age(&self, targets: &[Target]) -> Option<Duration> {
        let speed = targets.iter().find_map(|target| target.speed)?;
        // What is slower, its drive moves at its slowest.
        let speed_mm_s = speed.max(self.bench.z.slowest());
        let age_s = self.stopping.sample_age_s(&self.config, self.tips, speed_mm_s);
        Some(self.clock.wall(age_s))
    }
}
