//! The state machine of the run: one enum, one diagram, one function.
//! PURE. Uses: `journal`, `state`. Never: motion, storage, time.
//!
//! ```text
//!              start                     pause at checkpoint / need a person
//!      idle ----------> running --------------------------------> pausing
//!        ^                | ^ \                                      | raised
//!        |                | |  \ pause now, suspend, trip            v
//!        |                | |   +--------------> suspending ----> paused (why)
//!        |                | |                        raised         | | |
//!        |                | +---------------- resume ---------------+ | |
//!        |                |                                           | |
//!        |  ended         +-- stop --> stopping <------- stop --------+ |
//!        +<------------------------------ | ended                       |
//!        +<----- aborting <-- abort (from any of the above) ------------+
//!
//!      any --- raise failed ---> panicked      panicked --- reset ---> paused (trip)
//! ```
//! `requested` is the last requested state; the state is the one that has been reached.

use crate::journal::ExitStatus;
pub use crate::state::PausedWhy;
use crate::state::{StateChange, StoredState};

/// State that a run has reached (names as in Bluesky).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunState {
    /// No run is active.
    Idle,
    /// Moving and measuring.
    Running,
    /// Pauses at the next checkpoint: before a press, or after the commit of its trial.
    Pausing(PausedWhy),
    /// Paused with the tips raised.
    Paused(PausedWhy),
    /// Ends at the next checkpoint.
    Stopping,
    /// Raises the tips now, then ends.
    Aborting,
    /// Raises the tips now, then waits.
    Suspending(PausedWhy),
    /// The tips could not be raised: a person must inspect the rig.
    Panicked,
}

impl RunState {
    /// The state as it is stored and shown, without its reason.
    pub fn stored(self) -> StoredState {
        match self {
            RunState::Idle => StoredState::Idle,
            RunState::Running => StoredState::Running,
            RunState::Pausing(_) => StoredState::Pausing,
            RunState::Paused(_) => StoredState::Paused,
            RunState::Stopping => StoredState::Stopping,
            RunState::Aborting => StoredState::Aborting,
            RunState::Suspending(_) => StoredState::Suspending,
            RunState::Panicked => StoredState::Panicked,
        }
    }

    /// Text of the state.
    pub fn as_str(self) -> &'static str {
        self.stored().as_str()
    }

    /// The state of which `stored` and `why` are shown; none if no run is driven in it.
    pub fn of(stored: StoredState, why: Option<PausedWhy>) -> Option<Self> {
        match (stored, why) {
            (StoredState::Idle, _) => Some(RunState::Idle),
            (StoredState::Running, _) => Some(RunState::Running),
            (StoredState::Pausing, why) => why.map(RunState::Pausing),
            (StoredState::Paused, why) => why.map(RunState::Paused),
            (StoredState::Stopping, _) => Some(RunState::Stopping),
            (StoredState::Aborting, _) => Some(RunState::Aborting),
            (StoredState::Suspending, why) => why.map(RunState::Suspending),
            (StoredState::Panicked, _) => Some(RunState::Panicked),
            (
                StoredState::Queued
                | StoredState::Interrupted
                | StoredState::Ended
                | StoredState::Removed,
                _,
            ) => None,
        }
    }

    /// State that was requested and is not reached yet; none if the state is not a transition.
    pub fn requested(self) -> Option<StoredState> {
        match self {
            RunState::Pausing(_) | RunState::Suspending(_) => Some(StoredState::Paused),
            RunState::Stopping | RunState::Aborting => Some(StoredState::Idle),
            RunState::Idle | RunState::Running | RunState::Paused(_) | RunState::Panicked => None,
        }
    }

    /// The state with its request and reason, for the journal.
    pub fn change(self) -> StateChange {
        StateChange { state: self.stored(), requested: self.requested(), why: self.why() }
    }

    /// Reason why the run waits or is about to wait; none in other states.
    pub fn why(self) -> Option<PausedWhy> {
        match self {
            RunState::Pausing(why) | RunState::Paused(why) | RunState::Suspending(why) => Some(why),
            RunState::Idle
            | RunState::Running
            | RunState::Stopping
            | RunState::Aborting
            | RunState::Panicked => None,
        }
    }
}

/// Events of the run's state machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunEvent {
    /// An armed run starts.
    Start,
    /// Pause after the current trial.
    PauseAtCheckpoint,
    /// Raise the tips now and pause.
    PauseNow,
    /// The plan needs a person.
    Need(PausedWhy),
    /// A suspender, a trip or an e-stop: raise the tips now and wait.
    Suspend(PausedWhy),
    /// The run continues with its next step.
    Resume,
    /// End after the current trial.
    Stop,
    /// Raise the tips now and end.
    Abort,
    /// The engine has reached a checkpoint or has raised the tips: the requested state is reached.
    Raised,
    /// The tips could not be raised.
    RaiseFailed,
    /// The plan is complete, or cannot continue.
    Ended,
    /// A person has inspected the rig after a panic.
    Reset,
}

/// What the engine must do on entering the next state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunAction {
    /// Continue as before, to the next checkpoint.
    Continue,
    /// Raise the tips now.
    Raise,
    /// Wait for a person or a policy.
    Wait,
    /// End the run with this status.
    End(ExitStatus),
}

impl RunEvent {
    /// What cannot be done if the state does not allow the event.
    fn words(self) -> &'static str {
        match self {
            RunEvent::Start => "start",
            RunEvent::PauseAtCheckpoint | RunEvent::PauseNow => "pause",
            RunEvent::Need(_) => "wait for a person",
            RunEvent::Suspend(_) => "be suspended",
            RunEvent::Resume => "resume",
            RunEvent::Stop => "stop",
            RunEvent::Abort => "abort",
            RunEvent::Raised => "wait with raised tips",
            RunEvent::RaiseFailed => "wait with tips that are not raised",
            RunEvent::Ended => "end",
            RunEvent::Reset => "be reset",
        }
    }
}

impl RunState {
    /// What the state allows, for a person whose request it does not allow.
    pub(in crate::campaign) fn allowed(self) -> &'static str {
        match self {
            RunState::Idle => "queue and start a run first",
            RunState::Running => "pause, stop or abort it",
            RunState::Pausing(_) | RunState::Suspending(_) => {
                "wait until it is paused, or abort it"
            }
            RunState::Paused(_) => "resume, stop or abort it",
            RunState::Stopping => "wait until it has ended, or abort it",
            RunState::Aborting => "wait until it has ended",
            RunState::Panicked => "check the rig, then reset it",
        }
    }
}

/// An event that the state does not allow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the run is {} and cannot {} now: {}", state.as_str(), event.words(), state.allowed())]
pub struct Illegal {
    /// State in which the event occurred.
    pub state: RunState,
    /// Event that was refused.
    pub event: RunEvent,
}

/// Returns the next state and what to do in it.
///
/// # Errors
/// `Illegal` if the state does not allow the event.
pub fn step(state: RunState, event: RunEvent) -> Result<(RunState, RunAction), Illegal> {
    use RunAction::{Continue, End, Raise, Wait};
    use RunEvent as E;
    use RunState as S;
    let illegal = Err(Illegal { state, event });
    match (state, event) {
        // The remaining plan is unchanged: once the rig is homed, the run may be resumed, stopped
        // or aborted.
        (S::Panicked, E::Reset) => Ok((S::Paused(PausedWhy::Trip), Wait)),
        (S::Panicked, _) => illegal,
        (S::Idle, E::RaiseFailed) => Ok((S::Panicked, Wait)),
        (S::Idle, E::Start) => Ok((S::Running, Continue)),
        (S::Idle, _) => illegal,
        (_, E::Start | E::Reset) => illegal,
        (_, E::RaiseFailed) => Ok((S::Panicked, Wait)),

        (S::Running, E::PauseAtCheckpoint) => Ok((S::Pausing(PausedWhy::Operator), Continue)),
        (S::Running, E::Need(why)) => Ok((S::Pausing(why), Raise)),
        (S::Running | S::Pausing(_), E::PauseNow) => {
            Ok((S::Suspending(PausedWhy::Operator), Raise))
        }
        (S::Running, E::Suspend(why)) => Ok((S::Suspending(why), Raise)),
        (S::Pausing(before) | S::Suspending(before) | S::Paused(before), E::Suspend(why)) => {
            Ok((S::Suspending(lasting(before, why)), Raise))
        }
        (S::Running, E::Raised) => Ok((S::Running, Continue)),
        (S::Running, E::Resume) => illegal,

        (S::Pausing(why) | S::Suspending(why), E::Raised) => Ok((S::Paused(why), Wait)),
        (S::Pausing(_), E::Resume) => Ok((S::Running, Continue)),
        (S::Pausing(_), E::PauseAtCheckpoint | E::Need(_)) => illegal,

        // A person pauses what would resume automatically.
        (S::Suspending(PausedWhy::Trip), E::PauseAtCheckpoint | E::PauseNow) => {
            Ok((S::Suspending(PausedWhy::Operator), Raise))
        }
        (S::Paused(PausedWhy::Trip), E::PauseAtCheckpoint | E::PauseNow) => {
            Ok((S::Paused(PausedWhy::Operator), Raise))
        }

        (S::Suspending(_), E::PauseAtCheckpoint | E::PauseNow | E::Need(_) | E::Resume) => illegal,

        (S::Paused(_), E::Resume) => Ok((S::Running, Continue)),
        (S::Paused(_), E::Raised) => Ok((state, Wait)),
        (S::Paused(_), E::PauseAtCheckpoint | E::PauseNow | E::Need(_)) => illegal,

        (S::Running | S::Pausing(_), E::Stop) => Ok((S::Stopping, Continue)),
        (S::Suspending(_) | S::Paused(_), E::Stop) => Ok((S::Stopping, Raise)),
        (S::Stopping, E::Raised | E::Ended) => Ok((S::Idle, End(ExitStatus::Stopped))),
        (S::Stopping, E::Suspend(_)) => Ok((S::Stopping, Raise)),
        (S::Stopping, E::PauseAtCheckpoint | E::PauseNow | E::Need(_) | E::Resume | E::Stop) => {
            illegal
        }

        (S::Running | S::Pausing(_) | S::Suspending(_) | S::Paused(_) | S::Stopping, E::Abort) => {
            Ok((S::Aborting, Raise))
        }
        (S::Aborting, E::Raised | E::Ended) => Ok((S::Idle, End(ExitStatus::Abort))),
        (S::Aborting, E::Suspend(_)) => Ok((S::Aborting, Raise)),
        (
            S::Aborting,
            E::PauseAtCheckpoint | E::PauseNow | E::Need(_) | E::Resume | E::Stop | E::Abort,
        ) => illegal,

        (S::Running, E::Ended) => Ok((S::Idle, End(ExitStatus::Success))),
        (S::Pausing(_) | S::Suspending(_) | S::Paused(_), E::Ended) => {
            Ok((S::Idle, End(ExitStatus::Fail)))
        }
    }
}

/// Reason of a halted run that is halted again: what a person requested, or what waits for one, does not become
/// a reason after which the run resumes automatically.
fn lasting(before: PausedWhy, next: PausedWhy) -> PausedWhy {
    use PausedWhy as W;
    match (before, next) {
        (W::Operator, _) | (_, W::Restart) => before,
        (
            W::TipChange | W::ManualTrial | W::Suspender | W::Trip | W::Restart,
            W::Operator | W::TipChange | W::ManualTrial | W::Suspender | W::Trip,
        ) => next,
    }
}

/// Every state and event as in `docs/safety.md`; the test below derives it from `step`.
#[cfg(test)]
pub(in crate::campaign) const TABLE: &str = "\
idle       running - - - - - - - - panicked - -
running    - pausing suspending pausing suspending - stopping aborting running panicked idle -
pausing    - - suspending - suspending running stopping aborting paused panicked idle -
paused     - - - - suspending running stopping aborting paused panicked idle -
stopping   - - - - stopping - - aborting idle panicked idle -
aborting   - - - - aborting - - - idle panicked idle -
suspending - - - - suspending - stopping aborting paused panicked idle -
panicked   - - - - - - - - - - - paused
";

#[cfg(test)]
mod tests {
    use super::*;

    const WHY: PausedWhy = PausedWhy::Operator;

    fn states() -> Vec<RunState> {
        use RunState as S;
        vec![
            S::Idle,
            S::Running,
            S::Pausing(WHY),
            S::Paused(WHY),
            S::Stopping,
            S::Aborting,
            S::Suspending(WHY),
            S::Panicked,
        ]
    }

    fn events() -> Vec<RunEvent> {
        use RunEvent as E;
        vec![
            E::Start,
            E::PauseAtCheckpoint,
            E::PauseNow,
            E::Need(PausedWhy::TipChange),
            E::Suspend(PausedWhy::Trip),
            E::Resume,
            E::Stop,
            E::Abort,
            E::Raised,
            E::RaiseFailed,
            E::Ended,
            E::Reset,
        ]
    }

    /// Every state x event pair, as text: `-` is illegal.
    #[test]
    fn the_whole_table() {
        let mut table = String::new();
        for s in states() {
            let row: Vec<&str> = events()
                .iter()
                .map(|&e| step(s, e).map_or("-", |(next, _)| next.as_str()))
                .collect();
            table += &format!("{:10} {}\n", s.as_str(), row.join(" "));
        }
        assert_eq!(table, TABLE);
    }

    #[test]
    fn a_state_is_known_again_from_what_is_shown_of_it() {
        for state in states() {
            assert_eq!(RunState::of(state.stored(), state.why()), Some(state));
        }
        assert_eq!(RunState::of(StoredState::Queued, None), None);
        assert_eq!(RunState::of(StoredState::Paused, None), None);
    }

    #[test]
    fn an_abort_is_possible_wherever_a_run_is_under_way() {
        use RunState as S;
        for s in states() {
            let open = !matches!(s, S::Idle | S::Panicked | S::Aborting);
            assert_eq!(step(s, RunEvent::Abort).is_ok(), open, "{s:?}");
        }
    }

    #[test]
    fn what_waits_for_a_person_does_not_become_what_passes_by_itself() {
        use PausedWhy::{ManualTrial, Operator, Restart, Suspender, TipChange, Trip};
        let next = |state, event| step(state, event).unwrap().0;
        for why in [Operator, TipChange, ManualTrial, Suspender, Trip] {
            let ends = RunEvent::Suspend(Restart);
            for state in [RunState::Pausing(why), RunState::Suspending(why), RunState::Paused(why)]
            {
                assert_eq!(next(state, ends), RunState::Suspending(why), "{state:?}");
            }
        }
        let trip = RunEvent::Suspend(Trip);
        assert_eq!(next(RunState::Pausing(Operator), trip), RunState::Suspending(Operator));
        assert_eq!(next(RunState::Running, trip), RunState::Suspending(Trip));
        for pause in [RunEvent::PauseAtCheckpoint, RunEvent::PauseNow] {
            assert_eq!(next(RunState::Suspending(Trip), pause), RunState::Suspending(Operator));
            assert_eq!(next(RunState::Paused(Trip), pause), RunState::Paused(Operator));
        }
    }

    #[test]
    fn whatever_leaves_contact_in_a_hurry_raises_first() {
        for s in states() {
            for e in [RunEvent::PauseNow, RunEvent::Abort, RunEvent::Suspend(PausedWhy::Trip)] {
                if let Ok((_, action)) = step(s, e) {
                    assert_eq!(action, RunAction::Raise, "{s:?} {e:?}");
                }
            }
        }
    }
}
