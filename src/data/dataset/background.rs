//! Work that takes seconds: a dedicated thread with low priority for each task.
//! Uses: std's threads, `priority`. Never: a thread that is used again (its priority stays low).

use tokio::sync::oneshot;
use tracing::Span;

use super::error::{DatasetError, DatasetResult};
use crate::priority;

/// Runs `work` on a new thread with low priority, in the present span, and returns its result.
///
/// # Errors
/// `DatasetError::Worker` if the thread does not start, or if `work` panics.
pub async fn background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> DatasetResult<T> {
    let (done, finished) = oneshot::channel();
    let span = Span::current();
    let thread = std::thread::Builder::new().name("background".into()).spawn(move || {
        let _inside = span.entered();
        priority::lower();
        // The caller may have been dropped.
        let _ = done.send(work());
    });
    thread.map_err(|_| DatasetError::Worker)?;
    finished.await.map_err(|_| DatasetError::Worker)
}
