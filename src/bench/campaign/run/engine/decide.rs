//! Decisions after a halt: first the safe end; then retry, skip, wait or end, with the record of
//! it.
//! Uses: `campaign::{run::control, diary, safe_end}`. Never: pressing, a wait for the store.

use std::time::Duration;

use serde_json::json;

use super::recovery::BY_HAND;
use super::{Attempts, Engine, Next, Owed};
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::stage::Height;
use crate::campaign::diary::Note;
use crate::campaign::run::control::ENDED_PAUSING;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunAction, RunEvent, RunState};
use crate::campaign::shown::safe_end::Tips;
use crate::campaign::shown::status::Wanted;
use crate::journal::{ExitStatus, error_chain};
use crate::plain::grouped;
use crate::record::AttemptRecord;
use crate::schedule::plan::Kind;

/// Why no waiting run begins after a run that was aborted while it moved.
const ABORTED: &str = "the run before it was aborted, and a person may be at the rig";
/// Time before a trip within which a person who requested something of the rig may be at it, wall.
pub(super) const OPERATED_WITHIN: Duration = Duration::from_secs(600);

impl Engine {
    /// Decides what follows a halt, once the rig is safe. Only the state that a trip leads to is noted before, in
    /// memory: a process that dies meanwhile must not have left a run that resumes automatically.
    pub(super) async fn decide(
        &mut self,
        job: &Job,
        halt: Halt,
        attempts: &mut Attempts,
        auto_resumes: &mut u32,
    ) -> Next {
        let hands = matches!(halt, Halt::Needs(Wanted::Tips { .. }));
        let height = if hands { Height::Top } else { Height::Clear };
        if let Some(trip) = halt.as_trip() {
            self.suspend_for(PausedWhy::Trip, trip.detail.clone());
        }
        let safe = self.leave_contact(job, halt.as_trip(), height).await;
        let mut passing = false;
        // A run that is resumed after another halt waits for no failed attempt before it.
        attempts.has_failed = false;
        if job.plan.kind == Kind::RealRandom {
            // The weights may be lifted meanwhile: a confirmation holds for one undisturbed measurement.
            attempts.confirmed = None;
        }
        match halt {
            Halt::Asked => self.note_suspension(),
            Halt::Checkpoint => {}
            // No person is called to tips that may be down, nor to an axis that may move.
            Halt::Needs(wanted) => match self.lets_hands_in(&wanted).await {
                Ok(()) => self.need(wanted, attempts.not_measured.take()),
                Err(halt) => match halt.as_trip() {
                    Some(trip) => {
                        self.control.latch(trip);
                        self.suspend_for(PausedWhy::Trip, trip.detail.clone());
                    }
                    None => self.note_suspension(),
                },
            },
            // A placement is never given up: the person is asked again.
            Halt::Failed(reason) if job.plan.kind == Kind::RealRandom => {
                self.note_attempt(job, &reason, attempts);
                attempts.of_configuration += 1;
                attempts.not_measured = Some(reason);
            }
            Halt::Failed(reason) if safe => return self.failed(job, reason, attempts),
            Halt::Failed(reason) => {
                self.note_attempt(job, &reason, attempts);
                self.suspend_for(PausedWhy::Trip, reason);
            }
            Halt::Trip(trip) => {
                self.note_attempt(job, &trip.detail, attempts);
                let may = job.auto_resume && trip.kind.may_pass();
                let is_suspending = self.control.run() == RunState::Suspending(PausedWhy::Trip);
                if may && is_suspending && self.control.is_operated_within(OPERATED_WITHIN) {
                    self.control.show_run(|run| run.waiting_for = Some(BY_HAND.into()));
                } else if may && *auto_resumes < job.plan.policy.max_auto_resumes {
                    *auto_resumes += 1;
                    passing = true;
                }
            }
            Halt::Store(error) => {
                let why = error_chain(&error);
                self.control.say("store", json!({ "why": why }));
                self.suspend_for(PausedWhy::Suspender, why);
            }
        }
        let action = if safe {
            self.control.run_event(RunEvent::Raised).unwrap_or(RunAction::Wait)
        } else {
            // With failed wires the run state does not change until the tips are up.
            RunAction::Wait
        };
        match action {
            RunAction::End(status) => {
                if status == ExitStatus::Abort {
                    self.control.attended(ABORTED);
                }
                self.ended_by_request(status)
            }
            RunAction::Continue | RunAction::Raise => Next::Again,
            RunAction::Wait => self.wait(job, attempts, passing.then_some(auto_resumes)).await,
        }
    }

    /// Ends a run without a request: its plan is complete, or it gave up. The next run begins, unless a person has
    /// requested a pause meanwhile, and may be on the way to the rig.
    pub(super) fn end_unasked(&mut self) {
        if matches!(self.control.run(), RunState::Pausing(_)) {
            self.control.attended(ENDED_PAUSING);
        }
        // Ending is allowed in every state of an active run.
        let _ = self.control.run_event(RunEvent::Ended);
    }

    /// The end of a run that a person stopped or aborted.
    pub(super) fn ended_by_request(&self, status: ExitStatus) -> Next {
        let shown = self.control.inbox.status.borrow();
        let (stored, skipped, planned) = shown
            .run
            .as_ref()
            .map_or((0, 0, 0), |r| (r.trials_stored, r.trials_skipped, r.trials_planned));
        let (status, reason) = requested_end(status, stored, skipped, planned);
        Next::End(status, reason)
    }

    /// Safe end of a run that moves the rig. A manual run (Real-Random) has no tips to raise and
    /// only latches. Returns false if the tips are still down: with working wires the run is then
    /// panicked and needs a person; with failed wires the safe end is repeated while waiting.
    pub(super) async fn leave_contact(
        &mut self,
        job: &Job,
        trip: Option<&Trip>,
        height: Height,
    ) -> bool {
        if job.plan.kind == Kind::RealRandom {
            if let Some(trip) = trip {
                self.control.latch(trip);
            }
            return true;
        }
        let safe = self.make_safe(trip, height).await;
        if self.owed == Owed::Person {
            let _ = self.control.run_event(RunEvent::RaiseFailed);
        }
        safe
    }

    /// Checks before a tip change that the last safe end has raised the tips and stopped each axis, and that the cells do
    /// not contradict it.
    ///
    /// # Errors
    /// A trip if not; `Asked` after a request meanwhile.
    async fn lets_hands_in(&mut self, wanted: &Wanted) -> Result<(), Halt> {
        let Wanted::Tips { tips } = wanted else { return Ok(()) };
        let is_safe = {
            let status = self.control.inbox.status.borrow();
            let end = status.rig.safe_end.as_ref();
            end.is_some_and(|end| end.tips == Tips::Raised && end.is_stopped())
        };
        let stage = self.connection.as_ref().and_then(|c| c.stage.as_ref()).filter(|_| is_safe);
        let Some(stage) = stage else {
            let detail =
                format!("the tips are not raised and at rest for their change to {tips} tips");
            return Err(Halt::trip(TripKind::Position, detail));
        };
        stage.require_clear(&mut self.control).await
    }

    fn note_suspension(&mut self) {
        if self.state_suspension() && !matches!(self.control.run(), RunState::Suspending(_)) {
            let _ = self.control.run_event(RunEvent::Suspend(PausedWhy::Suspender));
        }
    }

    /// States why a suspender has requested a halt, once. Returns whether one has.
    pub(super) fn state_suspension(&mut self) -> bool {
        let Some(why) = self.control.take_suspended_for() else { return false };
        self.control.say("suspended", json!({ "why": why }));
        self.control.show_run(|run| run.waiting_for = Some(why));
        true
    }

    fn suspend_for(&mut self, why: PausedWhy, words: String) {
        self.control.show_run(|run| run.waiting_for = Some(words));
        // A panicked run stays panicked until a person resets it.
        let _ = self.control.run_event(RunEvent::Suspend(why));
    }

    fn need(&mut self, wanted: Wanted, not_measured: Option<String>) {
        let (why, words) = match &wanted {
            Wanted::Tips { tips } => (PausedWhy::TipChange, tip_words(*tips)),
            Wanted::Placement { trial, contacts } => {
                (PausedWhy::ManualTrial, placement_words(*trial, contacts.len(), not_measured))
            }
        };
        let data = json!({ "why": why, "wanted": wanted, "words": words });
        self.control.show_run(|run| {
            run.wanted = Some(wanted);
            run.waiting_for = Some(words);
        });
        let _ = self.control.run_event(RunEvent::Need(why));
        self.control.say("wanted", data);
    }

    /// Handles a failed attempt: retries, skips the configuration, or ends the run.
    fn failed(&mut self, job: &Job, reason: String, attempts: &mut Attempts) -> Next {
        self.note_attempt(job, &reason, attempts);
        attempts.has_failed = true;
        if attempts.of_configuration <= job.plan.policy.retries {
            attempts.of_configuration += 1;
            return Next::Again;
        }
        if let Some(configuration) = attempts.configuration {
            self.control.diary.note(Note::Skip(job.run, configuration, reason.clone()));
            let data = json!({ "configuration": configuration, "reason": reason });
            self.control.say("skipped", data);
        }
        // A touch-off or a reference press cannot be skipped: it is tried again, as often.
        attempts.skipped += 1;
        attempts.of_configuration = 1;
        if attempts.skipped > job.plan.policy.max_skipped {
            self.end_unasked();
            let words = format!("gave up after {} skipped: {reason}", attempts.skipped);
            return Next::End(ExitStatus::Fail, words);
        }
        Next::Again
    }

    fn note_attempt(&mut self, job: &Job, reason: &str, attempts: &mut Attempts) {
        let key = self.control.inbox.status.borrow().run.as_ref().and_then(|r| r.trial);
        attempts.configuration = key.map(|k| k.configuration);
        let data = json!({ "trial": key, "attempt": attempts.of_configuration, "reason": reason });
        self.control.say("attempt_failed", data);
        // Only an attempt at a trial is stored: the status counts what the summary counts.
        let Some(key) = key else { return };
        self.control.show_run(|run| run.retries += 1);
        let record = AttemptRecord {
            key,
            attempt: attempts.of_configuration,
            reason: reason.into(),
            at: jiff::Timestamp::now(),
        };
        self.control.diary.note(Note::Attempt(job.run, record));
    }
}

/// Exit status and reason of a run that ends on request, with these numbers of trials. A stop after the last
/// one leaves nothing out.
fn requested_end(
    status: ExitStatus,
    stored: u64,
    skipped: u64,
    planned: u64,
) -> (ExitStatus, String) {
    let share = format!("{} of {} trials", grouped(stored), grouped(planned));
    match status {
        ExitStatus::Stopped if stored + skipped >= planned => {
            (ExitStatus::Success, "stopped after its last trial".into())
        }
        ExitStatus::Stopped => (status, format!("stopped at {share}")),
        ExitStatus::Success | ExitStatus::Abort | ExitStatus::Fail => {
            (status, format!("aborted at {share}"))
        }
    }
}

fn placement_words(trial: u32, weights: usize, not_measured: Option<String>) -> String {
    let words = match weights {
        1 => format!("place 1 weight for trial {trial}, confirm"),
        n => format!("place {n} weights for trial {trial}, confirm"),
    };
    match not_measured {
        Some(reason) => format!("trial {trial} was not measured ({reason}): {words} again"),
        None => words,
    }
}

fn tip_words(tips: u8) -> String {
    match tips {
        1 => "mount 1 tip, on arm 1, then confirm".into(),
        n => format!("mount {n} tips, on arms 1 to {n}, then confirm"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_short_of_the_plan_is_no_success() {
        use ExitStatus::{Abort, Stopped, Success};
        let end = |status, stored, skipped| requested_end(status, stored, skipped, 33_000);
        assert_eq!(end(Stopped, 899, 11), (Stopped, "stopped at 899 of 33,000 trials".into()));
        assert_eq!(end(Stopped, 32_989, 11).0, Success);
        assert_eq!(end(Abort, 0, 0), (Abort, "aborted at 0 of 33,000 trials".into()));
    }
}
