//! A run that waits: for a person, or for the policy's automatic resume.
//! Uses: `campaign::run::control`. Never: pressing.

use std::time::Duration;

use serde_json::json;
use tokio::time::Instant;

use super::skin::next_window;
use super::{Attempts, Engine, IDLE_TICK, Last, Next, Owed, Waited, backoff};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::diary::Note;
use crate::campaign::run::control::name;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunAction, RunEvent, RunState};
use crate::campaign::safe_end::Height;
use crate::campaign::shown::command::{Envelope, Refusal, Request};
use crate::campaign::shown::status::{Done, Phase, Wanted};
use crate::ids::TrialKey;
use crate::journal::error_chain;
use crate::schedule::plan::Kind;

/// Longest wait for the store before an automatic resume; meanwhile no request is read.
const LOCK_LIMIT: Duration = Duration::from_secs(1);

/// How an automatic resume ended.
enum Recovery {
    /// A device does not answer yet; nothing was moved.
    NotYet,
    /// The reset, the homing or the resume failed.
    Failed,
    /// The run resumes.
    Done,
}

impl Engine {
    /// Waits for a person, or for the policy's automatic resume (`passing`: automatic resumes of the
    /// run, this one included).
    pub(super) async fn wait(
        &mut self,
        job: &Job,
        attempts: &mut Attempts,
        mut passing: Option<&mut u32>,
    ) -> Next {
        self.control.phase(Phase::Wait);
        if self.control.leaving() {
            return Next::Leave;
        }
        let waits_for = {
            let status = self.control.inbox.status.borrow();
            status.run.as_ref().and_then(|run| run.waiting_for.clone())
        };
        let mut try_at = passing.as_deref().map(|n| Instant::now() + backoff(job, *n));
        let mut failures = 0;
        let mut tick = tokio::time::interval(IDLE_TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let mut window = Box::pin(next_window(self.watched_skin()));
        loop {
            let waited = tokio::select! {
                envelope = self.control.inbox.next() => match envelope {
                    Some(envelope) => {
                        // The request may close the wires: no window keeps them.
                        window.set(next_window(None));
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
                    let ended = self.raise_when_possible(job).await;
                    if ended.is_some() {
                        ended
                    } else if self.control.estop.pressed().is_some() {
                        // A person has stopped the rig: nothing resumes automatically any more.
                        if try_at.take().is_some() {
                            self.control.show_run(|run| run.waiting_for = waits_for.clone());
                        }
                        None
                    } else if try_at.is_some_and(|at| Instant::now() >= at)
                        && matches!(self.control.run(), RunState::Paused(PausedWhy::Trip))
                    {
                        let lock = self.taken_lock().await;
                        let shown = lock.clone().or_else(|| waits_for.clone());
                        self.control.show_run(|run| run.waiting_for = shown);
                        let recovery = match lock {
                            Some(_) => Recovery::NotYet,
                            None => self.recover(job, presses).await,
                        };
                        failures += 1;
                        let resumes = passing.as_deref_mut().map_or(0, |n| {
                            *n += u32::from(matches!(recovery, Recovery::Failed));
                            *n
                        });
                        let again = match recovery {
                            Recovery::Failed => {
                                resumes <= job.plan.policy.max_auto_resumes && self.trip_may_pass()
                            }
                            Recovery::NotYet | Recovery::Done => true,
                        };
                        if !again {
                            self.control.say("recovering", json!({ "ended": true }));
                        }
                        let pause = backoff(job, resumes + failures);
                        try_at = again.then(|| Instant::now() + pause);
                        matches!(recovery, Recovery::Done).then_some(Waited::Resume)
                    } else {
                        None
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
                Some(Waited::Ended(status)) => return self.ended_by_request(status),
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
                Owed::Nothing | Owed::Wires(_) => return None,
                Owed::Person => {
                    let _ = self.control.run_event(RunEvent::RaiseFailed);
                    return None;
                }
            }
        }
        let action = self.control.run_event(RunEvent::Raised).ok()?;
        self.control.phase(Phase::Wait);
        match action {
            RunAction::End(status) => Some(Waited::Ended(status)),
            RunAction::Continue | RunAction::Raise | RunAction::Wait => None,
        }
    }

    /// Why nothing may move automatically: a person has taken the operator lock since the run halted, for example
    /// with hands in the rig, or the store does not answer.
    async fn taken_lock(&self) -> Option<String> {
        let journal = self.control.journal.clone();
        match tokio::time::timeout(LOCK_LIMIT, journal.lock_since(self.halted_at)).await {
            Ok(Ok(lock)) => lock.map(|who| format!("release of the operator lock ({who})")),
            Ok(Err(error)) => Some(format!("the store: {}", error_chain(&error))),
            Err(_late) => Some("the store, which does not answer".into()),
        }
    }

    /// Automatic resume after a trip that may pass: checks, resets, homes, arms and resumes.
    /// In a manual run nothing moves: a person's hands may be on the skin.
    /// `presses`: presses of the e-stop when it was decided; a later one is not cleared.
    async fn recover(&mut self, job: &Job, presses: u64) -> Recovery {
        self.control.say("recovering", json!({}));
        let Some(connection) = self.connection.as_ref() else { return Recovery::NotYet };
        if let Some(stage) = &connection.stage
            && (stage.pose().await.is_err() || stage.bench.cells.read().await.is_err())
        {
            return Recovery::NotYet;
        }
        if connection.skin.take(Instant::now(), 1).await.is_err() {
            return Recovery::NotYet;
        }
        if job.plan.kind == Kind::RealRandom {
            let tripped = self.control.rig() == RigState::Tripped;
            let reset = !tripped || self.reset(presses).await.is_ok();
            let resumed = reset && self.control.run_event(RunEvent::Resume).is_ok();
            return if resumed { Recovery::Done } else { Recovery::Failed };
        }
        let resumed = self.reset(presses).await.is_ok()
            && self.home().await
            && self.resume(job).await.is_ok();
        if resumed { Recovery::Done } else { Recovery::Failed }
    }

    /// Whether the present trip may pass without a person.
    fn trip_may_pass(&self) -> bool {
        self.control.inbox.status.borrow().rig.trip.as_ref().is_none_or(|t| t.kind.may_pass())
    }

    /// Whether the run may move the rig. A manual run moves nothing.
    fn may_move(&self, job: &Job) -> Result<(), Refusal> {
        let rig = self.control.rig();
        match (job.plan.kind, rig) {
            (Kind::RealRandom, _) | (Kind::RealHex, RigState::Homed | RigState::Armed) => Ok(()),
            (Kind::RealHex, RigState::Disconnected | RigState::Disarmed | RigState::Tripped) => {
                let rig = rig.as_str();
                let words = format!("resume is not possible while the rig is {rig}: reset, home");
                Err(Refusal::State(words))
            }
        }
    }

    /// Resumes the run; arms again if a reset has disarmed the rig.
    async fn resume(&mut self, job: &Job) -> Result<(), Refusal> {
        self.may_move(job)?;
        if job.plan.kind == Kind::RealHex {
            self.arm_stage(job).await?;
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
        let why = self.control.run().why();
        let needs_person = matches!(why, Some(PausedWhy::TipChange | PausedWhy::ManualTrial));
        let Envelope { request, answer, asked_in, presses } = envelope;
        match request {
            Request::Resume if !needs_person => {
                let resumed = self.resume(job).await;
                let waited = resumed.is_ok().then_some(Waited::Resume);
                let _ = answer.send(resumed);
                waited
            }
            Request::Confirm { done, confirmation } if needs_person => {
                let checked = self.confirmed(job, &confirmation.who, done).await;
                let waited = checked.is_ok().then_some(Waited::Confirmed(confirmation));
                let _ = answer.send(checked);
                waited
            }
            Request::Repeat { trial, why } => {
                let repeated = self.repeat(job, trial, last, &why).await;
                let waited = repeated.is_ok().then_some(Waited::Repeat);
                let _ = answer.send(repeated);
                waited
            }
            Request::Resume => {
                let words = "resume is not possible: confirm what the run waits for".into();
                let _ = answer.send(Err(Refusal::State(words)));
                None
            }
            Request::Stop | Request::Abort | Request::Suspend(_) => {
                let event = self.control.run_request(&request)?;
                let mut outcome = self.control.run_event(event);
                if outcome == Ok(RunAction::Raise)
                    && self.leave_contact(job, None, Height::Clear).await
                {
                    outcome = self.control.run_event(RunEvent::Raised);
                }
                let waited = match outcome {
                    Ok(RunAction::End(status)) => Some(Waited::Ended(status)),
                    _ => None,
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
                    RigState::Tripped => self.reset(presses).await,
                    _ => Ok(()),
                };
                if reset.is_ok() {
                    let _ = self.control.run_event(RunEvent::Reset);
                }
                let _ = answer.send(reset);
                None
            }
            Request::Start(_)
            | Request::Confirm { .. }
            | Request::PauseAtCheckpoint
            | Request::PauseNow => {
                let run = self.control.run();
                let (state, next) = (run.as_str(), run.allowed());
                let words = match &request {
                    Request::Confirm { .. } => {
                        format!("nothing is to be confirmed: the run is {state}")
                    }
                    other => {
                        format!("{} is not possible while the run is {state}: {next}", name(other))
                    }
                };
                let _ = answer.send(Err(Refusal::State(words)));
                None
            }
            Request::Tare if job.plan.kind == Kind::RealRandom => {
                self.tare_skin(answer);
                None
            }
            Request::Home | Request::Jog { .. } if job.plan.kind == Kind::RealRandom => {
                let words = format!(
                    "{} is not possible during a manual run: hands may be on the skin; end the run first",
                    name(&request)
                );
                let _ = answer.send(Err(Refusal::State(words)));
                None
            }
            Request::Connect
            | Request::Disconnect
            | Request::Home
            | Request::Jog { .. }
            | Request::Tare
            | Request::Mounted { .. }
            | Request::Reset => {
                self.rig_request(Envelope { request, answer, asked_in, presses }).await;
                None
            }
        }
    }

    /// Accepts a confirmation, and resumes a run with a stage: only a rig that may move.
    async fn confirmed(&mut self, job: &Job, who: &str, done: Done) -> Result<(), Refusal> {
        self.may_move(job)?;
        self.check_confirmed(who, done).await?;
        match job.plan.kind {
            Kind::RealHex => self.resume(job).await,
            Kind::RealRandom => Ok(()),
        }
    }

    /// Accepts the confirmation of what the run waits for, of a tip change only if the cells do not
    /// contradict it.
    async fn check_confirmed(&mut self, who: &str, done: Done) -> Result<(), Refusal> {
        let wanted = self.control.inbox.status.borrow().run.as_ref().and_then(|r| r.wanted.clone());
        match wanted {
            Some(wanted) if !done.fits(&wanted) => Err(Refusal::State(
                "the run waits for another confirmation: read the status".into(),
            )),
            Some(Wanted::Tips { tips }) => self.mounted(tips, who).await,
            Some(Wanted::Placement { .. }) => Ok(()),
            None => Err(Refusal::State("the run waits for no confirmation".into())),
        }
    }

    /// Withdraws a stored placement: the named one, otherwise the last one that was measured since the
    /// start of the service. Before that one, which trial a person means is not known.
    async fn repeat(
        &mut self,
        job: &Job,
        trial: Option<u32>,
        last: Last,
        why: &str,
    ) -> Result<(), Refusal> {
        let failed = |e| Refusal::State(error_chain(&e));
        let waiting = self.control.run().why() == Some(PausedWhy::ManualTrial);
        let Some(awaited) = self.wanted_trial().filter(|_| waiting) else {
            return Err(Refusal::State(
                "repeat is not possible: the run awaits no placement".into(),
            ));
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
        self.control.flush().await.map_err(failed)?;
        let progress = self.control.journal.progress(job.run).await.map_err(failed)?;
        let key = TrialKey { configuration, depth_index: 0 };
        if !progress.stored.contains(&key) {
            return Err(Refusal::State(format!("trial {configuration} is not stored")));
        }
        self.control.diary.note(Note::Discard(job.run, key, why.into()));
        self.control.say("repeat", json!({ "trial": key, "why": why }));
        self.control.flush().await.map_err(failed)
    }
}
