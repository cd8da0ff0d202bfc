//! The span of each request: its id, its route and its caller; at its end its status and duration.
//! Uses: axum, tracing. Never: a part of the e-stop before its latch (`estop`), the text of a key, a
//! query string.

use std::time::Instant;

use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::Response;
use tracing::{Instrument, Span, error_span, field};
use uuid::Uuid;

/// Header with the id of a request, in requests and responses.
const REQUEST_ID: &str = "x-request-id";
/// Largest length of an id that a client states, characters.
const ID_MAX_CHARS: usize = 64;
/// Route of an address that does not exist.
const NO_ROUTE: &str = "none";

/// Id of a request: that of its header, or a new one. At most 64 visible ASCII characters.
#[derive(Debug, Clone)]
pub struct RequestId(HeaderValue);

impl RequestId {
    /// Returns the id that the headers state if it is acceptable, and a new id otherwise.
    pub fn of(headers: &HeaderMap) -> Self {
        let acceptable = |value: &&HeaderValue| {
            let bytes = value.as_bytes();
            (1..=ID_MAX_CHARS).contains(&bytes.len()) && bytes.iter().all(u8::is_ascii_graphic)
        };
        let stated = headers.get(REQUEST_ID).filter(acceptable).cloned();
        let new = || HeaderValue::from_str(&Uuid::now_v7().to_string());
        // A uuid is a valid value.
        Self(stated.or_else(|| new().ok()).unwrap_or(HeaderValue::from_static("none")))
    }

    /// Text of the id.
    pub fn text(&self) -> &str {
        self.0.to_str().unwrap_or_default()
    }

    /// Writes the id to a response.
    pub fn stamp(self, response: &mut Response) {
        response.headers_mut().insert(REQUEST_ID, self.0);
    }

    /// Creates the span of a request. Its caller and its run are recorded once they are known.
    ///
    /// Spans have the level `error`, so that they exist at every level of the log.
    pub fn span(&self, method: &Method, route: Option<&MatchedPath>) -> Span {
        error_span!(
            "request",
            request = self.text(),
            method = method.as_str(),
            route = route.map_or(NO_ROUTE, MatchedPath::as_str),
            caller = field::Empty,
            run = field::Empty,
            scan_id = field::Empty,
        )
    }
}

/// Handles a request in its span, and logs its status and duration: failures of the service as
/// warnings, requests that change something as information, others for debugging. A request that is to be
/// sent again later is no failure. A streamed body gets the span as an extension of its response.
pub async fn follow(request: Request, next: Next) -> Response {
    let began = Instant::now();
    let id = RequestId::of(request.headers());
    let span = id.span(request.method(), request.extensions().get::<MatchedPath>());
    // An inference stores nothing, and may come with every frame.
    let reads = matches!(*request.method(), Method::GET | Method::HEAD)
        || request.uri().path() == "/api/v1/infer";
    let mut response = next.run(request).instrument(span.clone()).await;
    span.in_scope(|| log_end(&response, reads, began));
    id.stamp(&mut response);
    response.extensions_mut().insert(span);
    response
}

/// Logs the end of a request in the present span.
fn log_end(response: &Response, reads: bool, began: Instant) {
    let status = response.status().as_u16();
    let duration_ms = began.elapsed().as_secs_f64() * 1e3;
    if is_failure(response) {
        tracing::warn!(status, duration_ms, "a request failed");
    } else if reads {
        tracing::debug!(status, duration_ms, "a request was answered");
    } else {
        tracing::info!(status, duration_ms, "a request was answered");
    }
}

/// Whether the service failed: not if it states when the request may be sent again, as while the query engine is built.
fn is_failure(response: &Response) -> bool {
    response.status().is_server_error() && !response.headers().contains_key(header::RETRY_AFTER)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::Router;
    use axum::body::Body;
    use axum::http::StatusCode;
    use axum::middleware::from_fn;
    use axum::response::IntoResponse;
    use axum::routing::get;
    use tower_service::Service;

    async fn answered_id(stated: Option<&str>) -> String {
        let mut router: Router =
            Router::new().route("/runs/{run}", get(async || "one")).layer(from_fn(follow));
        let mut request = Request::builder().uri("/runs/7");
        if let Some(id) = stated {
            request = request.header(REQUEST_ID, id);
        }
        let request = request.body(Body::empty()).unwrap();
        let Ok(response) = router.call(request).await;
        assert_eq!(response.status(), 200);
        assert!(response.extensions().get::<Span>().is_some());
        response.headers()[REQUEST_ID].to_str().unwrap().to_owned()
    }

    #[tokio::test]
    async fn every_response_states_the_id_of_its_request() {
        let made = answered_id(None).await;
        assert!(Uuid::parse_str(&made).is_ok(), "{made}");
        assert_ne!(answered_id(None).await, made);
        assert_eq!(answered_id(Some("night-7/2")).await, "night-7/2");
        assert_eq!(answered_id(Some(&"x".repeat(64))).await, "x".repeat(64));
    }

    #[test]
    fn a_request_that_is_to_be_sent_again_is_no_failure() {
        let later = (StatusCode::SERVICE_UNAVAILABLE, [(header::RETRY_AFTER, "5")]).into_response();
        assert!(!is_failure(&later));
        assert!(is_failure(&StatusCode::SERVICE_UNAVAILABLE.into_response()));
        assert!(!is_failure(&StatusCode::CONFLICT.into_response()));
    }

    #[tokio::test]
    async fn an_id_that_is_too_long_or_not_visible_is_replaced() {
        for stated in ["", "a b", "a\tb", &"x".repeat(65)] {
            let id = answered_id(Some(stated)).await;
            assert!(Uuid::parse_str(&id).is_ok(), "{stated:?}: {id}");
        }
    }
}
