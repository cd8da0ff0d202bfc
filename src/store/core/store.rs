//! The database of a rig: opened, shared and closed. The other files add what it stores and answers.
//! Uses: `core::{writer, log}`, sqlx, `clock`. Never: a table by its name.

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Sqlite, Transaction};

use super::columns;
use super::error::{During, StoreError};
use super::facts::RunFacts;
use super::log;
use super::writer::Writer;
use crate::clock::Clock;
use crate::ids::RunUid;
use crate::record::LOG_BYTES;

/// A page holds about five trials' voltages (a fifth smaller than in 4096: `docs/decisions/0001`).
pub(crate) const PAGE_BYTES: u32 = 16_384;

/// How long SQLite waits for another process's lock.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// Connections that read.
const READERS: u32 = 4;

/// Longest wait for one of them.
const READER_TIMEOUT: Duration = Duration::from_secs(5);

/// Rows that a reading connection may be ahead of who reads them: each wait is a change of threads.
const ROWS_AHEAD: usize = 1024;

/// What is known of the file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Soundness {
    /// Not looked over yet, or not to the end.
    #[default]
    Unchecked,
    /// Nothing wrong was found.
    Sound,
    /// What is wrong, in words; a damaged trial by its id.
    Damaged(Vec<String>),
}

/// The tables, as they grew.
pub(crate) static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../../migrations");

/// The database of a rig. Clones share it.
#[derive(Clone)]
pub struct Store {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    pub(crate) path: PathBuf,
    pub(crate) clock: Clock,
    pub(crate) writer: Writer,
    pub(crate) readers: SqlitePool,
    pub(crate) runs: Mutex<HashMap<RunUid, RunFacts>>,
    pub(crate) soundness: Mutex<Soundness>,
}

impl Store {
    /// Opens the database file, creating it and bringing its tables up to date as needed.
    pub async fn open(path: &Path, clock: Clock) -> Result<Self, StoreError> {
        let open = |source| StoreError::Open { path: path.to_owned(), source };
        let options = SqliteConnectOptions::new()
            .filename(path)
            .busy_timeout(BUSY_TIMEOUT)
            .foreign_keys(true)
            .disable_statement_logging();
        let writing = options
            .clone()
            .page_size(PAGE_BYTES)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            // The log is cut back to this after a long read had let it grow.
            .pragma("journal_size_limit", LOG_BYTES.to_string());
        let is_new = matches!(path.symlink_metadata(), Err(e) if e.kind() == ErrorKind::NotFound);
        // SQLite keeps the log beside the file that a link leads to.
        let mut log = path.canonicalize().unwrap_or_else(|_| path.to_owned()).into_os_string();
        log.push("-wal");
        // SQLite would take an emptied file for a new database, and what was in it for what never was.
        if path.metadata().is_ok_and(|file| file.len() == 0) || is_new && Path::new(&log).exists() {
            return Err(StoreError::Lost { path: path.to_owned() });
        }
        // SQLite drops what follows a damaged place as if it had never been stored.
        let damage = match std::fs::read(&log) {
            Ok(log) => log::damage(&log),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(open(error.into())),
        };
        if let Some(log::LogDamage { at_byte, transactions }) = damage {
            return Err(StoreError::DamagedLog { path: path.to_owned(), at_byte, transactions });
        }
        if is_new {
            create(path, &writing).await?;
        }
        let writer = Writer::start(writing)?;
        writer.open(path, &MIGRATIONS).await?;
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .acquire_timeout(READER_TIMEOUT)
            .idle_timeout(None)
            .max_lifetime(None)
            .test_before_acquire(false)
            .connect_with(
                options.read_only(true).row_buffer_size(ROWS_AHEAD).pragma("query_only", "ON"),
            )
            .await
            .map_err(open)?;
        let (path, runs, soundness) = (path.to_owned(), Mutex::default(), Mutex::default());
        Ok(Self { inner: Arc::new(Inner { path, clock, writer, readers, runs, soundness }) })
    }

    /// The database file.
    pub fn path(&self) -> &Path {
        &self.inner.path
    }

    /// Ends all connections after the writes handed over so far; the log is merged into the file.
    pub async fn close(&self) {
        self.inner.readers.close().await;
        self.inner.writer.close().await;
    }

    /// Bytes that can still be stored on the database's disk.
    pub async fn free_bytes(&self) -> Result<u64, StoreError> {
        let folder = match self.inner.path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let disk =
            nix::sys::statvfs::statvfs(folder).map_err(|e| StoreError::FreeSpace(e.into()))?;
        Ok(disk.blocks_available() * disk.fragment_size())
    }

    /// A view of the file as it is now, which later writes do not change.
    pub(crate) async fn read(
        &self,
        operation: &'static str,
    ) -> Result<Transaction<'static, Sqlite>, StoreError> {
        self.inner.readers.begin().await.during(operation)
    }

    /// The time as it is stored.
    pub(crate) fn now_text(&self) -> String {
        columns::time_text(self.inner.clock.timestamp())
    }
}

/// Makes a new database beside its place, then puts it there: a process that is killed on the way
/// leaves none, so that an empty file is always a loss.
async fn create(path: &Path, options: &SqliteConnectOptions) -> Result<(), StoreError> {
    let new = path.with_added_extension("new");
    // What a kill may have left. SQLite drops its log by itself.
    let _ = std::fs::remove_file(&new);
    let writer = Writer::start(options.clone().filename(&new).create_if_missing(true))?;
    writer.open(path, &MIGRATIONS).await?;
    writer.close().await;
    let put = || {
        std::fs::rename(&new, path)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        std::fs::File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
    };
    put().map_err(|e| StoreError::Open { path: path.to_owned(), source: e.into() })
}
