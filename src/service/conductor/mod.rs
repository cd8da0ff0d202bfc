//! The order of runs: submissions become queued runs, queued runs are armed and started, and a run
//! that a crash interrupted resumes if its arming allows it.
//! Uses: `schedule`, `rig::reach`, `campaign` (its handle), `store`. Never: motion, HTTP.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use jiff::Timestamp;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use serde_json::json;
use sim_core::calibration::Calibration;
use tokio::sync::Notify;
use tokio::time::Instant;
use tracing::Instrument;
use utoipa::ToSchema;

use crate::campaign::shown::command::{Handle, Refusal, Request};
use crate::campaign::shown::run_action;
use crate::campaign::spans::run_span;
use crate::ids::RunUid;
use crate::journal::{ExitStatus, Journal, error_chain};
use crate::plain::grouped;
use crate::rig::setup::RigSetup;
use crate::schedule::preflight::Preflight;
use crate::state::{PausedWhy, StoredState};
use crate::store::{LockRow, RunRow, Soundness, Store};
use crate::suspension::Suspensions;

mod bring_up;
mod earlier;
mod error;
mod follow;
pub mod estimates;
mod operated;
mod prepare;
mod queue;
mod restart;
pub mod room;
#[cfg(test)]
mod stand_in;
mod stopped;
mod take_over;
mod turn;

pub use error::{ConductorError, ConductorResult};
use prepare::{Prepared, same_label};
pub use prepare::{Submission, run_kind};
pub use queue::Terms;
pub use restart::{AutoResume, resumes_automatically};

/// Time for which a code from arming is valid, wall.
const CODE_VALID: Duration = Duration::from_secs(600);

/// The rig on which runs are driven.
#[derive(Debug, Clone)]
pub struct RigFile {
    /// Name of the file, for problems.
    pub file: String,
    /// Text of the rig file, stored with every run.
    pub text: String,
    /// Parsed configuration.
    pub config: RigSetup,
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
    /// Runs that begin when the rig is free; no other one begins in this process. The store marks them for the next.
    waiting: Mutex<BTreeSet<RunUid>>,
    /// Runs that were started, waited and do not begin by themselves any more, with the reason.
    dropped: Mutex<BTreeMap<RunUid, String>>,
    /// Notified when a run is added to `waiting`.
    look: Notify,
    /// Held while a run begins, or ends without having been driven.
    beginning: tokio::sync::Mutex<()>,
    /// The run for which the rig is brought up after a start of the service; none once it was aborted.
    brought_up: Mutex<Option<RunUid>>,
    /// How many times a person has operated the rig, or may have come to it, since the start of the service.
    operations: AtomicU64,
    /// Runs that this process has begun.
    begun: Mutex<BTreeSet<RunUid>>,
    /// The last start of each run in this process that lets it wait.
    handed_over: Mutex<BTreeMap<RunUid, HandedOver>>,
    /// Notices that the computer was suspended.
    suspensions: Mutex<Suspensions>,
    /// Signs of a person that were followed: what waited then is dropped.
    signs: AtomicU64,
    /// What the next process must know of a person.
    noted: stopped::Noted,
}

/// The start of a run that waits.
struct HandedOver {
    /// `operations` at that time.
    operations: u64,
    /// Who started it, as the holder of a lock is named.
    by: String,
}

/// The first of the two steps of starting a run.
#[derive(Debug, Clone)]
struct Arming {
    code: String,
    expires_at: Timestamp,
    armed: Instant,
    edition: Edition,
}

/// What an edit of a queued run may change: a person arms one edition.
#[derive(Debug, Clone, PartialEq)]
struct Edition {
    files_sha256: [String; 2],
    auto_resume: bool,
    not_before: Option<Timestamp>,
}

impl Edition {
    fn of(run: &RunRow) -> Self {
        Self {
            files_sha256: [run.definition_sha256.clone(), run.sensor_sha256.clone()],
            auto_resume: run.auto_resume,
            not_before: run.not_before,
        }
    }
}

/// Result of arming: the preflight, and the code that starts the run.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Armed {
    /// Code for the action `start`.
    pub code: String,
    /// Time at which the code expires.
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
    /// The run starts when the one before it has ended and its own time has come.
    Waiting,
}

impl Conductor {
    /// Creates the conductor of one rig. Runs on the calibration's sensor carry its id.
    pub fn new(
        store: Store,
        campaign: Handle,
        rig: RigFile,
        calibration: Option<Calibration>,
    ) -> Self {
        let inner = Inner {
            store,
            campaign,
            rig,
            calibration,
            armings: Mutex::default(),
            waiting: Mutex::default(),
            dropped: Mutex::default(),
            look: Notify::new(),
            beginning: tokio::sync::Mutex::default(),
            brought_up: Mutex::default(),
            operations: AtomicU64::default(),
            begun: Mutex::default(),
            handed_over: Mutex::default(),
            suspensions: Mutex::new(Suspensions::watch()),
            signs: AtomicU64::default(),
            noted: stopped::Noted::default(),
        };
        Self { inner: Arc::new(inner) }
    }

    /// A person operates the rig: no run that was started before is driven again by itself after a restart.
    pub fn note_operation(&self) {
        self.inner.operations.fetch_add(1, Ordering::SeqCst);
    }

    /// How many times a person has operated the rig. While the computer is suspended a person may do so as well.
    fn operations(&self) -> u64 {
        if self.inner.suspensions.lock().newest().is_some() {
            self.note_operation();
        }
        self.inner.operations.load(Ordering::SeqCst)
    }

    /// Whether a person has operated the rig, and has not started this run since.
    fn is_operated_since_start(&self, run: RunUid) -> bool {
        let at_start = self.inner.handed_over.lock().get(&run).map_or(0, |start| start.operations);
        self.operations() > at_start
    }

    /// Returns the preflight of a stored run on this rig.
    ///
    /// # Errors
    /// `ConductorError::Problems` if a file is invalid.
    pub async fn preflight_of(&self, run: &RunRow) -> ConductorResult<Preflight> {
        Ok(self.prepare(Submission::of(run)).await?.preflight)
    }

    /// First step of a start: checks the run and returns a code.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not startable or the store is damaged; `Problems`
    /// if the preflight has problems.
    pub async fn arm(&self, run: &RunRow) -> ConductorResult<Armed> {
        startable(run)?;
        self.require_sound_store()?;
        let preflight = self.prepare_stored(run).await?.preflight;
        // The tail of a v7 uuid is random.
        let code: String = RunUid::new().0.simple().to_string()[26..].into();
        let expires_at = Timestamp::now() + CODE_VALID;
        let edition = Edition::of(run);
        let arming = Arming { code: code.clone(), expires_at, armed: Instant::now(), edition };
        self.armings().insert(run.uid, arming);
        Ok(Armed { code, expires_at, preflight })
    }

    /// Second step: starts the run, or lets it wait for the active one or for its time. `by`: who starts it, as the
    /// holder of a lock is named.
    ///
    /// # Errors
    /// `ConductorError::Forbidden` if the run is not startable, the code is invalid, the store is
    /// damaged, the e-stop is latched, or there is a sign of a person meanwhile; `Refused` if another person takes the
    /// operator lock meanwhile, or the campaign refuses.
    pub async fn start(&self, run: &RunRow, code: &str, by: String) -> ConductorResult<Started> {
        startable(run)?;
        self.check_code(run, code)?;
        let is_early = !turn::is_due(run, Timestamp::now());
        let status = self.inner.campaign.status();
        let signs = status.attended.signs;
        if is_early || status.run.is_some() {
            if let Some(words) = run_action::wait_refused(&status) {
                return Err(ConductorError::Forbidden(words));
            }
            let _one_at_a_time = self.inner.beginning.lock().await;
            self.require_sound_store()?;
            self.unended(run).await?;
            let operations = self.operations();
            self.inner.store.set_waiting(run.uid).await?;
            let start = HandedOver { operations, by: by.clone() };
            self.inner.handed_over.lock().insert(run.uid, start);
            self.dropped().remove(&run.uid);
            self.let_wait([run.uid]);
            // Read after it: a sign of a person that came before was followed without it, and a lock that was taken
            // before does not hold it up.
            let attended = self.require_no_person(signs, &by).await;
            if let Err(error) = attended.and_then(|()| self.require_released()) {
                self.drop_waiting(run, &error.to_string()).await?;
                return Err(error);
            }
            return Ok(Started::Waiting);
        }
        self.begin(run, true, self.require_no_person(signs, &by)).await?;
        Ok(Started::Running)
    }

    /// Ends a run that is open but not driven as aborted: it was interrupted, or is about to be driven again after a
    /// restart; if the rig homes for it, the homing ends, too. Its trials stay; it begins nothing, nor does a run that
    /// waits begin by itself, unless it was interrupted. Of a run that is not open and waits for its turn, takes the
    /// start back: it stays what it was. A run that has begun meanwhile is aborted by the campaign. Returns false if
    /// there is nothing to abort.
    ///
    /// # Errors
    /// `ConductorError::Refused` if the campaign refuses; `Forbidden` if it has ended in this process, and how is not
    /// stored yet; `Store` if the store fails.
    pub async fn abort_undriven(&self, run: &RunRow) -> ConductorResult<bool> {
        let _one_at_a_time = self.inner.beginning.lock().await;
        if self.active() == Some(run.uid) {
            self.halt(Request::Abort).await?;
            return Ok(true);
        }
        // Read after it: it may just have ended.
        let now = self.present(run).await?;
        if !now.is_open() && now.waiting_since.is_some() {
            // In memory first: it does not begin, whatever the store does.
            self.waiting().remove(&run.uid);
            let why = "its start was taken back: start it again";
            self.dropped().insert(run.uid, why.into());
            self.inner.store.clear_waiting(run.uid).await?;
            self.forget(run.uid);
            return Ok(true);
        }
        if !now.is_open() {
            return Ok(false);
        }
        // An e-stop or a pause may have marked it as interrupted meanwhile.
        let is_driven = now.is_driven() || now.paused_why == Some(PausedWhy::Restart);
        if is_driven && self.inner.begun.lock().contains(&run.uid) {
            // Its end waits for the store, and may be a success.
            let _ = self.halt(Request::CameLate).await;
            let scan_id = now.scan_id;
            return Err(ConductorError::Forbidden(format!(
                "run {scan_id} has ended, and how is not stored yet: read it again"
            )));
        }
        self.end_bringing_up(run.uid);
        self.forget(run.uid);
        let stored: u64 = self.inner.store.contact_counts(run.uid).await?.iter().sum();
        let (stored, planned) = (grouped(stored), grouped(run.trials_planned));
        let reason = format!("aborted at {stored} of {planned} trials, not driven");
        let status = ExitStatus::Abort;
        self.inner.store.end_run(run.uid, status, &reason, Timestamp::now()).await?;
        // An attempt that began meanwhile still found it open.
        self.end_bringing_up(run.uid);
        let data = json!({ "run": run.uid, "exit_status": status, "reason": reason });
        self.say(run, "ended", data).await;
        if now.is_driven() {
            // Also before the runs of the earlier process are taken over. If the campaign is busy, it is noted later.
            let _ = self.halt(Request::CameLate).await;
        }
        Ok(true)
    }

    /// The row of a run as it is stored now.
    async fn present(&self, run: &RunRow) -> ConductorResult<RunRow> {
        let now = self.inner.store.run(run.uid).await?;
        now.ok_or_else(|| ConductorError::NoRun(run.uid.to_string()))
    }

    /// The row of a run as it is stored now, unless it was edited, ended or removed since `run` was read.
    async fn unended(&self, run: &RunRow) -> ConductorResult<RunRow> {
        let now = self.present(run).await?;
        if Edition::of(&now) != Edition::of(run) {
            let words = format!("run {} was edited meanwhile: arm and start it again", run.scan_id);
            return Err(ConductorError::Forbidden(words));
        }
        if (now.state, now.exit_status) == (run.state, run.exit_status) {
            return Ok(now);
        }
        let words = format!("run {} is {} meanwhile: it is not driven", now.scan_id, now.state);
        Err(ConductorError::Forbidden(words))
    }

    fn check_code(&self, row: &RunRow, code: &str) -> ConductorResult<()> {
        let (run, armings) = (row.scan_id, self.armings());
        let forbidden = |words: String| Err(ConductorError::Forbidden(words));
        match armings.get(&row.uid) {
            None => forbidden(format!("run {run} has not been armed")),
            // The clock may have been set back.
            Some(Arming { expires_at, armed, .. })
                if *expires_at < Timestamp::now() || armed.elapsed() > CODE_VALID =>
            {
                forbidden(format!("the code of run {run} expired at {expires_at}"))
            }
            Some(arming) if arming.code != code => {
                forbidden(format!("code = {code}: not the code from arming run {run}"))
            }
            Some(arming) if arming.edition != Edition::of(row) => {
                forbidden(format!("run {run} was edited after it was armed: arm it again"))
            }
            Some(_) => Ok(()),
        }
    }

    /// Refuses runs on a database that is known to be damaged.
    fn require_sound_store(&self) -> ConductorResult<()> {
        match self.inner.store.soundness() {
            Soundness::Unchecked | Soundness::Sound => Ok(()),
            Soundness::Damaged(findings) => Err(ConductorError::Forbidden(format!(
                "the database is damaged, no run is armed or started: {}; restore it from a \
                 copy, or use another data folder",
                findings.join("; ")
            ))),
        }
    }

    /// Begins a run on the rig, unless `refused`: awaited last, since planning takes a while. `by_person`: whether a
    /// person starts it now; otherwise it begins by itself.
    async fn begin(
        &self,
        run: &RunRow,
        by_person: bool,
        refused: impl Future<Output = ConductorResult<()>> + Send,
    ) -> ConductorResult<()> {
        let beginning = async {
            let _one_at_a_time = self.inner.beginning.lock().await;
            self.require_sound_store()?;
            // It may have been aborted while the rig was homed.
            let run = &self.unended(run).await?;
            let mut job = self.prepare_stored(run).await?.job(run);
            job.has_waited = self.waiting().contains(&run.uid);
            if !by_person {
                job.beginning = self.unasked().await?;
            }
            // Read before it: the campaign refuses the start after a sign or a lock that `refused` has not seen.
            let signs = self.inner.campaign.status().attended.signs;
            let decided_at = (Timestamp::now(), Instant::now());
            refused.await?;
            let start = Request::Start(Arc::new(job));
            self.inner.campaign.ask_since(start, signs, decided_at).await?;
            self.inner.begun.lock().insert(run.uid);
            self.forget(run.uid);
            Ok(())
        };
        beginning.instrument(run_span(run.uid, run.scan_id)).await
    }

    async fn say(&self, run: &RunRow, kind: &str, data: serde_json::Value) {
        if let Err(error) = self.inner.store.append_event(Some(run.uid), kind, data).await {
            tracing::error!(error = error_chain(&error), kind, "an event was not stored");
        }
    }

    /// Plans a stored run again, and compares the plan with the kept one. That of a run of an older version is kept now.
    async fn prepare_stored(&self, run: &RunRow) -> ConductorResult<Prepared> {
        let prepared = self.prepare(Submission::of(run)).await?.sound()?;
        same_label(run.scan_id, run.label, prepared.label)?;
        match self.inner.store.plan_of(run.uid).await? {
            Some(stored) => prepared.matches(run, &stored)?,
            None => self.inner.store.keep_plan(run.uid, prepared.plan_text.clone()).await?,
        }
        Ok(prepared)
    }

    /// Plans a submission and checks it for this rig, without queueing it.
    ///
    /// # Errors
    /// `ConductorError::Problems` if a file is invalid.
    pub(crate) async fn prepare(&self, submission: Submission) -> ConductorResult<Prepared> {
        let rig = self.inner.rig.clone();
        // A plan of 198,000 trials takes about 0.3 s: not on a thread that answers requests.
        let prepared = tokio::task::spawn_blocking(move || Prepared::of(&submission, &rig)).await;
        match prepared {
            Ok(prepared) => prepared.map_err(|problems| ConductorError::Problems { problems }),
            Err(_) => Err(ConductorError::Refused(Refusal::Gone)),
        }
    }

    /// Who started the runs that wait, or waited, in this process.
    fn starters(&self) -> BTreeMap<RunUid, String> {
        let starts = self.inner.handed_over.lock();
        starts.iter().map(|(run, start)| (*run, start.by.clone())).collect()
    }

    /// Forgets that a run was armed, started or dropped.
    fn forget(&self, run: RunUid) {
        self.armings().remove(&run);
        self.waiting().remove(&run);
        self.dropped().remove(&run);
    }

    fn waiting(&self) -> parking_lot::MutexGuard<'_, BTreeSet<RunUid>> {
        self.inner.waiting.lock()
    }

    fn dropped(&self) -> parking_lot::MutexGuard<'_, BTreeMap<RunUid, String>> {
        self.inner.dropped.lock()
    }

    fn armings(&self) -> parking_lot::MutexGuard<'_, BTreeMap<RunUid, Arming>> {
        self.inner.armings.lock()
    }
}

/// The refusal of a run because of the operator lock of another person.
fn locked(LockRow { holder, note, .. }: &LockRow) -> ConductorError {
    Refusal::State(format!("{holder} has taken the operator lock: {note}")).into()
}

fn startable(run: &RunRow) -> ConductorResult<()> {
    match run.state {
        StoredState::Queued => Ok(()),
        _ if run.is_resumable => Ok(()),
        StoredState::Ended => Err(ConductorError::Forbidden(format!(
            "run {} has ended: nothing of it remains to be measured",
            run.scan_id
        ))),
        state => Err(ConductorError::Forbidden(format!(
            "run {} is {state}: only a queued, an interrupted or a stopped run can be started",
            run.scan_id
        ))),
    }
}
