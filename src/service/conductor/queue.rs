//! Submissions become queued runs; a queued run is edited, moved or removed.
//! Uses: `conductor::{prepare, turn}`, `store`. Never: a start.

use jiff::Timestamp;
use serde_json::json;

use super::prepare::{Prepared, run_kind};
use super::{Conductor, ConductorError, ConductorResult, Submission, turn};
use crate::ids::{CalibrationId, RunUid};
use crate::state::StoredState;
use crate::store::{NewRun, RunRow};

/// What a person requests of a run in addition to its files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Terms {
    /// Whether the run may resume automatically; absent: as in the policy of the experiment.
    pub auto_resume: Option<bool>,
    /// Earliest start; absent: any time.
    pub not_before: Option<Timestamp>,
}

impl Conductor {
    /// Queues a run.
    ///
    /// # Errors
    /// `ConductorError::Problems` if the files, the preflight or the start time have problems;
    /// `Store` if the store fails.
    pub async fn enqueue(
        &self,
        submission: Submission,
        who: String,
        terms: Terms,
    ) -> ConductorResult<RunRow> {
        let new = self.new_run(RunUid::new(), submission, who, terms).await?;
        Ok(self.inner.store.enqueue(new).await?)
    }

    /// Replaces files and terms of a queued run, which keeps its number and its place. If it was armed
    /// or started, that no longer holds: a person armed the earlier run.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not queued; others as [`Self::enqueue`].
    pub async fn edit(
        &self,
        run: &RunRow,
        submission: Submission,
        terms: Terms,
    ) -> ConductorResult<RunRow> {
        self.require_queued(run, "edited")?;
        let new = self.new_run(run.uid, submission, run.submitted_by.clone(), terms).await?;
        let _one_at_a_time = self.inner.beginning.lock().await;
        let earlier = self.present(run).await?;
        self.require_queued(&earlier, "edited")?;
        let row = self.inner.store.replace_queued(new).await?;
        self.forget(run.uid);
        if earlier.waiting_since.is_some() {
            let why = "it was edited after it was started: arm and start it again";
            self.say(&row, "not_begun", json!({ "why": why })).await;
        }
        Ok(row)
    }

    /// Moves a queued run to a position, from 1, but not while it begins; a position after the end is the end. Returns
    /// the queue.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not queued; `Store` if the store fails.
    pub async fn shift(&self, run: &RunRow, position: u32) -> Result<Vec<RunRow>, ConductorError> {
        let _one_at_a_time = self.inner.beginning.lock().await;
        self.require_queued(&self.present(run).await?, "moved")?;
        Ok(self.inner.store.move_item(run.uid, position).await?)
    }

    /// Removes a run from the queue permanently, but not while it begins. Its row remains, in the state `removed`.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not queued; `Store` if the store fails.
    pub async fn remove(&self, run: &RunRow) -> ConductorResult<RunRow> {
        let _one_at_a_time = self.inner.beginning.lock().await;
        self.require_queued(&self.present(run).await?, "removed")?;
        let row = self.inner.store.remove(run.uid).await?;
        self.forget(run.uid);
        Ok(row)
    }

    fn require_queued(&self, run: &RunRow, becomes: &str) -> ConductorResult<()> {
        let active = self.inner.campaign.status().run.is_some_and(|r| r.uid == run.uid);
        let state = if active { StoredState::Running } else { run.state };
        if state == StoredState::Queued {
            return Ok(());
        }
        let words = format!("run {} is {state}: only a queued run can be {becomes}", run.scan_id);
        Err(ConductorError::Forbidden(words))
    }

    async fn new_run(
        &self,
        uid: RunUid,
        submission: Submission,
        who: String,
        terms: Terms,
    ) -> ConductorResult<NewRun> {
        turn::check(terms.not_before, Timestamp::now())
            .map_err(|problems| ConductorError::Problems { problems })?;
        let definition = submission.definition.clone();
        let prepared = self.prepare(submission).await?.sound()?;
        let kind = run_kind(&prepared.plan);
        let Prepared { experiment, preflight, sensor_name, .. } = prepared;
        Ok(NewRun {
            uid,
            experiment: experiment.name,
            kind,
            definition,
            seed: Some(experiment.seed),
            rig: Some(self.inner.rig.text.clone()),
            sensor: prepared.sensor_text,
            calibration_id: self.calibration_of(&sensor_name),
            label: prepared.label,
            version: env!("CARGO_PKG_VERSION").into(),
            git_commit: crate::commit::known().map(Into::into),
            deadband_n: experiment.measure.deadband_n,
            tip_diameter_mm: Some(prepared.tip_diameter_mm),
            plan: Some(prepared.plan_text),
            trials_planned: preflight.trials,
            auto_resume: terms.auto_resume.unwrap_or(experiment.policy.auto_resume),
            not_before: terms.not_before,
            submitted_by: who,
        })
    }

    fn calibration_of(&self, sensor_name: &str) -> Option<CalibrationId> {
        let calibration = self.inner.calibration.as_ref();
        calibration
            .filter(|c| c.sensor == sensor_name)
            .and_then(|c| c.id().ok())
            .map(CalibrationId::unchecked)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;
    use std::time::Duration;

    use super::super::stand_in::{
        conductor, driven, granted, in_an_hour, queued_on, start, unasked,
    };
    use super::super::{CODE_VALID, Started};
    use super::*;
    use crate::campaign::shown::command::{Envelope, Refusal, Request};
    use crate::campaign::shown::show;
    use crate::journal::{ExitStatus, Journal};

    fn early() -> Terms {
        Terms { auto_resume: None, not_before: in_an_hour() }
    }

    #[tokio::test]
    async fn a_code_expires_although_the_clock_was_set_back() {
        let (conductor, _inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, early()).await;
        let code = conductor.arm(&run).await.unwrap().code;
        let earlier = CODE_VALID + Duration::from_secs(1);
        conductor.armings().get_mut(&run.uid).unwrap().armed -= earlier;
        let refused = conductor.start(&run, &code, "ada".into()).await.unwrap_err().to_string();
        assert!(refused.contains("expired at"), "{refused}");
    }

    #[tokio::test]
    async fn a_start_that_is_refused_for_its_code_names_the_run_by_its_number() {
        let (conductor, _inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, early()).await;
        let refused = async |code: &str| {
            conductor.start(&run, code, "ada".into()).await.unwrap_err().to_string()
        };
        assert_eq!(refused("a").await, "run 1 has not been armed");
        conductor.arm(&run).await.unwrap();
        assert_eq!(refused("a").await, "code = a: not the code from arming run 1");
    }

    #[tokio::test]
    async fn a_run_that_has_begun_as_it_is_moved_is_named_by_its_number() {
        let (conductor, _inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let one_at_a_time = conductor.inner.beginning.lock().await;
        let begins = async {
            driven(&conductor, &run).await;
            drop(one_at_a_time);
        };
        let (moved, ()) = tokio::join!(conductor.shift(&run, 1), begins);
        let words = "run 1 is running: only a queued run can be moved";
        assert_eq!(moved.unwrap_err().to_string(), words);
    }

    #[tokio::test]
    async fn a_run_that_begins_is_not_removed_from_the_queue() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let code = conductor.arm(&run).await.unwrap().code;
        let removed = async {
            let Envelope { request, answer, .. } = inbox.next().await.expect("a request");
            let Request::Start(job) = request else { panic!("{request:?}") };
            let begins = async {
                tokio::time::sleep(Duration::from_millis(100)).await;
                inbox.status.send_modify(|status| status.run = Some(show::started(&job)));
                let _ = answer.send(Ok(()));
            };
            // The store does not know yet that it begins.
            tokio::join!(conductor.remove(&run), begins).0
        };
        let (started, removed) = tokio::join!(conductor.start(&run, &code, "ada".into()), removed);
        assert_eq!(started.unwrap(), Started::Running);
        assert!(matches!(removed, Err(ConductorError::Forbidden(_))), "{removed:?}");
        assert_eq!(conductor.present(&run).await.unwrap().state, StoredState::Queued);
        let other = queued_on(&conductor, early()).await;
        start(&conductor, &other).await;
        assert_eq!(conductor.remove(&other).await.unwrap().state, StoredState::Removed);
        assert!(conductor.waiting().is_empty());
    }

    #[tokio::test]
    async fn a_run_that_begins_as_it_is_aborted_is_aborted_then() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let code = conductor.arm(&run).await.unwrap().code;
        let campaign = async {
            let Envelope { request, answer, .. } = inbox.next().await.expect("a request");
            let Request::Start(job) = request else { panic!("{request:?}") };
            tokio::time::sleep(Duration::from_millis(100)).await;
            inbox.status.send_modify(|status| status.run = Some(show::started(&job)));
            let _ = answer.send(Ok(()));
            granted(&mut inbox, |request| matches!(request, Request::Abort)).await;
        };
        let start = conductor.start(&run, &code, "ada".into());
        let (started, aborted, ()) = tokio::join!(start, conductor.abort_undriven(&run), campaign);
        assert_eq!(started.unwrap(), Started::Running);
        assert!(aborted.unwrap());
    }

    #[tokio::test]
    async fn an_abort_does_not_misstate_a_run_whose_end_is_not_stored_yet() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let code = conductor.arm(&run).await.unwrap().code;
        let begins = granted(&mut inbox, |request| matches!(request, Request::Start(_)));
        let (started, ()) = tokio::join!(conductor.start(&run, &code, "ada".into()), begins);
        assert_eq!(started.unwrap(), Started::Running);
        let store = &conductor.inner.store;
        driven(&conductor, &run).await;
        // The campaign does not drive it any more: its end waits for the store.
        for _ in 0..2 {
            let noted = granted(&mut inbox, |request| matches!(request, Request::CameLate));
            let (aborted, ()) = tokio::join!(conductor.abort_undriven(&run), noted);
            assert!(matches!(aborted, Err(ConductorError::Forbidden(_))), "{aborted:?}");
            // As after a pause or an e-stop meanwhile.
            store.interrupt_open_runs(None).await.unwrap();
        }
        store.end_run(run.uid, ExitStatus::Success, "done", Timestamp::now()).await.unwrap();
        assert!(!conductor.abort_undriven(&run).await.unwrap(), "it has ended");
        let row = conductor.present(&run).await.unwrap();
        assert_eq!(row.exit_status, Some(ExitStatus::Success));
    }

    #[tokio::test]
    async fn a_run_that_is_aborted_as_it_is_started_does_not_wait() {
        let (conductor, _inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, early()).await;
        let store = &conductor.inner.store;
        driven(&conductor, &run).await;
        store.interrupt_open_runs(None).await.unwrap();
        let run = conductor.present(&run).await.unwrap();
        let code = conductor.arm(&run).await.unwrap().code;
        let one_at_a_time = conductor.inner.beginning.lock().await;
        let aborts = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            store.end_run(run.uid, ExitStatus::Abort, "", Timestamp::now()).await.unwrap();
            drop(one_at_a_time);
        };
        let (started, ()) = tokio::join!(conductor.start(&run, &code, "ada".into()), aborts);
        assert!(matches!(started, Err(ConductorError::Forbidden(_))), "{started:?}");
        assert!(store.waiting_runs().await.unwrap().is_empty());
    }

    #[tokio::test]
    async fn a_run_that_is_started_as_a_person_aborts_another_does_not_wait() {
        let (conductor, inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, early()).await;
        let code = conductor.arm(&run).await.unwrap().code;
        let one_at_a_time = conductor.inner.beginning.lock().await;
        let aborts = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            inbox.status.send_modify(|status| status.attended.note("a run was aborted"));
            // The queue has followed it.
            conductor.inner.signs.store(1, Ordering::SeqCst);
            drop(one_at_a_time);
        };
        let (started, ()) = tokio::join!(conductor.start(&run, &code, "ada".into()), aborts);
        assert_eq!(started.unwrap_err().to_string(), "a run was aborted: start it again");
        assert!(conductor.waiting().is_empty());
        assert!(conductor.inner.store.waiting_runs().await.unwrap().is_empty());
        start(&conductor, &run).await;
    }

    #[tokio::test]
    async fn a_start_states_no_sign_and_no_lock_of_a_person_that_its_decision_has_not_seen() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        // After the last look at the signs, and before the request.
        let status = inbox.status.clone();
        let decided = async {
            status.send_modify(|status| status.attended.note("a run was aborted"));
            // The time of a lock is stored in milliseconds.
            tokio::time::sleep(Duration::from_millis(2)).await;
            conductor.inner.store.set_lock("bob", "hands in the rig").await?;
            Ok(())
        };
        let refuses = async {
            let Envelope { answer, signs, decided_at, .. } = inbox.next().await.expect("a request");
            let _ = answer.send(Err(Refusal::Busy("a run was aborted".into())));
            (signs, decided_at)
        };
        let (begun, (signs, decided_at)) =
            tokio::join!(conductor.begin(&run, true, decided), refuses);
        assert!(matches!(begun, Err(ConductorError::Refused(_))), "{begun:?}");
        assert_eq!((signs, inbox.status.borrow().attended.signs), (0, 1));
        let lock = conductor.inner.store.lock().await.unwrap().expect("it is taken");
        assert!(decided_at.0 < lock.since);
    }

    #[tokio::test]
    async fn a_run_that_is_started_as_another_person_takes_the_lock_does_not_begin() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let store = &conductor.inner.store;
        for terms in [Terms::default(), early()] {
            let run = queued_on(&conductor, terms).await;
            let code = conductor.arm(&run).await.unwrap().code;
            let one_at_a_time = conductor.inner.beginning.lock().await;
            let locks = async {
                tokio::time::sleep(Duration::from_millis(100)).await;
                store.set_lock("bob", "hands in the rig").await.unwrap();
                drop(one_at_a_time);
            };
            let start = conductor.start(&run, &code, "ada".into());
            let both = async { tokio::join!(start, locks).0 };
            let started = unasked(&mut inbox, both).await;
            let words = started.unwrap_err().to_string();
            assert_eq!(words, "bob has taken the operator lock: hands in the rig");
            assert!(conductor.waiting().is_empty());
            assert!(store.waiting_runs().await.unwrap().is_empty());
            store.clear_lock().await.unwrap();
        }
        // The holder may start one.
        store.set_lock("ada", "mine").await.unwrap();
        start(&conductor, &queued_on(&conductor, early()).await).await;
    }

    #[tokio::test]
    async fn an_abort_of_a_run_that_waits_takes_its_start_back() {
        let (conductor, _inbox, _folder) = conductor().await;
        let [queued, stopped] =
            [queued_on(&conductor, early()).await, queued_on(&conductor, early()).await];
        let store = &conductor.inner.store;
        let stop = store.end_run(stopped.uid, ExitStatus::Stopped, "", Timestamp::now());
        stop.await.unwrap();
        for run in [queued, stopped] {
            let run = conductor.present(&run).await.unwrap();
            start(&conductor, &run).await;
            assert!(conductor.abort_undriven(&run).await.unwrap());
            assert_eq!(conductor.present(&run).await.unwrap(), run, "it is what it was");
            assert!(conductor.still_waiting().await.unwrap().is_empty());
            assert_eq!(conductor.why_dropped(run.uid), None);
            assert!(!conductor.abort_undriven(&run).await.unwrap(), "it waits no more");
        }
    }
}
