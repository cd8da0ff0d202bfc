//! Why a query has no answer.
//! Uses: the errors of datasets and of programs. Never: HTTP, logging.

use std::io;

use crate::dataset::error::DatasetError;
use crate::program::ProgramError;

/// Why a query has no answer.
#[derive(Debug, thiserror::Error)]
pub enum QueryError {
    /// The statement cannot be evaluated. Holds what is wrong.
    #[error("{0}")]
    Refused(String),
    /// The engine is being built. Holds what cargo does.
    #[error(
        "the query engine is built first, once: about ten minutes on two cores; ask again then ({0})"
    )]
    Building(String),
    /// Too many queries are in progress.
    #[error("other queries are in progress: ask again")]
    Busy,
    /// There is no engine, and it cannot be built.
    #[error("{0}")]
    Program(String),
    /// The engine could not be started or talked to.
    #[error("the query engine: {0}")]
    Talk(#[from] io::Error),
    /// The engine ended without an answer.
    #[error("the query engine {0}")]
    Ended(String),
    /// The rows of a table could not be prepared, or those of the result not read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}

impl From<ProgramError> for QueryError {
    fn from(error: ProgramError) -> Self {
        Self::Program(error.to_string())
    }
}

impl From<arrow_schema::ArrowError> for QueryError {
    fn from(error: arrow_schema::ArrowError) -> Self {
        Self::Dataset(error.into())
    }
}

impl From<crate::store::StoreError> for QueryError {
    fn from(error: crate::store::StoreError) -> Self {
        Self::Dataset(error.into())
    }
}
