//! A run from its arming to its end: step after step of the plan.
//! Uses: `campaign::{press, touch_off, manual, resume}`. Never: what follows a halt (`decide`).

use serde_json::json;
use tokio::time::Instant;

use super::{Attempts, Engine, Next, error_chain, no_wires, raise, require_tips};
use crate::campaign::command::{Refusal, Request};
use crate::campaign::eta::Pace;
use crate::campaign::halt::Halt;
use crate::campaign::interlock::{ForceLimits, TripKind};
use crate::campaign::job::Job;
use crate::campaign::journal::{ExitStatus, JournalError, Progress};
use crate::campaign::manual;
use crate::campaign::press::Pressing;
use crate::campaign::resume;
use crate::campaign::rig_state::{RigEvent, RigState};
use crate::campaign::run_state::RunEvent;
use crate::campaign::show;
use crate::campaign::status::{Phase, Wanted};
use crate::campaign::touch_off;
use crate::ids::TrialKey;
use crate::schedule::plan::{Kind, Step};

impl Engine {
    /// Checks that a run may start, and arms the rig for it.
    pub(super) async fn arm(&mut self, job: &Job) -> Result<(), Refusal> {
        let connection = self.connection.as_mut().ok_or_else(no_wires)?;
        if job.plan.kind == Kind::RealHex {
            self.control.rig_event(RigEvent::Arm).await?;
            let (rig, run) = (&self.config.limits, &job.plan.limits);
            connection.stage.limits = ForceLimits {
                each_n: rig.force_n.min(run.force_n),
                sum_n: rig.force_sum_n.min(run.force_sum_n),
            };
        }
        self.prepared_setting = None;
        self.control.show(|status| status.run = Some(show::started(job)));
        self.control.begin(job.run).await
    }

    pub(super) async fn run(&mut self, job: &Job) {
        let (status, reason) = match self.session(job).await {
            Ok(Some(ended)) => ended,
            Ok(None) => return,
            Err(error) => {
                if job.plan.kind == Kind::RealHex {
                    self.raise_or_panic(false).await;
                }
                (ExitStatus::Fail, error_chain(&error))
            }
        };
        if let Err(error) =
            self.control.journal.end_run(job.run, status, &reason, jiff::Timestamp::now()).await
        {
            tracing::error!(%error, "the end of the run was not stored");
        }
        let data = json!({ "run": job.run, "exit_status": status, "reason": reason });
        self.control.say("ended", data).await;
        if self.control.rig() == RigState::Armed {
            // Armed always allows disarming.
            let _ = self.control.rig_event(RigEvent::Disarm).await;
        }
        self.control.forget_run();
        self.control.show(|status| status.run = None);
    }

    /// Drives a run to its end, through halts, pauses and resumes. None: it was left open.
    pub(super) async fn session(
        &mut self,
        job: &Job,
    ) -> Result<Option<(ExitStatus, String)>, JournalError> {
        let depths = job.plan.depths_mm.len();
        let mut pace = Pace::predicted(job.predicted_trial_s / self.config.clock_rate);
        let mut attempts = Attempts::default();
        let mut auto_resumes = 0;
        loop {
            let mut progress = self.control.journal.progress(job.run).await?;
            show::progress(&self.control, job, &progress, &pace);
            let Some(entry) = resume::entry(&job.plan.steps, depths, &progress) else {
                self.raise_or_panic(false).await;
                // Ending is allowed from every state that a run under way can be in.
                let _ = self.control.run_event(RunEvent::Ended).await;
                return Ok(Some((ExitStatus::Success, done_words(&progress))));
            };
            let steps = entry.prepare.iter().chain(&job.plan.steps[entry.next..]);
            let halt = match self.pass(job, steps, &mut progress, &mut pace, &mut attempts).await {
                Ok(()) => continue,
                Err(halt) => halt,
            };
            match self.decide(job, halt, &mut attempts, &mut auto_resumes).await? {
                Next::Again => {}
                Next::Leave => return Ok(None),
                Next::End(status, reason) => return Ok(Some((status, reason))),
            }
        }
    }

    /// Takes steps until one halts or all are done.
    pub(super) async fn pass(
        &mut self,
        job: &Job,
        steps: impl Iterator<Item = &Step>,
        progress: &mut Progress,
        pace: &mut Pace,
        attempts: &mut Attempts,
    ) -> Result<(), Halt> {
        let depths = job.plan.depths_mm.len();
        for step in steps {
            if resume::is_done(step, depths, progress) {
                continue;
            }
            self.control.checkpoint().await?;
            self.require_space(job, progress).await?;
            let begun = Instant::now();
            let stored = self.take(job, step, progress, attempts).await?;
            if let Some(connection) = &self.connection {
                show::counters(&self.control, &connection.open);
            }
            if stored > 0 {
                pace.note(stored, begun.elapsed().as_secs_f64());
                show::progress(&self.control, job, progress, pace);
                attempts.of_configuration = 1;
            }
        }
        Ok(())
    }

    /// One step of the plan. Returns the number of trials stored.
    pub(super) async fn take(
        &mut self,
        job: &Job,
        step: &Step,
        progress: &mut Progress,
        attempts: &Attempts,
    ) -> Result<u32, Halt> {
        let Some(connection) = self.connection.as_mut() else {
            return Err(Halt::trip(TripKind::Wire, "no wires are open"));
        };
        let (stage, control) = (&mut connection.stage, &mut self.control);
        let pressing =
            Pressing { run: job.run, plan: &job.plan, attempt: attempts.of_configuration };
        match step {
            Step::TipChange { setting, tips } => {
                if self.prepared_setting != Some(*setting) {
                    require_tips(stage, *tips).await?;
                    control.show(|status| {
                        status.rig.tips = Some(*tips);
                        status.rig.forces_n.clear();
                    });
                }
                Ok(0)
            }
            Step::TouchOff { setting, places } => {
                if self.prepared_setting == Some(*setting) {
                    return Ok(0);
                }
                control.phase(Phase::TouchOff);
                let samples = job.plan.measure.tare_samples;
                let at = stage.clock.timestamp();
                let found = touch_off::touch_off(stage, control, places, samples, at).await?;
                control.journal.touch_off(job.run, &found).await?;
                control.say("touch_off", json!(found)).await;
                control.show(|status| status.rig.surface = Some(found));
                self.prepared_setting = Some(*setting);
                Ok(0)
            }
            Step::Reference(press) => {
                pressing.reference(stage, control, press).await?;
                raise(stage, control).await?;
                Ok(0)
            }
            Step::Configuration(c) => {
                let pending = resume::pending_depths(c, job.plan.depths_mm.len(), progress);
                let stored = pressing.configuration(stage, control, c, &pending).await?;
                raise(stage, control).await?;
                progress.stored.extend(
                    pending
                        .iter()
                        .map(|&depth_index| TrialKey { configuration: c.index, depth_index }),
                );
                Ok(stored)
            }
            Step::Manual(placement) => match attempts.confirmed_by.clone() {
                Some((index, who)) if index == placement.index => {
                    let (skin, clock) = (stage.bench.skin.clone(), stage.clock.clone());
                    let about = (job.run, who, &job.plan.measure);
                    manual::measure(&skin, &clock, control, about, placement).await?;
                    let key = TrialKey { configuration: placement.index, depth_index: 0 };
                    progress.stored.insert(key);
                    Ok(1)
                }
                _ => Err(Halt::Needs(Wanted::Placement {
                    trial: placement.index,
                    contacts: manual::contacts(placement),
                })),
            },
        }
    }

    pub(super) async fn require_space(
        &mut self,
        job: &Job,
        progress: &Progress,
    ) -> Result<(), Halt> {
        let left = job.plan.trials().saturating_sub(progress.stored.len() as u64);
        let needed = left * job.bytes_per_trial;
        let free = self.control.journal.free_bytes().await?;
        if free < needed {
            let (free, needed) = (free / 1_000_000, needed / 1_000_000);
            return Err(self.suspend(format!("disk: {free} MB free, the rest needs {needed} MB")));
        }
        Ok(())
    }

    pub(super) fn suspend(&mut self, why: String) -> Halt {
        self.control.run_request(&Request::Suspend(why));
        Halt::Asked
    }
}

fn done_words(progress: &Progress) -> String {
    match progress.skipped.len() {
        0 => "every planned trial is stored".into(),
        n => format!("every planned trial is stored but those of {n} skipped configurations"),
    }
}
