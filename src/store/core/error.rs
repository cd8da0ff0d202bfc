//! The errors of the store: one enum, whose variants name the failed operation.
//! Uses: sqlx's and rusqlite's errors as sources. Never: HTTP, logging.
//!
//! A method that reads returns `Sql` or `Read` if its statement fails and `Unreadable` or `Damaged` if a stored
//! value cannot be decoded or differs from its checksum. A method that writes returns `Sql` if its
//! statement fails, and `Late` or `Closed` if the writer does not answer; one that reads first also `Read`.
//! Both return `NoSuchRun` if they are of a run that is not stored.

use std::path::PathBuf;

use crate::ids::{RunUid, TrialKey};
use crate::journal::{JournalError, error_chain};

/// Result of an operation of the store.
pub type StoreResult<T> = Result<T, StoreError>;

/// Failure of an operation of the store.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum StoreError {
    #[error("opening the database {path} failed")]
    Open {
        path: PathBuf,
        #[source]
        source: sqlx::Error,
    },
    #[error(
        "the database {path} is lost: the file is empty, or missing while its log {path}-wal exists; \
         restore it from a copy, or remove the remaining files to start a new database"
    )]
    Lost { path: PathBuf },
    /// The log of the database was changed after it was written. SQLite would drop stored transactions
    /// when it opens the file.
    #[error(
        "the log {path}-wal is damaged at byte {at_byte}: at least {transactions} stored transactions \
         after it cannot be read; copy both files before any program opens them, and restore the \
         database from a copy"
    )]
    DamagedLog { path: PathBuf, at_byte: usize, transactions: usize },
    #[error("migrating the tables of the database {path} failed")]
    Migrate {
        path: PathBuf,
        #[source]
        source: sqlx::migrate::MigrateError,
    },
    #[error("starting the writer of the store failed")]
    StartWriter(#[source] std::io::Error),
    /// A statement failed. After a failed write the outcome is unknown, unless a constraint refused it:
    /// read again before you continue.
    #[error("{operation} failed in the database")]
    Sql {
        operation: &'static str,
        #[source]
        source: sqlx::Error,
    },
    /// A statement that only reads failed.
    #[error("{operation} failed in the database")]
    Read {
        operation: &'static str,
        #[source]
        source: rusqlite::Error,
    },
    /// A write failed. A later read of the database shows that it is not stored.
    #[error("{operation} failed, and nothing of it is stored")]
    NotStored {
        operation: &'static str,
        #[source]
        source: Box<StoreError>,
    },
    /// A write did not finish in time. Its outcome is unknown.
    #[error("{operation} did not finish within {limit_s} s")]
    Late { operation: &'static str, limit_s: u64 },
    #[error("{operation}: the store is closed")]
    Closed { operation: &'static str },
    /// The store was opened with `Store::read_in_place`.
    #[error("{operation}: the database is only read")]
    ReadOnly { operation: &'static str },
    /// A record was refused before anything was written.
    #[error("{operation}: {field} {limit}")]
    Refused { operation: &'static str, field: &'static str, limit: &'static str },
    /// A stored value cannot be decoded.
    #[error("{operation}: column {column} holds {value:?}")]
    Unreadable { operation: &'static str, column: &'static str, value: String },
    #[error("the database is damaged: {}", findings.join("; "))]
    Damaged {
        /// Damage that SQLite or a checksum reported; a damaged trial is named by its id.
        findings: Vec<String>,
    },
    #[error("reading the free space of the disk failed")]
    FreeSpace(#[source] std::io::Error),
    #[error("there is no run {0}")]
    NoSuchRun(RunUid),
    #[error("run {0} has ended")]
    RunEnded(RunUid),
    #[error("run {0} is not in the queue")]
    NotQueued(RunUid),
    #[error("run {run} has no trial of configuration {} at depth {}", key.configuration, key.depth_index)]
    NoSuchTrial { run: RunUid, key: TrialKey },
    #[error("{holder} holds the operator lock: {note}")]
    LockHeld { holder: String, note: String },
}

impl StoreError {
    /// Whether a write that returned this error may be stored nevertheless: the disk, the file or the
    /// connection failed, and no constraint refused the write. (A failed fsync can leave its row in the
    /// file: `docs/references.md`, "SQLite".)
    pub fn outcome_unknown(&self) -> bool {
        match self {
            Self::Sql { source: sqlx::Error::Database(e), .. } => {
                matches!(e.kind(), sqlx::error::ErrorKind::Other)
            }
            Self::Sql { .. } | Self::Late { .. } => true,
            Self::Open { .. }
            | Self::Lost { .. }
            | Self::DamagedLog { .. }
            | Self::Migrate { .. }
            | Self::StartWriter(_)
            | Self::Read { .. }
            | Self::NotStored { .. }
            | Self::Closed { .. }
            | Self::ReadOnly { .. }
            | Self::Refused { .. }
            | Self::Unreadable { .. }
            | Self::Damaged { .. }
            | Self::FreeSpace(_)
            | Self::NoSuchRun(_)
            | Self::RunEnded(_)
            | Self::NotQueued(_)
            | Self::NoSuchTrial { .. }
            | Self::LockHeld { .. } => false,
        }
    }

    /// Whether the record itself is refused, or what it changes is damaged, so that a repetition fails, too.
    pub fn is_refusal(&self) -> bool {
        match self {
            Self::Sql { source: sqlx::Error::Database(e), .. } => {
                !matches!(e.kind(), sqlx::error::ErrorKind::Other)
            }
            Self::ReadOnly { .. }
            | Self::Refused { .. }
            | Self::Unreadable { .. }
            | Self::Damaged { .. }
            | Self::NoSuchRun(_)
            | Self::RunEnded(_)
            | Self::NotQueued(_)
            | Self::NoSuchTrial { .. } => true,
            _ => false,
        }
    }

    /// Returns the error for one finding of damage.
    pub(crate) fn damaged(finding: String) -> Self {
        Self::Damaged { findings: vec![finding] }
    }

    /// Returns the findings if the error means that the file is damaged.
    ///
    /// # Errors
    /// The error itself if it has another cause.
    pub(crate) fn into_findings(self) -> Result<Vec<String>, Self> {
        /// SQLite's result codes for a statement that does not match the tables (1), a failed read or
        /// write (10), a malformed page (11) and a file that is no database (26).
        const DAMAGE: [i32; 4] = [1, 10, 11, 26];
        let damage = match &self {
            Self::Damaged { findings } => return Ok(findings.clone()),
            Self::Unreadable { .. } => true,
            Self::Sql { source, .. } => match source {
                sqlx::Error::Database(e) => {
                    let code = e.code().and_then(|code| code.parse::<i32>().ok());
                    code.is_some_and(|code| DAMAGE.contains(&(code & 0xff)))
                }
                sqlx::Error::ColumnDecode { .. } | sqlx::Error::Decode(_) => true,
                _ => false,
            },
            Self::Read { source, .. } => match source {
                rusqlite::Error::SqliteFailure(e, _) => DAMAGE.contains(&(e.extended_code & 0xff)),
                rusqlite::Error::InvalidColumnType(..) => true,
                _ => false,
            },
            _ => false,
        };
        if damage { Ok(vec![error_chain(&self)]) } else { Err(self) }
    }

    /// Returns a conversion to the error of `Journal`, for `map_err`; `what` names the record.
    pub(crate) fn of(what: &'static str) -> impl Fn(Self) -> JournalError {
        move |source: Self| {
            let refused = source.is_refusal();
            JournalError { what, refused, source: Box::new(source) }
        }
    }
}

/// Conversion of a database failure into a [`StoreError`]: `.await.during(OPERATION)?`.
pub(crate) trait During<T> {
    /// Adds the name of the operation.
    fn during(self, operation: &'static str) -> StoreResult<T>;
}

impl<T> During<T> for Result<T, sqlx::Error> {
    fn during(self, operation: &'static str) -> StoreResult<T> {
        self.map_err(|source| StoreError::Sql { operation, source })
    }
}

impl<T> During<T> for Result<T, rusqlite::Error> {
    fn during(self, operation: &'static str) -> StoreResult<T> {
        self.map_err(|source| StoreError::Read { operation, source })
    }
}
