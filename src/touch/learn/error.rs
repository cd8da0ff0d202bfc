//! Errors of trainings and of models: one enum, whose messages name field and choices.
//! Uses: the errors of the parts of a model. Never: HTTP, logging.

use std::io;
use std::path::{Path, PathBuf};

use crate::dataset::error::DatasetError;
use crate::dataset::format::RowsError;
use crate::problem::{Problem, listed};
use crate::store::StoreError;

/// Why a training or a model failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum LearnError {
    #[error("{}", listed(.0))]
    Problems(Vec<Problem>),
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Rows(#[from] RowsError),
    #[error(transparent)]
    Train(#[from] nets::error::TrainError),
    #[error(transparent)]
    Model(#[from] super::model_file::ModelError),
    #[error("{operation} {}: {source}", path.display())]
    File { operation: &'static str, path: PathBuf, source: io::Error },
}

impl LearnError {
    /// Error for a value of `of` (a recipe, a dataset, an evaluation) that cannot be used.
    pub fn value(of: &str, key: &str, value: impl std::fmt::Display, limit: &str) -> Self {
        Self::Problems(vec![Problem::new(of, key, value, limit)])
    }

    /// Returns a conversion from an I/O error of an operation on a file.
    pub fn file(operation: &'static str, path: &Path) -> impl Fn(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { operation, path: path.clone(), source }
    }
}
