//! What can go wrong with training and with models: one enum, whose words name field and choices.
//! Uses: the errors of what models are made with. Never: HTTP, logging.

use std::io;
use std::path::{Path, PathBuf};

use crate::dataset::error::DatasetError;
use crate::dataset::format::RowsError;
use crate::problem::Problem;
use crate::store::StoreError;

/// Why there is no training, or no model.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// What was asked for cannot be.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Problems(Vec<Problem>),
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Rows of the dataset.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// The training itself.
    #[cfg(feature = "train")]
    #[error(transparent)]
    Train(nets::train::TrainError),
    /// What it gave is no model.
    #[error(transparent)]
    Model(#[from] super::model_file::ModelError),
    /// A file.
    #[error("{operation} {}: {source}", path.display())]
    File {
        /// What was done.
        operation: &'static str,
        /// Which file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
}

impl LearnError {
    /// A file's error, by what was done with it.
    pub fn file(operation: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { operation, path: path.clone(), source }
    }
}
