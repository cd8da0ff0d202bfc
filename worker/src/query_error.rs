//! What a request to the queue answered instead of a result.
//! Uses: the errors of graphile_worker and sqlx. Never: the address of the queue.

use graphile_worker::DbError;
use graphile_worker::errors::GraphileWorkerError;

/// Error of a request to the queue: its text, and the code of PostgreSQL.
pub(crate) struct QueryError {
    pub(crate) message: String,
    /// Code of PostgreSQL; absent if the connection was lost.
    pub(crate) code: Option<String>,
}

impl QueryError {
    pub(crate) fn lost(message: String) -> Self {
        Self { message, code: None }
    }
}

impl From<DbError> for QueryError {
    fn from(error: DbError) -> Self {
        Self { message: error.to_string(), code: error.code().map(str::to_owned) }
    }
}

impl From<GraphileWorkerError> for QueryError {
    fn from(error: GraphileWorkerError) -> Self {
        match error {
            GraphileWorkerError::SqlError(error) => error.into(),
            other => Self { message: other.to_string(), code: Some(String::new()) },
        }
    }
}

impl From<sqlx::Error> for QueryError {
    fn from(error: sqlx::Error) -> Self {
        let code = error.as_database_error().and_then(|error| error.code()).map(Into::into);
        Self { message: error.to_string(), code }
    }
}
