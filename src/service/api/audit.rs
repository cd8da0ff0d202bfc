//! The log of actions: who requested what, and the outcome.
//! Uses: `store`. Never: an action that waits because its entry cannot be stored.

use std::time::Duration;

use jiff::Timestamp;
use tracing::Instrument;

use super::App;
use super::auth::Caller;
use super::problem::ApiError;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::store::{NewAction, StoreError};

/// Largest number of entries that wait for a failing store.
pub(super) const LOGGED_LATER_MAX: usize = 1000;
/// Interval of storing such an entry again.
const LOG_AGAIN: Duration = Duration::from_secs(1);

/// What an entry of the log refers to.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ActionContext<'a> {
    /// The run that the action affects.
    pub run: Option<RunUid>,
    /// Name that the caller entered.
    pub who: Option<&'a str>,
    /// Reason that the caller entered, or the name of the object that the action affects.
    pub why: Option<&'a str>,
}

impl App {
    /// Logs an action with its outcome, and returns the outcome.
    ///
    /// # Errors
    /// The error of `outcome`; a failure of the log is only reported.
    pub(super) async fn logged<T>(
        &self,
        caller: &Caller,
        action: &str,
        context: ActionContext<'_>,
        outcome: Result<T, ApiError>,
    ) -> Result<T, ApiError> {
        let ActionContext { run, who, why } = context;
        let new = NewAction {
            at: Timestamp::now(),
            run,
            action: action.into(),
            who: caller.name(who),
            why: why.map(Into::into),
            accepted: outcome.is_ok(),
            detail: outcome.as_ref().err().map(|e| e.detail().into()),
        };
        if let Err(error) = self.store.log_action(new.clone()).await {
            let error = error_chain(&error);
            tracing::error!(error, ?new, "an action is not logged yet");
            self.log_later(new);
        }
        outcome
    }

    /// Stores an entry again until it is logged or the store rejects it permanently; for at most
    /// `LOGGED_LATER_MAX` entries at a time.
    fn log_later(&self, action: NewAction) {
        let Ok(place) = self.facts.logged_later.clone().try_acquire_owned() else {
            tracing::error!(?action, "an action was not logged: too many entries wait");
            return;
        };
        let store = self.store.clone();
        let again = async move {
            let _place = place;
            loop {
                tokio::time::sleep(LOG_AGAIN).await;
                match store.log_action(action.clone()).await {
                    Ok(()) | Err(StoreError::Closed { .. }) => break,
                    Err(error @ (StoreError::NoSuchRun(_) | StoreError::Unreadable { .. })) => {
                        let error = error_chain(&error);
                        tracing::error!(error, ?action, "an action cannot be logged");
                        break;
                    }
                    Err(_) => {}
                }
            }
        };
        self.facts.threads.spawn(again.in_current_span());
    }
}
