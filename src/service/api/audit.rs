//! The log of actions: who requested what, and the outcome.
//! Uses: `store`. Never: an action that waits because its entry cannot be stored.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::FromRequestParts;
use axum::http::StatusCode;
use axum::http::request::Parts;
use axum::response::Response;
use jiff::Timestamp;
use parking_lot::Mutex;
use serde::Deserialize;
use tracing::Instrument;

use super::App;
use super::auth::Caller;
use super::limits::{DETAIL_MAX_CHARS, WHO_MAX_CHARS, WHY_MAX_CHARS};
use super::problem::{ApiError, ApiResult, Refused};
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::plain::escaped;
use crate::store::{NewAction, StoreError};

/// Longest name of an action that is read from a body, characters.
const ACTION_MAX_CHARS: usize = 20;
/// Interval of storing such an entry again.
const LOG_AGAIN: Duration = Duration::from_secs(1);

/// The action that a request asks for, as the log of actions will show it. Its route sets the name
/// and the caller; the handler adds what it learns. Clones share it.
#[derive(Debug, Clone)]
pub(super) struct Act {
    caller: Caller,
    entry: Arc<Mutex<Entry>>,
}

/// Outcome of an action.
#[derive(Debug)]
pub(super) struct Outcome {
    /// Whether the action was accepted.
    pub accepted: bool,
    /// Why it was not.
    pub refused: Option<String>,
}

impl Outcome {
    /// Reads the outcome from a response.
    pub fn of(response: &Response) -> Self {
        let refused = response.extensions().get::<Refused>().map(|refused| refused.0.clone());
        Self { accepted: response.status().is_success(), refused }
    }
}

#[derive(Debug)]
struct Entry {
    action: Cow<'static, str>,
    run: Option<RunUid>,
    who: Option<String>,
    why: Option<String>,
}

impl Act {
    /// An action of a caller.
    pub fn new(caller: Caller, action: &'static str) -> Self {
        let entry = Entry { action: action.into(), run: None, who: None, why: None };
        Self { caller, entry: Arc::new(Mutex::new(entry)) }
    }

    /// Sets the name and the reason that the caller entered; longer ones are cut.
    pub fn stated(&self, who: Option<&str>, why: Option<&str>) {
        let mut entry = self.entry.lock();
        entry.who = who.map(|who| cut(who, WHO_MAX_CHARS));
        entry.why = why.map(|why| cut(why, WHY_MAX_CHARS));
    }

    /// Sets the object of the action, which is shown as its reason if the caller entered none.
    pub fn about(&self, object: &str) {
        self.entry.lock().why.get_or_insert_with(|| cut(object, WHY_MAX_CHARS));
    }

    /// Sets the run that the action affects.
    pub fn on(&self, run: RunUid) {
        self.entry.lock().run = Some(run);
    }

    /// Replaces the name of the action: one route may serve several.
    pub fn named(&self, action: &'static str) {
        self.entry.lock().action = action.into();
    }

    /// Reads name, person and reason from a body, if it is a JSON object with these: for the entry
    /// of a request that is refused before its handler.
    pub fn read(&self, body: &[u8]) {
        #[derive(Default, Deserialize)]
        struct Stated {
            action: Option<String>,
            who: Option<String>,
            why: Option<String>,
        }
        let stated: Stated = serde_json::from_slice(body).unwrap_or_default();
        self.stated(stated.who.as_deref(), stated.why.as_deref());
        if let Some(action) = stated.action.filter(|name| !name.is_empty()) {
            self.entry.lock().action = cut(&action, ACTION_MAX_CHARS).into();
        }
    }

    /// Returns the caller with the entered name, as the log shows it.
    pub fn name(&self) -> String {
        self.caller.name(self.entry.lock().who.as_deref())
    }

    /// Returns the caller.
    pub fn caller(&self) -> &Caller {
        &self.caller
    }

    /// Logs the action with its outcome.
    pub async fn log(&self, app: &App, outcome: Outcome) {
        let new = {
            let entry = self.entry.lock();
            NewAction {
                at: Timestamp::now(),
                run: entry.run,
                action: entry.action.clone().into_owned(),
                who: self.caller.name(entry.who.as_deref()),
                key_id: self.caller.key.as_ref().map(|key| key.id),
                why: entry.why.clone(),
                accepted: outcome.accepted,
                detail: outcome.refused.map(|why| cut(&why, DETAIL_MAX_CHARS)),
            }
        };
        app.log_action(new).await;
    }
}

impl<S: Sync> FromRequestParts<S> for Act {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> ApiResult<Self> {
        let none = || {
            let words = "this operation is not in the table of actions";
            ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, words)
        };
        parts.extensions.get::<Self>().cloned().ok_or_else(none)
    }
}

/// Returns the first characters of a text, with its control characters escaped.
pub(super) fn cut(text: &str, max_chars: usize) -> String {
    let first: String = text.chars().take(max_chars).collect();
    escaped(&first).into()
}

impl App {
    /// Stores an entry of the log. A failure is reported, and the entry is stored later. A database that is only read
    /// has no entry of who read it.
    pub(super) async fn log_action(&self, new: NewAction) {
        match self.store.log_action(new.clone()).await {
            Ok(()) | Err(StoreError::ReadOnly { .. }) => {}
            Err(error) => {
                let error = error_chain(&error);
                tracing::error!(error, ?new, "an action is not logged yet");
                self.log_later(new);
            }
        }
    }

    /// Stores an entry again until it is logged or the store rejects it permanently; for at most
    /// `limits::LOGGED_LATER_MAX` entries at a time.
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
