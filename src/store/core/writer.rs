//! The one connection that writes, on its own thread: jobs in, answers out, in order.
//! Uses: sqlx, `core::error`. Never: a wait for a reader, a browser, or the runtime of a caller.
//!
//! A job is a whole transaction. It runs to its end even if its caller no longer waits, and a caller on
//! a busy runtime cannot delay the next job.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use futures::future::LocalBoxFuture;
use sqlx::migrate::Migrator;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Connection};
use tokio::sync::{mpsc, oneshot};
use tracing::{Instrument, Span};

use super::error::{During, StoreError, StoreResult};
use crate::journal::error_chain;
use crate::priority;

/// Length of the job queue; further callers wait until they can submit their job.
const WAITING_JOBS: usize = 64;

/// Longest wall time from submitting a job to its answer, except for a patient writer.
const WRITE_DEADLINE: Duration = Duration::from_secs(30);

/// Longest wall time for opening: a migration may rewrite a large file.
const OPEN_DEADLINE: Duration = Duration::from_secs(600);

type Job = Box<dyn for<'h> FnOnce(&'h mut Hand) -> LocalBoxFuture<'h, ()> + Send>;

/// Sends jobs to the thread that writes. Clones share the thread.
#[derive(Clone)]
pub(crate) struct Writer {
    /// `None` for a database that is only read.
    jobs: Option<mpsc::Sender<Job>>,
    /// Longest wall time from submitting a job to its answer; `None` if the caller has its own deadline.
    deadline: Option<Duration>,
}

/// State of the thread: its connection, which is opened again after a failure.
struct Hand {
    options: SqliteConnectOptions,
    connection: Option<SqliteConnection>,
    closed: bool,
    #[cfg(test)]
    fail_after_commit: bool,
}

impl Writer {
    /// Starts the thread. `options` open the connection, also again after a failure.
    ///
    /// # Errors
    /// `StoreError::StartWriter` if the runtime or the thread cannot be created.
    pub(crate) fn start(options: SqliteConnectOptions) -> StoreResult<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(StoreError::StartWriter)?;
        let (jobs, mut inbox) = mpsc::channel::<Job>(WAITING_JOBS);
        let mut hand = Hand {
            options,
            connection: None,
            closed: false,
            #[cfg(test)]
            fail_after_commit: false,
        };
        std::thread::Builder::new()
            .name("store-writer".into())
            .spawn(move || {
                priority::raise();
                runtime.block_on(async move {
                    while !hand.closed
                        && let Some(job) = inbox.recv().await
                    {
                        job(&mut hand).await;
                    }
                    hand.close().await;
                });
            })
            .map_err(StoreError::StartWriter)?;
        Ok(Self { jobs: Some(jobs), deadline: Some(WRITE_DEADLINE) })
    }

    /// Returns a writer without a thread, which refuses every job, for a database that is only read.
    pub(crate) fn none() -> Self {
        Self { jobs: None, deadline: None }
    }

    /// Returns the same writer without a deadline, for a caller that has its own.
    pub(crate) fn patient(&self) -> Self {
        Self { deadline: None, ..self.clone() }
    }

    /// Returns the same writer with another deadline.
    #[cfg(test)]
    pub(crate) fn hurried(&self, deadline: Duration) -> Self {
        Self { deadline: Some(deadline), ..self.clone() }
    }

    /// Opens the file and applies the missing migrations. The file is created only if the options
    /// permit it, now or when it is opened again.
    ///
    /// # Errors
    /// `Open` if the file cannot be opened; `Migrate` if a migration fails; `Damaged` if a column is
    /// missing that the migrations create; `Late` after 600 s.
    pub(crate) async fn open(&self, path: &Path, migrations: &'static Migrator) -> StoreResult<()> {
        let path = path.to_owned();
        self.hand_over("opening the database", Some(OPEN_DEADLINE), async move |hand| {
            let connecting = hand.options.connect().await;
            let opened = |source| StoreError::Open { path: path.clone(), source };
            let mut connection = connecting.map_err(opened)?;
            let migrated = migrations.run(&mut connection).await;
            migrated.map_err(|source| StoreError::Migrate { path, source })?;
            require_columns(&mut connection, migrations).await?;
            hand.connection = Some(connection);
            Ok(())
        })
        .await
    }

    /// Runs `work` in one transaction.
    ///
    /// # Errors
    /// An error of `work`, after which the transaction is rolled back; `Sql` if it cannot begin or
    /// commit; `Late` after the deadline; `Closed` if the thread has ended; `ReadOnly` if
    /// there is none.
    pub(crate) async fn run<T, F>(&self, operation: &'static str, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: AsyncFnOnce(&mut SqliteConnection) -> StoreResult<T> + Send + 'static,
    {
        let work = async move |hand: &mut Hand| hand.transact(operation, work).await;
        self.hand_over(operation, self.deadline, work).await
    }

    /// Runs `work` in one transaction. If its outcome is unknown afterwards, makes the contents of the
    /// file durable on a new connection and asks `look` for the result of the work; `None` from `look`
    /// means that it is not stored.
    ///
    /// # Errors
    /// As [`Writer::run`], and `NotStored` if the work is known not to be stored.
    pub(crate) async fn run_and_settle<T, F, L>(
        &self,
        operation: &'static str,
        work: F,
        look: L,
    ) -> StoreResult<T>
    where
        T: Send + 'static,
        F: AsyncFnOnce(&mut SqliteConnection) -> StoreResult<T> + Send + 'static,
        L: AsyncFnOnce(&mut SqliteConnection) -> StoreResult<Option<T>> + Send + 'static,
    {
        self.hand_over(operation, self.deadline, async move |hand| {
            match hand.transact(operation, work).await {
                Err(error) if error.outcome_unknown() => hand.settle(operation, error, look).await,
                known => known,
            }
        })
        .await
    }

    /// Closes the connection after all submitted jobs, and ends the thread.
    pub(crate) async fn close(&self) {
        let closing = self
            .hand_over("closing the store", Some(WRITE_DEADLINE), async |hand| {
                hand.close().await;
                hand.closed = true;
                Ok(())
            })
            .await;
        if let Err(error) = closing {
            tracing::debug!(%error, "the writer was already closed");
        }
    }

    /// Makes the next transaction report a failed commit although it is stored.
    #[cfg(test)]
    pub(crate) async fn fail_after_next_commit(&self) -> StoreResult<()> {
        self.hand_over("arranging a failure", self.deadline, async |hand| {
            hand.fail_after_commit = true;
            Ok(())
        })
        .await
    }

    async fn hand_over<T, F>(
        &self,
        operation: &'static str,
        deadline: Option<Duration>,
        work: F,
    ) -> StoreResult<T>
    where
        T: Send + 'static,
        F: AsyncFnOnce(&mut Hand) -> StoreResult<T> + Send + 'static,
    {
        let Some(jobs) = &self.jobs else { return Err(StoreError::ReadOnly { operation }) };
        let (answer, answered) = oneshot::channel();
        let span = Span::current();
        let job: Job = Box::new(move |hand| {
            let answering = async move {
                // Sending fails if the caller no longer waits.
                let _ = answer.send(work(hand).await);
            };
            Box::pin(answering.instrument(span))
        });
        let closed = || StoreError::Closed { operation };
        let done = async {
            jobs.send(job).await.map_err(|_| closed())?;
            answered.await.map_err(|_| closed())?
        };
        let Some(deadline) = deadline else { return done.await };
        tokio::time::timeout(deadline, done)
            .await
            .unwrap_or(Err(StoreError::Late { operation, limit_s: deadline.as_secs() }))
    }
}

impl Hand {
    async fn connection(&mut self, operation: &'static str) -> StoreResult<&mut SqliteConnection> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => self.options.connect().await.during(operation)?,
        };
        Ok(self.connection.insert(connection))
    }

    async fn transact<T>(
        &mut self,
        operation: &'static str,
        work: impl AsyncFnOnce(&mut SqliteConnection) -> StoreResult<T>,
    ) -> StoreResult<T> {
        let result = self.attempt(operation, work).await;
        if let Err(error) = &result
            && error.outcome_unknown()
        {
            tracing::error!(error = error_chain(error), operation, "a write failed");
            self.close().await;
        }
        result
    }

    async fn attempt<T>(
        &mut self,
        operation: &'static str,
        work: impl AsyncFnOnce(&mut SqliteConnection) -> StoreResult<T>,
    ) -> StoreResult<T> {
        let connection = self.connection(operation).await?;
        let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await.during(operation)?;
        match work(&mut transaction).await {
            Ok(value) => {
                transaction.commit().await.during(operation)?;
                #[cfg(test)]
                if std::mem::take(&mut self.fail_after_commit) {
                    return Err(sqlx::Error::WorkerCrashed).during(operation);
                }
                Ok(value)
            }
            Err(error) => {
                // SQLite rolls some failed transactions back itself; then this rollback fails.
                if transaction.rollback().await.is_err() {
                    self.close().await;
                }
                Err(error)
            }
        }
    }

    /// Determines whether a write whose commit failed is stored. The log is first copied into the
    /// database file and synced, so that a found write is durable. The log is then truncated, so that an
    /// absent write stays absent: the next start would recover frames of the failed commit. If one of
    /// these steps fails, the first error is returned and the outcome is unknown.
    async fn settle<T>(
        &mut self,
        operation: &'static str,
        error: StoreError,
        look: impl AsyncFnOnce(&mut SqliteConnection) -> StoreResult<Option<T>>,
    ) -> StoreResult<T> {
        let found = async {
            let connection = self.connection(operation).await?;
            let (busy, _, _): (i64, i64, i64) = sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)")
                .fetch_one(&mut *connection)
                .await
                .during(operation)?;
            if busy == 0 { look(connection).await.map(Some) } else { Ok(None) }
        };
        match found.await {
            Ok(Some(Some(value))) => {
                tracing::warn!(operation, "the failed write is stored");
                Ok(value)
            }
            Ok(Some(None)) => Err(StoreError::NotStored { operation, source: Box::new(error) }),
            Ok(None) => {
                tracing::error!(operation, "a reader uses the log: the outcome is unknown");
                Err(error)
            }
            Err(second) => {
                let second = error_chain(&second);
                tracing::error!(operation, error = second, "reading the outcome failed, too");
                self.close().await;
                Err(error)
            }
        }
    }

    async fn close(&mut self) {
        if let Some(connection) = self.connection.take()
            && let Err(error) = connection.close().await
        {
            tracing::debug!(%error, "closing the writer's connection failed");
        }
    }
}

/// Compares the columns of a file with those that the migrations create in an empty database. They
/// differ if another program changed the tables after the migrations.
///
/// # Errors
/// `Damaged` with the missing columns.
pub(super) async fn require_columns(
    connection: &mut SqliteConnection,
    migrations: &Migrator,
) -> StoreResult<()> {
    const OPERATION: &str = "comparing the tables with those of this version";
    let options = SqliteConnectOptions::new().in_memory(true).disable_statement_logging();
    let mut fresh = options.connect().await.during(OPERATION)?;
    let migrated = migrations.run(&mut fresh).await;
    migrated.map_err(|source| StoreError::Migrate { path: ":memory:".into(), source })?;
    let present: BTreeSet<String> = columns_of(connection).await.during(OPERATION)?;
    let findings: Vec<String> = columns_of(&mut fresh)
        .await
        .during(OPERATION)?
        .difference(&present)
        .map(|name| format!("column {name} is missing"))
        .collect();
    if findings.is_empty() { Ok(()) } else { Err(StoreError::Damaged { findings }) }
}

/// Returns every column as `table.column`.
async fn columns_of(connection: &mut SqliteConnection) -> Result<BTreeSet<String>, sqlx::Error> {
    let names: Vec<String> = sqlx::query_scalar(
        "SELECT t.name || '.' || c.name FROM sqlite_schema t, pragma_table_info(t.name) c
         WHERE t.type = 'table' AND t.name NOT LIKE 'sqlite_%'",
    )
    .fetch_all(connection)
    .await?;
    Ok(names.into_iter().collect())
}
