//! The operator lock while a run is halted: who has taken it since, and a motion that it ends.
//! Uses: `journal`, `campaign::shown::command` (a moment). Never: motion, a motion that waits for the store.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use jiff::Timestamp;
use tokio::task::JoinSet;

use crate::campaign::shown::command::Moment;
use crate::journal::{Journal, error_chain};

/// Longest wait for the store before a run begins or resumes; meanwhile no request is read.
const LOCK_LIMIT: Duration = Duration::from_secs(1);
/// Period at which the lock is read while the rig homes for an automatic resume, wall time.
const LOCK_POLL: Duration = Duration::from_millis(200);

/// Returns the release that must come before anything moves, as text: a person has taken the operator lock after this,
/// for example with hands in the rig. None if it was not taken.
///
/// # Errors
/// What must come before as well, as text: the store fails or does not answer.
pub async fn taken_lock(
    journal: &dyn Journal,
    (at, instant): Moment,
) -> Result<Option<String>, String> {
    // The wall clock may have been set since: then the earlier of the two times counts.
    let since = at.min(Timestamp::now() - instant.elapsed());
    match tokio::time::timeout(LOCK_LIMIT, journal.lock_since(since)).await {
        Ok(Ok(lock)) => Ok(lock.map(|who| format!("the release of the operator lock ({who})"))),
        Ok(Err(error)) => Err(format!("an answer of the store ({})", error_chain(&error))),
        Err(_late) => Err("an answer of the store".into()),
    }
}

/// A motion that no person has requested: one who takes the operator lock ends it.
pub struct Unattended {
    is_locked: Arc<AtomicBool>,
    _watch: JoinSet<()>,
}

impl Unattended {
    /// Watches from now on whether the lock was taken after this. A store that does not answer ends no motion.
    pub fn watch(journal: Arc<dyn Journal>, since: Moment) -> Self {
        let is_locked = Arc::<AtomicBool>::default();
        let (mut watch, found) = (JoinSet::new(), is_locked.clone());
        watch.spawn(async move {
            while !matches!(taken_lock(journal.as_ref(), since).await, Ok(Some(_))) {
                tokio::time::sleep(LOCK_POLL).await;
            }
            found.store(true, Ordering::SeqCst);
        });
        Self { is_locked, _watch: watch }
    }

    /// Whether it was taken.
    pub fn is_locked(&self) -> bool {
        self.is_locked.load(Ordering::SeqCst)
    }
}
