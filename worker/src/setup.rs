//! Makes the tables of the queue, and the role of workers, whose rights are in `setup.sql`.
//! Uses: `queue`. Never: a password: logins of workers are made by the administrator.

use crate::WorkerResult;
use crate::queue::Queue;

/// Rights of the role `palpate_worker`.
pub const RIGHTS: &str = include_str!("setup.sql");

/// Makes or updates tables and role; it may run again at any time.
///
/// # Errors
/// `WorkerError` if the queue does not answer, or if the role may not make a schema and a role.
pub async fn setup(queue: &Queue) -> WorkerResult<()> {
    queue.migrate().await?;
    queue.apply(RIGHTS).await
}
