//! Work that takes seconds and must not be felt: a thread of its own, behind everything else.
//! Uses: std's threads, rustix. Never: a thread that others use later (its priority stays low).

use tokio::sync::oneshot;

use super::error::DatasetError;

/// How far behind: of two threads that want a processor, one at 0 gets ten times as much.
const NICE: i32 = 10;

/// Does `work` on a thread of low priority.
pub async fn background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, DatasetError> {
    let (done, finished) = oneshot::channel();
    let thread = std::thread::Builder::new().name("background".into()).spawn(move || {
        // On Linux this is the calling thread's alone. A system that refuses is only less polite.
        if let Err(error) = rustix::process::nice(NICE) {
            tracing::debug!(%error, "the work continues at the usual priority");
        }
        // Who asked may have gone.
        let _ = done.send(work());
    });
    thread.map_err(|_| DatasetError::Worker)?;
    finished.await.map_err(|_| DatasetError::Worker)
}
