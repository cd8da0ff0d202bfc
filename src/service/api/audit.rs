//! The log of actions: who asked for what, and what came of it.
//! Uses: `store`. Never: an action that waits for its entry when the entry cannot be stored.

use std::time::Duration;

use jiff::Timestamp;

use super::App;
use super::auth::Asker;
use super::problem::ApiError;
use crate::ids::RunUid;
use crate::store::{NewAction, StoreError};

/// Actions that wait at once for a store that takes nothing.
pub(super) const LOGGED_LATER_MAX: usize = 1000;
/// How often such an action is tried again.
const LOG_AGAIN: Duration = Duration::from_secs(1);

impl App {
    /// Logs an action and what came of it, and hands the outcome on.
    pub(super) async fn logged<T>(
        &self,
        asker: &Asker,
        action: &str,
        about: (Option<RunUid>, Option<&str>, Option<&str>),
        outcome: Result<T, ApiError>,
    ) -> Result<T, ApiError> {
        let (run, who, why) = about;
        let new = NewAction {
            at: Timestamp::now(),
            run,
            action: action.into(),
            who: asker.name(who),
            why: why.map(Into::into),
            accepted: outcome.is_ok(),
            detail: outcome.as_ref().err().map(|e| e.detail().into()),
        };
        if let Err(error) = self.store.log_action(new.clone()).await {
            tracing::error!(%error, ?new, "an action is not logged yet");
            self.log_later(new);
        }
        outcome
    }

    /// Tries again until an action is logged or the store refuses it for good; for up to
    /// `LOGGED_LATER_MAX` actions at a time.
    fn log_later(&self, action: NewAction) {
        let Ok(place) = self.facts.logged_later.clone().try_acquire_owned() else {
            tracing::error!(?action, "too many actions wait to be logged: this one is not");
            return;
        };
        let store = self.store.clone();
        self.facts.threads.spawn(async move {
            let _place = place;
            loop {
                tokio::time::sleep(LOG_AGAIN).await;
                match store.log_action(action.clone()).await {
                    Ok(()) | Err(StoreError::Closed { .. }) => break,
                    Err(error @ (StoreError::NoSuchRun(_) | StoreError::Unreadable { .. })) => {
                        tracing::error!(%error, ?action, "an action cannot be logged");
                        break;
                    }
                    Err(_) => {}
                }
            }
        });
    }
}
