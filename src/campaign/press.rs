//! One configuration: travel, tare, then every depth: approach, settle, measure, commit.
//! Uses: `campaign::{stage, tare, measure, journal}`. Never: retries, states (the engine decides).
//!
//! Paper II-B and IV-A: quasi-static, normal force only, loading direction only.

use serde_json::json;

use super::control::Control;
use super::halt::Halt;
use super::interlock;
use super::measure::{self, Taken};
use super::record::{ArmReading, Flag, Pose, ReferenceRecord, TareRecord, TrialRecord};
use super::stage::Stage;
use super::status::Phase;
use super::tare;
use crate::ids::{RunUid, TrialKey};
use crate::rig::config::ARMS;
use crate::schedule::configuration::Stand;
use crate::schedule::plan::{Plan, PlannedConfiguration, ReferencePress};

/// Tolerance of a reached depth before a trial is flagged, mm.
const DEPTH_TOLERANCE_MM: f64 = 0.05;

/// What one configuration needs to know of its run.
pub struct Pressing<'a> {
    /// The run.
    pub run: RunUid,
    /// Its plan.
    pub plan: &'a Plan,
    /// Which try this is, from 1.
    pub attempt: u32,
}

impl Pressing<'_> {
    /// Presses the pending depths of a configuration. Returns how many trials were stored; the tips
    /// are left down, for the engine to raise.
    pub async fn configuration(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        c: &PlannedConfiguration,
        pending: &[u32],
    ) -> Result<u32, Halt> {
        self.prepare(stage, control, &c.stand, c.index).await?;
        let mut stored = 0;
        let mut before: Option<[f64; ARMS]> = None;
        for &depth_index in pending {
            let key = TrialKey { configuration: c.index, depth_index };
            control.show_run(|run| run.trial = Some(key));
            let volts = self.trial(stage, control, c, key, before).await?;
            before = Some(volts);
            stored += 1;
            control.checkpoint().await?;
        }
        Ok(stored)
    }

    async fn prepare(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        stand: &Stand,
        configuration: u32,
    ) -> Result<(), Halt> {
        control.phase(Phase::Travel);
        stage.go_over(control, stand.centre_mm, stand.radius_mm).await?;
        control.phase(Phase::Tare);
        let samples = self.plan.measure.tare_samples;
        let volts = tare::tare(stage, control, samples, false).await?;
        let at = stage.clock.timestamp();
        let record = TareRecord { configuration, volts, samples, at };
        control.journal.tare(self.run, &record).await?;
        Ok(())
    }

    /// One trial: motion to its depth, settling, frames, commit. Returns the cells' outputs.
    async fn trial(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        c: &PlannedConfiguration,
        key: TrialKey,
        before: Option<[f64; ARMS]>,
    ) -> Result<[f64; ARMS], Halt> {
        let depth_mm = self.plan.depths_mm[key.depth_index as usize];
        let started_at = stage.clock.timestamp();
        let target =
            stage.pose_over(c.stand.centre_mm, c.stand.radius_mm, self.z_mm(stage, depth_mm)?);
        let (settled, taken, reached) = self.hold(stage, control, target.z_mm).await?;
        let mut flags = taken.flags;
        if !settled.at_rest {
            flags.push(Flag::Unsettled);
        }
        if (reached.z_mm - target.z_mm).abs() > DEPTH_TOLERANCE_MM {
            flags.push(Flag::DepthMissed);
        }
        if let Some(before) = before {
            let cells = &stage.config.cells;
            let still =
                interlock::still_cell(cells, stage.tips, &before, &taken.volts, &stage.tare_v);
            if let Some(arm) = still {
                return Err(Halt::Failed(format!("cell {arm} stayed still while depth grew")));
            }
        }
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
            overshoot_n: Some((stage.peak_n - measured_n).max(0.0)),
            started_at,
            measured_at: stage.clock.timestamp(),
        };
        control.phase(Phase::Commit);
        control.journal.trial(self.run, &record).await?;
        control.show_run(|run| run.trials_stored += 1);
        Ok(taken.volts)
    }

    /// A press on the reference place: kept in a table of its own, never a trial.
    pub async fn reference(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        press: &ReferencePress,
    ) -> Result<(), Halt> {
        control.show_run(|run| run.trial = None);
        self.prepare(stage, control, &press.stand, press.before_configuration).await?;
        let z_mm = self.z_mm(stage, press.depth_mm)?;
        let (_, mut taken, reached) = self.hold(stage, control, z_mm).await?;
        let arms = arm_readings(stage, &press.stand, &taken.volts);
        let record = ReferenceRecord {
            before_configuration: press.before_configuration,
            reached,
            depth_mm: press.depth_mm,
            arms,
            frame: taken.frames.swap_remove(0),
            at: stage.clock.timestamp(),
        };
        control.journal.reference(self.run, &record).await?;
        control.say("reference", json!({ "before": press.before_configuration })).await;
        control.checkpoint().await
    }

    async fn hold(
        &self,
        stage: &mut Stage,
        control: &mut Control,
        z_mm: f64,
    ) -> Result<(measure::Settled, Taken, Pose), Halt> {
        control.phase(Phase::Press);
        stage.peak_n = 0.0;
        stage.press_to(control, z_mm).await?;
        control.phase(Phase::Settle);
        let settled = measure::settle(stage, control, &self.plan.measure).await?;
        control.phase(Phase::Measure);
        let taken = measure::take(stage, &self.plan.measure).await?;
        let reached = stage.pose().await?;
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
