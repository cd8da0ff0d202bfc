//! The automatic resume of a run after a trip that may pass: when it is tried, what holds it, and what ends it.
//! Uses: `campaign::run::control`, `rig::traits`. Never: a step of the plan.

use std::time::Duration;

use futures::future::join_all;
use serde_json::json;
use tokio::time::Instant;

use super::{Engine, Owed, Waited, backoff};
use crate::campaign::bench::rig_state::{RigEvent, RigState};
use crate::campaign::bench::stage::Height;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunEvent, RunState};
use crate::campaign::run::unattended::Unattended;
use crate::campaign::shown::command::Refusal;
use crate::rig::error::RigError;
use crate::rig::traits::Bench;
use crate::schedule::plan::Kind;

/// Longest silence of a device after which a run resumes automatically, wall: a longer one may be a stop that removes
/// the power of the drives, and a person may be at the rig.
const SILENCE_MAX: Duration = Duration::from_secs(600);
/// Axes of a bench.
const AXES: usize = 4;
/// What a run waits for after a person has operated the rig.
pub(super) const BY_HAND: &str = "a request to resume: a person has operated the rig";

/// The automatic resume of a run that waits.
pub(super) struct Automatic<'a> {
    /// Automatic resumes of the run, this one included.
    resumes: &'a mut u32,
    /// What the run waits for otherwise, as text.
    waits_for: Option<String>,
    /// Time of the next attempt.
    at: Instant,
    attempts: u32,
    /// Whether each drive was homed when it was last known, in the order of the stops: an attempt that failed while it
    /// homed leaves some that are not.
    homed: [bool; AXES],
    /// Whether the tips could not be raised yet, since the wires fail.
    is_down: bool,
    /// Time since which a device may not have replied.
    silent_since: Option<Instant>,
}

/// Result of an attempt to resume.
enum Recovery {
    /// A device does not reply yet.
    Silent,
    /// It waits for this, as text.
    Held(String),
    /// A drive has lost its power, or a person was there, as text.
    ForPerson(String),
    /// The reset, the homing or the resume failed: why, as text, if it is known.
    Failed(Option<String>),
    /// The run resumes.
    Done,
}

impl<'a> Automatic<'a> {
    pub(super) fn new(job: &Job, resumes: &'a mut u32, waits_for: Option<String>) -> Self {
        let now = Instant::now();
        let at = now + backoff(job, *resumes);
        let (homed, silent_since) = ([true; AXES], Some(now));
        Self { resumes, waits_for, at, attempts: 0, homed, is_down: false, silent_since }
    }
}

impl Engine {
    /// One look at a run that waits, and may be about to resume automatically; a suspension of the computer ends that.
    /// `presses`: presses of the e-stop when it was decided; a later one is not cleared.
    pub(super) async fn resume_automatically(
        &mut self,
        job: &Job,
        automatic: &mut Option<Automatic<'_>>,
        presses: u64,
    ) -> Option<Waited> {
        if let Some(words) = self.notice_suspension() {
            self.end_automatic(automatic, Some(format!("a request to resume: {words}")));
        }
        let resume = automatic.as_mut()?;
        if self.control.estop.pressed().is_some() {
            let words = resume.waits_for.take();
            self.end_automatic(automatic, words);
            return None;
        }
        match self.control.run() {
            RunState::Paused(PausedWhy::Trip) => {}
            RunState::Suspending(_) => {
                resume.is_down = true;
                return None;
            }
            RunState::Idle
            | RunState::Running
            | RunState::Pausing(_)
            | RunState::Paused(
                PausedWhy::Operator
                | PausedWhy::TipChange
                | PausedWhy::ManualTrial
                | PausedWhy::Suspender
                | PausedWhy::Restart,
            )
            | RunState::Stopping
            | RunState::Aborting
            | RunState::Panicked => return None,
        }
        let now = Instant::now();
        if std::mem::take(&mut resume.is_down) {
            // The wires have just begun to work again: who made them work may be at the rig.
            resume.at = resume.at.max(now + backoff(job, 1));
        }
        if now < resume.at {
            return None;
        }
        if resume.silent_since.is_some_and(|since| since.elapsed() > SILENCE_MAX) {
            let minutes = SILENCE_MAX.as_secs() / 60;
            let words = format!(
                "a device was silent for more than {minutes} min: check the rig, reset, home, resume"
            );
            self.end_automatic(automatic, Some(words));
            return None;
        }
        let recovery = match self.control.taken_lock(self.halted_at).await {
            Some(lock) => Recovery::Held(lock),
            None => self.recover(job, presses, &mut resume.homed).await,
        };
        resume.attempts += 1;
        let is_silent = match &recovery {
            Recovery::Silent => true,
            // Who holds the lock may have cut the power.
            Recovery::Held(_) => !self.devices_reply().await,
            Recovery::ForPerson(_) | Recovery::Failed(_) | Recovery::Done => false,
        };
        resume.silent_since = resume.silent_since.or(Some(now)).filter(|_| is_silent);
        let words = match recovery {
            Recovery::Done => return Some(Waited::Resume),
            Recovery::ForPerson(words) => {
                self.end_automatic(automatic, Some(words));
                return None;
            }
            Recovery::Failed(why) => {
                *resume.resumes += 1;
                let words = why.or_else(|| resume.waits_for.clone());
                if *resume.resumes > job.plan.policy.max_auto_resumes || !self.trip_may_pass() {
                    self.end_automatic(automatic, words);
                    return None;
                }
                words
            }
            Recovery::Silent => resume.waits_for.clone(),
            Recovery::Held(words) => Some(words),
        };
        resume.at = Instant::now() + backoff(job, *resume.resumes + resume.attempts);
        self.control.show_run(|run| run.waiting_for = words);
        None
    }

    /// Ends the automatic resume: the run waits for a request. `words`: what it waits for.
    pub(super) fn end_automatic(
        &self,
        automatic: &mut Option<Automatic<'_>>,
        words: Option<String>,
    ) {
        if automatic.take().is_some() {
            self.control.say("recovering", json!({ "ended": true, "why": words }));
            self.control.show_run(|run| run.waiting_for = words);
        }
    }

    /// Whether the axes and the cells reply.
    async fn devices_reply(&self) -> bool {
        match self.connection.as_ref().map(|connection| &connection.stage) {
            Some(Some(stage)) => {
                stage.pose().await.is_ok() && stage.bench.cells.read().await.is_ok()
            }
            Some(None) => true,
            None => false,
        }
    }

    /// Which drives are homed; one that does not reply counts as homed, so that it must be once it replies.
    async fn homed_drives(&self) -> [bool; AXES] {
        let mut homed = [true; AXES];
        let Some(stage) = self.stage() else { return homed };
        let read = join_all(stage.bench.axes().map(|axis| axis.status())).await;
        for (homed, status) in homed.iter_mut().zip(read) {
            *homed = !status.is_ok_and(|status| !status.homed);
        }
        homed
    }

    /// Checks every device, resets, homes, arms and resumes. In a manual run nothing moves: a person's hands may be on
    /// the skin.
    async fn recover(&mut self, job: &Job, presses: u64, homed: &mut [bool; AXES]) -> Recovery {
        self.control.say("recovering", json!({}));
        // An axis that has not acknowledged its stop, or moves after it, is not homed.
        let is_owed = job.plan.kind == Kind::RealHex && self.owed != Owed::Nothing;
        if is_owed || !self.devices_reply().await {
            return Recovery::Silent;
        }
        let Some(connection) = self.connection.as_ref() else { return Recovery::Silent };
        if let Some(stage) = connection.stage.as_ref().filter(|_| job.plan.kind == Kind::RealHex) {
            match switched_off(&stage.bench, homed).await {
                Ok(None) => {}
                Ok(Some(words)) => return Recovery::ForPerson(words),
                Err(_) => return Recovery::Silent,
            }
        }
        if connection.skin.take(Instant::now(), 1).await.is_err() {
            return Recovery::Silent;
        }
        if self.control.rig() == RigState::Tripped
            && let Err(refused) = self.reset(presses, None).await
        {
            return Recovery::Failed(Some(refused.to_string()));
        }
        if job.plan.kind == Kind::RealRandom {
            let resumed = self.control.run_event(RunEvent::Resume).is_ok();
            return if resumed { Recovery::Done } else { Recovery::Failed(None) };
        }
        // The devices and the reset took a while: nothing homes under a lock that was taken meanwhile.
        if let Some(lock) = self.control.taken_lock(self.halted_at).await {
            return Recovery::Held(lock);
        }
        // A request since the checks began holds: nothing homes after it.
        self.control.take_operated();
        if let Some(held) = self.heed().await {
            return held;
        }
        let is_homed = self.home_unattended().await;
        *homed = self.homed_drives().await;
        if self.control.take_operated() {
            return Recovery::ForPerson(BY_HAND.into());
        }
        if !homed.contains(&true) {
            let words = "no drive is homed after a homing that failed, so that a loss of power would not show: check \
                         the rig, reset, home, resume";
            return Recovery::ForPerson(words.into());
        }
        if !is_homed {
            let is_tripped = self.control.rig() == RigState::Tripped;
            return match self.control.taken_lock(self.halted_at).await {
                // It has ended the homing.
                Some(lock) if !is_tripped => Recovery::Held(lock),
                Some(_) | None => Recovery::Failed(None),
            };
        }
        // A pause that was requested while it homed holds.
        let halted = RunState::Paused(PausedWhy::Trip);
        if self.control.run() != halted {
            return Recovery::Failed(None);
        }
        match self.arm_stage(job, None).await {
            Ok(()) => {}
            Err(Refusal::Busy(words)) => return Recovery::Held(words),
            Err(refused) => return Recovery::Failed(Some(refused.to_string())),
        }
        // Arming takes a while: a request since holds, too.
        if let Some(held) = self.heed().await {
            if matches!(held, Recovery::ForPerson(_)) {
                // An armed rig would refuse what this person requests next.
                let _ = self.control.rig_event(RigEvent::Disarm);
            }
            return held;
        }
        let resumed =
            self.control.run() == halted && self.control.run_event(RunEvent::Resume).is_ok();
        if resumed { Recovery::Done } else { Recovery::Failed(None) }
    }

    /// Accepts pending requests between two parts of an attempt. Returns its result if one of them ends it.
    async fn heed(&mut self) -> Option<Recovery> {
        if let Err(halt) = self.control.attend() {
            self.make_safe(halt.as_trip(), Height::Clear).await;
            return Some(Recovery::Failed(None));
        }
        self.control.take_operated().then(|| Recovery::ForPerson(BY_HAND.into()))
    }

    /// Homes until a person operates the rig, or takes the operator lock after the halt.
    async fn home_unattended(&mut self) -> bool {
        let journal = self.control.journal.clone();
        self.control.unattended = Some(Unattended::watch(journal, self.halted_at));
        let is_homed = self.home().await;
        self.control.unattended = None;
        is_homed
    }

    /// Whether the present trip may pass without a person.
    fn trip_may_pass(&self) -> bool {
        self.control.inbox.status.borrow().rig.trip.as_ref().is_none_or(|t| t.kind.may_pass())
    }
}

/// First axis whose drive was switched off, or stopped or taken over by a person, as text.
///
/// # Errors
/// A drive does not reply.
async fn switched_off(bench: &Bench, was_homed: &[bool; AXES]) -> Result<Option<String>, RigError> {
    for (axis, was_homed) in bench.axes().into_iter().zip(was_homed) {
        let found = axis.identify().await?;
        let why = match found.alarm {
            Some(alarm) => format!("has alarm {alarm:#x}"),
            None if found.emergency_stop => "is stopped by its own stop".into(),
            None if *was_homed && !found.homed => "is not homed any more".into(),
            None if found.in_command == Some(false) => "is no longer under remote control".into(),
            None if !found.enabled => "has its motor off".into(),
            None => continue,
        };
        let name = axis.name();
        let words =
            format!("{name} {why}, as after a loss of power: check the rig, reset, home, resume");
        return Ok(Some(words));
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::super::tests::{engine, job, suspensions, trip, waiting_for, with_handle};
    use super::*;
    use crate::campaign::shown::command::Request;

    /// An automatic resume whose next attempt is due; no test reads its count of resumes, which is leaked.
    fn due(job: &Job, waits_for: Option<String>) -> Option<Automatic<'static>> {
        let resume = Automatic::new(job, Box::leak(Box::new(1)), waits_for);
        Some(Automatic { at: Instant::now(), ..resume })
    }

    /// One attempt of an automatic resume while a device has been silent for this time, and a person holds the operator
    /// lock or not: whether further ones follow, and what the run waits for.
    async fn attempt(silent_since: Option<Duration>, is_locked: bool) -> (bool, Option<String>) {
        let (job, (axes, mut engine)) = (job(), engine());
        trip(&mut engine, &job);
        axes.x.replies.store(false, Ordering::SeqCst);
        if is_locked {
            axes.journal.lock(1);
        }
        let mut automatic = due(&job, Some("no reply".into()));
        automatic.as_mut().unwrap().silent_since = silent_since.map(|time| Instant::now() - time);
        assert!(engine.resume_automatically(&job, &mut automatic, 0).await.is_none());
        assert_eq!(engine.control.rig(), RigState::Tripped);
        assert_eq!(axes.z.starts.load(Ordering::SeqCst), 0);
        let known = automatic.as_ref().is_none_or(|resume| resume.silent_since.is_some());
        assert!(known, "the time of the silence is kept");
        (automatic.is_some(), waiting_for(&engine))
    }

    #[tokio::test]
    async fn a_run_resumes_by_itself_only_within_ten_minutes_of_silence() {
        for short in [None, Some(SILENCE_MAX - Duration::from_secs(10))] {
            assert_eq!(attempt(short, false).await, (true, Some("no reply".into())), "{short:?}");
            let (continues, words) = attempt(short, true).await;
            assert!(continues && words.is_some_and(|words| words.contains("operator lock (ada")));
        }
        for is_locked in [false, true] {
            let long = Some(SILENCE_MAX + Duration::from_secs(1));
            let (continues, words) = attempt(long, is_locked).await;
            assert!(!continues);
            assert!(words.is_some_and(|words| words.contains("silent for more than 10 min")));
        }
    }

    #[tokio::test]
    async fn a_loss_of_power_between_two_automatic_resumes_waits_for_a_person() {
        let (job, (axes, mut engine)) = (job(), engine());
        trip(&mut engine, &job);
        let mut automatic = due(&job, None);
        // The first one loses a wire while it homes.
        axes.x.starts_fail.store(true, Ordering::SeqCst);
        assert!(engine.resume_automatically(&job, &mut automatic, 0).await.is_none());
        let starts = axes.z.starts.load(Ordering::SeqCst);
        assert!(starts > 0 && automatic.is_some() && engine.control.rig() == RigState::Tripped);
        // A person switches the drives off and on.
        axes.x.starts_fail.store(false, Ordering::SeqCst);
        axes.z.status.lock().homed = false;
        automatic.as_mut().unwrap().at = Instant::now();
        assert!(engine.resume_automatically(&job, &mut automatic, 0).await.is_none());
        assert!(automatic.is_none() && axes.z.starts.load(Ordering::SeqCst) == starts);
        let words = waiting_for(&engine);
        assert!(words.is_some_and(|words| words.contains("z is not homed any more")));
    }

    #[tokio::test]
    async fn no_axis_is_homed_automatically_while_a_safe_end_is_not_complete() {
        let (job, (axes, mut engine)) = (job(), engine());
        trip(&mut engine, &job);
        let mut automatic = due(&job, None);
        for owed in [Owed::Wires(Instant::now(), Height::Clear), Owed::Nothing] {
            engine.owed = owed;
            automatic.as_mut().unwrap().at = Instant::now();
            let resumed = engine.resume_automatically(&job, &mut automatic, 0).await;
            let is_homed = axes.x.starts.load(Ordering::SeqCst) > 0;
            assert_eq!([resumed.is_some(), is_homed], [owed == Owed::Nothing; 2]);
        }
    }

    #[tokio::test]
    async fn a_run_does_not_resume_by_itself_if_a_person_operates_the_rig_once_it_is_homed() {
        let (job, (_, mut engine, handle)) = (job(), with_handle());
        trip(&mut engine, &job);
        let mut automatic = due(&job, None);
        let mut status = handle.watch_status();
        // While the pace of the wires is measured.
        let operates = async {
            drop(status.wait_for(|status| status.rig.state == RigState::Homed).await.unwrap());
            handle.ask(Request::Tare).await
        };
        let resumed = engine.resume_automatically(&job, &mut automatic, 0);
        let (resumed, operated) = tokio::join!(resumed, operates);
        assert!(resumed.is_none() && automatic.is_none() && operated.is_err());
        let states = (engine.control.rig(), engine.control.run());
        assert_eq!(states, (RigState::Homed, RunState::Paused(PausedWhy::Trip)));
        assert_eq!(waiting_for(&engine).as_deref(), Some(BY_HAND));
    }

    #[tokio::test]
    async fn a_run_does_not_resume_by_itself_if_a_person_takes_the_lock_once_the_rig_is_homed() {
        let (job, (axes, mut engine, handle)) = (job(), with_handle());
        trip(&mut engine, &job);
        let mut automatic = due(&job, None);
        let mut status = handle.watch_status();
        // While the pace of the wires is measured.
        let locks = async {
            drop(status.wait_for(|status| status.rig.state == RigState::Homed).await.unwrap());
            axes.journal.lock(0);
        };
        let resumed = engine.resume_automatically(&job, &mut automatic, 0);
        let (resumed, ()) = tokio::join!(resumed, locks);
        assert!(resumed.is_none() && automatic.is_some(), "it waits for the release");
        let states = (engine.control.rig(), engine.control.run());
        assert_eq!(states, (RigState::Homed, RunState::Paused(PausedWhy::Trip)));
        *axes.journal.locked_at.lock() = None;
        automatic.as_mut().unwrap().at = Instant::now();
        assert!(engine.resume_automatically(&job, &mut automatic, 0).await.is_some());
    }

    #[tokio::test]
    async fn nothing_homes_by_itself_under_a_lock_that_was_taken_while_the_devices_were_read() {
        let (job, (axes, mut engine)) = (job(), engine());
        trip(&mut engine, &job);
        let mut automatic = due(&job, None);
        *axes.cells.takes.lock() = Duration::from_millis(50);
        let locks = async { axes.journal.lock(0) };
        // In this order: the lock is taken once the cells are awaited.
        let resumed = engine.resume_automatically(&job, &mut automatic, 0);
        let (resumed, ()) = futures::join!(resumed, locks);
        assert!(resumed.is_none() && automatic.is_some(), "it waits for the release");
        assert_eq!(axes.z.starts.load(Ordering::SeqCst), 0);
        assert!(waiting_for(&engine).is_some_and(|words| words.contains("operator lock (ada")));
    }

    #[tokio::test]
    async fn a_run_does_not_resume_by_itself_after_the_computer_was_suspended() {
        let (job, (axes, mut engine)) = (job(), engine());
        let suspended_s = suspensions(&mut engine);
        trip(&mut engine, &job);
        let mut automatic = due(&job, Some("no reply".into()));
        suspended_s.store(3600, Ordering::SeqCst);
        assert!(engine.resume_automatically(&job, &mut automatic, 0).await.is_none());
        assert!(automatic.is_none() && engine.control.rig() == RigState::Tripped);
        assert_eq!(axes.z.starts.load(Ordering::SeqCst), 0);
        assert!(waiting_for(&engine).is_some_and(|words| words.contains("suspended for 3600 s")));
    }

    #[tokio::test]
    async fn a_lock_counts_although_the_clock_was_set_back_after_the_halt() {
        let (axes, engine) = engine();
        let halted = Instant::now() - Duration::from_secs(60);
        let ahead = jiff::Timestamp::now() + Duration::from_secs(3600);
        let since = (ahead, halted);
        assert_eq!(engine.control.taken_lock(since).await, None);
        axes.journal.lock(0);
        let taken = engine.control.taken_lock(since).await;
        assert!(taken.is_some(), "taken a minute after the halt");
        axes.journal.lock(-120);
        let taken = engine.control.taken_lock(since).await;
        assert_eq!(taken, None, "taken a minute before the halt");
    }
}
