//! Checks before a handler runs, by the table of operations: key, role, origin, number of requests,
//! size and pace of the body, operator lock. After it: the log of actions, and the end of streams
//! whose key is revoked.
//! Uses: `routes`, `auth`, `audit`, the store (the lock). Never: the e-stop, which checks its key
//! itself and waits for nothing.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::extract::{DefaultBodyLimit, MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::{StreamExt, TryStreamExt};
use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, timeout_at};

use super::App;
use super::audit::{Act, Outcome};
use super::auth::{self, Caller};
use super::limits::{
    BODY_MAX_BYTES, BODY_STALL, BODY_WITHIN, CALLER_REQUESTS, UPLOAD_WITHIN, WRONG_KEY_DELAY,
};
use super::line::Held;
use super::problem::ApiError;
use super::routes::{Access, Lock, Needs};
use crate::store::LockRow;

/// Requests in progress by caller: the number of the key, or none. Clones share it.
#[derive(Debug, Clone, Default)]
pub struct InProgress(Arc<Mutex<HashMap<Option<i64>, Arc<Semaphore>>>>);

impl InProgress {
    /// Takes a place for a request; `None` if the caller has `CALLER_REQUESTS` in progress.
    fn begin(&self, caller: &Caller) -> Option<OwnedSemaphorePermit> {
        let key = caller.key.as_ref().map(|key| key.id);
        let mut all = self.0.lock();
        all.retain(|of, places| *of == key || places.available_permits() < CALLER_REQUESTS);
        let places = all.entry(key).or_insert_with(|| Arc::new(Semaphore::new(CALLER_REQUESTS)));
        places.clone().try_acquire_owned().ok()
    }
}

/// Admits a request to its handler, and logs the action that it asks for.
pub async fn admit(State(app): State<App>, request: Request, next: Next) -> Response {
    let path = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let needs = path.and_then(|path| app.facts.needs.find(request.method(), path)).copied();
    let Some(needs) = needs else {
        let words = format!("{} is not a method of this address", request.method());
        return ApiError::new(StatusCode::METHOD_NOT_ALLOWED, words).into_response();
    };
    let caller = match auth::identify(&app, request.headers(), request.uri().query()) {
        Ok(caller) => caller,
        Err(refused) => {
            if refused.status() == StatusCode::UNAUTHORIZED {
                app.facts.wrong_keys.note();
                tokio::time::sleep(WRONG_KEY_DELAY).await;
            }
            return refused.into_response();
        }
    };
    tracing::Span::current().record("caller", caller.name(None));
    if let Some(key) = &caller.key {
        app.keys.note_use(key);
    }
    let Some(place) = app.facts.in_progress.begin(&caller) else {
        let words = format!(
            "{CALLER_REQUESTS} requests of {} are in progress: wait for one to end",
            caller.name(None)
        );
        let refused = ApiError::new(StatusCode::TOO_MANY_REQUESTS, words);
        return ([(header::RETRY_AFTER, "1")], refused).into_response();
    };
    let response = match needs.action {
        Some(action) => {
            let act = Act::new(caller.clone(), action);
            let response = handle(&app, needs, &caller, Some(&act), request, next).await;
            // A refused role is not an entry: a viewer must not be able to fill the log.
            if response.status() != StatusCode::FORBIDDEN {
                let outcome = Outcome::of(&response);
                act.log(&app, outcome).await;
            }
            response
        }
        None => handle(&app, needs, &caller, None, request, next).await,
    };
    response.map(|body| Body::new(Held::new(until_revoked(&app, &caller, body), place)))
}

async fn handle(
    app: &App,
    needs: Needs,
    caller: &Caller,
    act: Option<&Act>,
    mut request: Request,
    next: Next,
) -> Response {
    if let Err(refused) = allow(app, needs, caller, request.headers()).await {
        return refused.into_response();
    }
    DefaultBodyLimit::max(needs.body_max_bytes).apply(&mut request);
    let within = if needs.body_max_bytes > BODY_MAX_BYTES { UPLOAD_WITHIN } else { BODY_WITHIN };
    let mut request = request.map(|body| paced(body, within));
    request.extensions_mut().insert(caller.clone());
    if let Some(act) = act {
        request.extensions_mut().insert(act.clone());
    }
    next.run(request).await
}

async fn allow(
    app: &App,
    needs: Needs,
    caller: &Caller,
    headers: &HeaderMap,
) -> Result<(), ApiError> {
    auth::same_origin(headers)?;
    if let Access::From(role) = needs.access {
        caller.require(role)?;
    }
    let announced = headers.get(header::CONTENT_LENGTH);
    let announced = announced.and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    if announced.is_some_and(|length| length > needs.body_max_bytes as u64) {
        let words = format!("the body must have at most {} bytes", needs.body_max_bytes);
        return Err(ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, words));
    }
    match needs.lock {
        Lock::Refuses => app.unlocked(caller).await,
        Lock::Ignored | Lock::RefusesSome => Ok(()),
    }
}

/// A body that fails if no byte arrives for `BODY_STALL`, or if it is not complete in time.
fn paced(body: Body, within: Duration) -> Body {
    if body.is_end_stream() {
        return body;
    }
    let until = Instant::now() + within;
    let pieces = futures::stream::try_unfold(body.into_data_stream(), move |mut body| async move {
        let deadline = until.min(Instant::now() + BODY_STALL);
        match timeout_at(deadline, body.next()).await {
            Ok(piece) => Ok(piece.transpose()?.map(|piece| (piece, body))),
            Err(_) => Err(axum::Error::new(TooSlow)),
        }
    });
    Body::from_stream(pieces)
}

/// A body arrived too slowly.
#[derive(Debug, thiserror::Error)]
#[error("the body arrived too slowly: its next bytes are due within {} s", BODY_STALL.as_secs())]
pub struct TooSlow;

/// A streamed body ends when the key of its caller is revoked.
fn until_revoked(app: &App, caller: &Caller, body: Body) -> Body {
    match &caller.key {
        Some(key) if body.size_hint().exact().is_none() => {
            let revoked = app.keys.revoked(key);
            Body::from_stream(body.into_data_stream().take_until(Box::pin(revoked)).into_stream())
        }
        Some(_) | None => body,
    }
}

impl App {
    /// Completes when the key of a caller is revoked; never for a caller without a key.
    pub(super) async fn until_revoked(&self, caller: &Caller) {
        match &caller.key {
            Some(key) => self.keys.revoked(key).await,
            None => std::future::pending().await,
        }
    }

    /// Checks that no other person holds the operator lock. A lock that was taken without a key
    /// holds for everybody: nobody can prove to be its holder.
    ///
    /// # Errors
    /// 409 if the lock is held, or the store fails.
    pub(super) async fn unlocked(&self, caller: &Caller) -> Result<(), ApiError> {
        match self.store.lock().await? {
            Some(lock) if !caller.holds(&lock) => Err(locked(&lock)),
            Some(_) | None => Ok(()),
        }
    }
}

fn locked(lock: &LockRow) -> ApiError {
    let words = format!(
        "{} holds the operator lock ({}): ask the holder to release it",
        lock.holder, lock.note
    );
    ApiError::new(StatusCode::CONFLICT, words)
}

/// Adds the headers that tell a browser what it must not do with a response.
pub async fn harden(request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let mut default = |name, value| {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    };
    default(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    default(header::REFERRER_POLICY, "no-referrer");
    default(header::CONTENT_SECURITY_POLICY, "default-src 'none'; frame-ancestors 'none'");
    default(header::CACHE_CONTROL, "no-store");
    default(
        header::HeaderName::from_static("permissions-policy"),
        "camera=(), geolocation=(), microphone=()",
    );
    response
}
