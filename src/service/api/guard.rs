//! Checks before a handler runs, by the table of operations: key, role, origin, number of requests,
//! size and pace of the body, lateness (`in_time`), operator lock, repetitions (`once`), entity tags (`edited`). After
//! it: the log of actions, and the end of streams whose key is revoked.
//! Uses: `access`, `auth`, `audit`, `body`, `once`, `edited`, the store (the lock). Never: the e-stop, which
//! checks its key itself and waits for nothing.

use std::collections::HashMap;
use std::sync::Arc;

use axum::body::{Body, HttpBody, to_bytes};
use axum::extract::{DefaultBodyLimit, MatchedPath, Request};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tracing::Instrument;

use super::App;
use super::access::{Access, Lock, Needs};
use super::audit::{Act, Outcome};
use super::auth::{self, Caller};
use super::body::{announced_bytes, paced};
use super::edited;
use super::limits::{
    BODY_MAX_BYTES, BODY_WITHIN, CALLER_REQUESTS, FIELDS_MAX, HEADERS_MAX_BYTES, UPLOAD_WITHIN,
    URI_MAX_BYTES, WRONG_KEY_DELAY,
};
use super::line::Held;
use super::once;
use super::problem::{ApiError, ApiResult};
use super::runs;
use crate::store::{LockRow, Role};

/// Requests in progress by caller: the number of the key, or none.
#[derive(Debug, Default)]
pub struct InProgress(Mutex<HashMap<Option<i64>, Arc<Semaphore>>>);

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

/// A place of `InProgress`, kept until the response has been sent, or by a WebSocket until its end.
#[derive(Debug, Clone)]
pub struct Place(#[expect(dead_code, reason = "dropped at the end")] Arc<OwnedSemaphorePermit>);

/// Admits a request to its handler, and logs the action that it asks for.
pub async fn admit(app: App, mut request: Request, next: Next) -> Response {
    let path = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let needs = path.and_then(|path| app.facts.needs.find(request.method(), path)).copied();
    let Some(needs) = needs else {
        let words = format!("{} is not a method of this address", request.method());
        return ApiError::new(StatusCode::METHOD_NOT_ALLOWED, words).into_response();
    };
    let identified = match needs.socket {
        true => auth::identify_socket(&app, request.headers(), request.uri().query()),
        false => auth::identify(&app, request.headers()),
    };
    let caller = match identified {
        Ok(caller) => caller,
        Err(refused) => return wrong_key(&app, refused).await,
    };
    tracing::Span::current().record("caller", caller.name(None));
    if let Some(key) = &caller.key {
        app.keys.note_use(key);
    }
    // Pausing and ending a run, or a motion, waits for no other request.
    let place = match needs.lock {
        Lock::RefusesSome | Lock::Stops => None,
        Lock::Ignored | Lock::Refuses => match app.facts.in_progress.begin(&caller) {
            Some(place) => Some(Place(Arc::new(place))),
            None => return too_many(&caller),
        },
    };
    if let Err(refused) = allow(needs, &caller, request.headers()) {
        return refused.into_response();
    }
    DefaultBodyLimit::max(needs.body_max_bytes).apply(&mut request);
    let uploads = needs.body_max_bytes > BODY_MAX_BYTES;
    let mut request =
        request.map(|body| paced(body, if uploads { UPLOAD_WITHIN } else { BODY_WITHIN }));
    request.extensions_mut().insert(caller.clone());
    request.extensions_mut().insert(place.clone());
    let response = match needs.action {
        Some(action) => {
            let act = Act::new(caller.clone(), action);
            let request = checked(&app, needs, &act, request).await;
            let held = place.clone();
            let acting = carry_out(app.clone(), needs, act, request, next);
            let acting = async move { (acting.await, held).0 }.in_current_span();
            if uploads {
                acting.await
            } else {
                // It runs to its end and is logged, even if its client disconnects.
                let ended = tokio::spawn(acting).await;
                ended.unwrap_or_else(|_| panicked().into_response())
            }
        }
        None => edited::carry_out(&app, needs, request, next).await,
    };
    let is_events = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_some_and(|kind| kind.as_bytes().starts_with(b"text/event-stream"));
    response.map(|body| Body::new(Held::new(until_revoked(&app, &caller, body, is_events), place)))
}

/// Carries out an action if it is allowed, and logs it. A repetition does nothing and is not logged.
async fn carry_out(
    app: App,
    needs: Needs,
    act: Act,
    request: ApiResult<Request>,
    next: Next,
) -> Response {
    let response = match request {
        Ok(request) => once::carry_out(&app, needs, act.caller(), request, next).await,
        Err(refused) => refused.into_response(),
    };
    if is_logged(act.caller(), response.status()) && !once::is_repetition(&response) {
        let outcome = Outcome::of(&response);
        act.log(&app, outcome).await;
    }
    response
}

fn panicked() -> ApiError {
    let words =
        "the request failed, and its outcome is unknown: the log of the service has the cause";
    ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, words)
}

/// Whether the log of actions gets an entry. A viewer must not be able to fill it with bodies that
/// mean nothing.
fn is_logged(caller: &Caller, status: StatusCode) -> bool {
    let means_nothing = matches!(
        status,
        StatusCode::BAD_REQUEST
            | StatusCode::UNPROCESSABLE_ENTITY
            | StatusCode::UNSUPPORTED_MEDIA_TYPE
            | StatusCode::PAYLOAD_TOO_LARGE
            | StatusCode::REQUEST_TIMEOUT
    );
    caller.role >= Role::Operator || !means_nothing
}

/// Answers a request without a valid key: late, unless many such answers wait already.
async fn wrong_key(app: &App, refused: ApiError) -> Response {
    if refused.status() == StatusCode::UNAUTHORIZED {
        app.facts.wrong_keys.note();
        if let Ok(_delayed) = app.facts.delayed.try_acquire() {
            tokio::time::sleep(WRONG_KEY_DELAY).await;
        }
    }
    ([(header::CONNECTION, "close")], refused).into_response()
}

fn too_many(caller: &Caller) -> Response {
    let words = format!(
        "{CALLER_REQUESTS} requests of {} are in progress: wait for one to end",
        caller.name(None)
    );
    ApiError::new(StatusCode::TOO_MANY_REQUESTS, words).retry_after(1).into_response()
}

/// Receives the body of an action, then checks lateness, key and lock: what changed while it arrived counts.
/// Uploads are received by their handlers, which check again.
async fn checked(app: &App, needs: Needs, act: &Act, mut request: Request) -> ApiResult<Request> {
    if needs.body_max_bytes <= BODY_MAX_BYTES {
        let (parts, body) = request.into_parts();
        let body = to_bytes(body, needs.body_max_bytes).await.map_err(|error| {
            let words = format!("the body must have at most {} bytes", needs.body_max_bytes);
            ApiError::of_body(StatusCode::PAYLOAD_TOO_LARGE, words, &error)
        })?;
        act.read(&body);
        request = Request::from_parts(parts, Body::from(body));
    }
    if needs.moves && needs.lock == Lock::Refuses {
        app.in_time(request.headers())?;
    }
    if needs.lock == Lock::Refuses
        && let Err(refused) = app.unlocked(act.caller()).await
    {
        if let Some(run) = run_of(&request)
            && let Ok(run) = runs::find(app, run).await
        {
            act.on(run.uid);
        }
        return Err(refused);
    }
    app.still_valid(act.caller())?;
    request.extensions_mut().insert(act.clone());
    Ok(request)
}

/// Returns the run that an address names.
fn run_of(request: &Request) -> Option<&str> {
    let path = request.extensions().get::<MatchedPath>()?.as_str();
    let at = path.split('/').position(|part| part == "{run}")?;
    request.uri().path().split('/').nth(at)
}

fn allow(needs: Needs, caller: &Caller, headers: &HeaderMap) -> ApiResult<()> {
    auth::same_origin(headers)?;
    if let Access::From(role) = needs.access {
        caller.require(role)?;
    }
    if announced_bytes(headers).is_some_and(|length| length > needs.body_max_bytes as u64) {
        let words = format!("the body must have at most {} bytes", needs.body_max_bytes);
        return Err(ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, words));
    }
    Ok(())
}

/// The key of a caller was revoked.
#[derive(Debug, thiserror::Error)]
#[error("the key was revoked")]
struct Revoked;

/// A streamed body ends when the key of its caller is revoked: with an error, so that a part of a
/// table is not taken for all of it, unless it is a stream of events.
fn until_revoked(app: &App, caller: &Caller, body: Body, is_events: bool) -> Body {
    let Some(key) = caller.key.as_ref().filter(|_| body.size_hint().exact().is_none()) else {
        return body;
    };
    let state = (body.into_data_stream(), Box::pin(app.keys.revoked(key)));
    let pieces = futures::stream::unfold(Some(state), move |state| async move {
        let (mut body, mut revoked) = state?;
        tokio::select! {
            piece = body.next() => piece.map(|piece| (piece, Some((body, revoked)))),
            () = &mut revoked => (!is_events).then(|| (Err(axum::Error::new(Revoked)), None)),
        }
    });
    Body::from_stream(pieces)
}

impl App {
    /// Completes when the key of a caller is revoked; never for a caller without a key.
    pub(super) async fn until_revoked(&self, caller: &Caller) {
        match &caller.key {
            Some(key) => self.keys.revoked(key).await,
            None => std::future::pending().await,
        }
    }

    /// Checks that the key of a caller has not been revoked since.
    ///
    /// # Errors
    /// 401 if it has.
    fn still_valid(&self, caller: &Caller) -> ApiResult<()> {
        match caller.is_valid(self) {
            true => Ok(()),
            false => Err(ApiError::new(StatusCode::UNAUTHORIZED, "this key is revoked")),
        }
    }

    /// Checks again, after a long upload, that the key is valid and the lock is free.
    ///
    /// # Errors
    /// 401 or 409 if it is not.
    pub(super) async fn still_allowed(&self, act: &Act) -> ApiResult<()> {
        self.unlocked(act.caller()).await?;
        self.still_valid(act.caller())
    }

    /// Checks that no other person holds the operator lock. A lock that was taken without a key
    /// holds for every caller: none can prove to be its holder.
    ///
    /// # Errors
    /// 409 if the lock is held, or the store fails.
    pub(super) async fn unlocked(&self, caller: &Caller) -> ApiResult<()> {
        match self.store.lock().await? {
            Some(lock) if !caller.holds(&lock) => Err(locked(&lock)),
            Some(_) | None => Ok(()),
        }
    }
}

fn locked(lock: &LockRow) -> ApiError {
    let how = match lock.is_keyless() {
        true => {
            "it was taken without a key and holds for every caller: `palpate lock --clear` ends it"
        }
        false => "ask the holder to release it",
    };
    let words = format!("{} holds the operator lock ({}): {how}", lock.holder, lock.note);
    ApiError::new(StatusCode::CONFLICT, words)
}

/// Refuses a request with a long address or with many or long headers.
pub async fn short_head(request: Request, next: Next) -> Response {
    match check_head(request.uri(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(refused) => ([(header::CONNECTION, "close")], refused).into_response(),
    }
}

/// Checks the length of path and query, the number of headers and their length.
///
/// # Errors
/// 414 or 431 with the bound.
fn check_head(uri: &Uri, headers: &HeaderMap) -> ApiResult<()> {
    let too_large = |what: &str, n: usize, most: usize, unit: &str| {
        let words = format!("{what} = {n} {unit}: must be at most {most} {unit}");
        ApiError::new(StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE, words)
    };
    let address = uri.path_and_query().map_or(0, |address| address.as_str().len());
    if address > URI_MAX_BYTES {
        let words = format!(
            "path and query = {address} bytes: must be at most {URI_MAX_BYTES} bytes; request an export \
             or use several requests"
        );
        return Err(ApiError::new(StatusCode::URI_TOO_LONG, words));
    }
    if headers.len() > FIELDS_MAX {
        return Err(too_large("headers", headers.len(), FIELDS_MAX, "fields"));
    }
    // As they were sent: "NAME: VALUE" and the end of the line.
    let length = |(name, value): (&HeaderName, &HeaderValue)| name.as_str().len() + value.len() + 4;
    match headers.iter().map(length).sum::<usize>() {
        n if n > HEADERS_MAX_BYTES => Err(too_large("headers", n, HEADERS_MAX_BYTES, "bytes")),
        _ => Ok(()),
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_address_and_long_headers_are_refused_with_their_bound() {
        let status = |path: usize, fields: usize, length: usize| {
            let uri: Uri = format!("/{}", "x".repeat(path - 1)).parse().unwrap();
            let mut headers = HeaderMap::new();
            for _ in 0..fields {
                headers.append("x", HeaderValue::from_str(&"y".repeat(length - 5)).unwrap());
            }
            check_head(&uri, &headers).err().map(|e| (e.status().as_u16(), e.detail().to_owned()))
        };
        assert_eq!(status(URI_MAX_BYTES, FIELDS_MAX, 10), None);
        assert_eq!(status(1, 2, HEADERS_MAX_BYTES / 2), None);
        let long = |refused: Option<(u16, String)>, code: u16, words: &str| {
            assert!(
                refused.as_ref().is_some_and(|(s, d)| *s == code && d.contains(words)),
                "{refused:?}"
            );
        };
        long(status(URI_MAX_BYTES + 1, 1, 10), 414, "at most 32768 bytes");
        long(status(1, FIELDS_MAX + 1, 10), 431, "at most 100 fields");
        long(status(1, 2, HEADERS_MAX_BYTES / 2 + 1), 431, "at most 32768 bytes");
    }
}
