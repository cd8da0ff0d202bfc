//! The database of a rig: opening, sharing and closing. The other files add methods for its tables.
//! Uses: `core::{writer, log, migrations}`, sqlx, `clock`. Never: the name of a table.

use std::collections::HashMap;
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use parking_lot::Mutex;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use sqlx::{ConnectOptions, Sqlite, Transaction};

use super::bulk::Bulk;
use super::columns;
use super::error::{During, StoreError, StoreResult};
use super::facts::RunFacts;
use super::log;
use super::migrations::{self, MIGRATIONS};
use super::writer::{Writer, require_columns};
use crate::clock::Clock;
use crate::ids::RunUid;
use crate::record::LOG_BYTES;

/// Size of a page of the file, bytes: the voltages of about five trials. The file is a fifth smaller
/// than with pages of 4096 bytes (`docs/decisions/0001`).
pub(crate) const PAGE_BYTES: u32 = 16_384;

/// Longest time that SQLite waits for the file lock of another process.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// Number of connections that read.
const READERS: u32 = 4;

/// Longest wait for a connection that reads.
const READER_TIMEOUT: Duration = Duration::from_secs(5);

/// Number of rows that a connection reads ahead of its caller: each wait is a switch between threads.
const ROWS_AHEAD: usize = 1024;

/// Result of the last examination of the file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Soundness {
    /// No examination has completed.
    #[default]
    Unchecked,
    /// The examination found no damage.
    Sound,
    /// Damage that it found, as text; a damaged trial is named by its id.
    Damaged(Vec<String>),
}

/// Use of a database by other processes while this one only reads it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sharing {
    /// No process changes it: it is read without a lock, its log, or any other file next to it.
    Unchanged,
    /// Another process writes it: it is read with its log, as by the connections of that process.
    Written,
}

impl Sharing {
    /// What SQLite opens for a database.
    fn address(self, database: &Path) -> PathBuf {
        match self {
            Self::Unchanged => unchanging(database),
            Self::Written => database.to_owned(),
        }
    }
}

/// The database of a rig. Clones share its connections.
#[derive(Clone)]
pub struct Store {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    pub(crate) path: PathBuf,
    pub(crate) clock: Clock,
    pub(crate) writer: Writer,
    pub(crate) readers: SqlitePool,
    pub(crate) bulk: Bulk,
    pub(crate) runs: Mutex<HashMap<RunUid, RunFacts>>,
    pub(crate) soundness: Mutex<Soundness>,
    /// Number of changes of stored trials and of their twins, by scan id, since this store was opened.
    pub(crate) changes: Mutex<HashMap<i64, u64>>,
    /// Whether runs that an earlier process left open stay as they are stored, and are read as interrupted.
    pub(crate) leaves_open: AtomicBool,
}

impl Store {
    /// Opens the database file. Creates it if it is missing, and applies missing migrations.
    ///
    /// # Errors
    /// `Lost` if the file is empty, or missing while its log exists; `DamagedLog` if the log was changed
    /// after it was written; `Damaged` if a column is missing; `Open`, `Migrate` or `StartWriter` if a
    /// connection, a migration or the writer's thread fails; `Late` after 600 s.
    pub async fn open(path: &Path, clock: Clock) -> StoreResult<Self> {
        let open = |source| StoreError::Open { path: path.to_owned(), source };
        let writing = options(path)
            .page_size(PAGE_BYTES)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            // A long read makes the log grow; afterwards SQLite truncates it to this size.
            .pragma("journal_size_limit", LOG_BYTES.to_string())
            // A trigger makes SQLite keep the pages that its statement changes: not in a temporary file.
            .pragma("temp_store", "MEMORY");
        let is_new = matches!(path.symlink_metadata(), Err(e) if e.kind() == ErrorKind::NotFound);
        // The log is next to the target of a symbolic link.
        let mut log = path.canonicalize().unwrap_or_else(|_| path.to_owned()).into_os_string();
        log.push("-wal");
        // SQLite takes an empty file for a new database.
        if path.metadata().is_ok_and(|file| file.len() == 0) || is_new && Path::new(&log).exists() {
            return Err(StoreError::Lost { path: path.to_owned() });
        }
        // SQLite ignores every transaction behind a damaged frame.
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
        Self::with(path, path, writer, clock).await
    }

    /// Opens a current database ([`Self::is_current`]) where it is, and only reads it, without a thread that writes.
    ///
    /// `database`: path of the file. `path`: path that [`Self::path`] returns, in the folder of what is computed.
    ///
    /// # Errors
    /// `Open` if the file cannot be read.
    pub async fn read_in_place(
        database: &Path,
        sharing: Sharing,
        path: &Path,
        clock: Clock,
    ) -> StoreResult<Self> {
        Self::with(path, &sharing.address(database), Writer::none(), clock).await
    }

    /// Whether a file is a database with exactly the tables of this version; false also if it cannot be read. Writes
    /// nothing into it.
    pub async fn is_current(database: &Path, sharing: Sharing) -> bool {
        const OPERATION: &str = "comparing the migrations with those of this version";
        let compared = async {
            let reading = options(&sharing.address(database)).read_only(true);
            let mut connection = reading.connect().await.during(OPERATION)?;
            require_columns(&mut connection, &MIGRATIONS).await?;
            migrations::are_applied(&mut connection).await.during(OPERATION)
        };
        compared.await.unwrap_or(false)
    }

    /// The store of a file, or of an address of SQLite, with what writes to it.
    async fn with(path: &Path, file: &Path, writer: Writer, clock: Clock) -> StoreResult<Self> {
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .acquire_timeout(READER_TIMEOUT)
            .idle_timeout(None)
            .max_lifetime(None)
            .test_before_acquire(false)
            .connect_with(
                options(file)
                    .read_only(true)
                    .row_buffer_size(ROWS_AHEAD)
                    .pragma("query_only", "ON"),
            )
            .await
            .map_err(|source| StoreError::Open { path: path.to_owned(), source })?;
        let bulk = Bulk::new(file, BUSY_TIMEOUT);
        let (path, changes) = (path.to_owned(), Mutex::default());
        let (runs, soundness) = (Mutex::default(), Mutex::default());
        let leaves_open = AtomicBool::default();
        let inner =
            Inner { path, clock, writer, readers, bulk, runs, soundness, changes, leaves_open };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Returns the path of the database file.
    pub fn path(&self) -> &Path {
        &self.inner.path
    }

    /// Runs `work` in one transaction.
    pub(crate) async fn write<T, F>(&self, operation: &'static str, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: AsyncFnOnce(&mut SqliteConnection) -> StoreResult<T> + Send + 'static,
    {
        self.inner.writer.run(operation, work).await
    }

    /// Returns a number that grows with each stored twin and each discarded trial of a run: what was read
    /// of a run that has ended is as it was while the number is. New trials do not count.
    pub fn changes_of(&self, scan_id: i64) -> u64 {
        self.inner.changes.lock().get(&scan_id).copied().unwrap_or_default()
    }

    /// Counts a change of the trials of a run, or of their twins.
    pub(crate) fn count_change(&self, scan_id: i64) {
        *self.inner.changes.lock().entry(scan_id).or_default() += 1;
    }

    /// Closes all connections after the submitted writes, and merges the log into the file.
    pub async fn close(&self) {
        self.inner.bulk.close().await;
        self.inner.readers.close().await;
        self.inner.writer.close().await;
    }

    /// Returns the free space of the disk of the database, bytes.
    ///
    /// # Errors
    /// `FreeSpace` if the operating system does not report it.
    pub async fn free_bytes(&self) -> StoreResult<u64> {
        let folder = match self.inner.path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let disk =
            nix::sys::statvfs::statvfs(folder).map_err(|e| StoreError::FreeSpace(e.into()))?;
        Ok(disk.blocks_available() * disk.fragment_size())
    }

    /// Begins a read transaction: a view of the file as it is now, which later writes do not change.
    ///
    /// # Errors
    /// `Sql` if no connection is free within 5 s.
    pub(crate) async fn read(
        &self,
        operation: &'static str,
    ) -> StoreResult<Transaction<'static, Sqlite>> {
        self.inner.readers.begin().await.during(operation)
    }

    /// Returns the current wall time as it is stored.
    pub(crate) fn now_text(&self) -> String {
        columns::time_text(self.inner.clock.timestamp())
    }
}

/// Options of every connection to a file, or to the one that an address of SQLite names.
fn options(file: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(file)
        .busy_timeout(BUSY_TIMEOUT)
        .foreign_keys(true)
        .disable_statement_logging()
}

/// Address by which SQLite reads a file that no process changes: without a lock, and without its log.
fn unchanging(database: &Path) -> PathBuf {
    let encoded = |byte: &u8| match byte.is_ascii_alphanumeric() {
        true => char::from(*byte).to_string(),
        false => format!("%{byte:02X}"),
    };
    let path: String = database.as_os_str().as_bytes().iter().map(encoded).collect();
    format!("file:{path}?immutable=1").into()
}

/// Creates a new database under a temporary name, then renames it. A process that is killed meanwhile
/// leaves no database, so that an empty file is always a lost one.
async fn create(path: &Path, options: &SqliteConnectOptions) -> StoreResult<()> {
    let new = path.with_added_extension("new");
    // Remains of a killed process. SQLite removes their log itself.
    let _ = std::fs::remove_file(&new);
    // SQLite creates its log with the rights of the database.
    let made = std::fs::File::options().write(true).create_new(true).mode(0o600).open(&new);
    made.map_err(|e| StoreError::Open { path: path.to_owned(), source: e.into() })?;
    let writer = Writer::start(options.clone().filename(&new))?;
    writer.open(path, &MIGRATIONS).await?;
    writer.close().await;
    let rename = || {
        std::fs::rename(&new, path)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        std::fs::File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
    };
    rename().map_err(|e| StoreError::Open { path: path.to_owned(), source: e.into() })
}
