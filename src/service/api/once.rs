//! Requests that may be repeated: of one caller, a request with an `Idempotency-Key` is carried out once,
//! and a repetition gets the first response.
//! Uses: `store` (the keys and responses), `edited`. Never: a stored request that key, role, lock or body
//! refused; a repetition that does something; the text of an API key.

use std::collections::HashMap;

use axum::body::{Body, HttpBody, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use parking_lot::Mutex;

use super::App;
use super::access::Needs;
use super::auth::Caller;
use super::edited;
use super::limits::{BODY_MAX_BYTES, ONCE_KEY_MAX_CHARS, ONCE_MAX, ONCE_RESPONSE_MAX_BYTES};
use super::problem::{ApiError, ApiResult};
use crate::digest::Hashing;
use crate::journal::error_chain;
use crate::store::{OnceKey, OnceResponse, OnceRow};

/// Header with the key of a request.
pub const IDEMPOTENCY_KEY: &str = "idempotency-key";
/// Header of a response that was given before.
pub const REPLAYED: &str = "idempotency-replayed";

/// Requests with a key that this process carries out: the sha256 of each.
#[derive(Debug, Default)]
pub struct Running(Mutex<HashMap<OnceKey, String>>);

impl Running {
    /// Begins a request. Dropping the result ends it.
    ///
    /// # Errors
    /// The sha256 of the request that is carried out with the same key.
    fn begin(&self, key: &OnceKey, request: &str) -> Result<Turn<'_>, String> {
        let mut all = self.0.lock();
        if let Some(running) = all.get(key) {
            return Err(running.clone());
        }
        all.insert(key.clone(), request.to_owned());
        Ok(Turn { running: self, key: key.clone() })
    }
}

/// A request that is carried out.
struct Turn<'r> {
    running: &'r Running,
    key: OnceKey,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.running.0.lock().remove(&self.key);
    }
}

/// Carries out a request that has been admitted; with a key, unless it was carried out before.
pub async fn carry_out(
    app: &App,
    needs: Needs,
    caller: &Caller,
    request: Request,
    next: Next,
) -> Response {
    let stated = if needs.once { key_of(request.headers()) } else { Ok(None) };
    match stated {
        Ok(None) => edited::carry_out(app, needs, request, next).await,
        Ok(Some(name)) => {
            let caller = caller.key.as_ref().map(|key| key.id);
            let once = keyed(app, needs, OnceKey { caller, name }, request, next).await;
            once.unwrap_or_else(ApiError::into_response)
        }
        Err(refused) => refused.into_response(),
    }
}

async fn keyed(
    app: &App,
    needs: Needs,
    key: OnceKey,
    request: Request,
    next: Next,
) -> ApiResult<Response> {
    let (request, sha256) = digest(request).await?;
    let _turn = match app.facts.running.begin(&key, &sha256) {
        Ok(turn) => turn,
        Err(running) if running == sha256 => return Ok(repeated(in_progress())),
        Err(_) => return Ok(repeated(other_request())),
    };
    // From here on an entry without a response is one whose outcome is unknown.
    if let Some(first) = app.store.begin_once(&key, &sha256, ONCE_MAX).await? {
        return Ok(repeated(repetition(&sha256, first).unwrap_or_else(ApiError::into_response)));
    }
    let (response, read) = read(edited::carry_out(app, needs, request, next).await).await?;
    // After a refusal nothing was done, and the cause may pass.
    let refused = response.status().is_client_error()
        || [StatusCode::SERVICE_UNAVAILABLE, StatusCode::INSUFFICIENT_STORAGE]
            .contains(&response.status());
    let stored = match read {
        _ if refused => app.store.end_once(&key, None).await,
        Some(read) => app.store.end_once(&key, Some(read)).await,
        None => Ok(()),
    };
    if let Err(error) = stored {
        let error = error_chain(&error);
        tracing::error!(error, key = key.name, "the response of a request was not stored");
    }
    Ok(response)
}

/// Mark of a response to a repetition: nothing was done for it.
#[derive(Debug, Clone, Copy)]
struct Repetition;

/// True if a request was a repetition: nothing was done for it.
pub fn is_repetition(response: &Response) -> bool {
    response.extensions().get::<Repetition>().is_some()
}

fn repeated(response: impl IntoResponse) -> Response {
    let mut response = response.into_response();
    response.extensions_mut().insert(Repetition);
    response
}

/// Returns the key that the headers state.
///
/// # Errors
/// 400 if there are several, or if it is invalid.
fn key_of(headers: &HeaderMap) -> ApiResult<Option<String>> {
    let mut stated = headers.get_all(IDEMPOTENCY_KEY).iter();
    match (stated.next(), stated.next()) {
        (None, _) => Ok(None),
        (Some(value), None) => value.to_str().ok().and_then(parse).map(Some).ok_or_else(|| {
            let words = format!(
                "header Idempotency-Key: must be a string in double quotes, or a token, of 1 to \
                 {ONCE_KEY_MAX_CHARS} visible ASCII characters"
            );
            ApiError::new(StatusCode::BAD_REQUEST, words)
        }),
        (Some(_), Some(_)) => {
            let words = "header Idempotency-Key: must be given once";
            Err(ApiError::new(StatusCode::BAD_REQUEST, words))
        }
    }
}

/// Reads a key: a string of RFC 8941, or its characters alone.
fn parse(value: &str) -> Option<String> {
    let key = match value.strip_prefix('"') {
        Some(rest) => {
            let inner = rest.strip_suffix('"')?;
            let mut key = String::new();
            let mut chars = inner.chars();
            while let Some(char) = chars.next() {
                match char {
                    '"' => return None,
                    '\\' => key.push(chars.next().filter(|c| matches!(c, '"' | '\\'))?),
                    _ => key.push(char),
                }
            }
            key
        }
        None => value.to_owned(),
    };
    let length = 1..=ONCE_KEY_MAX_CHARS;
    (length.contains(&key.len()) && key.bytes().all(|b| b.is_ascii_graphic())).then_some(key)
}

/// Returns the request with the sha256 of its method, path, query and body. The body has arrived.
async fn digest(request: Request) -> ApiResult<(Request, String)> {
    let (parts, body) = request.into_parts();
    let body = to_bytes(body, BODY_MAX_BYTES).await.map_err(|error| {
        ApiError::of_body(StatusCode::PAYLOAD_TOO_LARGE, error.to_string(), &error)
    })?;
    let mut hashing = Hashing::default();
    let query = parts.uri.query().unwrap_or_default();
    hashing.update(format!("{}\n{}?{query}\n", parts.method, parts.uri.path()));
    hashing.update(&body);
    Ok((Request::from_parts(parts, Body::from(body)), hashing.finish()))
}

/// Returns a response, and what is stored of it: nothing if it is too large.
async fn read(response: Response) -> ApiResult<(Response, Option<OnceResponse>)> {
    let exact = response.body().size_hint().exact();
    if exact.is_none_or(|bytes| bytes > ONCE_RESPONSE_MAX_BYTES as u64) {
        return Ok((response, None));
    }
    let (parts, body) = response.into_parts();
    let body = to_bytes(body, ONCE_RESPONSE_MAX_BYTES).await.map_err(ApiError::internal)?;
    let text = |name| Some(parts.headers.get(name)?.to_str().ok()?.to_owned());
    let stored = OnceResponse {
        status: parts.status.as_u16(),
        location: text(header::LOCATION),
        content_type: text(header::CONTENT_TYPE),
        body: body.to_vec(),
    };
    Ok((Response::from_parts(parts, Body::from(body)), Some(stored)))
}

/// Answers a request whose key was used before.
///
/// # Errors
/// 422 if the key was used with another request; 409 if no response is stored.
fn repetition(sha256: &str, first: OnceRow) -> ApiResult<Response> {
    if first.request != sha256 {
        return Err(other_request());
    }
    let Some(stored) = first.response else {
        let words = format!(
            "the request with this Idempotency-Key began at {}, and its outcome is unknown: its \
             response was not stored; check the status, the queue or the list that it changes, \
             then use a new key",
            first.began_at
        );
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    };
    let mut response = Response::new(Body::from(stored.body));
    *response.status_mut() = StatusCode::from_u16(stored.status).map_err(ApiError::internal)?;
    let headers =
        [(header::LOCATION, stored.location), (header::CONTENT_TYPE, stored.content_type)];
    for (name, value) in headers {
        if let Some(value) = value.and_then(|value| HeaderValue::from_str(&value).ok()) {
            response.headers_mut().insert(name, value);
        }
    }
    let replayed = HeaderName::from_static(REPLAYED);
    response.headers_mut().insert(replayed, HeaderValue::from_static("true"));
    Ok(response)
}

fn other_request() -> ApiError {
    let words = "this Idempotency-Key was used with another request: use a new key";
    ApiError::new(StatusCode::UNPROCESSABLE_ENTITY, words)
}

fn in_progress() -> Response {
    let words = "the first request with this Idempotency-Key is in progress: repeat it later";
    ApiError::new(StatusCode::CONFLICT, words).retry_after(1).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_a_string_or_its_characters() {
        for (value, key) in [("\"a-1\"", "a-1"), ("a-1", "a-1"), (r#""a\"\\b""#, r#"a"\b"#)] {
            assert_eq!(parse(value).as_deref(), Some(key), "{value}");
        }
        let longest = "x".repeat(ONCE_KEY_MAX_CHARS);
        assert_eq!(parse(&format!("\"{longest}\"")), parse(&longest));
        let long = format!("{longest}x");
        for value in ["", "\"\"", "\"", "\"a", "a b", "\"a b\"", "\"a\";p=1", r#""\a""#, "é", &long]
        {
            assert_eq!(parse(value), None, "{value}");
        }
        let mut headers = HeaderMap::new();
        assert_eq!(key_of(&headers).unwrap(), None);
        headers.append(IDEMPOTENCY_KEY, HeaderValue::from_static("a"));
        assert_eq!(key_of(&headers).unwrap().as_deref(), Some("a"));
        headers.append(IDEMPOTENCY_KEY, HeaderValue::from_static("b"));
        assert_eq!(key_of(&headers).unwrap_err().status(), 400);
    }

    #[tokio::test]
    async fn requests_that_differ_in_any_part_differ() {
        let of = async |method: &str, uri: &str, body: &'static str| {
            let request = Request::builder().method(method).uri(uri).body(Body::from(body));
            let (request, sha256) = digest(request.unwrap()).await.unwrap();
            assert_eq!(to_bytes(request.into_body(), 99).await.unwrap(), body, "it is kept");
            sha256
        };
        let one = of("POST", "/a?b", "c").await;
        assert_eq!(of("POST", "/a?b", "c").await, one);
        for other in [("PUT", "/a?b", "c"), ("POST", "/a?c", "c"), ("POST", "/a?b", "d")] {
            assert_ne!(of(other.0, other.1, other.2).await, one, "{other:?}");
        }
    }

    #[test]
    fn a_key_has_one_request_in_progress() {
        let running = Running::default();
        let key = |caller| OnceKey { caller, name: "k".into() };
        let turn = running.begin(&key(None), "one").ok().unwrap();
        assert_eq!(running.begin(&key(None), "two").err().as_deref(), Some("one"));
        assert!(running.begin(&key(Some(1)), "one").is_ok(), "another caller");
        drop(turn);
        assert!(running.begin(&key(None), "two").is_ok());
    }

    #[tokio::test]
    async fn a_repetition_gets_the_first_response() {
        let response = (StatusCode::CREATED, [(header::LOCATION, "/runs/7")], "made");
        let (response, stored) = read(response.into_response()).await.unwrap();
        let began_at = "2026-11-20T18:00:00Z".parse().unwrap();
        let first = OnceRow { request: "one".into(), began_at, response: stored };
        let again = repetition("one", first.clone()).unwrap();
        assert_eq!(again.headers()[REPLAYED], "true");
        assert_eq!(
            (again.status(), &again.headers()["location"]),
            (response.status(), &response.headers()["location"])
        );
        assert_eq!(again.headers()["content-type"], response.headers()["content-type"]);
        assert_eq!(to_bytes(again.into_body(), 99).await.unwrap(), "made");
        assert_eq!(repetition("two", first.clone()).unwrap_err().status(), 422);
        let unknown = repetition("one", OnceRow { response: None, ..first }).unwrap_err();
        assert_eq!(unknown.status(), 409);
        assert!(unknown.detail().contains("2026-11-20T18:00:00Z"), "{}", unknown.detail());
    }

    #[tokio::test]
    async fn a_response_that_is_too_large_is_not_stored() {
        let (_, stored) = read("x".repeat(ONCE_RESPONSE_MAX_BYTES).into_response()).await.unwrap();
        assert!(stored.is_some());
        let large = "x".repeat(ONCE_RESPONSE_MAX_BYTES + 1);
        let (response, stored) = read(large.clone().into_response()).await.unwrap();
        assert!(stored.is_none());
        assert_eq!(to_bytes(response.into_body(), usize::MAX).await.unwrap(), large);
    }
}
