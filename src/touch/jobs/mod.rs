//! Long computations, one at a time: trainings of nets, evaluations of methods.
//! Uses: `learn`, `infer`, `evaluate`, `dataset::catalog`, `store`. Never: motion, HTTP, two at
//! once.
//!
//! A job is a task of the store: it resumes after a restart, a training from its last checkpoint. It
//! runs at low priority, so that it does not slow acquisition: an evaluation on a thread, a training in
//! a separate process (`trainer`). Trainings that other machines make are in `chunks`, answers to the frames of
//! an evaluation in `readings`: they need no store.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;

use crate::clock::Clock;
use crate::dataset::catalog::Catalog;
use crate::evaluate::request::EvaluationRequest;
use crate::ids::TaskId;
use crate::infer::registry::Registry;
use crate::infer::serving::Serving;
use crate::journal::error_chain;
use crate::learn::order::{CHECKPOINT, LOSSES};
use crate::learn::recipe::Recipe;
use crate::store::{Store, TaskEnd, TaskKind, TaskQueue, TaskRow, TaskState};
use starts::{STARTS_MAX, Starts};

pub mod chunks;
mod error;
mod evaluation;
mod gathered;
mod kept;
pub mod readings;
mod scoring;
mod starts;
mod trainer;
mod training;
mod watch_job;

pub use error::{JobError, JobResult};
pub use training::TrainingRequest;
pub use watch_job::{Progress, Watch, warnings_of};

/// Largest number of waiting jobs.
const WAITING_JOBS_MAX: u32 = 1000;

/// The jobs of a service. Clones share them.
#[derive(Clone)]
pub struct Jobs {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    datasets: Catalog,
    models: Registry,
    serving: Serving,
    data: PathBuf,
    clock: Clock,
    queue: TaskQueue<Watch>,
}

impl Jobs {
    /// Opens the jobs of a data folder.
    pub fn new(
        store: Store,
        datasets: Catalog,
        models: Registry,
        serving: Serving,
        data: &Path,
    ) -> Self {
        let queue = TaskQueue::new(store.clone(), TaskKind::JOBS);
        let (data, clock) = (data.to_owned(), Clock::new(1.0));
        let inner = Inner { store, datasets, models, serving, data, clock, queue };
        Self { inner: Arc::new(inner) }
    }

    /// Stores a request for a training, after a check of its recipe.
    ///
    /// # Errors
    /// `JobError` if the recipe is invalid, the queue is full, or the store fails.
    pub async fn train(&self, request: &TrainingRequest, asked_by: &str) -> JobResult<TaskRow> {
        Recipe::from_toml("recipe", &request.recipe)?;
        let request = serde_json::to_value(request).map_err(JobError::Json)?;
        self.ask(TaskKind::Training, request, asked_by).await
    }

    /// Stores a request for an evaluation, after a check of its values.
    ///
    /// # Errors
    /// `JobError` if a value is invalid, the queue is full, or the store fails.
    pub async fn evaluate(
        &self,
        request: &EvaluationRequest,
        asked_by: &str,
    ) -> JobResult<TaskRow> {
        request.check()?;
        let request = serde_json::to_value(request).map_err(JobError::Json)?;
        self.ask(TaskKind::Evaluation, request, asked_by).await
    }

    async fn ask(&self, kind: TaskKind, request: Value, who: &str) -> JobResult<TaskRow> {
        if self.inner.queue.is_full(WAITING_JOBS_MAX).await? {
            return Err(JobError::Full(WAITING_JOBS_MAX));
        }
        Ok(self.inner.queue.add(kind, request, who).await?)
    }

    /// Ends a job, waiting or running. An ended one does not change.
    ///
    /// # Errors
    /// `JobError::Store` if the store fails.
    pub async fn stop(&self, id: TaskId) -> JobResult<()> {
        Ok(self.inner.queue.stop(id, Watch::stop).await?)
    }

    /// Progress of a running job.
    pub fn progress(&self, id: TaskId) -> Option<Progress> {
        self.inner.queue.running(id).map(|watch| watch.progress())
    }

    /// The losses of a training so far: one JSON object per line. Empty for other jobs.
    pub fn losses(&self, id: TaskId) -> String {
        std::fs::read_to_string(self.folder(id).join(LOSSES)).unwrap_or_default()
    }

    /// Folder of a job's files until its end is stored.
    fn folder(&self, id: TaskId) -> PathBuf {
        self.inner.data.join("jobs").join(id.to_string())
    }

    /// Runs jobs, oldest first, until the future is dropped.
    pub async fn work(self) {
        let run = |job: TaskRow, watch| {
            let jobs = self.clone();
            async move { jobs.carry_out(&job, watch).await }
        };
        self.sweep().await;
        let ended = |id, end: &TaskEnd| {
            let folder = self.folder(id);
            match end {
                TaskEnd::Failed(_) if kept::is_kept(&folder) => None,
                // The losses of a failed training remain for diagnosis.
                TaskEnd::Failed(_) => std::fs::remove_file(folder.join(CHECKPOINT)).ok(),
                TaskEnd::Stopped if kept::keep(&folder) => None,
                TaskEnd::Done(_) | TaskEnd::Stopped => std::fs::remove_dir_all(folder).ok(),
            };
        };
        self.inner.queue.work(run, ended).await;
    }

    /// Removes the folders of jobs whose end was stored before they could be removed.
    async fn sweep(&self) {
        let Ok(folders) = std::fs::read_dir(self.inner.data.join("jobs")) else { return };
        for folder in folders.flatten() {
            let Ok(id) = folder.file_name().to_string_lossy().parse() else { continue };
            let job = self.inner.store.task(id).await.ok().flatten();
            let over = |job: TaskRow| matches!(job.state, TaskState::Done | TaskState::Stopped);
            if job.is_some_and(over) && !kept::is_kept(&folder.path()) {
                std::fs::remove_dir_all(folder.path()).ok();
            }
        }
    }

    async fn carry_out(&self, job: &TaskRow, watch: Arc<Watch>) -> TaskEnd {
        let starts = Starts::of(&self.folder(job.id));
        let in_vain = !starts.begin();
        // When the service ends, this is dropped, and the trainer writes a checkpoint.
        let _leaves = Leaves(watch.clone(), starts);
        let outcome = if in_vain {
            Err(JobError::InVain(STARTS_MAX))
        } else if job.kind == TaskKind::Training {
            training::run(self, job, &watch).await
        } else {
            evaluation::run(self, job, &watch).await
        };
        match outcome {
            Ok(Some(result)) => TaskEnd::Done(result),
            Ok(None) => TaskEnd::Stopped,
            Err(error) => {
                // The record of the job has the cause for those who requested it: a command that started this service
                // would report it twice.
                let error = error_chain(&error);
                tracing::info!(error, "a job has failed");
                TaskEnd::Failed(error)
            }
        }
    }
}

/// Stops a job whose worker was dropped; such an end is not a crash.
struct Leaves(Arc<Watch>, Starts);

impl Drop for Leaves {
    fn drop(&mut self) {
        self.0.stop();
        self.1.got_on();
    }
}
