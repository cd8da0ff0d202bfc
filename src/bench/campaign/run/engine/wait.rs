//! A run that waits: for a person, or for the policy's automatic resume.
//! Uses: `campaign::run::control`. Never: pressing.

use serde_json::json;
use tokio::time::timeout_at;

use super::recovery::{Automatic, BY_HAND};
use super::skin::next_window;
use super::{Answer, Attempts, Engine, IDLE_TICK, Last, Next, Owed, Waited};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stage::Height;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunAction, RunEvent, RunState};
use crate::campaign::shown::command::{ANSWERED_WITHIN, Envelope, Refusal, Request};
use crate::campaign::shown::run_action::NO_PLACEMENT;
use crate::campaign::shown::status::{Done, Phase, Wanted};
use crate::ids::TrialKey;
use crate::journal::error_chain;
use crate::schedule::plan::Kind;

/// Why no waiting run begins after a run that was ended while it waited.
const ENDED_HALTED: &str =
    "the run before it was ended while it was halted, and a person may be at the rig";

impl Engine {
    /// Waits for a person, or for the policy's automatic resume (`passing`: automatic resumes of the
    /// run, this one included).
    pub(super) async fn wait(
        &mut self,
        job: &Job,
        attempts: &mut Attempts,
        passing: Option<&mut u32>,
    ) -> Next {
        let waits_for = {
            let status = self.control.inbox.status.borrow();
            status.run.as_ref().and_then(|run| run.waiting_for.clone())
        };
        let mut automatic = passing.map(|resumes| Automatic::new(job, resumes, waits_for));
        let mut tick = tokio::time::interval(IDLE_TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let mut window = Box::pin(next_window(self.watched_skin()));
        loop {
            if self.control.leaving() {
                return Next::Leave;
            }
            // Again after each raise: what the rig refuses follows from the phase.
            self.control.phase(Phase::Wait);
            let waited = tokio::select! {
                envelope = self.control.inbox.next() => match envelope {
                    Some(envelope) => {
                        // The request may close the wires: no window keeps them.
                        window.set(next_window(None));
                        if envelope.request.rig_action().is_some() {
                            self.end_automatic(&mut automatic, Some(BY_HAND.into()));
                        }
                        let waited = self.waiting_request(job, envelope, attempts.last).await;
                        window.set(next_window(self.watched_skin()));
                        waited
                    }
                    None => Some(Waited::Left),
                },
                seen = &mut window => {
                    self.saw(seen);
                    window.set(next_window(self.watched_skin()));
                    None
                }
                _ = tick.tick() => {
                    // A press from here on outlasts an automatic resume.
                    let presses = self.control.estop.presses();
                    self.look().await;
                    match self.raise_when_possible(job).await {
                        None => self.resume_automatically(job, &mut automatic, presses).await,
                        ended => ended,
                    }
                }
            };
            match waited {
                None => {}
                Some(Waited::Resume) => return Next::Again,
                Some(Waited::Confirmed(confirmation)) => {
                    if let Some(trial) = self.wanted_trial() {
                        self.weights_are_placed();
                        self.control.say("placed", confirmation.event(trial));
                        attempts.confirmed = Some((trial, confirmation));
                    }
                    // With a stage the handler of the request has resumed it.
                    if job.plan.kind == Kind::RealRandom {
                        let _ = self.control.run_event(RunEvent::Resume);
                    }
                    return Next::Again;
                }
                Some(Waited::Repeat) => {
                    attempts.last = Last::Withdrawn;
                    attempts.confirmed = None;
                    // A repetition is another attempt at its placement.
                    attempts.of_configuration += 1;
                    let _ = self.control.run_event(RunEvent::Resume);
                    return Next::Again;
                }
                Some(Waited::Left) => return Next::Leave,
                Some(Waited::Ended(status)) => {
                    self.control.attended(ENDED_HALTED);
                    return self.ended_by_request(status);
                }
            }
        }
    }

    /// After a failure of wires the run has not reached the requested state: applies it once `look`
    /// has completed the safe end.
    async fn raise_when_possible(&mut self, job: &Job) -> Option<Waited> {
        if matches!(self.control.run(), RunState::Paused(_) | RunState::Panicked) {
            return None;
        }
        if job.plan.kind == Kind::RealHex {
            match self.owed {
                Owed::Nothing if self.connection.is_some() => {}
                Owed::Nothing | Owed::Wires(..) => return None,
                Owed::Person => {
                    let _ = self.control.run_event(RunEvent::RaiseFailed);
                    return None;
                }
            }
        }
        let action = self.control.run_event(RunEvent::Raised).ok()?;
        // It was requested while the rig homed for an automatic resume.
        if self.control.run() == RunState::Paused(PausedWhy::Suspender) {
            self.state_suspension();
        }
        match action {
            RunAction::End(status) => Some(Waited::Ended(status)),
            RunAction::Continue | RunAction::Raise | RunAction::Wait => None,
        }
    }

    /// Resumes the run; arms again if a reset has disarmed the rig. `answer`: of the request; none if it resumes
    /// automatically.
    pub(super) async fn resume(
        &mut self,
        job: &Job,
        answer: Option<&Answer>,
    ) -> Result<(), Refusal> {
        if job.plan.kind == Kind::RealHex {
            self.arm_stage(job, answer).await?;
        }
        self.control.run_event(RunEvent::Resume).map(|_| ())
    }

    fn wanted_trial(&self) -> Option<u32> {
        match self.control.inbox.status.borrow().run.as_ref()?.wanted.as_ref()? {
            Wanted::Placement { trial, .. } => Some(*trial),
            Wanted::Tips { .. } => None,
        }
    }

    /// Handles a request while a run waits.
    async fn waiting_request(
        &mut self,
        job: &Job,
        envelope: Envelope,
        last: Last,
    ) -> Option<Waited> {
        let Envelope { request, answer, asked_in, presses, signs, decided_at } = envelope;
        self.decided_at = decided_at;
        let refused = {
            let status = self.control.inbox.status.borrow();
            let by_rig = request.rig_action().and_then(|action| action.refused(&status));
            by_rig.or_else(|| request.refused_by_run(&status))
        };
        if let Some(words) = refused {
            let _ = answer.send(Err(Refusal::State(words)));
            return None;
        }
        match request {
            Request::Resume => {
                let resumed = self.resume(job, Some(&answer)).await;
                let waited = resumed.is_ok().then_some(Waited::Resume);
                let _ = answer.send(resumed);
                waited
            }
            Request::Confirm { done, confirmation } => {
                let checked = self.confirmed(job, &confirmation.who, done, &answer).await;
                let waited = checked.is_ok().then_some(Waited::Confirmed(confirmation));
                let _ = answer.send(checked);
                waited
            }
            Request::Repeat { trial, why } => {
                let repeated = self.repeat(job, trial, last, &why, &answer).await;
                let waited = repeated.is_ok().then_some(Waited::Repeat);
                let _ = answer.send(repeated);
                waited
            }
            Request::Stop | Request::Abort | Request::AbortMotion | Request::Suspend(..) => {
                let event = self.control.run_request(&request)?;
                let mut outcome = self.control.run_event(event);
                if outcome.is_ok() {
                    self.state_suspension();
                }
                if outcome == Ok(RunAction::Raise)
                    && self.leave_contact(job, None, Height::Clear).await
                {
                    outcome = self.control.run_event(RunEvent::Raised);
                }
                let waited = match outcome {
                    Ok(RunAction::End(status)) => Some(Waited::Ended(status)),
                    Ok(RunAction::Continue | RunAction::Raise | RunAction::Wait) | Err(_) => None,
                };
                let _ = answer.send(outcome.map(|_| ()));
                waited
            }
            Request::Shutdown => {
                self.control.leave();
                let _ = answer.send(Ok(()));
                Some(Waited::Left)
            }
            // A person has reset a panicked run: it waits as after any trip.
            Request::Reset if self.control.run() == RunState::Panicked => {
                let reset = match self.control.rig() {
                    RigState::Tripped => self.reset(presses, Some(&answer)).await,
                    RigState::Disconnected
                    | RigState::Disarmed
                    | RigState::Homed
                    | RigState::Armed => Ok(()),
                };
                if reset.is_ok() {
                    let _ = self.control.run_event(RunEvent::Reset);
                }
                let _ = answer.send(reset);
                None
            }
            // The tips are up, or their raise is pending: only the reason to wait changes.
            Request::PauseAtCheckpoint | Request::PauseNow => {
                let paused = self.control.run_event(RunEvent::PauseNow).map(|_| ());
                let _ = answer.send(paused);
                None
            }
            Request::CameLate => {
                self.control.came_late();
                let _ = answer.send(Ok(()));
                None
            }
            Request::Start(_) => {
                let (run, start) = (self.control.run(), request.name());
                let (state, next) = (run.as_str(), run.allowed());
                let words = format!("{start} is not possible while the run is {state}: {next}");
                let _ = answer.send(Err(Refusal::State(words)));
                None
            }
            Request::Tare if job.plan.kind == Kind::RealRandom => {
                self.tare_skin(answer);
                None
            }
            Request::Connect
            | Request::Disconnect
            | Request::Home
            | Request::HomeForRun
            | Request::Jog { .. }
            | Request::Tare
            | Request::Mounted { .. }
            | Request::Reset => {
                let envelope = Envelope { request, answer, asked_in, presses, signs, decided_at };
                self.rig_request(envelope).await;
                None
            }
        }
    }

    /// Accepts a confirmation, and resumes a run with a stage.
    pub(super) async fn confirmed(
        &mut self,
        job: &Job,
        who: &str,
        done: Done,
        answer: &Answer,
    ) -> Result<(), Refusal> {
        self.check_confirmed(who, done, answer).await?;
        match job.plan.kind {
            Kind::RealHex => self.resume(job, Some(answer)).await,
            Kind::RealRandom => Ok(()),
        }
    }

    /// Accepts the confirmation of what the run waits for: of a tip change only if the cells do not contradict it, of
    /// a placement only if its zero is of the present stream.
    async fn check_confirmed(
        &mut self,
        who: &str,
        done: Done,
        answer: &Answer,
    ) -> Result<(), Refusal> {
        let wanted = self.control.inbox.status.borrow().run.as_ref().and_then(|r| r.wanted.clone());
        match wanted {
            Some(wanted) if !done.fits(&wanted) => Err(Refusal::State(
                "the run waits for another confirmation: read the status".into(),
            )),
            Some(Wanted::Tips { tips }) => self.mounted(tips, who, answer).await,
            Some(Wanted::Placement { .. }) => self.require_zero_of_stream(),
            None => Err(Refusal::State("the run waits for no confirmation".into())),
        }
    }

    /// Withdraws a stored placement: the named one, otherwise the last one that was measured since the
    /// start of the service. Before that one, which trial a person means is not known. After a refusal it stays
    /// stored, unless that states that the store does not answer and that it must be read later.
    async fn repeat(
        &mut self,
        job: &Job,
        trial: Option<u32>,
        last: Last,
        why: &str,
        answer: &Answer,
    ) -> Result<(), Refusal> {
        let failed = |e| Refusal::State(error_chain(&e));
        let Some(awaited) = self.wanted_trial() else {
            return Err(Refusal::State(NO_PLACEMENT.into()));
        };
        let configuration = match (trial, last) {
            (Some(trial), _) | (None, Last::Stored(trial)) => trial,
            (None, Last::Unknown) => {
                let words = format!(
                    "no placement was measured since the start of the service: name the trial to \
                     repeat (the run awaits trial {awaited})"
                );
                return Err(Refusal::State(words));
            }
            (None, Last::Withdrawn) => {
                let words = format!("trial {awaited} is already repeated: name another one");
                return Err(Refusal::State(words));
            }
        };
        // It is answered while its caller waits, who otherwise is told that it failed.
        let deadline = self.decided_at.1 + ANSWERED_WITHIN;
        let silent =
            |outcome: &str| Refusal::State(format!("the store does not answer: {outcome}"));
        let read = async {
            self.control.flush().await?;
            self.control.journal.progress(job.run).await
        };
        let Ok(progress) = timeout_at(deadline, read).await else {
            return Err(silent(&format!("trial {configuration} stays stored")));
        };
        let key = TrialKey { configuration, depth_index: 0 };
        if !progress.map_err(failed)?.stored.contains(&key) {
            return Err(Refusal::State(format!("trial {configuration} is not stored")));
        }
        if answer.is_closed() {
            return Err(Refusal::Gone);
        }
        // Not by the diary, which would withdraw it later although its caller was told that it failed.
        let withdrawn = self.control.journal.discard(job.run, key, why);
        let Ok(withdrawn) = timeout_at(deadline, withdrawn).await else {
            return Err(silent(&format!("read later whether trial {configuration} is stored")));
        };
        withdrawn.map_err(failed)?;
        tracing::info!(configuration, reason = why, "a trial was withdrawn");
        self.control.say("repeat", json!({ "trial": key, "why": why }));
        Ok(())
    }
}
