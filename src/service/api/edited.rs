//! Things that two people may edit: entity tags of what is shown, and changes that are refused if the
//! thing is no longer what their client saw.
//! Uses: the handlers that show the things. Never: a wait of a stop, a pause or the end of a run.

use axum::body::{Body, to_bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::Mutex;

use super::problem::ApiError;
use super::routes::Needs;
use super::{App, models, people, queue};
use crate::digest::sha256_hex;

/// A thing that two people may edit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edited {
    /// The operator lock.
    Lock,
    /// The queue of runs.
    Queue,
    /// The serving models.
    Serving,
}

/// For each thing a mutex that is held from the comparison to the end of its change.
#[derive(Debug, Default)]
pub struct Edits {
    lock: Mutex<()>,
    queue: Mutex<()>,
    serving: Mutex<()>,
}

impl Edits {
    fn of(&self, thing: Edited) -> &Mutex<()> {
        match thing {
            Edited::Lock => &self.lock,
            Edited::Queue => &self.queue,
            Edited::Serving => &self.serving,
        }
    }
}

impl Edited {
    /// Address at which the thing is shown.
    fn path(self) -> &'static str {
        match self {
            Edited::Lock => "/api/v1/lock",
            Edited::Queue => "/api/v1/queue",
            Edited::Serving => "/api/v1/serving",
        }
    }

    /// The response that shows the thing as it is now.
    async fn shown(self, app: &App) -> Response {
        let app = State(app.clone());
        match self {
            Edited::Lock => people::lock(app).await.into_response(),
            Edited::Queue => queue::list(app).await.into_response(),
            Edited::Serving => models::serving(app).await.into_response(),
        }
    }

    /// Checks that the thing is what the client saw.
    ///
    /// The conductor takes runs from the queue without the mutex, because no start waits for an editor.
    /// After the comparison this is harmless: the store refuses to move or remove a run that it took, in
    /// the transaction of the change, and a position counts in the queue as it is then.
    ///
    /// # Errors
    /// 412 if it is not; 500 if the store fails.
    async fn check(self, app: &App, headers: &HeaderMap) -> Result<(), ApiError> {
        if !headers.contains_key(header::IF_MATCH) {
            return Ok(());
        }
        let (_, tag) = tagged(self.shown(app).await).await?;
        match tag {
            // The thing cannot be read: the change would be blind.
            None => Err(ApiError::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                format!("{} could not be read for the comparison with If-Match", self.path()),
            )),
            Some(tag) if lists(headers, &header::IF_MATCH, &tag) => Ok(()),
            Some(_) => {
                let words = format!(
                    "If-Match: it has changed meanwhile: GET {} shows it with its new entity tag",
                    self.path()
                );
                Err(ApiError::new(StatusCode::PRECONDITION_FAILED, words))
            }
        }
    }
}

/// Lets a handler answer: what it shows gets an entity tag; what it changes is compared with `If-Match`.
pub async fn carry_out(app: &App, needs: Needs, request: Request, next: Next) -> Response {
    let Some(thing) = needs.edited else { return next.run(request).await };
    if matches!(*request.method(), Method::GET | Method::HEAD) {
        let headers = request.headers().clone();
        let shown = tagged(next.run(request).await).await;
        return shown.map_or_else(ApiError::into_response, |shown| unless_known(&headers, shown));
    }
    let _alone = app.facts.edits.of(thing).lock().await;
    match thing.check(app, request.headers()).await {
        Ok(()) => next.run(request).await,
        Err(refused) => refused.into_response(),
    }
}

/// Returns a response with the entity tag of its body; errors have none.
async fn tagged(response: Response) -> Result<(Response, Option<String>), ApiError> {
    let failed = |words: String| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, words);
    if !response.status().is_success() {
        return Ok((response, None));
    }
    let (mut parts, body) = response.into_parts();
    let body = to_bytes(body, usize::MAX).await.map_err(|error| failed(error.to_string()))?;
    let tag = format!("\"{}\"", sha256_hex(&body));
    let value = HeaderValue::from_str(&tag).map_err(|error| failed(error.to_string()))?;
    parts.headers.insert(header::ETAG, value);
    parts.headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
    Ok((Response::from_parts(parts, Body::from(body)), Some(tag)))
}

/// Returns 304 instead of what the client has already.
fn unless_known(headers: &HeaderMap, (shown, tag): (Response, Option<String>)) -> Response {
    match tag {
        Some(tag) if lists(headers, &header::IF_NONE_MATCH, &tag) => {
            let (mut parts, _) = shown.into_parts();
            parts.status = StatusCode::NOT_MODIFIED;
            parts.headers.remove(header::CONTENT_TYPE);
            Response::from_parts(parts, Body::empty())
        }
        _ => shown,
    }
}

/// Whether a header lists an entity tag, or is `*`. A weak tag equals the strong one for
/// `If-None-Match` only (RFC 9110, 8.8.3.2).
pub fn lists(headers: &HeaderMap, name: &HeaderName, tag: &str) -> bool {
    let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
    let mut tags = values.flat_map(|value| value.split(',')).map(str::trim);
    let weak =
        |listed: &str| *name == header::IF_NONE_MATCH && listed.strip_prefix("W/") == Some(tag);
    tags.any(|listed| listed == "*" || listed == tag || weak(listed))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(name: HeaderName, values: &[&str]) -> bool {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(&name, value.parse().unwrap());
        }
        lists(&headers, &name, "\"a\"")
    }

    #[test]
    fn weak_tags_match_for_reading_only() {
        for name in [header::IF_MATCH, header::IF_NONE_MATCH] {
            for values in [&["\"a\""][..], &["*"], &["\"b\", \"a\""], &["\"b\"", "\"a\""]] {
                assert!(listed(name.clone(), values), "{name}: {values:?}");
            }
            for values in [&[][..], &[""], &["a"], &["\"b\""], &["W/\"b\""], &["\"A\""]] {
                assert!(!listed(name.clone(), values), "{name}: {values:?}");
            }
        }
        assert!(listed(header::IF_NONE_MATCH, &["W/\"a\""]));
        assert!(!listed(header::IF_MATCH, &["W/\"a\""]));
    }

    #[tokio::test]
    async fn equal_bodies_have_equal_tags_and_are_sent_once() {
        let tag = async |body: &'static str| tagged(body.into_response()).await.unwrap();
        let (shown, one) = tag("one").await;
        let one = one.unwrap();
        assert_eq!(shown.headers()[header::ETAG], one);
        let mut headers = HeaderMap::new();
        headers.insert(header::IF_NONE_MATCH, one.parse().unwrap());
        let same = unless_known(&headers, tag("one").await);
        assert_eq!(same.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(same.headers()[header::ETAG], one);
        let other = unless_known(&headers, tag("two").await);
        assert_eq!(other.status(), 200);
        let refused = ApiError::not_found("nothing").into_response();
        assert!(tagged(refused).await.unwrap().1.is_none());
    }
}
