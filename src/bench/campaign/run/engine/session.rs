//! Execution of a run from arming to its end, step by step.
//! Uses: `campaign::{trial::press, bench::touch_off, trial::manual, run::resume}`. Never:
//! decisions after a halt (`decide`).

use std::time::Duration;

use serde_json::json;
use tokio::time::Instant;
use tracing::Instrument;

use super::skin::EmptySkin;
use super::{
    Answer, Attempts, Connection, Engine, IDLE_TICK, Last, NOT_COMPLETE, Next, Owed, no_stage,
    no_wires, trip_of,
};
use crate::campaign::bench::evidence::SilentArms;
use crate::campaign::bench::interlock::{self, ForceLimits, TripKind};
use crate::campaign::bench::rig_state::{RigEvent, RigState};
use crate::campaign::bench::stage::{AxisName, Height, Stage};
use crate::campaign::bench::touch_off;
use crate::campaign::diary::Note;
use crate::campaign::run::eta::Pace;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::Job;
use crate::campaign::run::resume;
use crate::campaign::safe_end::raise_as_planned;
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::run_action;
use crate::campaign::shown::show;
use crate::campaign::shown::status::{Phase, Wanted};
use crate::campaign::spans::{configuration_span, trial_span};
use crate::campaign::trial::manual;
use crate::campaign::trial::press::Pressing;
use crate::ids::TrialKey;
use crate::journal::{ExitStatus, Progress, error_chain};
use crate::schedule::manual::PlannedPlacement;
use crate::schedule::plan::{Kind, Step};
use crate::schedule::visits::StepOfTour;

/// Longest wait for it before the next attempt of a run.
const OWED_LIMIT: Duration = Duration::from_secs(30);
/// Wait after a failed attempt, process s. What disturbed it, such as a vibration, would fail the next ones, too: with
/// the default policy a run gives up after at least 8 min of it.
const FAILED_WAIT_S: f64 = 15.0;

impl Engine {
    /// Checks that a run may start, and arms the rig for it: at the measured pace of the wires, the
    /// stopping distance must stay within the margin of the force limit.
    ///
    /// # Errors
    /// No wires are open, the computer was suspended, an axis is not stopped, a device does not reply, no press is
    /// slow enough for the margin, a drive cannot move as slowly as its axis must, the state does not allow arming, a
    /// person has taken the operator lock meanwhile, or its client no longer waits for the answer.
    pub(super) async fn arm(&mut self, job: &Job, answer: &Answer) -> Result<(), Refusal> {
        if self.connection.is_none() {
            return Err(no_wires());
        }
        if let Some(words) = self.notice_suspension() {
            let next = match job.plan.kind {
                Kind::RealHex => "reset, home",
                Kind::RealRandom => "reset",
            };
            return Err(Refusal::State(format!("{words}: {next}, then start the run")));
        }
        self.require_nothing_owed()?;
        if job.plan.kind == Kind::RealHex {
            let stage = self.stage_mut()?;
            stage.stopping.begin();
            stage.silent = SilentArms::default();
            self.arm_stage(job, Some(answer)).await?;
        }
        self.begin(job)
    }

    /// Begins a run on a rig that is not armed, since a wire failed meanwhile: its first halt is that trip.
    ///
    /// # Errors
    /// A person has taken the operator lock or pressed the stop meanwhile, the computer was suspended, or the client no
    /// longer waits for the answer.
    pub(super) async fn begin_halted(&mut self, job: &Job, answer: &Answer) -> Result<(), Refusal> {
        if let Some(awaited) = self.control.taken_lock(self.decided_at).await {
            return Err(Refusal::Busy(format!("nothing moves before {awaited}")));
        }
        let stopped = self.control.estop.pressed().map(|_| "the stop was pressed".to_owned());
        if let Some(words) = stopped.or_else(|| self.notice_suspension()) {
            return Err(Refusal::State(words));
        }
        if answer.is_closed() { Err(Refusal::Gone) } else { self.begin(job) }
    }

    fn begin(&mut self, job: &Job) -> Result<(), Refusal> {
        self.prepared_setting = None;
        self.control.show(|status| status.run = Some(show::started(job)));
        self.control.begin(job.run, job.beginning)
    }

    /// Arms a homed rig with the force limits of a run and the measured pace of the wires; also for its resume,
    /// since the wires may have been opened again meanwhile. `answer`: of the request, whose caller may have been
    /// told meanwhile that it failed; none for an automatic resume.
    ///
    /// # Errors
    /// As `arm`.
    pub(super) async fn arm_stage(
        &mut self,
        job: &Job,
        answer: Option<&Answer>,
    ) -> Result<(), Refusal> {
        self.require_nothing_owed()?;
        let connection = self.connection.as_mut().ok_or_else(no_wires)?;
        let stage = connection.stage.as_mut().ok_or_else(no_stage)?;
        if self.control.rig() == RigState::Homed {
            let timed = stage.time_polls().await;
            timed.map_err(|halt| {
                let trip = trip_of(&halt);
                Refusal::Fault(trip.kind, trip.detail)
            })?;
        }
        require_speeds(stage)?;
        let (tips, slowest) = (job.plan.most_tips(), stage.bench.z.slowest());
        let distance = stage.stopping.distance(&stage.config, tips, slowest);
        let distance = distance.map_err(Refusal::Value)?;
        // Homing and timing took a while: a lock that was taken meanwhile holds, too.
        let since = if answer.is_some() { self.decided_at } else { self.halted_at };
        if let Some(awaited) = self.control.taken_lock(since).await {
            return Err(Refusal::Busy(format!("nothing moves before {awaited}")));
        }
        if answer.is_some_and(Answer::is_closed) {
            return Err(Refusal::Gone);
        }
        if self.control.rig() != RigState::Armed {
            self.control.rig_event(RigEvent::Arm)?;
        }
        let (rig, run) = (&stage.config.limits, &job.plan.limits);
        stage.limits = ForceLimits {
            each_n: rig.force_n.min(run.force_n),
            sum_n: rig.force_sum_n.min(run.force_sum_n),
            below_n: rig.tare_drift_n,
        };
        self.control.show(|status| status.rig.stopping = Some(distance));
        Ok(())
    }

    /// Drives a run that has begun to its end. `first`: its halt before it could move, if there was one.
    pub(super) async fn run(&mut self, job: &Job, first: Option<Halt>) {
        let Some((status, reason)) = self.session(job, first).await else { return };
        self.show_stopping();
        let stopping = self.control.inbox.status.borrow().rig.stopping;
        self.control.diary.note(Note::EndRun(job.run, status, reason.clone()));
        let data = json!({ "run": job.run, "exit_status": status, "reason": reason,
            "stopping": stopping });
        self.control.say("ended", data);
        if self.control.rig() == RigState::Armed {
            // Armed always allows disarming.
            let _ = self.control.rig_event(RigEvent::Disarm);
        }
        // A client that waits for the end then finds it stored, if the store answers.
        if let Err(error) = self.control.flush().await {
            let error = error_chain(&error);
            tracing::error!(error, "the end of the run is not stored yet");
        }
        self.control.forget_run();
        self.control.show(|status| {
            status.run = None;
            // Also one that may pass: nothing resumes any more.
            if let Some(why) = run_action::tripped(status) {
                status.attended.note(why);
            }
        });
    }

    fn show_stopping(&self) {
        let Some(stage) = self.stage() else { return };
        let tips = stage.tips.max(1);
        let slowest = stage.bench.z.slowest();
        if let Ok(distance) = stage.stopping.distance(&stage.config, tips, slowest) {
            self.control.show(|status| status.rig.stopping = Some(distance));
        }
    }

    /// Executes a run to its end, through halts, pauses and resumes. Returns none if it stays open.
    async fn session(
        &mut self,
        job: &Job,
        mut first: Option<Halt>,
    ) -> Option<(ExitStatus, String)> {
        let mut pace = Pace::predicted(job.predicted_trial_s / self.config.clock_rate());
        let mut attempts = Attempts::default();
        let mut auto_resumes = 0;
        if job.plan.kind == Kind::RealRandom {
            // Weights and hands are on the skin: before the next press a person confirms the tips again.
            self.mounting = None;
            // What an earlier session saw is not followed: a person tares the skin again.
            self.control.inbox.untouched.send_replace(None);
        }
        self.empty_skin = EmptySkin::default();
        loop {
            // A lock that was taken as it began holds, too.
            let decided_at = first.as_ref().map(|_| self.decided_at);
            let advanced = match first.take() {
                Some(halt) => Err(halt),
                None => self.advance(job, &mut pace, &mut attempts).await,
            };
            let halt = match advanced {
                Ok(None) => continue,
                Ok(Some(words)) => {
                    self.leave_contact(job, None, Height::Clear).await;
                    self.end_unasked();
                    return Some((ExitStatus::Success, words));
                }
                Err(halt) => halt,
            };
            self.halted_at = decided_at.unwrap_or_else(|| (jiff::Timestamp::now(), Instant::now()));
            match self.decide(job, halt, &mut attempts, &mut auto_resumes).await {
                Next::Again => {}
                Next::Leave => return None,
                Next::End(status, reason) => return Some((status, reason)),
            }
        }
    }

    /// Waits until the last safe end is complete: no axis is commanded that has not acknowledged its stop, or moves
    /// after it.
    ///
    /// # Errors
    /// As `attend`; a trip if the safe end is not complete in time, or needs a person.
    async fn complete_safe_end(&mut self) -> Result<(), Halt> {
        let deadline = Instant::now() + OWED_LIMIT;
        while self.owed != Owed::Nothing {
            self.control.attend()?;
            if self.owed == Owed::Person || Instant::now() > deadline {
                let replies = match self.stage() {
                    Some(stage) => stage.pose().await.is_ok(),
                    None => false,
                };
                let kind = if replies { TripKind::Device } else { TripKind::Wire };
                return Err(Halt::trip(kind, NOT_COMPLETE));
            }
            tokio::time::sleep(IDLE_TICK).await;
            self.look().await;
        }
        Ok(())
    }

    /// Waits after a failed attempt, with raised tips.
    ///
    /// # Errors
    /// As `checkpoint`: a request ends the wait.
    async fn wait_after_failure(&mut self, attempts: &mut Attempts) -> Result<(), Halt> {
        let clock = self.connection.as_ref().map(|connection| connection.clock.clone());
        let Some(clock) = clock.filter(|_| std::mem::take(&mut attempts.has_failed)) else {
            return Ok(());
        };
        let until = clock.now() + clock.wall(FAILED_WAIT_S);
        loop {
            self.control.checkpoint()?;
            let left = until.saturating_duration_since(clock.now());
            if left.is_zero() {
                return Ok(());
            }
            tokio::time::sleep(left.min(IDLE_TICK)).await;
            self.look().await;
        }
    }

    /// Reads what is stored and executes the remaining steps. Returns a message if none remain. After a failed attempt
    /// it waits for the end of its safe end, and then `FAILED_WAIT_S`.
    pub(super) async fn advance(
        &mut self,
        job: &Job,
        pace: &mut Pace,
        attempts: &mut Attempts,
    ) -> Result<Option<String>, Halt> {
        if job.plan.kind == Kind::RealHex {
            self.complete_safe_end().await?;
            self.wait_after_failure(attempts).await?;
        }
        let depths = job.plan.depths_mm.len();
        let mut progress = self.stored(job).await?;
        show::progress(&self.control, job, &progress, pace);
        let Some(entry) = resume::entry(&job.plan.steps, depths, &progress) else {
            return Ok(Some(done_words(&progress)));
        };
        let steps = entry.prepare.iter().chain(&job.plan.steps[entry.next..]);
        self.pass(job, steps, &mut progress, pace, attempts).await?;
        Ok(None)
    }

    /// Progress of a run as stored, including all earlier notes.
    async fn stored(&mut self, job: &Job) -> Result<Progress, Halt> {
        let (diary, journal, run) =
            (self.control.diary.clone(), self.control.journal.clone(), job.run);
        self.control
            .at_rest(async move {
                diary.flush().await?;
                journal.progress(run).await
            })
            .await
    }

    /// Executes steps until one halts or all are done.
    async fn pass(
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
            self.control.checkpoint()?;
            self.require_space(job, progress).await?;
            let begun = Instant::now();
            let stored = self.take(job, step, progress, attempts).await?;
            if let Some(connection) = &self.connection {
                connection.show_counters(&self.control);
            }
            self.show_stopping();
            if stored > 0 {
                pace.note(stored, begun.elapsed().as_secs_f64());
                show::progress(&self.control, job, progress, pace);
                attempts.of_configuration = 1;
                if let Step::Manual(placement) = step {
                    attempts.last = Last::Stored(placement.index);
                }
            }
        }
        Ok(())
    }

    /// Executes one step of the plan. Returns the number of trials stored.
    async fn take(
        &mut self,
        job: &Job,
        step: &Step,
        progress: &mut Progress,
        attempts: &mut Attempts,
    ) -> Result<u32, Halt> {
        if let Step::TipChange { setting, tips } = step {
            if self.prepared_setting != Some(*setting) {
                self.require_tips(*tips, progress).await?;
            }
            return Ok(0);
        }
        if let Step::Manual(placement) = step {
            return self.take_placement(job, placement, progress, attempts).await;
        }
        let stage = open_stage(&mut self.connection)?;
        let control = &mut self.control;
        let pressing =
            Pressing { run: job.run, plan: &job.plan, attempt: attempts.of_configuration };
        match step {
            Step::TipChange { .. } | Step::Manual(_) => Ok(0),
            Step::TouchOff { setting, places } => {
                if self.prepared_setting == Some(*setting) {
                    return Ok(0);
                }
                control.phase(Phase::TouchOff);
                control.show_run(|run| run.trial = None);
                let samples = job.plan.measure.tare_samples;
                let at = stage.clock.timestamp();
                let found = touch_off::touch_off(stage, control, places, samples, at).await?;
                control.diary.note(Note::TouchOff(job.run, found.clone()));
                control.say("touch_off", json!(found));
                control.show(|status| status.rig.surface = Some(found));
                self.prepared_setting = Some(*setting);
                Ok(0)
            }
            Step::Reference(press) => {
                control.show_run(|run| run.trial = None);
                pressing.reference(stage, control, press).await?;
                control.phase(Phase::Raise);
                raise_as_planned(control, stage).await?;
                Ok(0)
            }
            Step::Configuration(c) => {
                let place = StepOfTour::of(&job.plan, c.index);
                control.show_run(|run| run.current_step = place);
                let pending = resume::pending_depths(c, job.plan.depths_mm.len(), progress);
                let pressed = async {
                    let stored = pressing.configuration(stage, control, c, &pending).await?;
                    control.phase(Phase::Raise);
                    let raised = raise_as_planned(control, stage).await;
                    if matches!(raised, Err(Halt::Asked)) {
                        // What comes next is another configuration.
                        attempts.of_configuration = 1;
                    }
                    raised.map(|()| stored)
                };
                let stored = pressed.instrument(configuration_span(c.index, c.tips)).await?;
                progress.stored.extend(
                    pending
                        .iter()
                        .map(|&depth_index| TrialKey { configuration: c.index, depth_index }),
                );
                Ok(stored)
            }
        }
    }

    /// Measures a placement if a person has confirmed it, and asks for it otherwise.
    async fn take_placement(
        &mut self,
        job: &Job,
        placement: &PlannedPlacement,
        progress: &mut Progress,
        attempts: &Attempts,
    ) -> Result<u32, Halt> {
        let connection = self.connection.as_ref().ok_or_else(wires_closed)?;
        let key = TrialKey { configuration: placement.index, depth_index: 0 };
        self.control.show_run(|run| run.trial = Some(key));
        let confirmed = attempts.confirmed.clone().filter(|(index, _)| *index == placement.index);
        let Some((_, confirmation)) = confirmed else {
            return Err(Halt::Needs(Wanted::Placement {
                trial: placement.index,
                contacts: manual::contacts(placement),
            }));
        };
        let (skin, clock) = (connection.skin.clone(), connection.clock.clone());
        let (run, measure, attempt) = (job.run, &job.plan.measure, attempts.of_configuration);
        let confirmed = manual::Confirmed { run, confirmation, measure, attempt };
        let place = StepOfTour::of(&job.plan, placement.index);
        self.control.show_run(|run| run.current_step = place);
        let trial = manual::measure(&skin, &clock, &mut self.control, confirmed, placement);
        trial.instrument(trial_span(key)).await?;
        progress.stored.insert(key);
        Ok(1)
    }

    /// Continues only if a person has entered these tips as mounted and the cells do not
    /// contradict. An entry from before a restart holds for a resumed run if the cells still show
    /// the same.
    async fn require_tips(&mut self, tips: u8, progress: &Progress) -> Result<(), Halt> {
        let stage = open_stage(&mut self.connection)?;
        let volts = self.control.attending(stage.bench.cells.read()).await??.volts;
        let live = interlock::live_cells(&stage.config.cells, &volts, tips);
        let goes_on = !progress.stored.is_empty();
        let said = self.mounting.as_ref().is_some_and(|(m, now)| {
            m.tips == tips && live == Ok(m.live_cells) && (*now || goes_on)
        });
        if !said {
            return Err(Halt::Needs(Wanted::Tips { tips }));
        }
        stage.tips = tips;
        self.control.show(|status| {
            status.rig.tips = Some(tips);
            status.rig.forces_n.clear();
        });
        Ok(())
    }

    async fn require_space(&mut self, job: &Job, progress: &Progress) -> Result<(), Halt> {
        let left = job.plan.trials().saturating_sub(progress.stored.len() as u64);
        let needed = left * job.bytes_per_trial;
        let journal = self.control.journal.clone();
        let free = self.control.at_rest(async move { journal.free_bytes().await }).await?;
        if free < needed {
            let (free, needed) = (free / 1_000_000, needed / 1_000_000);
            let why = format!("disk: {free} MB free, the rest needs {needed} MB");
            self.control.run_request(&Request::Suspend(job.run, why));
            return Err(Halt::Asked);
        }
        Ok(())
    }
}

fn wires_closed() -> Halt {
    Halt::trip(TripKind::Wire, "no wires are open")
}

fn open_stage(connection: &mut Option<Connection>) -> Result<&mut Stage, Halt> {
    let stage = connection.as_mut().ok_or_else(wires_closed)?.stage.as_mut();
    stage.ok_or_else(|| Halt::trip(TripKind::Device, "the rig has no stage"))
}

fn done_words(progress: &Progress) -> String {
    match progress.skipped.len() {
        0 => "every planned trial is stored".into(),
        n => format!("every planned trial is stored, except {n} skipped configurations"),
    }
}

/// Refuses an axis whose travelling speed is below the slowest motion of its drive, which would exceed it.
fn require_speeds(stage: &Stage) -> Result<(), Refusal> {
    for name in [AxisName::X, AxisName::Y, AxisName::Z, AxisName::Radial] {
        let driven = stage.driven(name);
        let (axis, speed, slowest) = (driven.axis.name(), driven.speed, driven.axis.slowest());
        if speed < slowest {
            let unit = if name == AxisName::Radial { "deg" } else { "mm" };
            return Err(Refusal::Value(format!(
                "axes.{axis}.speed_{unit}_s = {speed}: must be at least {slowest:.4}, the slowest \
                 motion of its drive"
            )));
        }
    }
    Ok(())
}
