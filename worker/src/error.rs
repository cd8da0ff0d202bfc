//! Why a command failed.
//! Never: an address with a password. Errors of the queue and the store name host and bucket only.

use std::path::PathBuf;

/// Result of a command or of a part of it.
pub type WorkerResult<T> = Result<T, WorkerError>;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum WorkerError {
    /// An address, a file or an option is invalid.
    #[error("{0}")]
    Invalid(String),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: std::io::Error },
    /// The queue did not answer, or refused.
    #[error("queue: {0}")]
    Queue(String),
    /// The queue has no tables yet, or the role may not use them.
    #[error("queue: {0}; an administrator runs `palpate-worker setup` once per database")]
    NotSetUp(String),
    /// The store did not answer, or refused.
    #[error("store: {0}")]
    Store(String),
    /// The work was done, and something in it is wrong.
    #[error("{0}")]
    Failed(String),
}

impl WorkerError {
    /// Error of a file.
    pub fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }

    /// Exit code of the program, as in `docs/commands.md`.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Invalid(_) => 2,
            Self::File { .. }
            | Self::Queue(_)
            | Self::NotSetUp(_)
            | Self::Store(_)
            | Self::Failed(_) => 1,
        }
    }
}

impl From<object_store::Error> for WorkerError {
    fn from(error: object_store::Error) -> Self {
        Self::Store(error.to_string())
    }
}
