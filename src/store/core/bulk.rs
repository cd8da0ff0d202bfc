//! Connections that read many rows: rusqlite lends each value in place, where sqlx copies it and hands
//! every row from one thread to another (`docs/decisions/0016`).
//! Uses: rusqlite, tokio's blocking threads. Never: a write, a read on a thread of the runtime, a mapped
//! file (an error of the disk would end the process).

use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags, params_from_iter};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::columns::{Columns, Names};
use super::error::{During, StoreError, StoreResult};

/// Number of connections.
pub(crate) const BULK_CONNECTIONS: u32 = 4;
/// Longest wait for a free connection.
const CONNECTION_WAIT: Duration = Duration::from_secs(5);
/// Memory of the pages that a connection keeps, KiB.
const CACHE_KIB: i64 = 8 << 10;
/// Steps of SQLite's machine after which a read checks whether its caller still waits.
const CHECK_STEPS: i32 = 10_000;

/// The connections of a store. Clones share them.
#[derive(Clone)]
pub(crate) struct Bulk {
    inner: Arc<Inner>,
}

struct Inner {
    path: PathBuf,
    busy_timeout: Duration,
    turns: Arc<Semaphore>,
    idle: Mutex<Vec<Connection>>,
}

/// Set when the caller of a read no longer waits for it.
struct Gone(Arc<AtomicBool>);

impl Drop for Gone {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Bulk {
    /// Connections to this file, or to the one that an address of SQLite names, opened when they are first needed.
    pub(crate) fn new(path: &Path, busy_timeout: Duration) -> Self {
        let turns = Arc::new(Semaphore::new(BULK_CONNECTIONS as usize));
        let inner = Inner { path: path.to_owned(), busy_timeout, turns, idle: Mutex::default() };
        Self { inner: Arc::new(inner) }
    }

    /// Runs `work` in a read transaction: a view of the file as it is now. If this future is dropped, its
    /// statement is interrupted.
    ///
    /// # Errors
    /// `Closed` if the store is closed; `Read` if no connection is free within 5 s or can be opened; what
    /// `work` returns.
    pub(crate) async fn read<T: Send + 'static>(
        &self,
        operation: &'static str,
        work: impl FnOnce(&Connection) -> StoreResult<T> + Send + 'static,
    ) -> StoreResult<T> {
        let turn = timeout(CONNECTION_WAIT, self.inner.turns.clone().acquire_owned()).await;
        let turn = turn.map_err(|_| busy()).during(operation)?;
        let turn = turn.map_err(|_| StoreError::Closed { operation })?;
        self.view(operation, Some(turn), work).await
    }

    /// Like [`Self::read`], on a new connection that waits for no other: for what must not wait behind
    /// people who read, and for what must see the file and not the pages that a connection keeps.
    pub(crate) async fn read_apart<T: Send + 'static>(
        &self,
        operation: &'static str,
        work: impl FnOnce(&Connection) -> StoreResult<T> + Send + 'static,
    ) -> StoreResult<T> {
        if self.inner.turns.is_closed() {
            return Err(StoreError::Closed { operation });
        }
        self.view(operation, None, work).await
    }

    /// Runs `work` on a kept connection, which belongs to the turn, or without one on a new connection.
    async fn view<T: Send + 'static>(
        &self,
        operation: &'static str,
        turn: Option<OwnedSemaphorePermit>,
        work: impl FnOnce(&Connection) -> StoreResult<T> + Send + 'static,
    ) -> StoreResult<T> {
        let (inner, gone) = (self.inner.clone(), Arc::new(AtomicBool::new(false)));
        let caller = Gone(gone.clone());
        let reading = tokio::task::spawn_blocking(move || {
            let kept = turn.as_ref().and_then(|_| inner.idle.lock().pop());
            let connection = kept.map_or_else(|| inner.open(), Ok).during(operation)?;
            let stops = move || gone.load(Ordering::Relaxed);
            connection.progress_handler(CHECK_STEPS, Some(stops)).during(operation)?;
            let view = connection.unchecked_transaction().during(operation)?;
            let result = work(&view)?;
            view.finish().during(operation)?;
            if turn.is_some() {
                inner.idle.lock().push(connection);
            }
            drop(turn);
            Ok(result)
        });
        let result = reading.await;
        drop(caller);
        match result {
            Ok(result) => result,
            Err(error) if error.is_panic() => resume_unwind(error.into_panic()),
            Err(_) => Err(StoreError::Closed { operation }),
        }
    }

    /// Closes the connections after the reads in progress, except those apart; further reads return `Closed`.
    pub(crate) async fn close(&self) {
        let all = self.inner.turns.acquire_many(BULK_CONNECTIONS).await;
        self.inner.turns.close();
        drop(all);
        self.inner.idle.lock().clear();
    }
}

impl Inner {
    fn open(&self) -> rusqlite::Result<Connection> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
            | OpenFlags::SQLITE_OPEN_NO_MUTEX
            | OpenFlags::SQLITE_OPEN_URI;
        let connection = Connection::open_with_flags(&self.path, flags)?;
        connection.busy_timeout(self.busy_timeout)?;
        connection.pragma_update(None, "query_only", true)?;
        connection.pragma_update(None, "cache_size", -CACHE_KIB)?;
        // An index for one statement takes a read of the whole table.
        connection.pragma_update(None, "automatic_index", false)?;
        Ok(connection)
    }
}

fn busy() -> rusqlite::Error {
    let words = format!("no connection is free within {} s", CONNECTION_WAIT.as_secs());
    let code = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_BUSY);
    rusqlite::Error::SqliteFailure(code, Some(words))
}

/// A statement with the values of its `?`, in their order.
#[derive(Debug, Default, Clone)]
pub(crate) struct Statement {
    text: String,
    values: Vec<Value>,
}

impl Statement {
    /// A statement that begins with this text.
    pub(crate) fn new(text: &str) -> Self {
        Self { text: text.to_owned(), values: Vec::new() }
    }

    /// Appends a text.
    pub(crate) fn push(&mut self, text: &str) -> &mut Self {
        self.text.push_str(text);
        self
    }

    /// Appends a value.
    pub(crate) fn bind(&mut self, value: impl Into<Value>) -> &mut Self {
        self.values.push(value.into());
        self.push("?")
    }

    /// Appends what `push` appends for each value, separated by `between`.
    pub(crate) fn each<T>(&mut self, values: &[T], between: &str, push: impl Fn(&mut Self, &T)) {
        for (n, value) in values.iter().enumerate() {
            self.push(if n == 0 { "" } else { between });
            push(self, value);
        }
    }

    /// Returns what `read` makes of each row.
    ///
    /// # Errors
    /// `Read` if the statement fails; what `read` returns.
    pub(crate) fn rows<T>(
        &self,
        connection: &Connection,
        operation: &'static str,
        mut read: impl FnMut(&Columns<'_>) -> StoreResult<T>,
    ) -> StoreResult<Vec<T>> {
        let mut statement = connection.prepare_cached(&self.text).during(operation)?;
        let names = Names::of(&statement);
        let mut rows = statement.query(params_from_iter(&self.values)).during(operation)?;
        let mut all = Vec::new();
        while let Some(row) = rows.next().during(operation)? {
            all.push(read(&Columns::lent(row, &names, operation))?);
        }
        Ok(all)
    }

    /// Returns the plan of SQLite, one line per step.
    #[cfg(test)]
    pub(crate) fn explain(&self, connection: &Connection) -> StoreResult<Vec<String>> {
        let mut explained = self.clone();
        explained.text = format!("EXPLAIN QUERY PLAN {}", self.text);
        explained.rows(connection, "explaining a query", |c| c.get("detail"))
    }
}
