//! Durable records in one SQLite file: runs, trials, events, and who did what.
//! Uses: `campaign` (its records and its `Journal`, which this implements), `clock`, `ids`, sqlx.
//! Never: HTTP, the rig, a write from any connection but the writer's.
//!
//! ```text
//! campaign, api --jobs--> writer thread, one connection, WAL, synchronous=FULL --> palpate.sqlite
//!                                                     read-only connections <-----/
//! ```
//! One trial is one transaction; its key is unique in the file, so that none is lost or doubled.
//! Reads never wait for the writer, nor the writer for reads: acquisition waits for nobody. What
//! was measured carries checksums, which every read compares.
//!
//! Methods of `Journal` wait for the disk as long as it takes, since the campaign has deadlines of
//! its own; all others give up after 30 s.

use palpate_words::{clock, ids, journal, record};
use parking_lot::Mutex;

mod actions;
mod as_journal;
mod bench;
mod checksum;
mod columns;
mod condition;
mod counts;
mod datasets;
mod error;
mod events;
mod examine;
mod imports;
mod jobs;
mod keys;
mod lock;
mod log;
mod models;
mod mountings;
mod queue;
mod runs;
pub mod table;
mod trial_query;
mod trial_rows;
mod trials;
mod twins;
mod writer;

#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use sqlx::{ConnectOptions, Sqlite, Transaction};

pub use actions::{ActionRow, NewAction};
pub use bench::SkipRow;
pub use condition::{Comparison, Condition, Operand};
pub use counts::SettingCount;
pub use datasets::{DatasetRow, ExportEnd, ExportRow, ExportState, RunExtent};
pub use error::StoreError;
pub use examine::Soundness;
pub use imports::{IMPORTED_CONTACTS_MAX, IMPORTED_MODEL, ImportedTrial};
pub use jobs::{JobEnd, JobKind, JobRow, JobState};
pub use keys::{KEYLESS, KEYLESS_SUFFIX, Key, KeyRing, KeyRow, Role};
pub use lock::LockRow;
pub use models::{ModelRow, PromotionRow};
pub use runs::{Label, NewRun, RunKind, RunPage, RunRow};
pub use trial_query::{MAX_PAGE, Order, TrialQuery};
pub use trial_rows::{Contact, TrialRow, tips_as_contacts};
pub use twins::{Fit, NewTwinModel, Twin, TwinCount, TwinModelId, TwinOutcome};

use crate::clock::Clock;
use crate::ids::RunUid;
use crate::record::LOG_BYTES;
use error::During;
use writer::Writer;

/// A page holds about five trials' voltages (a fifth smaller than in 4096: `docs/decisions/0001`).
const PAGE_BYTES: u32 = 16_384;

/// How long SQLite waits for another process's lock.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// Connections that read.
const READERS: u32 = 4;

/// Longest wait for one of them.
const READER_TIMEOUT: Duration = Duration::from_secs(5);

/// Rows that a reading connection may be ahead of who reads them: each wait is a change of threads.
const ROWS_AHEAD: usize = 1024;

/// The tables, as they grew.
static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../../migrations");

/// The database of a rig. Clones share it.
#[derive(Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

struct Inner {
    path: PathBuf,
    clock: Clock,
    writer: Writer,
    readers: SqlitePool,
    runs: Mutex<HashMap<RunUid, RunFacts>>,
    soundness: Mutex<Soundness>,
}

/// What never changes in a run and every insert needs.
#[derive(Debug, Clone, Copy)]
struct RunFacts {
    scan_id: i64,
    kind: RunKind,
    deadband_n: f64,
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
    async fn read(
        &self,
        operation: &'static str,
    ) -> Result<Transaction<'static, Sqlite>, StoreError> {
        self.inner.readers.begin().await.during(operation)
    }

    /// The time as it is stored.
    fn now_text(&self) -> String {
        columns::time_text(self.inner.clock.timestamp())
    }

    /// What every insert of a run needs, for reads.
    async fn facts(&self, run: RunUid, operation: &'static str) -> Result<RunFacts, StoreError> {
        if let Some(facts) = self.known(run) {
            return Ok(facts);
        }
        let mut view = self.read(operation).await?;
        Ok(self.keep(run, RunFacts::read(&mut view, run, operation).await?))
    }

    /// The same for the campaign: however many read, it is not kept waiting for a connection.
    async fn facts_to_write(
        &self,
        run: RunUid,
        operation: &'static str,
    ) -> Result<RunFacts, StoreError> {
        self.facts_by(&self.inner.writer.patient(), run, operation).await
    }

    async fn facts_by(
        &self,
        writer: &Writer,
        run: RunUid,
        operation: &'static str,
    ) -> Result<RunFacts, StoreError> {
        if let Some(facts) = self.known(run) {
            return Ok(facts);
        }
        let read = async move |c: &mut SqliteConnection| RunFacts::read(c, run, operation).await;
        Ok(self.keep(run, writer.run(operation, read).await?))
    }

    fn known(&self, run: RunUid) -> Option<RunFacts> {
        self.inner.runs.lock().get(&run).copied()
    }

    /// A run that was stored just now.
    fn keep_facts(&self, row: RunRow) -> RunRow {
        let (scan_id, kind, deadband_n) = (row.scan_id, row.kind, row.deadband_n);
        self.keep(row.uid, RunFacts { scan_id, kind, deadband_n });
        row
    }

    fn keep(&self, run: RunUid, facts: RunFacts) -> RunFacts {
        self.inner.runs.lock().insert(run, facts);
        facts
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

impl RunFacts {
    async fn read(
        connection: &mut SqliteConnection,
        run: RunUid,
        operation: &'static str,
    ) -> Result<Self, StoreError> {
        let row = sqlx::query("SELECT scan_id, kind, deadband_n FROM runs WHERE uid = ?1")
            .bind(run.to_string())
            .fetch_optional(connection)
            .await
            .during(operation)?
            .ok_or(StoreError::NoSuchRun(run))?;
        let columns = columns::Columns::of(&row, operation);
        Ok(Self {
            scan_id: columns.get("scan_id")?,
            kind: columns.word("kind")?,
            deadband_n: columns.get("deadband_n")?,
        })
    }
}
