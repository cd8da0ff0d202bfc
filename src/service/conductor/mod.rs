//! The order of runs: submissions become queued runs, queued runs are armed and started, and a run
//! that a crash interrupted resumes if its arming allows it.
//! Uses: `schedule`, `rig::reach`, `campaign` (its handle), `store`. Never: motion, HTTP.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use serde_json::json;
use sim_core::calibration::Calibration;
use tokio::sync::Notify;
use tracing::Instrument;
use utoipa::ToSchema;

use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::command::{Handle, Refusal, Request};
use crate::campaign::spans::run_span;
use crate::ids::{CalibrationId, RunUid};
use crate::journal::{ExitStatus, Journal, JournalError, error_chain};
use crate::problem::Problem;
use crate::rig::config::RigConfig;
use crate::schedule::preflight::Preflight;
use crate::state::StoredState;
use crate::store::{NewRun, RunRow, Soundness, Store, StoreError};

mod prepare;
mod restart;

use prepare::Prepared;
pub use prepare::Submission;
use restart::TakenOver;

/// Time for which a code from arming is valid, wall.
const CODE_VALID: Duration = Duration::from_secs(600);
/// Longest wait for homing, wall.
const HOMING: Duration = Duration::from_secs(300);
/// Interval of polling the rig's state.
const LOOK: Duration = Duration::from_millis(50);
/// Number of attempts to reach the rig after a restart, and the pause before the second; it
/// doubles.
const RESTART_TRIES: u32 = 8;
const RESTART_PAUSE: Duration = Duration::from_secs(1);

/// The rig on which runs are driven.
#[derive(Debug, Clone)]
pub struct RigFile {
    /// Name of the file, for problems.
    pub file: String,
    /// Text of the rig file, stored with every run.
    pub text: String,
    /// Parsed configuration.
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
    /// Runs that begin when the rig is free. The store marks them as well, for the process after a
    /// crash; in this process only the runs in this set begin.
    waiting: Mutex<BTreeSet<RunUid>>,
    /// Notified when a run is added to `waiting`.
    look: Notify,
    /// Held while a run begins, or ends without having been driven.
    beginning: tokio::sync::Mutex<()>,
}

/// The first of the two steps of starting a run.
#[derive(Debug, Clone)]
struct Arming {
    code: String,
    expires_at: Timestamp,
}

/// Result of arming: the preflight, and the code that starts the run.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Armed {
    /// Code for the action `start`.
    pub code: String,
    /// Time at which the code expires.
    #[schema(value_type = String, format = DateTime)]
    pub expires_at: Timestamp,
    /// Preflight of the run.
    pub preflight: Preflight,
}

/// Result of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Started {
    /// The run is active.
    Running,
    /// The run starts when the one before it has ended.
    Waiting,
}

/// Why a request was refused or failed.
#[derive(Debug, thiserror::Error)]
pub enum ConductorError {
    /// The files cannot be used on this rig.
    #[error("{}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Problems {
        /// Every problem found.
        problems: Vec<Problem>,
    },
    /// There is no run with this id.
    #[error("there is no run {0}")]
    NoRun(String),
    /// This version plans the files of a stored run differently.
    #[error(
        "run {run} was queued by version {version}, and this version plans it differently: \
         {difference}. The trials of one run come from one plan: abort it (palpate abort {run}), and \
         queue its files again (palpate run --new)"
    )]
    PlanDiffers {
        /// Number of the run.
        run: i64,
        /// Version that planned it.
        version: String,
        /// Differing places with both values.
        difference: String,
    },
    /// The state of the run or the store forbids it.
    #[error("{0}")]
    Forbidden(String),
    /// The campaign refused the request.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The end of a run could not be stored.
    #[error(transparent)]
    NotEnded(#[from] JournalError),
}

impl Conductor {
    /// Creates the conductor of one rig. Runs on the calibration's sensor carry its id.
    pub fn new(
        store: Store,
        campaign: Handle,
        rig: RigFile,
        calibration: Option<Calibration>,
    ) -> Self {
        let (armings, waiting, look) = (Mutex::default(), Mutex::default(), Notify::new());
        let beginning = tokio::sync::Mutex::default();
        let inner = Inner { store, campaign, rig, calibration, armings, waiting, look, beginning };
        Self { inner: Arc::new(inner) }
    }

    /// Returns the preflight of a submission, without queueing it.
    ///
    /// # Errors
    /// `ConductorError::Problems` if a file is invalid.
    pub async fn preflight(&self, submission: Submission) -> Result<Preflight, ConductorError> {
        Ok(self.prepare(submission).await?.preflight)
    }

    /// Queues a run.
    ///
    /// # Errors
    /// `ConductorError::Problems` if the files or the preflight have problems; `Store` if the store
    /// fails.
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
            git_commit: crate::commit::known().map(Into::into),
            deadband_n: experiment.measure.deadband_n,
            tip_diameter_mm: Some(prepared.tip_diameter_mm),
            plan: Some(prepared.plan_text.clone()),
            trials_planned: prepared.preflight.trials,
            auto_resume: auto_resume.unwrap_or(experiment.policy.auto_resume),
            submitted_by: who,
        };
        Ok(self.inner.store.enqueue(new).await?)
    }

    fn calibration_of(&self, sensor_name: &str) -> Option<CalibrationId> {
        let calibration = self.inner.calibration.as_ref();
        calibration
            .filter(|c| c.sensor == sensor_name)
            .and_then(|c| c.id().ok())
            .map(CalibrationId::unchecked)
    }

    /// Returns the preflight of a stored run on this rig.
    ///
    /// # Errors
    /// `ConductorError::Problems` if a file is invalid.
    pub async fn preflight_of(&self, run: &RunRow) -> Result<Preflight, ConductorError> {
        self.preflight(Submission::of(run)).await
    }

    /// First step of a start: checks the run and returns a code.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not startable or the store is damaged; `Problems`
    /// if the preflight has problems.
    pub async fn arm(&self, run: &RunRow) -> Result<Armed, ConductorError> {
        startable(run)?;
        self.require_sound_store()?;
        let preflight = self.prepare_stored(run).await?.preflight;
        // The tail of a v7 uuid is random.
        let code: String = RunUid::new().0.simple().to_string()[26..].into();
        let expires_at = Timestamp::now() + CODE_VALID;
        self.armings().insert(run.uid, Arming { code: code.clone(), expires_at });
        Ok(Armed { code, expires_at, preflight })
    }

    /// Second step: starts the run, or lets it wait for the active one.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not startable, the code is invalid or the store is
    /// damaged; `Refused` if the campaign refuses.
    pub async fn start(&self, run: &RunRow, code: &str) -> Result<Started, ConductorError> {
        startable(run)?;
        self.check_code(run.uid, code)?;
        if self.inner.campaign.status().run.is_some() {
            self.require_sound_store()?;
            self.inner.store.set_waiting(run.uid).await?;
            self.let_wait([run.uid]);
            return Ok(Started::Waiting);
        }
        self.begin(run).await?;
        Ok(Started::Running)
    }

    /// Ends an interrupted run as aborted. Its trials stay; nothing moves.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not interrupted, `Store` if its end is not stored.
    pub async fn abort_interrupted(&self, run: &RunRow) -> Result<(), ConductorError> {
        let _one_at_a_time = self.inner.beginning.lock().await;
        let now = self.present(run).await?;
        let active = self.inner.campaign.status().run.is_some_and(|r| r.uid == run.uid);
        if active || now.state != StoredState::Interrupted {
            let words = format!("run {} is {}, not interrupted", now.scan_id, now.state);
            return Err(ConductorError::Forbidden(words));
        }
        self.armings().remove(&run.uid);
        self.waiting().remove(&run.uid);
        let reason = "aborted while it was interrupted";
        let ended = self.inner.store.end_run(run.uid, ExitStatus::Abort, reason, Timestamp::now());
        Ok(ended.await?)
    }

    /// The row of a run as it is stored now.
    async fn present(&self, run: &RunRow) -> Result<RunRow, ConductorError> {
        let now = self.inner.store.run(run.uid).await?;
        now.ok_or_else(|| ConductorError::NoRun(run.uid.to_string()))
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
                forbidden(format!("code = {code}: not the code from arming run {run}"))
            }
            Some(_) => Ok(()),
        }
    }

    /// Refuses runs on a database that is known to be damaged.
    fn require_sound_store(&self) -> Result<(), ConductorError> {
        match self.inner.store.soundness() {
            Soundness::Unchecked | Soundness::Sound => Ok(()),
            Soundness::Damaged(findings) => Err(ConductorError::Forbidden(format!(
                "the database is damaged, no run is armed or started: {}; restore it from a \
                 copy, or use another data folder",
                findings.join("; ")
            ))),
        }
    }

    async fn begin(&self, run: &RunRow) -> Result<(), ConductorError> {
        let beginning = async {
            let _one_at_a_time = self.inner.beginning.lock().await;
            self.require_sound_store()?;
            // It may have been aborted while the rig was homed.
            let state = self.present(run).await?.state;
            if matches!(state, StoredState::Ended | StoredState::Removed) {
                let words = format!("run {} is {state}: it cannot be driven", run.scan_id);
                return Err(ConductorError::Forbidden(words));
            }
            let job = self.prepare_stored(run).await?.job(run);
            self.inner.campaign.ask(Request::Start(Arc::new(job))).await?;
            self.armings().remove(&run.uid);
            self.waiting().remove(&run.uid);
            Ok(())
        };
        beginning.instrument(run_span(run.uid, run.scan_id)).await
    }

    /// Follows the campaign: a run that was started while another was active begins when the rig is
    /// free. Ends with the campaign's thread.
    pub async fn follow(self) {
        let mut status = self.inner.campaign.watch_status();
        loop {
            tokio::select! {
                changed = status.changed() => if changed.is_err() { return },
                () = self.inner.look.notified() => {}
            }
            let free = {
                let now = status.borrow_and_update();
                now.run.is_none() && now.rig.state == RigState::Homed
            };
            if free && let Err(error) = self.begin_next().await {
                tracing::warn!(error = error_chain(&error), "the next run did not start");
            }
        }
    }

    /// Begins the first waiting run. A run that cannot begin must be started again; an event
    /// reports it.
    async fn begin_next(&self) -> Result<(), ConductorError> {
        if self.waiting().is_empty() {
            return Ok(());
        }
        for run in self.inner.store.waiting_runs().await? {
            if !self.waiting().contains(&run.uid) {
                continue;
            }
            match self.begin(&run).await {
                Ok(()) => return Ok(()),
                // Another run was started first: this one continues to wait.
                Err(_) if self.inner.campaign.status().run.is_some() => return Ok(()),
                Err(error) => self.drop_waiting(&run, &error.to_string()).await?,
            }
        }
        Ok(())
    }

    fn let_wait(&self, runs: impl IntoIterator<Item = RunUid>) {
        self.waiting().extend(runs);
        self.inner.look.notify_one();
    }

    async fn drop_waiting(&self, run: &RunRow, why: &str) -> Result<(), ConductorError> {
        run_span(run.uid, run.scan_id)
            .in_scope(|| tracing::warn!(why, "a waiting run does not begin"));
        self.waiting().remove(&run.uid);
        self.inner.store.clear_waiting(run.uid).await?;
        self.say(run, "not_begun", json!({ "why": why })).await;
        Ok(())
    }

    /// Called after a start of the service: resumes the run that was driven when the process ended,
    /// and then the runs that were started behind it, if their arming and `resume` allow it. Marks
    /// other open runs as interrupted; a waiting run that is dropped must be started again. Reports
    /// in events what it does and what it cannot do.
    ///
    /// Until the run is driven again it keeps its state: if this process ends early, the next one
    /// finds the same case.
    ///
    /// # Errors
    /// `ConductorError` if the store fails, or the run cannot resume.
    pub async fn go_on(&self, resume: bool) -> Result<(), ConductorError> {
        let store = &self.inner.store;
        let (open, waiting) = (store.open_runs().await?, store.waiting_runs().await?);
        let TakenOver { driven, waiting, dropped } = TakenOver::of(open, waiting, resume);
        store.interrupt_open_runs(driven.as_ref().map(|run| run.uid)).await?;
        for (run, why) in &dropped {
            self.drop_waiting(run, why).await?;
        }
        let outcome = match driven.as_ref().or(waiting.first()) {
            Some(first) => {
                self.go_on_with(first).instrument(run_span(first.uid, first.scan_id)).await
            }
            None => return Ok(()),
        };
        if driven.is_some() && !matches!(outcome, Ok(true)) {
            store.interrupt_open_runs(None).await?;
        }
        let begun = usize::from(driven.is_none() && matches!(outcome, Ok(true)));
        if self.inner.campaign.status().rig.state == RigState::Tripped {
            for run in &waiting[begun..] {
                self.drop_waiting(run, "the rig tripped during the start").await?;
            }
        } else {
            self.let_wait(waiting[begun..].iter().map(|run| run.uid));
        }
        outcome.map(|_| ())
    }

    /// Drives a run again; returns `false` if the rig could not be reached.
    async fn go_on_with(&self, run: &RunRow) -> Result<bool, ConductorError> {
        // Before the wires are opened: nothing moves for a run that is refused.
        self.require_sound_store()?;
        if let Err(error) = self.prepare_stored(run).await {
            let data = json!({ "attempt": 0, "why": error.to_string() });
            self.say(run, "not_gone_on", data).await;
            return Err(error);
        }
        let mut pause = RESTART_PAUSE;
        for attempt in 1..=RESTART_TRIES {
            let outcome = match self.bring_up().await {
                Ok(()) => self.begin(run).await,
                Err(refusal) => Err(refusal.into()),
            };
            let Err(error) = outcome else {
                tracing::info!(attempt, "the run is driven again");
                self.say(run, "went_on", json!({ "attempt": attempt })).await;
                return Ok(true);
            };
            let why = error.to_string();
            self.say(run, "not_gone_on", json!({ "attempt": attempt, "why": why })).await;
            let tripped = self.inner.campaign.status().rig.state == RigState::Tripped;
            let for_good = matches!(
                error,
                ConductorError::Problems { .. }
                    | ConductorError::PlanDiffers { .. }
                    | ConductorError::Forbidden(_)
            );
            if tripped || for_good {
                return Err(error);
            }
            tracing::warn!(attempt, error = error_chain(&error), "the run is not driven again yet");
            tokio::time::sleep(pause).await;
            pause *= 2;
        }
        Ok(false)
    }

    async fn say(&self, run: &RunRow, kind: &str, data: serde_json::Value) {
        if let Err(error) = self.inner.store.append_event(Some(run.uid), kind, data).await {
            let error = error.with_causes();
            tracing::error!(error, kind, "an event was not stored");
        }
    }

    /// Opens the wires and homes the rig, as needed. After a crash the first motion is z up, as in
    /// every homing.
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
        let late = || {
            let limit_s = HOMING.as_secs();
            Err(Refusal::State(format!("the rig was not homed within {limit_s} s: check its axes")))
        };
        tokio::time::timeout(HOMING, homed).await.unwrap_or_else(|_| late())
    }

    /// Plans a stored run again, and compares the plan with the one that was kept. The plan of a run
    /// that an older version queued is kept now.
    async fn prepare_stored(&self, run: &RunRow) -> Result<Prepared, ConductorError> {
        let prepared = self.prepare(Submission::of(run)).await?.sound()?;
        match self.inner.store.plan_of(run.uid).await? {
            Some(stored) => prepared.matches(run, &stored)?,
            None => self.inner.store.keep_plan(run.uid, prepared.plan_text.clone()).await?,
        }
        Ok(prepared)
    }

    async fn prepare(&self, submission: Submission) -> Result<Prepared, ConductorError> {
        let rig = self.inner.rig.clone();
        // A plan of 198,000 trials takes about 0.3 s: not on a thread that answers requests.
        let prepared = tokio::task::spawn_blocking(move || Prepared::of(&submission, &rig)).await;
        match prepared {
            Ok(prepared) => prepared.map_err(|problems| ConductorError::Problems { problems }),
            Err(_) => Err(ConductorError::Refused(Refusal::Gone)),
        }
    }

    fn waiting(&self) -> parking_lot::MutexGuard<'_, BTreeSet<RunUid>> {
        self.inner.waiting.lock()
    }

    fn armings(&self) -> parking_lot::MutexGuard<'_, BTreeMap<RunUid, Arming>> {
        self.inner.armings.lock()
    }
}

fn startable(run: &RunRow) -> Result<(), ConductorError> {
    match run.state {
        StoredState::Queued | StoredState::Interrupted => Ok(()),
        state => Err(ConductorError::Forbidden(format!(
            "run {} is {state}: only a queued or an interrupted run can be started",
            run.scan_id
        ))),
    }
}
