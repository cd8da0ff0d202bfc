//! What runs next: submissions become queued runs, queued runs are armed and started, and what a
//! crash interrupted goes on where its arming allowed it.
//! Uses: `schedule`, `rig::reach`, `campaign` (its handle), `store`. Never: motion, HTTP.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::json;
use sim_core::calibration::Calibration;
use utoipa::ToSchema;

use crate::campaign::command::{Handle, Refusal, Request};
use crate::campaign::journal::Journal;
use crate::campaign::rig_state::RigState;
use crate::campaign::run_state::{PausedWhy, RunState};
use crate::ids::RunUid;
use crate::problem::Problem;
use crate::rig::config::RigConfig;
use crate::schedule::preflight::Preflight;
use crate::store::{NewRun, RunRow, Store, StoreError};

mod prepare;

use prepare::Prepared;
pub use prepare::Submission;

/// How long a code from arming may be used.
const CODE_VALID: Duration = Duration::from_secs(600);
/// Longest wait for homing, wall.
const HOMING: Duration = Duration::from_secs(300);
/// Pause between looks at the rig's state.
const LOOK: Duration = Duration::from_millis(50);
/// Tries at reaching the rig after a restart, and the pause before the second; it doubles.
const RESTART_TRIES: u32 = 8;
const RESTART_PAUSE: Duration = Duration::from_secs(1);

/// The rig that runs are made for.
#[derive(Debug, Clone)]
pub struct RigFile {
    /// Name of the file, for problems.
    pub file: String,
    /// Its text, stored with every run.
    pub text: String,
    /// Its contents.
    pub config: RigConfig,
}

/// Queue and campaign of one rig. Clones share it.
#[derive(Clone)]
pub struct Conductor {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    campaign: Handle,
    rig: RigFile,
    calibration: Option<Calibration>,
    armings: Mutex<BTreeMap<RunUid, Arming>>,
}

/// The first of the two steps of starting a run.
#[derive(Debug, Clone)]
struct Arming {
    code: String,
    expires_at: Timestamp,
    /// Started while another run was under way: goes when the rig is free.
    started: bool,
}

/// What arming answers: what will happen, and the code that starts it.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Armed {
    /// To be given with `start`.
    pub code: String,
    /// The code is void after this.
    #[schema(value_type = String, format = DateTime)]
    pub expires_at: Timestamp,
    /// What the run is.
    pub preflight: Preflight,
}

/// How a start was taken up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Started {
    /// It is under way.
    Running,
    /// It goes when the run before it has ended.
    Waiting,
}

/// Why something was not done.
#[derive(Debug, thiserror::Error)]
pub enum ConductorError {
    /// The files cannot be used on this rig.
    #[error("{}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Problems {
        /// All of them.
        problems: Vec<Problem>,
    },
    /// There is no such run.
    #[error("there is no run {0}")]
    NoRun(String),
    /// The state forbids it.
    #[error("{0}")]
    Forbidden(String),
    /// The campaign refused.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Conductor {
    /// A conductor of one rig. Runs on the calibration's sensor carry its id.
    pub fn new(
        store: Store,
        campaign: Handle,
        rig: RigFile,
        calibration: Option<Calibration>,
    ) -> Self {
        let inner = Inner { store, campaign, rig, calibration, armings: Mutex::default() };
        Self { inner: Arc::new(inner) }
    }

    /// What a submission would be, without queueing it.
    pub async fn preflight(&self, submission: Submission) -> Result<Preflight, ConductorError> {
        Ok(self.prepare(submission).await?.preflight)
    }

    /// Queues a run. A submission with problems is refused.
    pub async fn enqueue(
        &self,
        submission: Submission,
        who: String,
        auto_resume: Option<bool>,
    ) -> Result<RunRow, ConductorError> {
        let files = submission.clone();
        let prepared = self.prepare(submission).await?.sound()?;
        let experiment = &prepared.experiment;
        let new = NewRun {
            uid: RunUid::new(),
            experiment: experiment.name.clone(),
            kind: prepared.run_kind(),
            definition: files.definition,
            seed: Some(experiment.seed),
            rig: Some(self.inner.rig.text.clone()),
            sensor: files.sensor,
            calibration_id: self.calibration_of(&prepared.sensor_name),
            label: prepared.label,
            version: env!("CARGO_PKG_VERSION").into(),
            git_commit: option_env!("PALPATE_COMMIT").map(Into::into),
            deadband_n: experiment.measure.deadband_n,
            tip_diameter_mm: Some(prepared.tip_diameter_mm),
            trials_planned: prepared.preflight.trials,
            auto_resume: auto_resume.unwrap_or(experiment.policy.auto_resume),
            submitted_by: who,
        };
        Ok(self.inner.store.enqueue(new).await?)
    }

    fn calibration_of(&self, sensor_name: &str) -> Option<String> {
        let calibration = self.inner.calibration.as_ref();
        calibration.filter(|c| c.sensor == sensor_name).and_then(|c| c.id().ok())
    }

    /// The preflight of a stored run on this rig.
    pub async fn preflight_of(&self, run: &RunRow) -> Result<Preflight, ConductorError> {
        self.preflight(Submission::of(run)).await
    }

    /// The first step of starting: checks the run and hands out a code.
    pub async fn arm(&self, run: &RunRow) -> Result<Armed, ConductorError> {
        startable(run)?;
        let preflight = self.prepare(Submission::of(run)).await?.sound()?.preflight;
        // The tail of a v7 uuid is random.
        let code: String = RunUid::new().0.simple().to_string()[26..].into();
        let expires_at = Timestamp::now() + CODE_VALID;
        let arming = Arming { code: code.clone(), expires_at, started: false };
        self.armings().insert(run.uid, arming);
        Ok(Armed { code, expires_at, preflight })
    }

    /// The second step: starts the run, or lets it follow the one under way.
    pub async fn start(&self, run: &RunRow, code: &str) -> Result<Started, ConductorError> {
        startable(run)?;
        self.check_code(run.uid, code)?;
        if self.inner.campaign.status().run.is_some() {
            if let Some(arming) = self.armings().get_mut(&run.uid) {
                arming.started = true;
            }
            return Ok(Started::Waiting);
        }
        self.begin(run).await?;
        Ok(Started::Running)
    }

    fn check_code(&self, run: RunUid, code: &str) -> Result<(), ConductorError> {
        let armings = self.armings();
        let forbidden = |words: String| Err(ConductorError::Forbidden(words));
        match armings.get(&run) {
            None => forbidden(format!("run {run} has not been armed")),
            Some(arming) if arming.expires_at < Timestamp::now() => {
                forbidden(format!("the code of run {run} expired at {}", arming.expires_at))
            }
            Some(arming) if arming.code != code => {
                forbidden(format!("code = {code}: not the one that arming run {run} gave"))
            }
            Some(_) => Ok(()),
        }
    }

    async fn begin(&self, run: &RunRow) -> Result<(), ConductorError> {
        let job = self.prepare(Submission::of(run)).await?.sound()?.job(run);
        self.inner.campaign.ask(Request::Start(Arc::new(job))).await?;
        self.armings().remove(&run.uid);
        Ok(())
    }

    /// Follows the campaign: a run that was started while another was under way begins when the rig
    /// is free. Ends with the campaign's thread.
    pub async fn follow(self) {
        let mut status = self.inner.campaign.watch_status();
        while status.changed().await.is_ok() {
            let free = {
                let now = status.borrow_and_update();
                now.run.is_none() && now.rig.state == RigState::Homed
            };
            if free && let Err(error) = self.begin_next().await {
                tracing::warn!(%error, "the next run did not start");
            }
        }
    }

    async fn begin_next(&self) -> Result<(), ConductorError> {
        if !self.armings().values().any(|a| a.started) {
            return Ok(());
        }
        for run in self.inner.store.queue().await? {
            let started = self.armings().get(&run.uid).is_some_and(|a| a.started);
            if started {
                let begun = self.begin(&run).await;
                self.armings().remove(&run.uid);
                return begun;
            }
        }
        Ok(())
    }

    /// After a start of the service: goes on by itself with the run that was being driven when the
    /// process ended, if its arming allows that, and marks what else was left open as interrupted.
    /// Says in events what it does and what it cannot do.
    ///
    /// Until it drives the run again, the run keeps the state that it was left in: a process that
    /// ends on the way leaves the same case to the next one.
    pub async fn go_on(&self) -> Result<(), ConductorError> {
        let store = &self.inner.store;
        let open = store.open_runs().await?;
        let run = open.into_iter().rfind(|run| run.auto_resume && was_driven(run));
        store.interrupt_open_runs(run.as_ref().map(|run| run.uid)).await?;
        let Some(run) = run else { return Ok(()) };
        let outcome = self.go_on_with(&run).await;
        if !matches!(outcome, Ok(true)) {
            store.interrupt_open_runs(None).await?;
        }
        outcome.map(|_| ())
    }

    /// Whether it is driven again; `false` when the rig could not be reached.
    async fn go_on_with(&self, run: &RunRow) -> Result<bool, ConductorError> {
        let mut pause = RESTART_PAUSE;
        for attempt in 1..=RESTART_TRIES {
            let outcome = match self.bring_up().await {
                Ok(()) => self.begin(run).await,
                Err(refusal) => Err(refusal.into()),
            };
            let Err(error) = outcome else {
                self.say(run, "went_on", json!({ "attempt": attempt })).await;
                return Ok(true);
            };
            let why = error.to_string();
            self.say(run, "not_gone_on", json!({ "attempt": attempt, "why": why })).await;
            let tripped = self.inner.campaign.status().rig.state == RigState::Tripped;
            if tripped || matches!(error, ConductorError::Problems { .. }) {
                return Err(error);
            }
            tokio::time::sleep(pause).await;
            pause *= 2;
        }
        Ok(false)
    }

    async fn say(&self, run: &RunRow, kind: &str, data: serde_json::Value) {
        if let Err(error) = self.inner.store.event(Some(run.uid), kind, data).await {
            tracing::error!(%error, kind, "an event was not stored");
        }
    }

    /// Opens the wires and homes, as far as the rig is not there yet. After a crash the first
    /// motion is z up: homing sees to it.
    async fn bring_up(&self) -> Result<(), Refusal> {
        let campaign = &self.inner.campaign;
        if campaign.status().rig.state == RigState::Disconnected {
            campaign.ask(Request::Connect).await?;
        }
        if campaign.status().rig.state == RigState::Disarmed {
            campaign.ask(Request::Home).await?;
        }
        let homed = async {
            loop {
                let rig = campaign.status().rig;
                match rig.state {
                    RigState::Homed => return Ok(()),
                    RigState::Tripped => {
                        let why = rig.trip.map_or_else(String::new, |t| t.detail);
                        return Err(Refusal::State(format!("the rig tripped: {why}")));
                    }
                    RigState::Disconnected | RigState::Disarmed | RigState::Armed => {
                        tokio::time::sleep(LOOK).await;
                    }
                }
            }
        };
        tokio::time::timeout(HOMING, homed).await.unwrap_or(Err(Refusal::Gone))
    }

    async fn prepare(&self, submission: Submission) -> Result<Prepared, ConductorError> {
        let rig = self.inner.rig.clone();
        // A plan of 198,000 trials takes a third of a second: not on a thread that answers requests.
        let prepared = tokio::task::spawn_blocking(move || Prepared::of(&submission, &rig)).await;
        match prepared {
            Ok(prepared) => prepared.map_err(|problems| ConductorError::Problems { problems }),
            Err(_) => Err(ConductorError::Refused(Refusal::Gone)),
        }
    }

    fn armings(&self) -> std::sync::MutexGuard<'_, BTreeMap<RunUid, Arming>> {
        self.inner.armings.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A run that waited for a person, stood in a trip, or was to end when the process ended is not gone
/// on with unasked: somebody may be at the rig.
fn was_driven(run: &RunRow) -> bool {
    run.state == RunState::Running.as_str()
        || run.paused_why.as_deref() == Some(PausedWhy::Restart.as_str())
}

fn startable(run: &RunRow) -> Result<(), ConductorError> {
    match run.state.as_str() {
        "queued" | "interrupted" => Ok(()),
        state => Err(ConductorError::Forbidden(format!(
            "run {} is {state}: only a queued or an interrupted run can be started",
            run.scan_id
        ))),
    }
}
