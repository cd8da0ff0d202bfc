//! A queue of tasks: stored when requested, run one at a time, oldest first, continued after a restart.
//! Uses: `lab::tasks`. Never: the meaning of a request.
//!
//! A task that has run to its end runs again only if the process ends before its end is stored.
//!
//! Each queue serves some kinds of tasks, so that an export does not wait for a training. The caller
//! passes what one task does: the queue neither knows datasets nor nets.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt;
use parking_lot::Mutex;
use serde_json::Value;
use tokio::sync::Notify;
use tracing::{Instrument, error_span};

use super::tasks::{TaskEnd, TaskKind, TaskRow};
use crate::core::{Store, StoreResult};
use crate::ids::TaskId;
use crate::journal::error_chain;

/// Interval of polling the store if no task is open, and shortest pause after a failure of the store.
const TASKS_POLL: Duration = Duration::from_millis(500);
/// Longest pause between two attempts to store the end of a task.
const PAUSE_MAX: Duration = Duration::from_secs(60);

/// A queue of the tasks of some kinds. `W` is the state that a running task shares with those who ask
/// for its progress or stop it.
pub struct TaskQueue<W> {
    store: Store,
    kinds: &'static [TaskKind],
    running: Mutex<Option<(TaskId, Arc<W>)>>,
    added: Notify,
}

impl<W: Default> TaskQueue<W> {
    /// Creates the queue of these kinds. A kind must be in one queue only.
    pub fn new(store: Store, kinds: &'static [TaskKind]) -> Self {
        Self { store, kinds, running: Mutex::default(), added: Notify::new() }
    }

    /// Whether at least `limit` tasks wait or run.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn is_full(&self, limit: u32) -> StoreResult<bool> {
        Ok(self.store.open_tasks(self.kinds, limit).await?.len() >= limit as usize)
    }

    /// Stores a request for a task of one of the kinds, and wakes the worker.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn add(
        &self,
        kind: TaskKind,
        request: Value,
        asked_by: &str,
    ) -> StoreResult<TaskRow> {
        let row = self.store.create_task(kind, request, asked_by).await?;
        self.added.notify_one();
        Ok(row)
    }

    /// Shared state of a task while it runs; `None` before and after.
    pub fn running(&self, id: TaskId) -> Option<Arc<W>> {
        let running = self.running.lock();
        running.as_ref().filter(|(of, _)| *of == id).map(|(_, shared)| shared.clone())
    }

    /// Stops a task. `request` asks a running task to stop; a waiting task ends at once. A task that has
    /// ended does not change.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the end of a waiting task cannot be stored.
    pub async fn stop(&self, id: TaskId, request: impl Fn(&W)) -> StoreResult<()> {
        if let Some(shared) = self.running(id) {
            request(&shared);
            return Ok(());
        }
        self.store.end_task(id, TaskEnd::Stopped).await?;
        // The worker may have begun it meanwhile.
        if let Some(shared) = self.running(id) {
            request(&shared);
        }
        Ok(())
    }

    /// Runs the tasks, oldest first, until the future is dropped. `run` does what one task requests:
    /// long computations on a thread of low priority. If it panics, the task fails. `ended` is called
    /// once the end of a task is stored: only then may files go from which it could resume. Only one
    /// worker may serve a queue.
    pub async fn work<F>(
        &self,
        run: impl Fn(TaskRow, Arc<W>) -> F,
        ended: impl Fn(TaskId, &TaskEnd),
    ) where
        F: Future<Output = TaskEnd>,
    {
        loop {
            match self.store.open_tasks(self.kinds, 1).await.map(|open| open.into_iter().next()) {
                Ok(Some(task)) => {
                    let span = error_span!("task", id = %task.id, kind = %task.kind);
                    self.carry_out(task, &run, &ended).instrument(span).await;
                    continue;
                }
                Ok(None) => {}
                Err(error) => {
                    let error = error_chain(&error);
                    tracing::warn!(error, kinds = ?self.kinds, "the open tasks could not be read");
                }
            }
            // The timeout repeats a failed read.
            let _ = tokio::time::timeout(TASKS_POLL, self.added.notified()).await;
        }
    }

    async fn carry_out<F>(
        &self,
        task: TaskRow,
        run: &impl Fn(TaskRow, Arc<W>) -> F,
        ended: &impl Fn(TaskId, &TaskEnd),
    ) where
        F: Future<Output = TaskEnd>,
    {
        let (id, shared) = (task.id, Arc::new(W::default()));
        // Before the task begins, so that no stop is missed.
        *self.running.lock() = Some((id, shared.clone()));
        let begun = loop {
            match self.store.begin_task(id, None).await {
                Ok(begun) => break begun,
                // The shared state stays: a stop that was requested meanwhile holds.
                Err(error) => {
                    let error = error_chain(&error);
                    tracing::warn!(error, "a task could not begin, and is tried again");
                    tokio::time::sleep(TASKS_POLL).await;
                }
            }
        };
        // Otherwise it was stopped after it was read.
        if begun {
            tracing::info!("a task begins");
            let outcome = AssertUnwindSafe(run(task, shared)).catch_unwind().await;
            let end = outcome
                .unwrap_or_else(|_| TaskEnd::Failed("the program failed: see its log".into()));
            self.end(id, &end).await;
            ended(id, &end);
        }
        *self.running.lock() = None;
    }

    /// Stores the end of a task; tries until it is stored, since the task would otherwise run again.
    async fn end(&self, id: TaskId, end: &TaskEnd) {
        let mut pause = TASKS_POLL;
        loop {
            match self.store.end_task(id, end.clone()).await {
                // An earlier attempt may have been stored although it failed, or the task was stopped.
                Ok(false) => tracing::info!("the end of a task was already stored"),
                Ok(true) => tracing::info!(state = %end.state(), "a task has ended"),
                Err(error) => {
                    let error = error_chain(&error);
                    tracing::error!(error, "the end of a task could not be stored");
                    tokio::time::sleep(pause).await;
                    pause = (2 * pause).min(PAUSE_MAX);
                    continue;
                }
            }
            return;
        }
    }
}
