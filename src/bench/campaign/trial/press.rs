//! One configuration: travel, tare, then every depth: approach, settle, measure, commit.
//! Uses: `campaign::{bench::stage, bench::tare, trial::measure, diary}`. Never: retries, states
//! (the engine decides), a step to the next depth before the trial is durable.
//!
//! Paper II-B and IV-A: quasi-static, normal force only, loading direction only.

use serde_json::json;
use tracing::Instrument;

use crate::campaign::bench::evidence::{self, Held, PressedArm};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stage::Stage;
use crate::campaign::bench::tare::{self, Accept};
use crate::campaign::diary::Note;
use crate::campaign::run::control::{Control, STORE_LIMIT};
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::status::Phase;
use crate::campaign::spans::trial_span;
use crate::campaign::trial::measure::{self, Taken};
use crate::ids::{RunUid, TrialKey};
use crate::journal::JournalError;
use crate::record::{
    ARMS, ArmReading, Flag, Pose, ReferenceRecord, TareRecord, TrialRecord, TrialScalars,
};
use crate::schedule::configuration::Stand;
use crate::schedule::plan::{Plan, PlannedConfiguration, ReferencePress};

/// Deviation of the reached depth from the target above which a trial is flagged, mm.
const DEPTH_TOLERANCE_MM: f64 = 0.05;

/// Context of one configuration: run, plan and attempt.
pub struct Pressing<'a> {
    /// Id of the run.
    pub run: RunUid,
    /// Plan of the run.
    pub plan: &'a Plan,
    /// Number of the attempt, from 1.
    pub attempt: u32,
}

impl Pressing<'_> {
    /// Presses the pending depths of a configuration. Returns the number of trials stored. The tips
    /// stay down; the engine raises them.
    ///
    /// # Errors
    /// Halts on a limit, a fault, a request, a failed attempt or a failing store.
    pub async fn configuration(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        c: &PlannedConfiguration,
        pending: &[u32],
    ) -> Result<u32, Halt> {
        // What fails before the first press is of this configuration, not of the one before.
        let first =
            pending.first().map(|&depth_index| TrialKey { configuration: c.index, depth_index });
        control.show_run(|run| run.trial = first);
        self.prepare(stage, control, &c.stand, c.index).await?;
        let mut stored = 0;
        let mut before: Option<Held> = None;
        for &depth_index in pending {
            let key = TrialKey { configuration: c.index, depth_index };
            control.show_run(|run| run.trial = Some(key));
            let trial = self.trial(stage, control, c, key, before.as_ref());
            let held = trial.instrument(trial_span(key)).await?;
            before = Some(held);
            stored += 1;
            control.checkpoint()?;
        }
        if let Some(deepest) = before {
            let arms: Vec<PressedArm> = stage.pressed_arms(&deepest).collect();
            if let Some(words) = stage.silent.note(arms, &stage.config.limits) {
                return Err(Halt::trip(TripKind::Cell, words));
            }
        }
        Ok(stored)
    }

    /// Moves over a stand and tares. Halts there if a pause or a stop was requested.
    async fn prepare(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        stand: &Stand,
        configuration: u32,
    ) -> Result<(), Halt> {
        control.phase(Phase::Travel);
        let over = stage.go_over(control, stand).await?;
        control.phase(Phase::Tare);
        let samples = self.plan.measure.tare_samples;
        let volts = tare::tare_untouched(stage, control, samples, Accept::NearLast).await?;
        let at = stage.clock.timestamp();
        let record = TareRecord { configuration, volts, samples, at };
        control.diary.note(Note::Tare(self.run, record));
        stage.require_over(control, &over).await?;
        // The tips are up: what was requested meanwhile waits for no further press.
        control.checkpoint()
    }

    /// Executes one trial: motion to its depth, settling, frames, commit. Returns the held forces.
    async fn trial(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        c: &PlannedConfiguration,
        key: TrialKey,
        before: Option<&Held>,
    ) -> Result<Held, Halt> {
        let depth_mm = self.plan.depths_mm[key.depth_index as usize];
        let started_at = stage.clock.timestamp();
        let target = stage.pose_over(&c.stand, self.z_mm(stage, depth_mm)?);
        let (settled, taken, reached) = self.hold(stage, control, &target).await?;
        let held = Held { z_mm: reached.z_mm, forces_n: stage.forces_n(&taken.volts) };
        let limits = &stage.config.limits;
        if let Some(before) = before
            && let Some(words) = evidence::outside_corridor(before, &held, stage.tips, limits)
        {
            return Err(Halt::trip(TripKind::Force, words));
        }
        let flags = load_flags(stage, &held, settled, &target, taken.flags);
        let arms = arm_readings(stage, &c.stand, &taken.volts);
        let measured_n = arms.iter().map(|a| a.force_n).fold(0.0, f64::max);
        let record = TrialRecord {
            key,
            attempt: self.attempt,
            tips: c.tips,
            depth_mm: Some(depth_mm),
            target: Some(target),
            reached: Some(reached),
            arms,
            placed: Vec::new(),
            placed_by: None,
            frames: taken.frames,
            quality: taken.quality,
            flags,
            settle_ms: settled.settle_ms,
            scalars: TrialScalars { overshoot_n: Some((stage.peak_n - measured_n).max(0.0)) },
            started_at,
            measured_at: stage.clock.timestamp(),
        };
        self.commit(stage, control, record).await?;
        Ok(held)
    }

    /// Makes a trial durable. The stage does not move before that; forces and requests are checked
    /// meanwhile.
    async fn commit(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        record: TrialRecord,
    ) -> Result<(), Halt> {
        control.phase(Phase::Commit);
        let diary = control.diary.clone();
        let durable = tokio::time::timeout(STORE_LIMIT, diary.trial(self.run, record));
        match stage.watch_while(control, durable).await? {
            Ok(stored) => stored?,
            Err(_late) => {
                let words = format!("not durable within {} s", STORE_LIMIT.as_secs());
                return Err(Halt::Store(JournalError::of("a trial", &words)));
            }
        }
        control.show_run(|run| run.trials_stored += 1);
        Ok(())
    }

    /// Presses at the reference position. The result is stored in its own table and is never a
    /// trial.
    ///
    /// # Errors
    /// As `configuration`; the store is not awaited.
    pub async fn reference(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        press: &ReferencePress,
    ) -> Result<(), Halt> {
        control.show_run(|run| run.trial = None);
        self.prepare(stage, control, &press.stand, press.before_configuration).await?;
        let z_mm = self.z_mm(stage, press.depth_mm)?;
        let target = stage.pose_over(&press.stand, z_mm);
        let (settled, mut taken, reached) = self.hold(stage, control, &target).await?;
        let held = Held { z_mm: reached.z_mm, forces_n: stage.forces_n(&taken.volts) };
        let flags = load_flags(stage, &held, settled, &target, std::mem::take(&mut taken.flags));
        let arms = arm_readings(stage, &press.stand, &taken.volts);
        let record = ReferenceRecord {
            before_configuration: press.before_configuration,
            reached,
            depth_mm: press.depth_mm,
            arms,
            frame: taken.frames.swap_remove(0),
            at: stage.clock.timestamp(),
        };
        control.diary.note(Note::Reference(self.run, Box::new(record)));
        let before = press.before_configuration;
        // Its record has no flags: who compares the forces of two presses finds them here.
        let data = match flags.is_empty() {
            true => json!({ "before": before }),
            false => json!({ "before": before, "flags": flags }),
        };
        control.say("reference", data);
        control.checkpoint()
    }

    async fn hold(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        target: &Pose,
    ) -> Result<(measure::Settled, Taken, Pose), Halt> {
        control.phase(Phase::Press);
        stage.peak_n = 0.0;
        stage.press_to(control, target.z_mm).await?;
        control.phase(Phase::Settle);
        let settled = measure::settle(stage, control, &self.plan.measure, target).await?;
        control.phase(Phase::Measure);
        let taken = measure::take(stage, control, &self.plan.measure).await?;
        let reached = stage.require_reached(control, target).await?;
        // Nothing is stored of a load that was held while the computer was suspended.
        control.attend()?;
        let forces = stage.forces_n(&taken.volts);
        let tips = usize::from(stage.tips);
        control.show(|status| {
            status.rig.pose = Some(reached);
            status.rig.forces_n =
                forces.iter().enumerate().map(|(i, &f)| (i < tips).then_some(f)).collect();
        });
        Ok((settled, taken, reached))
    }

    fn z_mm(&self, stage: &Stage, depth_mm: f64) -> Result<f64, Halt> {
        let surface = stage.surface.as_ref().map(|s| s.surface_z_mm);
        let surface = surface.ok_or_else(|| Halt::Failed("no touch-off has been done".into()))?;
        Ok(surface - self.plan.standoff_mm + depth_mm)
    }
}

/// Possible faults of a held load: those of its frames, and of how it was reached.
fn load_flags(
    stage: &Stage,
    held: &Held,
    settled: measure::Settled,
    target: &Pose,
    mut flags: Vec<Flag>,
) -> Vec<Flag> {
    if !settled.at_rest {
        flags.push(Flag::Unsettled);
    }
    if (held.z_mm - target.z_mm).abs() > DEPTH_TOLERANCE_MM {
        flags.push(Flag::DepthMissed);
    }
    if stage.pressed_arms(held).any(|arm| arm.is_silent(&stage.config.limits)) {
        flags.push(Flag::StillCell);
    }
    flags
}

fn arm_readings(stage: &Stage, stand: &Stand, volts: &[f64; ARMS]) -> Vec<ArmReading> {
    let forces = stage.forces_n(volts);
    stand
        .tips_mm
        .iter()
        .enumerate()
        .map(|(i, &[x_mm, y_mm])| ArmReading {
            arm: i as u8 + 1,
            x_mm,
            y_mm,
            force_n: forces[i],
            cell_v: volts[i],
            tare_v: stage.tare_v[i],
        })
        .collect()
}
