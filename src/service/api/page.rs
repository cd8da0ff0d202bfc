//! The HTML page, the API description, and the response for unknown addresses.
//! Uses: nothing of the rig. Never: data (the page asks the API for it).

use axum::Json;
use axum::http::{Method, StatusCode, Uri, header};
use axum::response::{Html, IntoResponse};

use super::problem::ApiError;

/// Content security policy: the page loads from and connects to this service only.
const POLICY: &str = "default-src 'self' 'unsafe-inline'; frame-ancestors 'none'";

/// Returns the HTML page (`/`).
pub async fn first() -> impl IntoResponse {
    ([(header::CONTENT_SECURITY_POLICY, POLICY)], Html(include_str!("page.html")))
}

/// Returns the API description (`/openapi.json`).
pub async fn description() -> impl IntoResponse {
    Json(super::description())
}

/// Returns the error for a method that an address does not have.
pub async fn wrong_method(method: Method, uri: Uri) -> ApiError {
    let words = format!("{method} is not a method of {}; see /openapi.json", uri.path());
    ApiError::new(StatusCode::METHOD_NOT_ALLOWED, words)
}

/// Returns the error for an unknown address.
pub async fn unknown(uri: Uri) -> ApiError {
    ApiError::not_found(format!("{}: unknown address; see /openapi.json", uri.path()))
}
