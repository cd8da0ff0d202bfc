//! Long computations, one at a time: trainings of nets, evaluations of methods.
//! Uses: `learn`, `infer`, `evaluate`, `dataset::catalog`, `store`. Never: motion, HTTP, two at
//! once.
//!
//! A job is a row of the store: it resumes after a restart, a training from its last checkpoint. It
//! runs on a thread of low priority, so that it does not slow acquisition.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::{Value, json};
use tokio::sync::watch;
use tracing::{Instrument, error_span};

use crate::clock::Clock;
use crate::dataset::catalog::Catalog;
use crate::evaluate::request::EvaluationRequest;
use crate::infer::registry::Registry;
use crate::infer::serving::Serving;
use crate::journal::error_chain;
use crate::store::{JobEnd, JobKind, JobRow, Store};
use starts::{STARTS_MAX, Starts};

mod error;
mod evaluation;
mod gathered;
mod starts;
#[cfg(not(feature = "train"))]
#[path = "lean.rs"]
mod training;
#[cfg(feature = "train")]
mod training;
mod watch_job;

pub use error::JobError;
pub use watch_job::{Progress, Watch};

/// Largest number of waiting jobs.
const WAITING_MAX: u32 = 1000;
/// Name of the file with a training's losses.
const LOSSES: &str = "losses.ndjson";
/// Interval at which the worker checks for jobs if it is not notified.
const IDLE: Duration = Duration::from_millis(500);

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
    running: Mutex<Option<(String, Arc<Watch>)>>,
    changed: watch::Sender<u64>,
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
        let (running, changed) = (Mutex::default(), watch::Sender::new(0));
        let (data, clock) = (data.to_owned(), Clock::new(1.0));
        let inner = Inner { store, datasets, models, serving, data, clock, running, changed };
        Self { inner: Arc::new(inner) }
    }

    /// Stores a request for a training, after a check of its recipe.
    ///
    /// # Errors
    /// `JobError` if the recipe is invalid, the queue is full, or the store fails.
    pub async fn train(&self, recipe: &str, asked_by: &str) -> Result<JobRow, JobError> {
        training::check(recipe)?;
        self.ask(JobKind::Training, json!({ "recipe": recipe }), asked_by).await
    }

    /// Stores a request for an evaluation, after a check of its values.
    ///
    /// # Errors
    /// `JobError` if a value is invalid, the queue is full, or the store fails.
    pub async fn evaluate(
        &self,
        request: &EvaluationRequest,
        asked_by: &str,
    ) -> Result<JobRow, JobError> {
        request.check()?;
        let request = serde_json::to_value(request).map_err(JobError::Json)?;
        self.ask(JobKind::Evaluation, request, asked_by).await
    }

    async fn ask(&self, kind: JobKind, request: Value, who: &str) -> Result<JobRow, JobError> {
        let waiting = self.inner.store.open_jobs(WAITING_MAX).await?.len();
        if waiting >= WAITING_MAX as usize {
            return Err(JobError::Full(WAITING_MAX));
        }
        let id = format!("job-{}", uuid::Uuid::now_v7());
        let row = self.inner.store.create_job(id, kind, request, who).await?;
        self.inner.changed.send_modify(|changes| *changes += 1);
        Ok(row)
    }

    /// Ends a job, waiting or running. An ended one does not change.
    ///
    /// # Errors
    /// `JobError::Store` if the store fails.
    pub async fn stop(&self, id: &str) -> Result<(), JobError> {
        if let Some(watch) = self.watch(id) {
            watch.stop();
        } else {
            self.inner.store.end_job(id, JobEnd::Stopped).await?;
        }
        Ok(())
    }

    /// Progress of a running job.
    pub fn progress(&self, id: &str) -> Option<Progress> {
        self.watch(id).map(|watch| watch.progress())
    }

    /// The losses of a training so far: one JSON object per line. Empty for other jobs.
    pub fn losses(&self, id: &str) -> String {
        std::fs::read_to_string(self.folder(id).join(LOSSES)).unwrap_or_default()
    }

    /// Folder of a job's files while it runs.
    fn folder(&self, id: &str) -> PathBuf {
        self.inner.data.join("jobs").join(id)
    }

    fn watch(&self, id: &str) -> Option<Arc<Watch>> {
        let running = self.inner.running.lock();
        running.as_ref().filter(|(of, _)| of == id).map(|(_, watch)| watch.clone())
    }

    /// Runs jobs, oldest first, until the future is dropped.
    pub async fn work(self) {
        let mut changed = self.inner.changed.subscribe();
        loop {
            match self.inner.store.open_jobs(1).await {
                Ok(open) if !open.is_empty() => {
                    for job in open {
                        let kind = match job.kind {
                            JobKind::Training => "training",
                            JobKind::Evaluation => "evaluation",
                        };
                        let span = error_span!("job", id = job.id, kind);
                        self.carry_out(job).instrument(span).await;
                    }
                    continue;
                }
                Ok(_) => {}
                Err(error) => {
                    let error = error.with_causes();
                    tracing::warn!(error, "the queue of jobs could not be read");
                }
            }
            // A missed change is found at the next check.
            let _ = tokio::time::timeout(IDLE, changed.changed()).await;
        }
    }

    async fn carry_out(&self, job: JobRow) {
        let watch = Arc::new(Watch::default());
        let starts = Starts::of(&self.folder(&job.id));
        let in_vain = !starts.begin();
        // When the service ends, this is dropped, and the working thread writes a checkpoint.
        let _leaves = Leaves(watch.clone(), starts);
        self.set_running(Some((job.id.clone(), watch.clone())));
        tracing::info!("a job begins");
        let outcome = match self.inner.store.begin_job(&job.id, None).await {
            Ok(()) if in_vain => Err(JobError::InVain(STARTS_MAX)),
            Ok(()) if job.kind == JobKind::Training => training::run(self, &job, &watch).await,
            Ok(()) => evaluation::run(self, &job, &watch).await,
            Err(error) => Err(error.into()),
        };
        let end = match outcome {
            Ok(Some(result)) => {
                tracing::info!("a job is complete");
                JobEnd::Done(result)
            }
            Ok(None) => {
                tracing::info!("a job was stopped");
                JobEnd::Stopped
            }
            Err(error) => {
                tracing::warn!(error = error_chain(&error), "a job has failed");
                JobEnd::Failed(error.to_string())
            }
        };
        if let Err(error) = self.inner.store.end_job(&job.id, end).await {
            tracing::error!(error = error.with_causes(), "the end of a job was not stored");
            tokio::time::sleep(IDLE).await;
        }
        self.set_running(None);
    }

    fn set_running(&self, job: Option<(String, Arc<Watch>)>) {
        *self.inner.running.lock() = job;
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
