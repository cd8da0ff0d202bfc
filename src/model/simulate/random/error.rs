//! Errors of Sim-Random.
//! Uses: thiserror. Never: exit codes, logging.

use std::io;
use std::path::PathBuf;

use parquet::errors::ParquetError;
use sim_core::batch::BatchError;

/// Why a folder of shards could not be made or resumed.
#[derive(Debug, thiserror::Error)]
pub enum RandomError {
    /// The folder contains shards of another definition.
    #[error(
        "{folder} contains shards of another definition: {field} = {there}, requested {here}; \
         name another folder, or use the same options to resume",
        folder = folder.display()
    )]
    OtherDefinition {
        /// Path of the folder.
        folder: PathBuf,
        /// Dotted key of the manifest's definition.
        field: String,
        /// Value in the manifest.
        there: String,
        /// Requested value.
        here: String,
    },
    /// The folder contains Parquet files without a manifest.
    #[error(
        "{folder} contains {file} and no manifest: it was not made by this command",
        folder = folder.display()
    )]
    Foreign {
        /// Path of the folder.
        folder: PathBuf,
        /// Name of a file in it.
        file: String,
    },
    /// Another process writes into the folder.
    #[error("another process writes into {folder}", folder = folder.display())]
    Busy {
        /// Path of the folder.
        folder: PathBuf,
    },
    /// The manifest is not valid JSON.
    #[error("reading {path}: {source}", path = path.display())]
    Manifest {
        /// Path of the manifest.
        path: PathBuf,
        /// Error of the parser.
        source: serde_json::Error,
    },
    /// A file or folder could not be read or written.
    #[error("{operation} {path}: {source}", path = path.display())]
    File {
        /// The failed operation.
        operation: &'static str,
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A shard could not be encoded or written.
    #[error("writing {file}: {source}")]
    Encode {
        /// File name of the shard, or its trials.
        file: String,
        /// Error of the encoder.
        source: ParquetError,
    },
    /// A trial could not be simulated.
    #[error("simulating trials {first} to {last}: {source}")]
    Simulate {
        /// Number of the first trial of the row group.
        first: u64,
        /// Number of the last one.
        last: u64,
        /// Error of the model.
        source: BatchError,
    },
    /// A shard that was repeated differs from its entry in the manifest.
    #[error(
        "{file} was repeated and has sha256 {now}, but the manifest states {before}: the same \
         definition must give the same bytes"
    )]
    NotReproduced {
        /// File name of the shard.
        file: String,
        /// sha256 in the manifest.
        before: String,
        /// sha256 of the repeated shard.
        now: String,
    },
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
