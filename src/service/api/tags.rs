//! Entity tags (RFC 9110, 8.8.3): of what is shown, and as requests list them.
//! Uses: axum. Never: a change.

use axum::body::{Body, to_bytes};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::Response;

use super::problem::{ApiError, ApiResult};
use crate::digest::sha256_hex;

/// Returns a response with the entity tag of its body; errors have none.
///
/// # Errors
/// 500 if the body cannot be read.
pub async fn tagged(response: Response) -> ApiResult<(Response, Option<String>)> {
    if !response.status().is_success() {
        return Ok((response, None));
    }
    let (parts, body) = response.into_parts();
    let body = to_bytes(body, usize::MAX).await.map_err(ApiError::internal)?;
    let tag = tag_of(&body);
    let mut response = Response::from_parts(parts, Body::from(body));
    add_tag(&mut response, &tag)?;
    Ok((response, Some(tag)))
}

/// Returns the entity tag of a body.
pub fn tag_of(body: &[u8]) -> String {
    format!("\"{}\"", sha256_hex(body))
}

/// Adds an entity tag to a response; a client may keep it, and must compare the tag before each use.
///
/// # Errors
/// 500 if it is no value of a header.
pub fn add_tag(response: &mut Response, tag: &str) -> ApiResult<()> {
    let tag = HeaderValue::from_str(tag).map_err(ApiError::internal)?;
    response.headers_mut().insert(header::ETAG, tag);
    let caching = HeaderValue::from_static("private, no-cache");
    response.headers_mut().insert(header::CACHE_CONTROL, caching);
    Ok(())
}

/// Returns 304 instead of what the client has already.
pub fn unless_known(headers: &HeaderMap, shown: Response, tag: Option<String>) -> Response {
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
    use axum::response::IntoResponse;

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
        let (shown, again) = tag("one").await;
        let same = unless_known(&headers, shown, again);
        assert_eq!(same.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(same.headers()[header::ETAG], one);
        let (shown, two) = tag("two").await;
        let other = unless_known(&headers, shown, two);
        assert_eq!(other.status(), 200);
        let refused = ApiError::not_found("nothing").into_response();
        assert!(tagged(refused).await.unwrap().1.is_none());
    }
}
