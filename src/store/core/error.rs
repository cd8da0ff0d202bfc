//! What can go wrong with the store: one enum, each variant names the operation.
//! Uses: sqlx's errors as sources. Never: HTTP, logging.

use std::path::PathBuf;

use crate::ids::{RunUid, TrialKey};
use crate::journal::JournalError;

/// The store could not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database file cannot be opened or created.
    #[error("opening the database {path} failed")]
    Open {
        /// The file.
        path: PathBuf,
        /// Its cause.
        #[source]
        source: sqlx::Error,
    },
    /// The database file has no contents, or is gone while its log is there.
    #[error(
        "the database {path} is lost: the file is empty, or gone while its log ({path}-wal) is \
         there; bring it back from a copy, or remove what is left of it to begin anew"
    )]
    Lost {
        /// The file.
        path: PathBuf,
    },
    /// The database's log was changed after it was written: opening it would drop stored transactions.
    #[error(
        "the log {path}-wal is damaged at byte {at_byte}: {transactions} stored transactions or more \
         from there on cannot be read. Copy both files away before anything opens them, and restore \
         them from a copy"
    )]
    DamagedLog {
        /// The database file.
        path: PathBuf,
        /// The first byte of the frame of the log that is not as it was written.
        at_byte: usize,
        /// Stored transactions from there on, at least.
        transactions: usize,
    },
    /// The tables cannot be brought up to date.
    #[error("bringing the tables of the database up to date failed")]
    Migrate(#[source] sqlx::migrate::MigrateError),
    /// The writer's thread cannot be started.
    #[error("starting the store's writer failed")]
    StartWriter(#[source] std::io::Error),
    /// A statement failed. After a failed write the outcome is unknown unless a constraint
    /// refused it: read again before going on.
    #[error("{operation} failed in the database")]
    Sql {
        /// What was being done.
        operation: &'static str,
        /// Its cause.
        #[source]
        source: sqlx::Error,
    },
    /// A write failed, and the database was asked since: it is not stored.
    #[error("{operation} failed, and nothing of it is stored")]
    NotStored {
        /// What was being done.
        operation: &'static str,
        /// The failure.
        #[source]
        source: Box<StoreError>,
    },
    /// A write did not finish in time: its outcome is unknown.
    #[error("{operation} was not finished by the store within {limit_s} s")]
    Late {
        /// What was being done.
        operation: &'static str,
        /// The deadline, s.
        limit_s: u64,
    },
    /// The store has been closed.
    #[error("{operation}: the store is closed")]
    Closed {
        /// What was asked.
        operation: &'static str,
    },
    /// A record was refused before anything was written.
    #[error("{operation}: {field} {limit}")]
    Refused {
        /// What was being done.
        operation: &'static str,
        /// The field.
        field: &'static str,
        /// What is allowed.
        limit: &'static str,
    },
    /// A stored value cannot be understood.
    #[error("{operation}: column {column} holds {value:?}")]
    Unreadable {
        /// What was being done.
        operation: &'static str,
        /// The column.
        column: &'static str,
        /// What it holds.
        value: String,
    },
    /// The database file is damaged.
    #[error("the database is damaged: {}", findings.join("; "))]
    Damaged {
        /// What SQLite, or a checksum, found; a damaged trial by its id.
        findings: Vec<String>,
    },
    /// The disk cannot be asked how much it still holds.
    #[error("asking the disk for its free space failed")]
    FreeSpace(#[source] std::io::Error),
    /// There is no such run.
    #[error("there is no run {0}")]
    NoSuchRun(RunUid),
    /// The run has ended; it does not change any more.
    #[error("run {0} has ended")]
    RunEnded(RunUid),
    /// The run does not wait in the queue.
    #[error("run {0} is not in the queue")]
    NotQueued(RunUid),
    /// The run has no such trial.
    #[error("run {run} has no trial of configuration {} at depth {}", key.configuration, key.depth_index)]
    NoSuchTrial {
        /// The run.
        run: RunUid,
        /// The trial's place in it.
        key: TrialKey,
    },
    /// Somebody else holds the operator lock.
    #[error("{holder} holds the operator lock: {note}")]
    LockHeld {
        /// Who.
        holder: String,
        /// Why, in their words.
        note: String,
    },
}

impl StoreError {
    /// True when a write that ended like this may still have been stored: the disk, the file or the
    /// connection failed, and no rule of ours refused it. (A failed fsync was seen to leave its row
    /// behind: `docs/references.md`, "SQLite".)
    pub fn outcome_unknown(&self) -> bool {
        match self {
            Self::Sql { source: sqlx::Error::Database(e), .. } => {
                matches!(e.kind(), sqlx::error::ErrorKind::Other)
            }
            Self::Sql { .. } | Self::Late { .. } => true,
            Self::Open { .. }
            | Self::Lost { .. }
            | Self::DamagedLog { .. }
            | Self::Migrate(_)
            | Self::StartWriter(_)
            | Self::NotStored { .. }
            | Self::Closed { .. }
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

    /// True when the record itself is refused: trying again does not help.
    fn is_refusal(&self) -> bool {
        match self {
            Self::Sql { source: sqlx::Error::Database(e), .. } => {
                !matches!(e.kind(), sqlx::error::ErrorKind::Other)
            }
            Self::Refused { .. }
            | Self::NoSuchRun(_)
            | Self::RunEnded(_)
            | Self::NotQueued(_)
            | Self::NoSuchTrial { .. } => true,
            _ => false,
        }
    }

    /// A finding of damage.
    pub(crate) fn damaged(finding: String) -> Self {
        Self::Damaged { findings: vec![finding] }
    }

    /// What the error says of the file where it is damage: findings; else the error again.
    pub(crate) fn into_findings(self) -> Result<Vec<String>, Self> {
        /// SQLite's codes of a statement that does not fit the tables, an unreadable place, a
        /// malformed page and a file that is no database.
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
            _ => false,
        };
        if damage { Ok(vec![self.with_causes()]) } else { Err(self) }
    }

    /// The error with its causes, each said once, for people.
    pub fn with_causes(&self) -> String {
        let mut words = self.to_string();
        let mut cause = std::error::Error::source(self);
        while let Some(error) = cause {
            let said = error.to_string();
            if !words.contains(&said) {
                words = format!("{words}: {said}");
            }
            cause = error.source();
        }
        words
    }

    /// The same error as the campaign sees it.
    pub(crate) fn of(what: &'static str) -> impl Fn(Self) -> JournalError {
        move |source: Self| {
            let refused = source.is_refusal();
            JournalError { what, refused, source: Box::new(source) }
        }
    }
}

/// Adds the operation to a failure of the database: `.await.during(OPERATION)?`.
pub(crate) trait During<T> {
    /// Names what was being done, in the words of [`StoreError::Sql`].
    fn during(self, operation: &'static str) -> Result<T, StoreError>;
}

impl<T> During<T> for Result<T, sqlx::Error> {
    fn during(self, operation: &'static str) -> Result<T, StoreError> {
        self.map_err(|source| StoreError::Sql { operation, source })
    }
}
