//! `GET /api/v1/status`: snapshot of rig, run and service.
//! Uses: `campaign::shown::status`, `suspenders`, `store`. Never: a wait for the rig.

use std::sync::Arc;

use axum::Json;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::glance::{Facts, Glance, glances};
use super::history::predicted;
use super::needs::{Around, Need, needs};
use super::people::LockOut;
use super::problem::ApiResult;
use super::refusals::{self, ActionStatus};
use super::suspenders::{Readings, Suspender};
use crate::campaign::shown::status::{RunStatus, Status};
use crate::conductor::{resumes_automatically, room};
use crate::ids::RunUid;
use crate::schedule::experiment::{Experiment, TwinLimits};
use crate::state::PausedWhy;
use crate::store::{LockRow, StoreError, StoreResult};

/// Time after which a pause is stored, unless the database fails, wall.
const STORED_WITHIN: SignedDuration = SignedDuration::from_secs(3);

/// Status of rig, run and service.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ServiceStatus {
    /// Time of the service at which the status was made, for `Status-At`. It does not follow a wall clock that is set.
    pub at: Timestamp,
    /// Status of rig and run.
    #[serde(flatten)]
    pub campaign: Status,
    /// Actions that this rig has, each with the reason why it would be refused now. The role of a key and the
    /// operator lock may refuse more. While the rig moves outside a run, every action is refused. `check` is a check of
    /// the rig.
    pub rig_actions: Vec<ActionStatus>,
    /// Actions on a run, each with the reason why it would be refused now. `start` is of a run that is queued,
    /// interrupted or stopped, and of one that presses: a manual run needs open wires only. All others are of the active
    /// run. `pause` is a pause at the checkpoint. The role of a key and the operator lock may refuse more, and while the
    /// rig homes for a paused run, more is refused.
    pub run_actions: Vec<ActionStatus>,
    /// Version and process of the service.
    pub service: ServiceInfo,
    /// The operator lock; absent if it is free.
    pub lock: Option<LockOut>,
    /// Number of runs in the queue.
    pub queue_length: usize,
    /// What the next run that was started waits for, as text: its start time, or the active run. If none waits
    /// any more because a person may be at the rig, which run must be started again, and why; absent otherwise.
    pub waiting_for: Option<String>,
    /// Which run does not begin by itself although a person had started it, and why, as text: a person must start it
    /// again, or remove it. Absent if there is none.
    pub not_begun: Option<String>,
    /// Free space of the disk of the data folder; null if it is unknown.
    pub disk: Option<DiskStatus>,
    /// Time of measurement of the newest durable trial of the active run; null without one.
    pub last_trial_at: Option<Timestamp>,
    /// What may suspend the active run; empty without one.
    pub suspenders: Vec<Suspender>,
    /// What a person must do, the most urgent first; empty if nothing.
    pub needs: Vec<Need>,
    /// The night at a glance: is it safe, is it on time, are the data good?
    pub glance: Vec<Glance>,
}

/// Space of the disk of the data folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DiskStatus {
    /// Free space, bytes.
    pub free_bytes: u64,
    /// Space that the active run and the queue still need, bytes.
    pub needed_bytes: u64,
}

/// The part of the status that is stored.
#[derive(Debug, Clone, Default)]
pub(super) struct StoredPart {
    lock: Option<LockRow>,
    queue_length: usize,
    waiting_for: Option<String>,
    not_begun: Option<String>,
    /// Space that the queued runs need, bytes.
    queue_bytes: u64,
    last_trial_at: Option<Timestamp>,
    /// The active run, if a service that starts now would resume it automatically, and when its row was read.
    resumes: Option<(RunUid, Timestamp)>,
    /// Limits of the fit of the active run; absent without one.
    limits: Option<Arc<TwinLimits>>,
    /// Name and number of trials of the first run of the queue.
    next: Option<(String, u64)>,
    /// Start of the active run, and its duration as it was predicted then, s.
    predicted: Option<(Timestamp, f64)>,
}

/// Version and process of the service.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ServiceInfo {
    /// Version of the program.
    pub version: &'static str,
    /// Commit of the program; absent if it is unknown.
    pub git_commit: Option<&'static str>,
    /// Path of the database file.
    pub database: String,
    /// Time of the start of the service.
    pub started_at: Timestamp,
    /// Process id of the service.
    pub pid: u32,
    /// Number of requests without a valid key since the start.
    pub wrong_keys: u64,
    /// Time of the last one; absent if there was none.
    pub wrong_key_at: Option<Timestamp>,
}

/// Returns the status of rig, run and service.
#[utoipa::path(get, path = "/api/v1/status", tag = "status",
    responses((status = 200, body = ServiceStatus)))]
pub async fn status(app: App) -> ApiResult<Json<ServiceStatus>> {
    let stored = app.stored_part().await?;
    Ok(Json(app.status_with(stored).await))
}

impl App {
    /// Reads the part of the status that is stored.
    pub(super) async fn stored_part(&self) -> StoreResult<StoredPart> {
        let queue = self.store.queue().await?;
        let channels = self.serving.sensor().channels() as u64;
        let active = self.campaign.status().run.map(|run| run.uid);
        let read_at = Timestamp::now();
        let (last_trial_at, limits, predicted, row) = match active {
            Some(run) => (
                self.store.last_trial_at(run).await?,
                self.limits_of(run).await?,
                self.facts.memory.predicted.get(run, predicted(&self.store, run)).await?,
                self.store.run(run).await?,
            ),
            None => (None, None, None, None),
        };
        let mut queue_bytes = 0;
        for run in &queue {
            let key = (run.definition_sha256.clone(), run.trials_planned);
            let needed = async { Ok::<_, StoreError>(room::needed_bytes(run, channels)) };
            // An experiment file that cannot be read is refused when it is armed.
            queue_bytes += self.facts.memory.room.get(key, needed).await?.unwrap_or(0);
        }
        Ok(StoredPart {
            lock: self.store.lock().await?,
            queue_length: queue.len(),
            waiting_for: self.conductor.waiting_for().await?,
            not_begun: self.conductor.not_begun().await?,
            queue_bytes,
            last_trial_at,
            resumes: row.filter(resumes_automatically).map(|row| (row.uid, read_at)),
            limits,
            next: queue.first().map(|run| (run.experiment.clone(), run.trials_planned)),
            predicted,
        })
    }

    /// Limits of the fit of a run's twins; absent if its experiment file cannot be read.
    async fn limits_of(&self, run: RunUid) -> StoreResult<Option<Arc<TwinLimits>>> {
        let read = async {
            let row = self.store.run(run).await?;
            let experiment =
                row.and_then(|row| Experiment::from_toml(&row.experiment, &row.definition).ok());
            Ok(experiment.map(|experiment| Arc::new(experiment.twins)))
        };
        self.facts.memory.limits.get(run, read).await
    }

    /// The status as it is now, with a stored part.
    pub(super) async fn status_with(&self, stored: StoredPart) -> ServiceStatus {
        let at = self.time();
        let (wrong_keys, wrong_key_at) = self.facts.wrong_keys.count();
        let service = ServiceInfo {
            version: env!("CARGO_PKG_VERSION"),
            git_commit: crate::commit::known(),
            database: self.store.path().display().to_string(),
            started_at: self.facts.started_at,
            pid: std::process::id(),
            wrong_keys,
            wrong_key_at,
        };
        let mut campaign = self.campaign.status();
        self.facts.memory.stopper.name(&mut campaign);
        let free_bytes = self.store.free_bytes().await.ok();
        let frame = self.campaign.watch_frames().borrow().clone();
        let twins = self.twins.status();
        let readings = campaign.run.as_ref().map(|run| Readings {
            free_bytes,
            needed_bytes: run.needed_bytes,
            frame_age_ms: frame.map(|frame| frame.received.elapsed().as_secs_f64() * 1e3),
            frame_age_limit_ms: self.facts.rig.config.frame_age_ms(),
            fit: twins.rolling.as_ref(),
            limits: stored.limits.as_deref(),
        });
        let suspenders = self.facts.memory.beyond.suspenders(readings.as_ref(), Timestamp::now());
        let of_run = campaign.run.as_ref().map_or(0, |run| run.needed_bytes);
        let needed_bytes = of_run + stored.queue_bytes;
        let around = Around {
            not_begun: stored.not_begun.as_deref(),
            space: free_bytes.map(|free_bytes| (free_bytes, needed_bytes)),
            suspenders: &suspenders,
            is_unstored: campaign.run.as_ref().is_some_and(|run| is_unstored(run, stored.resumes)),
        };
        let facts = Facts {
            next: stored.next.as_ref().map(|(name, trials)| (name.as_str(), *trials)),
            late: campaign.run.as_ref().and_then(|run| {
                let (from, predicted_s) = stored.predicted?;
                let elapsed_s = Timestamp::now().duration_since(from).as_secs_f64();
                Some((elapsed_s + run.eta?.remaining_s - predicted_s, predicted_s))
            }),
            fit: twins.rolling.as_ref(),
            broken_channels: self.facts.memory.counters.broken_channels(),
        };
        ServiceStatus {
            at,
            needs: needs(&campaign, around),
            glance: glances(&campaign, around, facts),
            rig_actions: refusals::of_rig(self, &campaign),
            run_actions: refusals::of_run(&campaign),
            campaign,
            service,
            lock: stored.lock.map(LockOut::from),
            queue_length: stored.queue_length,
            waiting_for: stored.waiting_for,
            not_begun: stored.not_begun,
            disk: free_bytes.map(|free_bytes| DiskStatus { free_bytes, needed_bytes }),
            last_trial_at: stored.last_trial_at,
            suspenders,
        }
    }
}

/// Whether a run waits, and was stored as one that resumes automatically although it had waited for a while. `resumes`:
/// such a run, and when it was read: what was read earlier states nothing.
fn is_unstored(run: &RunStatus, resumes: Option<(RunUid, Timestamp)>) -> bool {
    let (Some(since), Some((uid, read_at))) = (run.waits_since, resumes) else { return false };
    // As the service ends a run waits for the next one.
    let is_held = run.paused_why != Some(PausedWhy::Restart);
    is_held && uid == run.uid && read_at.duration_since(since) > STORED_WITHIN
}

#[cfg(test)]
mod tests {
    use super::super::needs::tests::waiting;
    use super::*;

    #[test]
    fn a_pause_is_not_stored_if_its_run_was_read_as_running_long_after_it() {
        let run = waiting(PausedWhy::Operator);
        let read = |after_s| Timestamp::UNIX_EPOCH + SignedDuration::from_secs(after_s);
        assert!(is_unstored(&run, Some((run.uid, read(4)))));
        // It is still being stored, was read before, or is another run.
        for (uid, after_s) in [(run.uid, 2), (run.uid, -4), (RunUid::new(), 4)] {
            assert!(!is_unstored(&run, Some((uid, read(after_s)))), "{after_s}");
        }
        assert!(!is_unstored(&run, None));
        let ends = RunStatus { uid: run.uid, ..waiting(PausedWhy::Restart) };
        assert!(!is_unstored(&ends, Some((run.uid, read(4)))), "it resumes as it should");
        let runs = RunStatus { waits_since: None, paused_why: None, ..run.clone() };
        assert!(!is_unstored(&runs, Some((run.uid, read(4)))));
    }
}
