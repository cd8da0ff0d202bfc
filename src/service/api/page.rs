//! The first page, the description, and the answer to an address that means nothing.
//! Uses: nothing of the rig. Never: data (the page asks the API for it).

use axum::Json;
use axum::http::{Uri, header};
use axum::response::{Html, IntoResponse};

use super::problem::ApiError;

/// Nothing from elsewhere is loaded or talked to.
const POLICY: &str = "default-src 'self' 'unsafe-inline'; frame-ancestors 'none'";

/// `/`
pub async fn first() -> impl IntoResponse {
    ([(header::CONTENT_SECURITY_POLICY, POLICY)], Html(include_str!("page.html")))
}

/// `/openapi.json`
pub async fn description() -> impl IntoResponse {
    Json(super::description())
}

/// Everything else.
pub async fn nothing(uri: Uri) -> ApiError {
    ApiError::not_found(format!("there is nothing at {}; see /openapi.json", uri.path()))
}
