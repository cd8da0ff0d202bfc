//! z is up, and no cell reads a load: checks before another axis moves or homes, and while it does; and before a person
//! tares.
//! Uses: `campaign::{bench::stage, bench::travel, bench::interlock, bench::sound, bench::not_clear, run::control}`.
//! Never: the plan, storage, a motion.

use futures::future::try_join;
use tokio::time::Instant;

use crate::campaign::bench::interlock::{self, TripKind};
use crate::campaign::bench::not_clear::NotClear;
use crate::campaign::bench::sound::{require_no_alarm, require_on, require_zero};
use crate::campaign::bench::stage::{AxisName, BEYOND_TRAVEL, Driven, Stage};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::rig::traits::AxisStatus;

/// Distance that z may sink during a lateral motion and the tare after it, beyond its tolerance, mm: more than an
/// encoder jitters at rest, and less than the smallest clearance of a rig file (0.5 mm).
const SINKS_MM: f64 = 0.2;

impl Stage {
    /// Reads z, which must know its position and have no alarm: a lateral motion depends on it.
    async fn known_z(&self) -> Result<AxisStatus, Halt> {
        let z = self.bench.z.status().await?;
        require_zero(self.bench.z.as_ref(), &z)?;
        self.require_within(AxisName::Z, &z, BEYOND_TRAVEL)?;
        require_no_alarm(self.bench.z.as_ref(), &z)?;
        Ok(z)
    }

    /// Position below which z, once it was measured clear, has sunk, machine mm.
    pub(super) fn sunk_mm(&self) -> f64 {
        self.clear_z_mm() + self.driven(AxisName::Z).tolerance + SINKS_MM
    }

    /// Checks before each start of a lateral motion or homing, and during it, that z has stayed up with its motor on (a
    /// drive may lose its power, and a brake slip), and that no cell reads a load. `clear_at`: when the older of the last
    /// readings of z and the cells arrived, from which every wait of the motion counts; none unless one is lateral: then
    /// nothing is read.
    ///
    /// # Errors
    /// A trip if not, if a device does not reply, or if the last readings are too old; a request meanwhile.
    pub(super) async fn require_still_clear(
        &mut self,
        control: &mut Control,
        clear_at: &mut Option<Instant>,
    ) -> Result<(), Halt> {
        let Some(last) = clear_at else { return Ok(()) };
        let is_up = async {
            let z = self.known_z().await?;
            require_on(self.bench.z.as_ref(), &z)?;
            if z.position > self.sunk_mm() {
                let (at, clear) = (z.position, self.clear_z_mm());
                let detail =
                    format!("z sank to {at:.3} mm during a lateral motion, clear at {clear:.3}");
                return Err(Halt::trip(TripKind::Position, detail));
            }
            Ok::<_, Halt>(z)
        };
        let read = async { Ok::<_, Halt>(self.bench.cells.read().await?) };
        let both = try_join(is_up, read);
        let (z, reading) = self.in_time(control, Some(*last), both).await?;
        interlock::check_unloaded(&self.config.cells, self.tips, &reading, &self.tare_v)?;
        *last = z.at.min(reading.at);
        // A jog reads the cells with its axis, too: since its last sample they were read here.
        if let Some(sample) = &mut self.last_sample {
            sample.at = sample.at.max(reading.at);
        }
        Ok(())
    }

    /// Checks before a lateral motion or homing, and before hands are called to the tips, that z is measured clear of the
    /// surface, with its motor on, and that the cells do not contradict it.
    ///
    /// # Errors
    /// A trip if not, or if a device does not reply; a request meanwhile.
    pub(in crate::campaign) async fn require_clear(
        &self,
        control: &mut Control,
    ) -> Result<(), Halt> {
        let (clear, tolerance) = (self.clear_z_mm(), self.driven(AxisName::Z).tolerance);
        // A module that converts slowly still returns the load before the raise, and one that hangs needs some updates
        // to show it.
        let cells = &self.config.cells;
        let updates_s = f64::from(cells.repeats_max() + 2) * cells.update_ms / 1e3;
        let deadline = self.clock.now() + self.clock.wall(updates_s);
        loop {
            let asked = self.clock.now();
            let reading = control.attending(self.bench.cells.read()).await?;
            // Read after each reply of the cells: z may have sunk while they were awaited.
            let z = control.attending(self.known_z()).await??;
            if z.moving || z.position > clear + tolerance {
                let at = z.position;
                let detail =
                    format!("lateral motion refused: z at {at:.3} mm, clear at {clear:.3}");
                return Err(Halt::trip(TripKind::Position, detail));
            }
            let unloaded = interlock::check_unloaded(cells, self.tips, &reading?, &self.tare_v);
            // It may report that it is ready a moment after the raise.
            match unloaded.map_err(Halt::from).and(require_on(self.bench.z.as_ref(), &z)) {
                Ok(()) => return Ok(()),
                Err(halt) if asked > deadline => return Err(halt),
                Err(_) => self.poll_pause().await,
            }
            control.attend()?;
        }
    }

    /// Checks before and after a tare that a person requests that z is measured clear of the surface, at rest and with its
    /// motor on: the load on a tip that touches would become its zero, and the force limits would be too high by it.
    ///
    /// # Errors
    /// `Halt::Failed` if not, with what must be done first: nothing moves because of it. A trip if z does not reply; a
    /// request meanwhile.
    pub(super) async fn require_clear_to_tare(&self, control: &mut Control) -> Result<(), Halt> {
        let z = control.attending(self.read_ready(&[AxisName::Z])).await??[0];
        match self.not_clear(&z) {
            Some(why) => Err(Halt::Failed(why.refuses_tare(control.rig()))),
            None => Ok(()),
        }
    }

    /// Why this reading of z does not permit a tare that a person requests; none if it does.
    pub(in crate::campaign) fn not_clear(&self, z: &AxisStatus) -> Option<NotClear> {
        let Driven { axis, tolerance, .. } = self.driven(AxisName::Z);
        let (at_mm, limit_mm) = (z.position, self.clear_z_mm() + tolerance);
        let sound = require_no_alarm(axis, z)
            .and_then(|()| require_on(axis, z))
            .and_then(|()| self.require_within(AxisName::Z, z, BEYOND_TRAVEL));
        if !z.homed {
            return Some(NotClear::NotHomed);
        }
        if let Err(halt) = sound {
            let words = halt.as_trip().map_or_else(String::new, |trip| trip.detail.clone());
            return Some(NotClear::Faulty(words));
        }
        if z.moving {
            return Some(NotClear::Moving { at_mm });
        }
        (at_mm > limit_mm).then_some(NotClear::Low { at_mm, limit_mm })
    }

    /// The oldest of the last sample and of the readings that showed z clear.
    pub(super) fn oldest(&self, clear_at: Option<Instant>) -> Option<Instant> {
        clear_at.into_iter().chain(self.last_sample.map(|last| last.at)).min()
    }
}
