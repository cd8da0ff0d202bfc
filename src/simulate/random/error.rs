//! Why Sim-Random could not be made.
//! Uses: thiserror. Never: exit codes, logging.

use std::io;
use std::path::PathBuf;

use parquet::errors::ParquetError;
use sim_core::batch::BatchError;

/// Why a folder of shards could not be made or gone on with.
#[derive(Debug, thiserror::Error)]
pub enum RandomError {
    /// The folder holds shards of another definition.
    #[error(
        "{folder} holds shards of another definition: {field} is {there} there and {here} here; \
         name another folder, or give the same options to go on",
        folder = folder.display()
    )]
    OtherDefinition {
        /// The folder.
        folder: PathBuf,
        /// Dotted key of the manifest's definition.
        field: String,
        /// Its value in the manifest.
        there: String,
        /// Its value as asked for now.
        here: String,
    },
    /// The folder holds Parquet files that no manifest accounts for.
    #[error(
        "{folder} holds {file} and no manifest: it was not made by this command",
        folder = folder.display()
    )]
    Foreign {
        /// The folder.
        folder: PathBuf,
        /// A file in it.
        file: String,
    },
    /// Another process writes into the folder.
    #[error("another process writes into {folder}", folder = folder.display())]
    Busy {
        /// The folder.
        folder: PathBuf,
    },
    /// The manifest cannot be understood.
    #[error("reading {path}: {source}", path = path.display())]
    Manifest {
        /// The manifest's file.
        path: PathBuf,
        /// Why not.
        source: serde_json::Error,
    },
    /// A file or folder could not be read or written.
    #[error("{operation} {path}: {source}", path = path.display())]
    File {
        /// What was tried.
        operation: &'static str,
        /// On what.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// A shard could not be encoded or written.
    #[error("writing {file}: {source}")]
    Encode {
        /// The shard's file name.
        file: String,
        /// Why.
        source: ParquetError,
    },
    /// A trial could not be simulated.
    #[error("simulating trials {first} to {last}: {source}")]
    Simulate {
        /// Number of the first trial of the row group.
        first: u64,
        /// Number of the last one.
        last: u64,
        /// Why.
        source: BatchError,
    },
    /// A shard that was made again has other bytes than the manifest says it had.
    #[error(
        "{file} was made again and has sha256 {now}, but the manifest says {before}: the same \
         definition must give the same bytes"
    )]
    NotReproduced {
        /// The shard's file name.
        file: String,
        /// sha256 in the manifest.
        before: String,
        /// sha256 now.
        now: String,
    },
}

impl RandomError {
    /// Makes the error of an operation on a file.
    pub fn file(
        operation: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { operation, path, source }
    }
}
