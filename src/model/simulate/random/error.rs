//! Errors of Sim-Random.
//! Uses: thiserror. Never: exit codes, logging.

use std::io;
use std::path::PathBuf;

use parquet::errors::ParquetError;
use sim_core::batch::BatchError;

/// Why a folder of shards could not be made or resumed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum RandomError {
    #[error(
        "{folder} contains shards of another definition: {field} = {there}, requested {here}; \
         name another folder, or use the same options to resume",
        folder = folder.display()
    )]
    OtherDefinition { folder: PathBuf, field: String, there: String, here: String },
    #[error(
        "{folder} contains {file} and no manifest: it was not made by this command",
        folder = folder.display()
    )]
    Foreign { folder: PathBuf, file: String },
    #[error("another process writes into {folder}", folder = folder.display())]
    Busy { folder: PathBuf },
    #[error("reading {path}: {source}", path = path.display())]
    Manifest { path: PathBuf, source: serde_json::Error },
    #[error("{operation} {path}: {source}", path = path.display())]
    File { operation: &'static str, path: PathBuf, source: io::Error },
    #[error("writing {file}: {source}")]
    Encode { file: String, source: ParquetError },
    #[error("simulating trials {first} to {last}: {source}")]
    Simulate { first: u64, last: u64, source: BatchError },
    #[error(
        "{file} was repeated and has sha256 {now}, but the manifest states {before}: the same \
         definition must give the same bytes"
    )]
    NotReproduced { file: String, before: String, now: String },
}

impl RandomError {
    /// Returns a conversion from an I/O error of an operation on a file.
    pub fn file(
        operation: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { operation, path, source }
    }
}
