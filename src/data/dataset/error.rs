//! Errors of datasets, exports and imports: one enum, whose messages name field, value and choices.
//! Uses: the errors of the store, the formats and the shards. Never: HTTP, logging.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use arrow_schema::ArrowError;
use parquet::errors::ParquetError;

use super::format::FormatError;
use super::shards::ShardsError;
use crate::ids::DatasetId;
use crate::problem::{Problem, listed};
use crate::store::StoreError;

/// Result of work on datasets, exports and imports.
pub type DatasetResult<T> = Result<T, DatasetError>;

/// Why a dataset, an export or an import failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum DatasetError {
    #[error("{}", listed(.0))]
    Problems(Vec<Problem>),
    #[error("no dataset {name}: choose from {choices}, or run-N for a run that has ended{meant}")]
    NoDataset { name: String, choices: String, meant: String },
    #[error("dataset {0} has not been made: palpate dataset make {0}")]
    NotMade(String),
    #[error("this file was imported as run {0}, with the same name, label and sensor")]
    Imported(i64),
    #[error("runs = {0}: no run has this uid, scan id or experiment")]
    NoRun(String),
    /// The run may still get trials. Holds its scan id.
    #[error(
        "run {0} has not ended: read its trials in pages, or request the dataset after its end"
    )]
    NotEnded(i64),
    #[error("dataset {name} has no rows: {why}")]
    Empty { name: String, why: String },
    #[error("label = absent: the runs have different labels ({0}); select one label")]
    Labels(String),
    #[error(
        "runs: all frames of a dataset must have the same length: {one}, {other}; name the runs"
    )]
    Channels { one: String, other: String },
    #[error("sim_random = {folder}: simulated with {there}, the other simulated rows with {here}")]
    Models { folder: String, there: String, here: String },
    /// Trials were removed between the two passes over them.
    #[error("trials were removed while the dataset was made: request it again")]
    Changed,
    #[error(
        "{product} of about {needed} bytes: {free} bytes are free, {kept} of them reserved for runs"
    )]
    DiskFull { product: Product, needed: u64, free: u64, kept: u64 },
    #[error("dataset {0}: its file is missing; make the dataset again by its name")]
    FileMissing(DatasetId),
    #[error(transparent)]
    Shards(#[from] ShardsError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("{operation} {path}: {source}", path = path.display())]
    File { operation: &'static str, path: PathBuf, source: io::Error },
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Arrow(#[from] ArrowError),
    #[error(transparent)]
    Parquet(#[from] ParquetError),
    #[error("a value cannot be converted to or from JSON: {0}")]
    Json(serde_json::Error),
    #[error("a worker thread ended before its result")]
    Worker,
}

/// A file that the service writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Product {
    /// Rows and card of a dataset.
    Dataset,
    /// A dataset in a requested format.
    Export,
    /// An uploaded file and its trials.
    Import,
    /// Stored trials as a file that questions in SQL read.
    Piece,
}

impl fmt::Display for Product {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dataset => "a dataset",
            Self::Export => "an export",
            Self::Import => "an import",
            Self::Piece => "a file of trials for questions",
        })
    }
}

impl DatasetError {
    /// Returns a conversion from an I/O error of an operation on a file.
    pub(crate) fn file(operation: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { operation, path: path.clone(), source }
    }

    /// Whether the same request may succeed later: the disk was full, the store did not answer, or trials were removed
    /// meanwhile.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::DiskFull { .. } | Self::Changed => true,
            Self::Store(error) => !error.is_refusal(),
            error => lacks_space(error),
        }
    }

    /// The error for one invalid value of a request.
    pub(super) fn value(key: &str, value: impl std::fmt::Display, limit: &str) -> Self {
        Self::Problems(vec![Problem::new("request", key, value, limit)])
    }
}

/// Whether a write failed because its disk is full.
fn lacks_space(error: &(dyn std::error::Error + 'static)) -> bool {
    let of_system = error.downcast_ref::<io::Error>();
    of_system.is_some_and(|error| error.kind() == io::ErrorKind::StorageFull)
        || error.source().is_some_and(lacks_space)
}

#[cfg(test)]
mod tests {
    use std::io::{self, ErrorKind};

    use arrow_schema::ArrowError;
    use parquet::errors::ParquetError;

    use super::{DatasetError, Product};
    use crate::dataset::format::FormatError;
    use crate::store::StoreError;

    #[test]
    fn a_disk_that_became_full_is_found_behind_every_writer() {
        let file = |kind: ErrorKind| {
            let (operation, path) = ("writing", "ds-1.parquet".into());
            DatasetError::File { operation, path, source: kind.into() }
        };
        let full = || io::Error::from(ErrorKind::StorageFull);
        let encoded = FormatError::Parquet(ParquetError::from(full()));
        let columns = FormatError::Arrow(ArrowError::IoError("a".into(), full()));
        let written = [encoded, columns, FormatError::Io(full())].map(DatasetError::Format);
        assert!(written.iter().all(DatasetError::may_pass), "{written:?}");
        assert!(DatasetError::Parquet(ParquetError::from(full())).may_pass());
        assert!(file(ErrorKind::StorageFull).may_pass());
        assert!(!file(ErrorKind::PermissionDenied).may_pass());
        assert!(!DatasetError::Worker.may_pass());
        let store = |error| DatasetError::Store(error).may_pass();
        assert!(store(StoreError::Late { operation: "reading", limit_s: 30 }));
        assert!(!store(StoreError::Damaged { findings: vec![] }));
    }

    #[test]
    fn a_full_disk_is_reported_for_what_was_to_be_written() {
        let message =
            |product| DatasetError::DiskFull { product, needed: 3, free: 2, kept: 1 }.to_string();
        assert!(message(Product::Dataset).starts_with("a dataset of about 3 bytes: 2 bytes"));
        assert!(message(Product::Export).starts_with("an export of about 3 bytes: 2 bytes"));
    }
}
