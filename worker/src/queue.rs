//! The queue on PostgreSQL: the tables, functions and leases of `graphile_worker`.
//! Uses: graphile_worker, sqlx, `query_error`. Never: a result; a wait without a deadline; the address in an error.
//!
//! An answer that does not come within a deadline may be lost with its connection: all connections are then
//! replaced. Transactions are short, so that a repeated request costs one.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use graphile_worker::sql::complete_job::complete_job;
use graphile_worker::sql::fail_job::single::fail_job;
use graphile_worker::sql::get_job::get_job_with_filter;
use graphile_worker::sql::worker_heartbeat::registration::{worker_deregister, worker_heartbeat};
use graphile_worker::worker_utils::types::CleanupTask;
use graphile_worker::{
    ActiveWorkerRow, Database, HookRegistry, Job, JobFlagFilter, JobSpec, RawJobSpec,
    SweepStaleWorkersOptions, TaskDetails, WorkerRecoveryConfig, WorkerUtils,
};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};

use crate::needs::Needs;
use crate::query_error::QueryError;
use crate::{WorkerError, WorkerResult};

/// Schema of the queue's tables.
pub const SCHEMA: &str = "palpate_queue";
/// Longest wait for an answer.
pub const ANSWER: Duration = Duration::from_secs(15);
/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(10);
/// Chunks that one request adds.
const BATCH: usize = 1000;

/// A chunk, as the queue carries it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChunkRef {
    /// Id of its order.
    pub order: String,
    /// Its place in the order.
    pub index: u64,
    /// Number of times that a machine refused it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub refused: u32,
}

fn is_zero(number: &u32) -> bool {
    *number == 0
}

impl ChunkRef {
    /// Its name in the queue.
    fn name(&self) -> String {
        format!("{}/{}", self.order, self.index)
    }
}

/// What the queue holds of an order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Backlog {
    /// Id of the order.
    pub order: String,
    /// Chunks that wait for a worker.
    pub waiting: u64,
    /// Chunks that a worker makes.
    pub running: u64,
    /// Waiting chunks that a machine could not make.
    pub again: u64,
    /// Error of one of these.
    pub again_error: Option<String>,
    /// Chunks that are set aside.
    pub failed: u64,
}

/// A connection to the queue.
#[derive(Debug, Clone)]
pub struct Queue {
    options: PgConnectOptions,
    connections: u32,
    pool: Arc<Mutex<PgPool>>,
}

impl Queue {
    /// A queue that is connected when it is first used.
    pub fn new(options: PgConnectOptions, connections: u32) -> Self {
        let options = options.application_name("palpate-worker");
        let pool = Arc::new(Mutex::new(pool(&options, connections)));
        Self { options, connections, pool }
    }

    fn pool(&self) -> PgPool {
        self.pool.lock().clone()
    }

    fn utils(&self) -> WorkerUtils {
        WorkerUtils::new(self.pool(), SCHEMA)
    }

    /// Waits for an answer up to a deadline. If none came, all connections are replaced.
    async fn answer<T, E: Into<QueryError>>(
        &self,
        limit: Duration,
        query: impl Future<Output = Result<T, E>>,
    ) -> WorkerResult<T> {
        let error = match tokio::time::timeout(limit, query).await {
            Ok(Ok(answer)) => return Ok(answer),
            Ok(Err(error)) => error.into(),
            Err(_) => QueryError::lost(format!("no answer within {} s", limit.as_secs())),
        };
        if error.code.is_none() {
            *self.pool.lock() = pool(&self.options, self.connections);
        }
        let host = self.options.get_host();
        let text = format!("{host}: {}", error.message);
        Err(match error.code.as_deref() {
            // Undefined table, function or schema; no right.
            Some("42P01" | "42883" | "3F000" | "42501") => WorkerError::NotSetUp(text),
            _ => WorkerError::Queue(text),
        })
    }

    /// Makes or updates the tables.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer, or the role may not.
    pub async fn migrate(&self) -> WorkerResult<()> {
        let utils = self.utils();
        let migrated =
            async { utils.migrate().await.map_err(|error| QueryError::lost(error.to_string())) };
        self.answer(ANSWER * 4, migrated).await
    }

    /// Runs statements that have no parameters, in one transaction.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer, or refuses.
    pub async fn apply(&self, statements: &'static str) -> WorkerResult<()> {
        let pool = self.pool();
        self.answer(ANSWER, async { sqlx::raw_sql(statements).execute(&pool).await.map(drop) })
            .await
    }

    /// The orders that the queue knows, without some of them. Each is a task of the queue.
    ///
    /// # Errors
    /// `WorkerError::NotSetUp` if the queue has no tables, `Queue` if it does not answer.
    pub async fn orders(&self, without: &[String]) -> WorkerResult<TaskDetails> {
        let pool = self.pool();
        let query = sqlx::query_as(
            "SELECT id, identifier FROM palpate_queue._private_tasks WHERE identifier <> ALL($1)",
        );
        let rows: Vec<(i32, String)> =
            self.answer(ANSWER, query.bind(without).fetch_all(&pool)).await?;
        let mut orders = TaskDetails::new();
        for (id, order) in rows {
            orders.insert(id, order);
        }
        Ok(orders)
    }

    /// Takes the next chunk of some orders that a machine may make.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn take(
        &self,
        orders: &TaskDetails,
        worker: &str,
        allowed: &[String],
    ) -> WorkerResult<Option<Job>> {
        let database = Database::from(self.pool());
        let filter = JobFlagFilter::new(&[], &[]).with_allowlist(allowed);
        self.answer(ANSWER, get_job_with_filter(&database, orders, SCHEMA, worker, filter, None))
            .await
    }

    /// Whether the queue has a chunk that a machine may make, now or later: one that waits for its next attempt, or is
    /// made by a worker that may be lost, counts.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn has_work(&self, allowed: &[String]) -> WorkerResult<bool> {
        let pool = self.pool();
        let query = sqlx::query_scalar(
            "SELECT EXISTS (SELECT FROM palpate_queue._private_jobs \
             WHERE (locked_at IS NOT NULL OR attempts < max_attempts) \
             AND (flags IS NULL OR flags - $1::text[] = '{}'::jsonb))",
        );
        self.answer(ANSWER, query.bind(allowed).fetch_one(&pool)).await
    }

    /// Removes a chunk that is done.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn complete(&self, job: &Job, worker: &str) -> WorkerResult<()> {
        let database = Database::from(self.pool());
        self.answer(ANSWER, complete_job(&database, job, worker, SCHEMA)).await
    }

    /// Returns a chunk with its error; after its last attempt it is set aside.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn fail(&self, job: &Job, worker: &str, error: &str) -> WorkerResult<()> {
        let database = Database::from(self.pool());
        self.answer(ANSWER, fail_job(&database, job, SCHEMA, worker, error, None)).await
    }

    /// Returns a chunk that a machine could not make, with its error. Its attempt does not count. It becomes the
    /// first of its order: a machine that makes the order takes it next.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn give_back(
        &self,
        job: &Job,
        worker: &str,
        chunk: &ChunkRef,
        error: &str,
    ) -> WorkerResult<()> {
        let payload =
            serde_json::to_string(chunk).map_err(|error| WorkerError::Queue(error.to_string()))?;
        let pool = self.pool();
        let query = sqlx::query(
            "UPDATE palpate_queue._private_jobs \
             SET payload = $3::text::json, last_error = $4, updated_at = now(), \
               run_at = created_at - interval '1 hour' \
             WHERE id = $1 AND locked_by = $2",
        );
        let query = query.bind(*job.id()).bind(worker).bind(payload).bind(error);
        self.answer(ANSWER, query.execute(&pool)).await?;
        self.return_jobs(&[*job.id()], worker).await
    }

    /// Sets the waiting chunks of an order aside, with one error.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn set_aside(&self, order: &str, error: &str) -> WorkerResult<()> {
        let pool = self.pool();
        let query = sqlx::query(
            "UPDATE palpate_queue._private_jobs \
             SET attempts = max_attempts, last_error = $2, updated_at = now() \
             WHERE key LIKE $1 || '/%' AND locked_at IS NULL AND attempts < max_attempts",
        );
        let query = query.bind(order).bind(error);
        self.answer(ANSWER, query.execute(&pool)).await.map(drop)
    }

    /// Renews the lease of a worker.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn heartbeat(&self, worker: &str, about: &Value) -> WorkerResult<()> {
        let database = Database::from(self.pool());
        self.answer(ANSWER, worker_heartbeat(&database, SCHEMA, worker, Some(about.clone()))).await
    }

    /// Returns the chunks that a worker took at least `since` ago and does not have: the answer to their taking
    /// was lost. Their attempts do not count.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn return_unknown(
        &self,
        worker: &str,
        held: &[i64],
        since: Duration,
    ) -> WorkerResult<usize> {
        let pool = self.pool();
        let query = sqlx::query_scalar(
            "SELECT id FROM palpate_queue._private_jobs WHERE locked_by = $1 AND id <> ALL($2) \
             AND locked_at < now() - make_interval(secs => $3)",
        );
        let query = query.bind(worker).bind(held).bind(since.as_secs_f64());
        let unknown: Vec<i64> = self.answer(ANSWER, query.fetch_all(&pool)).await?;
        if !unknown.is_empty() {
            self.return_jobs(&unknown, worker).await?;
        }
        Ok(unknown.len())
    }

    /// Returns chunks that a worker has taken. Their attempts do not count.
    async fn return_jobs(&self, jobs: &[i64], worker: &str) -> WorkerResult<()> {
        let pool = self.pool();
        let query = sqlx::query("SELECT palpate_queue._private_return_jobs($1, $2)");
        self.answer(ANSWER, query.bind(worker).bind(jobs).execute(&pool)).await.map(drop)
    }

    /// Ends the lease of a worker.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn leave(&self, worker: &str) -> WorkerResult<()> {
        let database = Database::from(self.pool());
        self.answer(ANSWER, worker_deregister(&database, SCHEMA, worker)).await
    }

    /// Returns the chunks of workers whose lease has ended; `hooks` decide on each.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn sweep(&self, lease: Duration, hooks: Arc<HookRegistry>) -> WorkerResult<i32> {
        let utils = self.utils().with_hooks(hooks);
        let config = WorkerRecoveryConfig::default().sweep_threshold(lease);
        let options = SweepStaleWorkersOptions::default();
        let swept = self
            .answer(ANSWER * 4, utils.sweep_stale_workers_with_config(&config, options))
            .await?;
        Ok(swept.recovered_count)
    }

    /// The workers, and whether the lease of each has ended.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn workers(&self, lease: Duration) -> WorkerResult<Vec<ActiveWorkerRow>> {
        self.answer(ANSWER, self.utils().list_active_workers(lease)).await
    }

    /// Calls `added` when chunks were added, until the listener is lost.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer any more.
    pub async fn listen(&self, added: impl Fn()) -> WorkerResult<()> {
        let database = Database::from(self.pool());
        let listener = self.answer(ANSWER, database.listen("jobs:insert")).await?;
        let Some(mut listener) = listener else { return Ok(()) };
        while let Some(notification) = listener.next().await {
            notification.map_err(|error| WorkerError::Queue(error.to_string()))?;
            added();
        }
        Ok(())
    }

    /// Adds chunks. One that the queue has and that nobody makes is replaced.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer; a part of the chunks may have been added.
    pub async fn add(
        &self,
        chunks: &[ChunkRef],
        priority: i16,
        attempts: i16,
        needs: Needs,
    ) -> WorkerResult<()> {
        for batch in chunks.chunks(BATCH) {
            let jobs: Result<Vec<_>, _> =
                batch.iter().map(|chunk| spec(chunk, priority, attempts, needs)).collect();
            let jobs = jobs.map_err(|error| WorkerError::Queue(error.to_string()))?;
            self.answer(ANSWER * 4, self.utils().add_raw_jobs(&jobs)).await?;
        }
        Ok(())
    }

    /// The indices of an order's chunks that wait or are being made.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn present(&self, order: &str) -> WorkerResult<Vec<u64>> {
        let pool = self.pool();
        let query = sqlx::query_scalar(
            "SELECT (payload->>'index')::bigint FROM palpate_queue._private_jobs \
             WHERE key LIKE $1 || '/%' AND (locked_at IS NOT NULL OR attempts < max_attempts)",
        );
        let found: Vec<i64> = self.answer(ANSWER, query.bind(order).fetch_all(&pool)).await?;
        Ok(found.into_iter().filter_map(|index| u64::try_from(index).ok()).collect())
    }

    /// Removes the chunks of an order that are set aside.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn forget_failed(&self, order: &str) -> WorkerResult<u64> {
        let pool = self.pool();
        let query = sqlx::query(
            "DELETE FROM palpate_queue._private_jobs \
             WHERE key LIKE $1 || '/%' AND locked_at IS NULL AND attempts >= max_attempts",
        );
        Ok(self.answer(ANSWER, query.bind(order).execute(&pool)).await?.rows_affected())
    }

    /// Removes all chunks of an order. A worker that makes one ends it, and removes nothing more.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn cancel(&self, order: &str) -> WorkerResult<u64> {
        let pool = self.pool();
        let query =
            sqlx::query("DELETE FROM palpate_queue._private_jobs WHERE key LIKE $1 || '/%'");
        Ok(self.answer(ANSWER, query.bind(order).execute(&pool)).await?.rows_affected())
    }

    /// Forgets the orders that have no chunk in the queue: each take reads all that it knows.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer, or others add chunks for longer than a second.
    pub async fn forget_orders(&self) -> WorkerResult<()> {
        self.answer(ANSWER, self.utils().cleanup(&[CleanupTask::GcTaskIdentifiers])).await
    }

    /// What the queue holds of each order.
    ///
    /// # Errors
    /// `WorkerError` if the queue does not answer.
    pub async fn backlogs(&self) -> WorkerResult<Vec<Backlog>> {
        let pool = self.pool();
        let query = sqlx::query_as(
            "SELECT split_part(key, '/', 1), \
               count(*) FILTER (WHERE locked_at IS NULL AND attempts < max_attempts), \
               count(*) FILTER (WHERE locked_at IS NOT NULL), \
               count(*) FILTER (WHERE locked_at IS NULL AND attempts < max_attempts AND last_error IS NOT NULL), \
               max(last_error) FILTER (WHERE locked_at IS NULL AND attempts < max_attempts), \
               count(*) FILTER (WHERE locked_at IS NULL AND attempts >= max_attempts) \
             FROM palpate_queue._private_jobs WHERE key IS NOT NULL GROUP BY 1 ORDER BY 1",
        );
        let rows: Vec<(String, i64, i64, i64, Option<String>, i64)> =
            self.answer(ANSWER, query.fetch_all(&pool)).await?;
        let number = |count: i64| u64::try_from(count).unwrap_or(0);
        Ok(rows
            .into_iter()
            .map(|(order, waiting, running, again, again_error, failed)| Backlog {
                order,
                waiting: number(waiting),
                running: number(running),
                again: number(again),
                again_error,
                failed: number(failed),
            })
            .collect())
    }
}

fn spec(
    chunk: &ChunkRef,
    priority: i16,
    attempts: i16,
    needs: Needs,
) -> serde_json::Result<RawJobSpec> {
    let spec = JobSpec {
        max_attempts: Some(attempts),
        job_key: Some(chunk.name()),
        priority: Some(priority),
        flags: Some(needs.flags()),
        ..JobSpec::default()
    };
    Ok(RawJobSpec { identifier: chunk.order.clone(), payload: serde_json::to_value(chunk)?, spec })
}

fn pool(options: &PgConnectOptions, connections: u32) -> PgPool {
    let pool = PgPoolOptions::new().max_connections(connections).acquire_timeout(CONNECT);
    pool.idle_timeout(Duration::from_secs(300)).connect_lazy_with(options.clone())
}
