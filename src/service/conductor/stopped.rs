//! A stop by a person outside a run, and what it leaves to the next process, which does not know of it: that drives no run
//! by itself.
//! Uses: `conductor::take_over`, `campaign` (its handle), `store`. Never: motion, HTTP, a delay of the stop.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;

use super::take_over::NOT_DRIVEN;
use super::{Conductor, ConductorError, ConductorResult};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::command::{Refusal, Request};
use crate::ids::RunUid;
use crate::journal::error_chain;

/// Why a run that waited does not begin after a press of the e-stop that tripped nothing.
const PRESSED: &str = "the e-stop was pressed while no wires were open";
/// Why a run that waited does not begin after a halt that was requested as the service ended.
const UNANSWERED: &str =
    "a pause, a stop or an abort was requested as the service ended: start it again";
/// Time before the end of the service within which a halt that had no answer was requested as it ended, wall.
const UNANSWERED_WITHIN: Duration = Duration::from_secs(600);

/// What the next process must know of a person, apart from what is stored at once.
#[derive(Default)]
pub(super) struct Noted {
    /// Why no run that the earlier process left begins: the last sign of a person, or trip, that was followed.
    sign: Mutex<Option<String>>,
    /// When a halt was requested last that the campaign did not answer.
    unanswered: Mutex<Option<Instant>>,
    /// Halts that the campaign has not answered yet.
    awaited: AtomicU64,
}

/// A halt that the campaign has not answered yet. If it is dropped without an answer, it had none.
struct Awaited<'a> {
    noted: &'a Noted,
    is_answered: bool,
}

impl<'a> Awaited<'a> {
    fn begin(noted: &'a Noted) -> Self {
        noted.awaited.fetch_add(1, Ordering::SeqCst);
        Self { noted, is_answered: false }
    }
}

impl Drop for Awaited<'_> {
    fn drop(&mut self) {
        if !self.is_answered {
            *self.noted.unanswered.lock() = Some(Instant::now());
        }
        self.noted.awaited.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Conductor {
    /// Requests a pause, a stop or an abort of the campaign. If it does not answer, since the service ends, or its caller
    /// does not wait for the answer, the next process drives no run by itself.
    ///
    /// # Errors
    /// The refusal of the campaign.
    pub async fn halt(&self, request: Request) -> Result<(), Refusal> {
        let mut awaited = Awaited::begin(&self.inner.noted);
        let asked = self.inner.campaign.ask(request).await;
        awaited.is_answered = asked != Err(Refusal::Gone);
        asked
    }

    /// Notes why no run begins that waits and that the earlier process left, also one that is not taken over yet. Returns
    /// whether this is not the last such reason.
    pub(super) fn note_sign(&self, why: String) -> bool {
        let before = self.inner.noted.sign.lock().replace(why.clone());
        before != Some(why)
    }

    /// Why a run that is stored as one that waits begins neither in this process nor in the next one by itself, as text.
    pub(super) fn why_not_next(&self, run: RunUid) -> Option<String> {
        let is_of_this_process = self.inner.handed_over.lock().contains_key(&run)
            || self.inner.begun.lock().contains(&run);
        let left = || self.inner.noted.sign.lock().clone().filter(|_| !is_of_this_process);
        self.why_dropped(run).or_else(left)
    }

    /// Called after each press of the e-stop, once it is latched: a person is at the rig. No run of an earlier process
    /// is driven again by itself. This is stored at once: while no wires are open nothing trips, and this process may
    /// end before its next attempt to drive the run.
    ///
    /// # Errors
    /// `Store` if the store fails: then only this process drives nothing.
    pub async fn note_stop(&self) -> ConductorResult<()> {
        // Before the wait, and in memory: an attempt in progress does not begin it, whatever the store does.
        self.note_operation();
        // With open wires the press trips the rig, which drops the runs that wait.
        let is_closed = || self.inner.campaign.status().rig.state == RigState::Disconnected;
        let was_closed = is_closed();
        if was_closed {
            self.drop_all_waiting(PRESSED);
        }
        let _one_at_a_time = self.inner.beginning.lock().await;
        self.inner.store.interrupt_open_runs(self.active()).await?;
        if was_closed || is_closed() {
            let waiting = self.inner.store.waiting_runs().await?;
            self.drop_each(&waiting, &format!("{PRESSED}: start it again")).await?;
        }
        Ok(())
    }

    /// Ends a homing or a jog: the axes stop, then the tips rise. A person is at the rig: no run of an earlier process is
    /// driven again by itself, also not the one for which the rig homes. This is stored, also if nothing moved any more.
    /// A run that has begun meanwhile is aborted by the campaign.
    ///
    /// # Errors
    /// `Forbidden` if a run is active; `Refused` if nothing moves; `Store` if the store fails: then only this process
    /// drives nothing.
    pub async fn abort_motion(&self) -> ConductorResult<()> {
        if let Some(run) = self.inner.campaign.status().run {
            let words = format!("run {} is active: pause, stop or abort it", run.scan_id);
            return Err(ConductorError::Forbidden(words));
        }
        // In memory first: an attempt in progress does not begin a run, whatever the store does.
        self.note_operation();
        let aborted = self.halt(Request::AbortMotion).await;
        *self.inner.brought_up.lock() = None;
        self.store_operation().await?;
        aborted.map_err(ConductorError::Refused)
    }

    /// Called after each action on the rig, also a refused one: stores what [`Conductor::note_operation`] has noted, since
    /// this process may end before its next attempt to drive a run. Nor does a run begin by itself that waits behind one of
    /// the earlier process. If the store fails, only this process drives nothing.
    pub async fn keep_operation(&self) {
        if let Err(error) = self.store_operation().await {
            tracing::error!(error = error_chain(&error), "a run may begin or resume automatically");
        }
    }

    /// Stores that no run of the earlier process is driven again, and none begins that waits behind it: this process would
    /// drop those, too, but only once it has given the run up.
    async fn store_operation(&self) -> ConductorResult<()> {
        let (active, begun) = (self.active(), self.inner.begun.lock().clone());
        let open = self.inner.store.open_runs().await.unwrap_or_default();
        let is_left = |run: &RunUid| Some(*run) != active && !begun.contains(run);
        let dropped = match open.iter().any(|run| is_left(&run.uid)) {
            true => {
                self.note_sign(NOT_DRIVEN.into());
                self.store_dropped().await
            }
            false => Ok(()),
        };
        let _one_at_a_time = self.inner.beginning.lock().await;
        self.inner.store.interrupt_open_runs(self.active()).await?;
        dropped
    }

    /// Refuses to let a run wait while the e-stop is latched, also with closed wires, where nothing is tripped: it
    /// would wait in the next process, too.
    pub(super) fn require_released(&self) -> ConductorResult<()> {
        let pressed = self.inner.campaign.stop_switch().pressed();
        pressed.map_or(Ok(()), |press| {
            let why = press.why;
            Err(ConductorError::Forbidden(format!(
                "the e-stop is latched ({why}): open the wires and reset it, then start the run"
            )))
        })
    }

    /// Called at the end of the service, after that of the campaign: what the next process would not know. While an
    /// e-stop is latched, or after a halt that was requested as the service ended, it must drive no run by itself. No
    /// waiting run begins after a sign of a person that was not followed any more, such as an abort, and none that was
    /// dropped in memory only.
    pub async fn keep_stopped(&self) {
        let attended = self.inner.campaign.status().attended;
        let is_stopped = self.inner.campaign.stop_switch().pressed().is_some();
        let is_followed = self.inner.signs.load(Ordering::SeqCst) == attended.signs;
        // First: a halt that loses its answer meanwhile is one of the two.
        let is_awaited = self.inner.noted.awaited.load(Ordering::SeqCst) > 0;
        let unanswered = *self.inner.noted.unanswered.lock();
        let is_unanswered =
            is_awaited || unanswered.is_some_and(|at| at.elapsed() <= UNANSWERED_WITHIN);
        let of_all = match is_stopped {
            true => {
                Some("the e-stop was latched when the service ended: start it again".to_owned())
            }
            false if is_unanswered => Some(UNANSWERED.to_owned()),
            false => (!is_followed).then(|| format!("{}: start it again", attended.why)),
        };
        let kept = async {
            if is_stopped || is_unanswered {
                self.inner.store.interrupt_open_runs(None).await?;
            }
            for run in self.inner.store.waiting_runs().await? {
                if let Some(why) = of_all.clone().or_else(|| self.why_not_next(run.uid)) {
                    self.drop_waiting(&run, &why).await?;
                }
            }
            Ok::<(), ConductorError>(())
        };
        if let Err(error) = kept.await {
            tracing::error!(error = error_chain(&error), "a run may begin or resume automatically");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::stand_in::{
        conductor, driven, earlier, granted, in_an_hour, queued_on, start, unasked,
    };
    use super::super::{AutoResume, Terms};
    use super::*;
    use crate::campaign::shown::show;
    use crate::state::StoredState;
    use crate::store::RunRow;
    use crate::suspension::Suspensions;

    /// Why a run is dropped.
    const ABORTED: &str = "the run before it was aborted";

    #[tokio::test]
    async fn after_an_e_stop_with_closed_wires_neither_this_process_nor_the_next_drives_a_run() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: Some(true), not_before: None };
        let [run, next] = [queued_on(&conductor, terms).await, queued_on(&conductor, terms).await];
        driven(&conductor, &run).await;
        let store = &conductor.inner.store;
        store.set_waiting(next.uid).await.unwrap();
        conductor.note_stop().await.unwrap();
        // The next process reads only what is stored.
        let stored = conductor.present(&run).await.unwrap();
        assert_eq!(stored.state, StoredState::Interrupted);
        assert!(store.waiting_runs().await.unwrap().is_empty());
        assert_eq!(conductor.why_dropped(next.uid), Some(format!("{PRESSED}: start it again")));
        let taken = conductor.resume_after_restart(AutoResume::Allowed);
        unasked(&mut inbox, taken).await.unwrap();
    }

    #[tokio::test]
    async fn a_pause_that_comes_as_the_service_ends_holds_in_the_next_process() {
        let (conductor, inbox, _folder) = conductor().await;
        let [run, _next] = earlier(&conductor).await;
        let left = async || {
            conductor.keep_stopped().await;
            let waiting = conductor.inner.store.waiting_runs().await.unwrap().len();
            (conductor.present(&run).await.unwrap().state, waiting)
        };
        assert_eq!(left().await, (StoredState::Running, 1), "without a request");
        // The campaign's thread has ended.
        drop(inbox);
        assert_eq!(conductor.halt(Request::PauseNow).await, Err(Refusal::Gone));
        assert_eq!(left().await, (StoredState::Interrupted, 0));
    }

    #[tokio::test]
    async fn a_pause_without_an_answer_yet_or_whose_caller_has_gone_holds_in_the_next_process() {
        for is_gone in [false, true] {
            let (conductor, _inbox, _folder) = conductor().await;
            let [run, _next] = earlier(&conductor).await;
            let mut pause = Some(Box::pin(conductor.halt(Request::PauseNow)));
            let asked = pause.as_mut().expect("it is requested");
            let answer = tokio::time::timeout(Duration::from_millis(20), asked).await;
            assert!(answer.is_err(), "the campaign is busy");
            drop(pause.take_if(|_| is_gone));
            conductor.keep_stopped().await;
            let state = conductor.present(&run).await.unwrap().state;
            assert_eq!(state, StoredState::Interrupted, "{is_gone}");
        }
    }

    #[tokio::test]
    async fn after_an_abort_of_a_motion_neither_this_process_nor_the_next_drives_a_run() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: Some(true), not_before: None };
        let run = queued_on(&conductor, terms).await;
        driven(&conductor, &run).await;
        // The rig homes for it.
        *conductor.inner.brought_up.lock() = Some(run.uid);
        let next = queued_on(&conductor, terms).await;
        conductor.inner.store.set_waiting(next.uid).await.unwrap();
        let ended = granted(&mut inbox, |request| matches!(request, Request::AbortMotion));
        let (aborted, ()) = tokio::join!(conductor.abort_motion(), ended);
        aborted.unwrap();
        assert!(conductor.inner.store.waiting_runs().await.unwrap().is_empty());
        assert!(conductor.is_operated_since_start(run.uid));
        assert_eq!(*conductor.inner.brought_up.lock(), None);
        let stored = conductor.present(&run).await.unwrap();
        assert_eq!(stored.state, StoredState::Interrupted);
    }

    #[tokio::test]
    async fn after_an_action_on_the_rig_the_next_process_drives_no_run_but_the_active_one() {
        let (conductor, inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: Some(true), not_before: None };
        let [active, left] =
            [queued_on(&conductor, terms).await, queued_on(&conductor, terms).await];
        for run in [&active, &left] {
            driven(&conductor, run).await;
        }
        let job = conductor.prepare_stored(&active).await.unwrap().job(&active);
        inbox.status.send_modify(|status| status.run = Some(show::started(&job)));
        conductor.keep_operation().await;
        let state = async |run: &RunRow| conductor.present(run).await.unwrap().state;
        assert_eq!(state(&active).await, StoredState::Running);
        assert_eq!(state(&left).await, StoredState::Interrupted);
        conductor.inner.store.close().await;
        // It is only logged.
        conductor.keep_operation().await;
    }

    #[tokio::test]
    async fn after_an_action_on_the_rig_the_next_process_begins_no_run_behind_an_earlier_one() {
        let (conductor, _inbox, _folder) = conductor().await;
        let [run, next] = earlier(&conductor).await;
        let terms = Terms { auto_resume: Some(true), not_before: in_an_hour() };
        let started = queued_on(&conductor, terms).await;
        start(&conductor, &started).await;
        conductor.keep_operation().await;
        assert_eq!(conductor.present(&run).await.unwrap().state, StoredState::Interrupted);
        assert_eq!(conductor.why_dropped(next.uid).as_deref(), Some(NOT_DRIVEN));
        let waiting = conductor.inner.store.waiting_runs().await.unwrap();
        let waiting: Vec<RunUid> = waiting.iter().map(|run| run.uid).collect();
        assert_eq!(waiting, [started.uid], "a person has started it in this process");
    }

    #[tokio::test]
    async fn an_abort_of_a_motion_aborts_no_run() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let job = conductor.prepare_stored(&run).await.unwrap().job(&run);
        inbox.status.send_modify(|status| status.run = Some(show::started(&job)));
        let aborted = unasked(&mut inbox, conductor.abort_motion()).await;
        let words = aborted.unwrap_err().to_string();
        assert_eq!(words, "run 1 is active: pause, stop or abort it");
    }

    #[tokio::test]
    async fn after_an_e_stop_with_closed_wires_no_run_begins_although_the_store_fails() {
        let (conductor, _inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: None, not_before: in_an_hour() };
        let run = queued_on(&conductor, terms).await;
        start(&conductor, &run).await;
        conductor.inner.store.close().await;
        conductor.note_stop().await.unwrap_err();
        assert!(conductor.waiting().is_empty());
        assert_eq!(conductor.why_dropped(run.uid), Some(format!("{PRESSED}: start it again")));
    }

    #[tokio::test]
    async fn no_run_is_let_wait_while_the_e_stop_is_latched_with_closed_wires() {
        let (conductor, _inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: Some(true), not_before: in_an_hour() };
        let run = queued_on(&conductor, terms).await;
        let code = conductor.arm(&run).await.unwrap().code;
        conductor.inner.campaign.estop("hands");
        let refused = conductor.start(&run, &code, "ada".into()).await.unwrap_err().to_string();
        assert!(refused.starts_with("the e-stop is latched (hands)"), "{refused}");
        assert!(conductor.inner.store.waiting_runs().await.unwrap().is_empty());
        assert!(conductor.inner.campaign.stop_switch().release(1));
        start(&conductor, &run).await;
    }

    #[tokio::test]
    async fn an_abort_shortly_before_the_end_of_the_service_is_kept_for_the_next_one() {
        let (conductor, inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: None, not_before: in_an_hour() };
        let run = queued_on(&conductor, terms).await;
        start(&conductor, &run).await;
        let waits = async || conductor.inner.store.waiting_runs().await.unwrap().len();
        conductor.keep_stopped().await;
        assert_eq!(waits().await, 1, "without a sign");
        inbox.status.send_modify(|status| status.attended.note(ABORTED));
        conductor.keep_stopped().await;
        assert_eq!(waits().await, 0);
        start(&conductor, &run).await;
        // The sign is followed, and the store did not take what follows from it.
        conductor.inner.signs.store(1, Ordering::SeqCst);
        conductor.keep_stopped().await;
        assert_eq!(waits().await, 1);
        conductor.dropped().insert(run.uid, ABORTED.into());
        conductor.keep_stopped().await;
        assert_eq!(waits().await, 0);
        start(&conductor, &run).await;
        conductor.inner.campaign.estop("hands");
        conductor.keep_stopped().await;
        assert_eq!(waits().await, 0);
    }

    #[tokio::test]
    async fn an_operation_of_the_rig_and_a_suspension_count_until_the_run_is_started_again() {
        let (conductor, _inbox, _folder) = conductor().await;
        let terms = Terms { auto_resume: None, not_before: in_an_hour() };
        let run = queued_on(&conductor, terms).await;
        let suspended_s = Arc::<AtomicU64>::default();
        let read = suspended_s.clone();
        *conductor.inner.suspensions.lock() =
            Suspensions::of(move || Duration::from_secs(read.load(Ordering::SeqCst)));
        let is_operated = || conductor.is_operated_since_start(run.uid);
        assert!(!is_operated());
        conductor.note_operation();
        assert!(is_operated() && is_operated(), "it lasts");
        start(&conductor, &run).await;
        assert!(!is_operated());
        suspended_s.store(3600, Ordering::SeqCst);
        assert!(is_operated());
        start(&conductor, &run).await;
        assert!(!is_operated());
    }
}
