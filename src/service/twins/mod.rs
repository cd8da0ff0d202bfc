//! The pool of threads that simulates the twin of every stored trial (paper, Sim-Hex).
//! Uses: sim-core, `store`, `campaign` (its status, and the request to suspend). Never: a job row,
//! a delay of the campaign; pending trials are queried from the store.
//!
//! The active run has priority, then the newest one. One page of trials is read, simulated by the
//! workers and stored in one transaction; then the priority is determined again. `elsewhere` lets other machines
//! make twins, and stores them after a check.

pub mod drift;
pub mod elsewhere;
mod make;
mod progress;
pub mod skins;

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use serde::Serialize;
use sim_core::calibration::Calibration;
use sim_core::forward::ForwardModel;
use sim_core::sensor::Sensor;
use tracing::Instrument;
use utoipa::ToSchema;

use self::drift::{DriftWatch, Level, Pairing, RollingFit};
use self::make::{Recipe, twins_of};
use self::progress::Progress;
use self::skins::{SkinCalibration, SkinError, Source, WarmSkins};
use crate::campaign::shown::command::{Handle, Request};
use crate::campaign::spans::run_span;
use crate::ids::{CalibrationId, RunUid, TrialId};
use crate::journal::error_chain;
use crate::problem::listed;
use crate::rig::setup::RigSetup;
use crate::schedule::experiment::Experiment;
use crate::store::{
    IMPORTED_MODEL, NewTwinModel, RunKind, RunRow, Store, StoreError, StoreResult, TrialRow, Twin,
    TwinCount, TwinModelId, TwinOutcome,
};

/// Number of trials per worker in a page: a few milliseconds of work, and a transaction that does
/// not delay a trial's commit for longer.
const WORKER_TRIALS: usize = 16;
/// Interval of polling the store if nothing is pending.
const PENDING_POLL: Duration = Duration::from_millis(250);
/// Pause after a failure of the store.
const BACK_OFF: Duration = Duration::from_secs(5);
/// Interval at which skipped trials, and runs without pending trials, are checked again.
const RECONCILE: Duration = Duration::from_secs(60);

/// Status of the pool.
#[derive(Debug, Clone, Default, Serialize, ToSchema)]
pub struct PoolStatus {
    /// Number of threads that simulate.
    pub workers: usize,
    /// Number of twins made since the service started.
    pub made: u64,
    /// Twins per second, moving average over pages; absent before the first page.
    pub per_s: Option<f64>,
    /// The last failure, as text.
    pub last_error: Option<String>,
    /// Fit of the last active run over its window; absent before its first twin.
    pub rolling: Option<RollingFit>,
}

/// The pool. Clones share it.
#[derive(Clone)]
pub struct TwinPool {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    campaign: Handle,
    /// Calibration of the service with its id.
    calibration: Option<(CalibrationId, Arc<Calibration>)>,
    skins: WarmSkins,
    workers: usize,
    status: Mutex<PoolStatus>,
    models: Mutex<HashMap<RunUid, TwinModelId>>,
    /// Runs of which this process makes no further twin.
    settled: Mutex<HashSet<RunUid>>,
}

/// Why the twins of a run cannot be made or stored.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum PoolError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("run {run}: its {file} file cannot be used: {why}")]
    File { run: i64, file: &'static str, why: String },
    /// The run, by its number, was measured on another kind of skin, or simulated.
    #[error("run {0}: there is no model of its skin")]
    Foreign(i64),
    /// Twins that were made elsewhere are not those of this run; the text is the cause.
    #[error("the file of twins {0}")]
    Made(String),
    #[error(
        "trial {0}: its stored twin differs from that of the file, and stays; make the chunk again on a machine like \
         that of the service"
    )]
    OtherTwin(i64),
    #[error("a worker panicked")]
    Worker,
}

impl TwinPool {
    /// Creates a pool of `workers` threads; 0 makes no twins. `calibration` applies to runs on its
    /// sensor; unit responses are cached in `cache_dir`.
    pub fn new(
        store: Store,
        campaign: Handle,
        calibration: Option<Calibration>,
        cache_dir: PathBuf,
        workers: usize,
    ) -> Self {
        let status = Mutex::new(PoolStatus { workers, ..PoolStatus::default() });
        let (models, settled) = (Mutex::default(), Mutex::default());
        let with_id = |c: Calibration| Some((CalibrationId::unchecked(c.id().ok()?), Arc::new(c)));
        let calibration = calibration.and_then(with_id);
        let skins = WarmSkins::new(cache_dir);
        let inner = Inner { store, campaign, calibration, skins, workers, status, models, settled };
        Self { inner: Arc::new(inner) }
    }

    /// The models that the pool keeps warm.
    pub fn skins(&self) -> &WarmSkins {
        &self.inner.skins
    }

    /// The calibration of the service, if it applies to a sensor, with its id.
    pub fn calibration_of(&self, sensor_name: &str) -> Option<SkinCalibration> {
        let own = self.inner.calibration.as_ref().filter(|(_, c)| c.sensor == sensor_name)?;
        Some(SkinCalibration { id: own.0.clone(), source: Source::Here(own.1.clone()) })
    }

    /// Current status of the pool.
    pub fn status(&self) -> PoolStatus {
        self.inner.status.lock().clone()
    }

    /// Counts the twins of a run, made by the model that the pool uses for it.
    ///
    /// # Errors
    /// `StoreError` if the store fails.
    pub async fn count(&self, run: RunUid) -> StoreResult<TwinCount> {
        let model = self.inner.models.lock().get(&run).copied().unwrap_or(TwinModelId::NONE);
        self.inner.store.twin_count(run, model).await
    }

    /// Whether this process still makes twins of a run: of one that has ended, trials remain without a twin if a page
    /// of it was set aside, or if its files or a trial of it are damaged.
    ///
    /// # Errors
    /// `StoreError` if the store fails.
    pub async fn awaits(&self, run: RunUid) -> StoreResult<bool> {
        let is_pending = self.count(run).await?.pending() > 0;
        Ok(is_pending && self.inner.workers > 0 && !self.inner.settled.lock().contains(&run))
    }

    /// Makes twins until the future is dropped. Twins that are not stored are pending at the next
    /// start.
    pub async fn work(self) {
        if self.inner.workers == 0 {
            return;
        }
        let mut progress = Progress::default();
        let mut reconciled = Instant::now();
        loop {
            if reconciled.elapsed() > RECONCILE {
                reconciled = Instant::now();
                progress.passed.clear();
                progress.done.clear();
            }
            match self.next_page(&mut progress).await {
                Ok(true) => {}
                Ok(false) => tokio::time::sleep(PENDING_POLL).await,
                Err(error) => {
                    tracing::warn!(error = error_chain(&error), "twins could not be made");
                    self.show(|status| status.last_error = Some(error.to_string()));
                    tokio::time::sleep(BACK_OFF).await;
                }
            }
        }
    }

    /// Makes the twins of one page, and notes of which runs no further twin is made; returns `false` if nothing is
    /// pending in any run.
    async fn next_page(&self, progress: &mut Progress) -> Result<bool, PoolError> {
        let page = self.page(progress).await;
        // After a failure a run may have trials that were not read.
        let settled = if page.is_ok() { progress.settled() } else { HashSet::new() };
        *self.inner.settled.lock() = settled;
        page
    }

    async fn page(&self, progress: &mut Progress) -> Result<bool, PoolError> {
        let store = &self.inner.store;
        let active = self.inner.campaign.status().run.map(|run| run.uid);
        if progress.watch.as_ref().is_some_and(|(watched, _)| Some(*watched) != active) {
            // The fit of a run that has ended is not that of the next.
            progress.watch = None;
            self.show(|status| status.rolling = None);
        }
        // A run that was resumed has new trials.
        progress.done.retain(|run| Some(*run) != active);
        let others = store.runs_with_trials().await?.into_iter().filter(|r| Some(*r) != active);
        let limit = (self.inner.workers * WORKER_TRIALS) as u32;
        for run in active.into_iter().chain(others) {
            let given_up = progress.unusable.contains(&run);
            if given_up || progress.done.contains(&run) {
                continue;
            }
            let recipe = match self.recipe(run, progress).await {
                Ok(recipe) => recipe,
                Err(PoolError::Foreign(_)) => {
                    progress.unusable.insert(run);
                    continue;
                }
                Err(error @ PoolError::File { .. }) => {
                    progress.unusable.insert(run);
                    return Err(error);
                }
                Err(PoolError::Worker) if progress.panicked(run, TrialId(0)) => {
                    tracing::error!(%run, "a run gets no twins before the next start");
                    progress.unusable.insert(run);
                    return Err(PoolError::Worker);
                }
                Err(error) => return Err(error),
            };
            let after = progress.passed.get(&run).copied().unwrap_or(TrialId(0));
            let mut trials = match store.pending_twins(run, recipe.id, after, limit).await {
                // Older runs still get their twins.
                Err(error @ (StoreError::Damaged { .. } | StoreError::Unreadable { .. })) => {
                    progress.unusable.insert(run);
                    return Err(error.into());
                }
                trials => trials?,
            };
            let Some((last, scan_id)) = trials.last().map(|t| (t.trial_id, t.scan_id)) else {
                // Further trials of the active run will follow.
                if Some(run) != active {
                    progress.done.insert(run);
                    progress.recipes.remove(&run);
                }
                continue;
            };
            trials.retain(|trial| !progress.set_aside.contains(&trial.trial_id));
            let span = run_span(run, scan_id);
            let making = async {
                let began = Instant::now();
                let page: Vec<TrialId> = trials.iter().map(|trial| trial.trial_id).collect();
                let trials = Arc::new(trials);
                let made = twins_of(&recipe, &trials, self.inner.workers).await;
                let twins = progress.made(run, &page, made)?;
                store.insert_twins(recipe.id, twins.clone()).await?;
                progress.passed.insert(run, last);
                self.count_made(twins.len(), began.elapsed());
                if Some(run) == active && !twins.is_empty() {
                    self.watch(run, &recipe, &trials, &twins, progress).await?;
                }
                Ok(true)
            };
            return making.instrument(span).await;
        }
        Ok(false)
    }

    /// The model of a run's sensor file, with the calibration if it applies, and the force noise of
    /// its rig, which defines a contact.
    async fn recipe(&self, run: RunUid, progress: &mut Progress) -> Result<Recipe, PoolError> {
        if let Some(recipe) = progress.recipes.get(&run) {
            return Ok(recipe.clone());
        }
        let recipe = self.stored_recipe(run).await?;
        progress.recipes.insert(run, recipe.clone());
        Ok(recipe)
    }

    /// The recipe of a run, whose model is stored.
    async fn stored_recipe(&self, run: RunUid) -> Result<Recipe, PoolError> {
        let row = self.row(run).await?;
        let recipe = self.unstored_recipe(&row).await?;
        let new = NewTwinModel {
            hash: recipe.model.model_hash().to_owned(),
            sensor_sha256: row.sensor_sha256.clone(),
            calibration_id: recipe.model.sensor().calibration().map(CalibrationId::unchecked),
            version: env!("CARGO_PKG_VERSION").into(),
            git_commit: crate::commit::known().map(Into::into),
        };
        let id = self.inner.store.twin_model(new).await?;
        self.inner.models.lock().insert(run, id);
        Ok(Recipe { id, ..recipe })
    }

    /// The recipe of a run, whose model has no number.
    async fn unstored_recipe(&self, row: &RunRow) -> Result<Recipe, PoolError> {
        let unusable = |file, why: String| PoolError::File { run: row.scan_id, file, why };
        let force_noise_n = match &row.rig {
            Some(rig) => RigSetup::from_toml("rig", rig)
                .map_err(|problems| unusable("rig", listed(&problems)))?
                .force_noise_n()
                .unwrap_or(0.0),
            // Contacts of an import are used as they are.
            None => 0.0,
        };
        if row.kind == RunKind::Imported && self.is_foreign(row).await? {
            return Err(PoolError::Foreign(row.scan_id));
        }
        let model = self.skin(row).await?;
        Ok(Recipe { model, id: TwinModelId::NONE, kind: row.kind, force_noise_n })
    }

    /// Whether an import is of another kind of skin, or contains simulated frames.
    async fn is_foreign(&self, row: &RunRow) -> Result<bool, PoolError> {
        if Sensor::from_toml(&row.sensor).is_err() {
            return Ok(true);
        }
        let extent = self.inner.store.run_extent(row.uid).await?;
        let Some(hash) = extent.model else { return Ok(false) };
        let model = self.inner.store.twin_model_of(&hash).await?;
        Ok(model.is_some_and(|model| model.version == IMPORTED_MODEL))
    }

    async fn row(&self, run: RunUid) -> Result<RunRow, PoolError> {
        let row = self.inner.store.run(run).await?;
        row.ok_or(PoolError::Store(StoreError::NoSuchRun(run)))
    }

    async fn skin(&self, row: &RunRow) -> Result<Arc<ForwardModel>, PoolError> {
        let unusable = |why: String| PoolError::File { run: row.scan_id, file: "sensor", why };
        let sensor = Sensor::from_toml(&row.sensor).map_err(|e| unusable(e.to_string()))?;
        let built = self.inner.skins.of(&row.sensor, self.calibration_of(&sensor.file.name));
        match built.instrument(run_span(row.uid, row.scan_id)).await {
            Ok(skin) => Ok(skin.model.clone()),
            Err(SkinError::Worker) => Err(PoolError::Worker),
            Err(error) => Err(unusable(error.to_string())),
        }
    }

    /// Updates the rolling fit of the active run, which may warn or suspend it.
    async fn watch(
        &self,
        run: RunUid,
        recipe: &Recipe,
        trials: &[TrialRow],
        twins: &[Twin],
        progress: &mut Progress,
    ) -> Result<(), PoolError> {
        if progress.watch.as_ref().is_none_or(|(watched, _)| *watched != run) {
            let row = self.row(run).await?;
            let limits = Experiment::from_toml("experiment", &row.definition)
                .map(|experiment| experiment.twins)
                .unwrap_or_default();
            let electrodes = recipe.model.circuit().electrodes.len();
            progress.watch = Some((run, DriftWatch::new(limits, electrodes)));
        }
        let Some((_, watch)) = progress.watch.as_mut() else { return Ok(()) };
        for (trial, twin) in trials.iter().zip(twins) {
            let changed = pairing(trial, twin).and_then(|pairing| watch.push(pairing));
            let Some(fit) = changed else { continue };
            let words = fit.describe(watch.limits());
            let data = fit.event(watch.limits());
            if let Err(error) = self.inner.store.append_event(Some(run), "twins", data).await {
                tracing::error!(error = error_chain(&error), "an event was not stored");
            }
            if fit.level == Level::Suspend
                && let Err(refusal) = self.inner.campaign.ask(Request::Suspend(run, words)).await
            {
                tracing::warn!(%refusal, "the run was not suspended");
            }
        }
        let fit = watch.fit();
        self.show(|status| status.rolling = Some(fit));
        Ok(())
    }

    fn count_made(&self, made: usize, took: Duration) {
        let now = made as f64 / took.as_secs_f64().max(1e-9);
        self.show(|status| {
            status.made += made as u64;
            status.per_s = Some(status.per_s.map_or(now, |before| 0.9 * before + 0.1 * now));
        });
    }

    fn show(&self, change: impl FnOnce(&mut PoolStatus)) {
        change(&mut self.inner.status.lock());
    }
}

fn pairing(trial: &TrialRow, twin: &Twin) -> Option<Pairing> {
    match (&twin.outcome, &trial.voltages_v) {
        (TwinOutcome::Frame { voltages_v, fvu: Some(fvu), .. }, Some(measured_v)) => {
            Some(Pairing {
                max_force_n: trial.max_force_n?,
                measured_v: measured_v.clone(),
                simulated_v: voltages_v.clone(),
                fvu: *fvu,
            })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::estop::StopSwitch;
    use crate::campaign::shown::command::channel;
    use crate::campaign::shown::show;
    use crate::clock::Clock;
    use crate::record::Label;
    use crate::store::{ImportedTrial, NewRun};

    /// A run whose files cannot be used, with one trial.
    async fn unusable_run(store: &Store) -> RunUid {
        let new = NewRun {
            uid: RunUid::new(),
            experiment: "small".into(),
            kind: RunKind::RealRandom,
            definition: "no experiment".into(),
            seed: Some(1),
            rig: Some("no rig".into()),
            sensor: "no sensor".into(),
            calibration_id: None,
            label: Label::Virtual,
            version: "0.1.0".into(),
            git_commit: None,
            deadband_n: 5.0,
            tip_diameter_mm: None,
            plan: None,
            trials_planned: 1,
            auto_resume: false,
            not_before: None,
            submitted_by: "ada".into(),
        };
        let run = store.create_run(new).await.unwrap().uid;
        let trial = ImportedTrial { voltages_v: vec![0.1; 784], ..ImportedTrial::default() };
        store.import_trials(run, None, vec![trial]).await.unwrap();
        run
    }

    #[tokio::test]
    async fn twins_that_this_process_does_not_make_are_not_awaited() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("palpate.db"), Clock::new(1.0)).await.unwrap();
        let run = unusable_run(&store).await;
        let rig = include_str!("../../../experiments/rigs/virtual.toml");
        let rig = RigSetup::from_toml("virtual.toml", rig).unwrap();
        let (campaign, _inbox) = channel(StopSwitch::default(), show::closed(&rig));
        let pool = |workers| {
            TwinPool::new(store.clone(), campaign.clone(), None, folder.path().into(), workers)
        };
        assert!(!pool(0).awaits(run).await.unwrap(), "this service makes none");
        let (pool, mut progress) = (pool(1), Progress::default());
        assert!(pool.awaits(run).await.unwrap());
        let failed = pool.next_page(&mut progress).await;
        assert!(matches!(failed, Err(PoolError::File { .. })), "{failed:?}");
        assert!(pool.awaits(run).await.unwrap(), "other trials were not read");
        assert!(!pool.next_page(&mut progress).await.unwrap());
        assert!(!pool.awaits(run).await.unwrap());
        assert_eq!(pool.count(run).await.unwrap().pending(), 1);
    }
}
