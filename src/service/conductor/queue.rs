//! Submissions become queued runs; a queued run is edited.
//! Uses: `conductor::{prepare, turn}`, `store`. Never: a start.

use jiff::Timestamp;
use serde_json::json;

use super::prepare::{Prepared, run_kind};
use super::{Conductor, ConductorError, Submission, turn};
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
    ) -> Result<RunRow, ConductorError> {
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
    ) -> Result<RunRow, ConductorError> {
        self.require_queued(run)?;
        let new = self.new_run(run.uid, submission, run.submitted_by.clone(), terms).await?;
        let _one_at_a_time = self.inner.beginning.lock().await;
        let earlier = self.present(run).await?;
        self.require_queued(&earlier)?;
        let row = self.inner.store.replace_queued(new).await?;
        self.armings().remove(&run.uid);
        self.waiting().remove(&run.uid);
        self.dropped().remove(&run.uid);
        if earlier.waiting_since.is_some() {
            let why = "it was edited after it was started: arm and start it again";
            self.say(&row, "not_begun", json!({ "why": why })).await;
        }
        Ok(row)
    }

    fn require_queued(&self, run: &RunRow) -> Result<(), ConductorError> {
        let active = self.inner.campaign.status().run.is_some_and(|r| r.uid == run.uid);
        let state = if active { StoredState::Running } else { run.state };
        if state == StoredState::Queued {
            return Ok(());
        }
        let words = format!("run {} is {state}: only a queued run can be edited", run.scan_id);
        Err(ConductorError::Forbidden(words))
    }

    async fn new_run(
        &self,
        uid: RunUid,
        submission: Submission,
        who: String,
        terms: Terms,
    ) -> Result<NewRun, ConductorError> {
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
