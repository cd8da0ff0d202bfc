//! From the texts of files to a run that can be queued, checked and driven.
//! PURE. Uses: `schedule`, `rig::{config, reach}`, `campaign::run::job`. Never: files, storage.

use serde::Deserialize;
use sim_core::sensor::Sensor;
use utoipa::ToSchema;

use super::{ConductorError, ConductorResult, RigFile};
use crate::campaign::run::job::{Beginning, Job};
use crate::carried;
use crate::problem::Problem;
use crate::rig::reach::{bench, reach};
use crate::schedule::experiment::Experiment;
use crate::schedule::kept;
use crate::schedule::lint::lint;
use crate::schedule::plan::{Kind, Plan};
use crate::schedule::preflight::Preflight;
use crate::store::{Label, RunKind, RunRow};

/// An experiment as submitted: texts, since the service may not have access to the sender's files.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
pub struct Submission {
    /// Name of the experiment file, for problems.
    pub file: String,
    /// Text of the experiment file.
    pub definition: String,
    /// Text of the sensor file that it names; absent: the program carries that file.
    #[serde(default)]
    pub sensor: Option<String>,
}

impl Submission {
    /// The texts of a stored run.
    pub fn of(run: &RunRow) -> Self {
        Self {
            file: format!("{}.toml", run.experiment),
            definition: run.definition.clone(),
            sensor: Some(run.sensor.clone()),
        }
    }

    /// Text of the sensor file that the experiment names: submitted, or carried by the program.
    ///
    /// # Errors
    /// The names of the carried files, if it is neither.
    pub fn sensor_text(&self, named: &str) -> Result<String, Vec<Problem>> {
        let carried = || carried::sensor(named).map(Into::into);
        self.sensor.clone().or_else(carried).ok_or_else(|| {
            let names = carried::names(carried::SENSORS);
            let known: Vec<String> = names.map(|name| format!("sensors/{name}.toml")).collect();
            let limit = format!(
                "must be a file that the program carries ({}), or its text must be in the request",
                known.join(", ")
            );
            vec![Problem::new(&self.file, "sensor", named, limit)]
        })
    }
}

/// Kind of the run that executes a plan.
pub fn run_kind(plan: &Plan) -> RunKind {
    match plan.kind {
        Kind::RealHex => RunKind::RealHex,
        Kind::RealRandom => RunKind::RealRandom,
    }
}

/// A submission, planned and checked for one rig.
pub struct Prepared {
    /// Experiment, parsed and checked.
    pub experiment: Experiment,
    /// Plan of the run.
    pub plan: Plan,
    /// The plan as it is stored.
    pub plan_text: String,
    /// Preflight on this rig, for the person who arms the run.
    pub preflight: Preflight,
    /// Text of the sensor file.
    pub sensor_text: String,
    /// Name of the sensor.
    pub sensor_name: String,
    /// Diameter of a tip, mm.
    pub tip_diameter_mm: f64,
    /// Label of the rig.
    pub label: Label,
    clock_rate: f64,
}

impl Prepared {
    /// Plans a submission. Problems on this rig are in the preflight.
    ///
    /// # Errors
    /// All problems of the experiment or sensor file.
    pub fn of(submission: &Submission, rig: &RigFile) -> Result<Self, Vec<Problem>> {
        let file = &submission.file;
        let experiment = Experiment::from_toml(file, &submission.definition)?;
        let sensor_text = submission.sensor_text(&experiment.sensor)?;
        let sensor = Sensor::from_toml(&sensor_text)
            .map_err(|e| vec![Problem::whole(&experiment.sensor, e.to_string())])?;
        let problems = lint(file, &experiment, &sensor, &reach(&rig.file, &rig.config));
        let plan = Plan::of(file, &experiment, &sensor)?;
        let preflight = Preflight::of(&plan, &bench(&rig.config), problems);
        let label = rig.config.label();
        let clock_rate = rig.config.clock_rate();
        let tip_diameter_mm = sensor.file.tip_diameter_mm;
        let sensor_name = sensor.file.name;
        let plan_text = plan.text();
        Ok(Self {
            experiment,
            plan,
            plan_text,
            preflight,
            sensor_text,
            sensor_name,
            tip_diameter_mm,
            label,
            clock_rate,
        })
    }

    /// Returns the run, unless the preflight found problems.
    ///
    /// # Errors
    /// `ConductorError::Problems` with those of the preflight.
    pub fn sound(self) -> ConductorResult<Self> {
        if self.preflight.problems.is_empty() {
            Ok(self)
        } else {
            Err(ConductorError::Problems { problems: self.preflight.problems })
        }
    }

    /// Checks that this version plans the run as it was planned when it was queued.
    ///
    /// # Errors
    /// `ConductorError::PlanDiffers` with the differing places.
    pub fn matches(&self, run: &RunRow, stored: &str) -> ConductorResult<()> {
        let difference = kept::difference(stored, &self.plan_text)
            .unwrap_or_else(|error| Some(format!("the stored plan cannot be read: {error}")));
        match difference {
            None => Ok(()),
            Some(difference) => Err(ConductorError::PlanDiffers {
                run: run.scan_id,
                version: match &run.git_commit {
                    Some(commit) => format!("{} (commit {commit})", run.version),
                    None => run.version.clone(),
                },
                difference,
            }),
        }
    }

    /// The job that the campaign drives, as a person starts it.
    pub fn job(self, run: &RunRow) -> Job {
        let trials = self.preflight.trials.max(1);
        Job {
            run: run.uid,
            scan_id: run.scan_id,
            predicted_trial_s: self.preflight.duration_s * self.clock_rate / trials as f64,
            auto_resume: run.auto_resume,
            has_waited: false,
            beginning: Beginning::OfPerson,
            bytes_per_trial: (self.preflight.disk_bytes - self.preflight.disk_fixed_bytes) / trials,
            plan: self.plan,
        }
    }
}

/// Checks that the rig has the label of the run: all trials of a run have one label.
///
/// # Errors
/// `ConductorError::Forbidden` with both labels.
pub fn same_label(run: i64, of_run: Label, of_rig: Label) -> ConductorResult<()> {
    if of_run == of_rig {
        return Ok(());
    }
    let (of_run, of_rig) = (of_run.as_str(), of_rig.as_str());
    Err(ConductorError::Forbidden(format!(
        "run {run} was queued for a {of_run} rig, this rig is {of_rig}: start the service on the rig of \
         the run, or queue its files again (palpate run --new)"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trials_of_a_virtual_rig_never_enter_a_measured_run() {
        assert!(same_label(3, Label::Virtual, Label::Virtual).is_ok());
        for labels in [(Label::Measured, Label::Virtual), (Label::Virtual, Label::Measured)] {
            let refused = same_label(3, labels.0, labels.1).unwrap_err().to_string();
            assert!(refused.starts_with("run 3 was queued for a"), "{refused}");
        }
    }
}
