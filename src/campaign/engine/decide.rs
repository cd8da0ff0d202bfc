//! What follows a halt: raise, retry, skip, wait, end.
//! Uses: `campaign::{control, journal}`. Never: pressing.

use serde_json::json;

use super::{Attempts, Engine, Next, error_chain};
use crate::campaign::halt::Halt;
use crate::campaign::job::Job;
use crate::campaign::journal::{ExitStatus, JournalError};
use crate::campaign::record::AttemptRecord;
use crate::campaign::run_state::{PausedWhy, RunAction, RunEvent, RunState};
use crate::campaign::status::{Phase, Wanted};
use crate::schedule::plan::Kind;

impl Engine {
    /// What follows a halt: the tips go up in every case, then policy or a person decides.
    pub(super) async fn decide(
        &mut self,
        job: &Job,
        halt: Halt,
        attempts: &mut Attempts,
        auto_resumes: &mut u32,
    ) -> Result<Next, JournalError> {
        let moving = job.plan.kind == Kind::RealHex;
        let mut passing = None;
        match halt {
            Halt::Asked => {
                if let Some(why) = self.control.take_suspended_for() {
                    self.control.say("suspended", json!({ "why": why })).await;
                    self.control.show_run(|run| run.waiting_for = Some(why));
                    if !matches!(self.control.run(), RunState::Suspending(_)) {
                        let event = RunEvent::Suspend(PausedWhy::Suspender);
                        let _ = self.control.run_event(event).await;
                    }
                }
            }
            Halt::Checkpoint => {}
            Halt::Needs(wanted) => {
                self.need(wanted.clone()).await;
                if matches!(wanted, Wanted::Tips { .. })
                    && let Some(connection) = self.connection.as_mut()
                    && let Err(why) = connection.stage.raise_fully().await
                {
                    self.control.say("raise_failed", json!({ "why": why })).await;
                }
            }
            Halt::Failed(reason) => {
                return self.failed(job, reason, attempts).await;
            }
            Halt::Trip(trip) => {
                self.note_attempt(job, &trip.detail, attempts).await?;
                self.control.trip(&trip).await;
                self.control.show_run(|run| run.waiting_for = Some(trip.detail.clone()));
                let _ = self.control.run_event(RunEvent::Suspend(PausedWhy::Trip)).await;
                let may = job.auto_resume && trip.kind.may_pass();
                if may && *auto_resumes < job.plan.policy.max_auto_resumes {
                    *auto_resumes += 1;
                    passing = Some(*auto_resumes);
                }
            }
            Halt::Store(error) => {
                let why = error_chain(&error);
                self.control.say("store", json!({ "why": why })).await;
                self.control.show_run(|run| run.waiting_for = Some(why));
                let _ = self.control.run_event(RunEvent::Suspend(PausedWhy::Suspender)).await;
            }
        }
        if moving {
            self.raise_or_panic(true).await;
        }
        let action = if self.control.run() == RunState::Panicked || moving && !self.raised().await {
            // Wires that are down leave the run where it is until the tips are up.
            RunAction::Wait
        } else {
            self.control.run_event(RunEvent::Raised).await.unwrap_or(RunAction::Continue)
        };
        match action {
            RunAction::End(status) => Ok(Next::End(status, "asked for".into())),
            RunAction::Continue | RunAction::Raise => Ok(Next::Again),
            RunAction::Wait => self.wait(job, attempts, passing).await,
        }
    }

    pub(super) async fn need(&mut self, wanted: Wanted) {
        let (why, words) = match &wanted {
            Wanted::Tips { tips } => (PausedWhy::TipChange, tip_words(*tips)),
            Wanted::Placement { trial, contacts } => (
                PausedWhy::ManualTrial,
                format!("place {} weights for trial {trial}, confirm", contacts.len()),
            ),
        };
        let data = json!({ "why": why, "wanted": wanted, "words": words });
        self.control.show_run(|run| {
            run.wanted = Some(wanted);
            run.waiting_for = Some(words);
        });
        let _ = self.control.run_event(RunEvent::Need(why)).await;
        self.control.say("wanted", data).await;
    }

    /// A failed try: again, or give the configuration up, or give the run up.
    pub(super) async fn failed(
        &mut self,
        job: &Job,
        reason: String,
        attempts: &mut Attempts,
    ) -> Result<Next, JournalError> {
        self.note_attempt(job, &reason, attempts).await?;
        if job.plan.kind == Kind::RealHex {
            self.raise_or_panic(true).await;
        }
        let configuration = attempts.configuration;
        if attempts.of_configuration > job.plan.policy.retries {
            if let Some(configuration) = configuration {
                let now = jiff::Timestamp::now();
                self.control.journal.skip(job.run, configuration, &reason, now).await?;
                let data = json!({ "configuration": configuration, "reason": reason });
                self.control.say("skipped", data).await;
                attempts.skipped += 1;
            }
            attempts.of_configuration = 1;
            if configuration.is_none() || attempts.skipped > job.plan.policy.max_skipped {
                let _ = self.control.run_event(RunEvent::Ended).await;
                let words = format!("gave up after {} skipped: {reason}", attempts.skipped);
                return Ok(Next::End(ExitStatus::Fail, words));
            }
        } else {
            attempts.of_configuration += 1;
        }
        Ok(Next::Again)
    }

    pub(super) async fn note_attempt(
        &mut self,
        job: &Job,
        reason: &str,
        attempts: &mut Attempts,
    ) -> Result<(), JournalError> {
        let key = self.control.inbox.status.borrow().run.as_ref().and_then(|r| r.trial);
        attempts.configuration = key.map(|k| k.configuration);
        let data = json!({ "trial": key, "attempt": attempts.of_configuration, "reason": reason });
        self.control.say("attempt_failed", data).await;
        self.control.show_run(|run| run.retries += 1);
        let Some(key) = key else { return Ok(()) };
        let record = AttemptRecord {
            key,
            attempt: attempts.of_configuration,
            reason: reason.into(),
            at: jiff::Timestamp::now(),
        };
        self.control.journal.attempt(job.run, &record).await
    }

    /// Raises the tips. `after_halt`: wires that are down are tried again while waiting; any other
    /// failure is a panic, for a person.
    pub(super) async fn raise_or_panic(&mut self, after_halt: bool) {
        let Some(connection) = self.connection.as_mut() else { return };
        if self.control.estop.pressed().is_some() {
            return;
        }
        self.control.phase(Phase::Raise);
        if let Err(error) = connection.stage.raise().await {
            self.control.say("raise_failed", json!({ "why": error })).await;
            let wires_down = after_halt && connection.stage.pose().await.is_err();
            if !wires_down {
                let _ = self.control.run_event(RunEvent::RaiseFailed).await;
            }
        }
    }

    /// Whether z is measured clear of the skin and at rest; true after an e-stop, which leaves the
    /// tips where they are until a person releases it.
    pub(super) async fn raised(&mut self) -> bool {
        let Some(connection) = self.connection.as_ref() else { return false };
        if self.control.estop.pressed().is_some() {
            return true;
        }
        let clear = connection.stage.clear_z_mm() + self.config.axes.z.tolerance_mm;
        let z = connection.open.bench.z.status().await;
        z.is_ok_and(|z| !z.moving && z.position <= clear)
    }
}

fn tip_words(tips: u8) -> String {
    match tips {
        1 => "mount 1 tip, on arm 1, then confirm".into(),
        n => format!("mount {n} tips, on arms 1 to {n}, then confirm"),
    }
}
