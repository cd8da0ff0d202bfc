//! Files on their way out: ranges, entity tags, sha256; and rows in whatever format is asked for.
//! Uses: tower-http's file service, `dataset::format`. Never: a file that can still change.

use std::io::Write;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use parking_lot::Mutex;
use serde_json::value::RawValue;
use tower_http::services::ServeFile;

use super::problem::ApiError;
use crate::dataset::error::DatasetError;
use crate::dataset::export::ExportFile;
use crate::dataset::format::{Format, Stream};

/// The media type of a format's answers.
fn media_type(format: Format) -> HeaderValue {
    HeaderValue::from_static(format.media_type())
}

/// Sends a file, or the part of it that is asked for. Its entity tag is its sha256, so that what was
/// fetched in pieces belongs together. `immutable` where the address can never mean another file.
pub async fn file(
    mut request: Request,
    export_file: &ExportFile,
    format: Format,
    (name, immutable): (&str, bool),
) -> Result<Response, ApiError> {
    let tag = format!("\"{}\"", export_file.sha256);
    let unchanged = text(request.headers(), &header::IF_NONE_MATCH).is_some_and(|tags| {
        tags == "*" || tags.split(',').any(|known| known.trim().trim_start_matches("W/") == tag)
    });
    if text(request.headers(), &header::IF_RANGE).is_some_and(|wanted| wanted != tag) {
        // The rest of another file would not fit: the whole of this one is sent instead.
        request.headers_mut().remove(header::RANGE);
    }
    // Other units than bytes are to be ignored (RFC 9110, 14.2).
    if text(request.headers(), &header::RANGE).is_some_and(|range| !range.starts_with("bytes=")) {
        request.headers_mut().remove(header::RANGE);
    }
    // The tag decides, not the time of the file.
    for name in [header::IF_RANGE, header::IF_NONE_MATCH, header::IF_MODIFIED_SINCE] {
        request.headers_mut().remove(name);
    }
    let mut response = if unchanged {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let mime = format.media_type().parse().map_err(|_| internal("a media type"))?;
        let sent = ServeFile::new_with_mime(&export_file.path, &mime).try_call(request).await;
        sent.map_err(|error| internal(&error.to_string()))?.map(Body::new)
    };
    let headers = response.headers_mut();
    headers.remove(header::LAST_MODIFIED);
    let mut set = |name: HeaderName, value: String| {
        if let Ok(value) = HeaderValue::from_str(&value) {
            headers.insert(name, value);
        }
    };
    set(header::ETAG, tag);
    set(header::CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\""));
    if let Some(digest) = digest(&export_file.sha256) {
        set(HeaderName::from_static("repr-digest"), digest);
    }
    let cache = if immutable { "private, max-age=31536000, immutable" } else { "no-cache" };
    set(header::CACHE_CONTROL, cache.into());
    Ok(response)
}

fn text<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    headers.get(name)?.to_str().ok()
}

/// The digest as RFC 9530 writes it; `None` where the text is not hexadecimal.
fn digest(sha256: &str) -> Option<String> {
    let bytes = hex::decode(sha256).ok()?;
    Some(format!("sha-256=:{}:", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// The format that an `Accept` header names, where it names one.
pub fn accepted(headers: &HeaderMap) -> Option<Format> {
    let accept = headers.get(header::ACCEPT)?.to_str().ok()?;
    let types: Vec<&str> =
        accept.split(',').filter_map(|part| part.split(';').next()).map(str::trim).collect();
    Format::ALL
        .into_iter()
        .find(|format| types.iter().any(|name| format.media_type().split(';').next() == Some(name)))
}

/// What a stream of rows has written and nobody has taken yet.
#[derive(Debug, Clone, Default)]
pub struct Piece(Arc<Mutex<Vec<u8>>>);

impl Piece {
    /// Takes what has been written so far.
    pub fn take(&self) -> Vec<u8> {
        std::mem::take(&mut self.0.lock())
    }
}

impl Write for Piece {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Some batches as an answer in a format that streams; `next` is the cursor of the page after it.
pub fn batches(
    format: Format,
    schema: &SchemaRef,
    batches: &[RecordBatch],
    next: Option<String>,
) -> Result<Response, ApiError> {
    let out = || -> Result<Vec<u8>, DatasetError> {
        let mut stream = Stream::new(format, schema, Vec::new())?;
        for batch in batches {
            stream.push(batch)?;
        }
        Ok(stream.finish()?)
    };
    Ok(with_headers(format, next, Body::from(out()?)))
}

/// Lines of JSON as values of an answer.
pub fn values(lines: &[u8]) -> Result<Vec<Box<RawValue>>, DatasetError> {
    let lines = lines.split(|&byte| byte == b'\n').filter(|line| !line.is_empty());
    lines.map(serde_json::from_slice).collect::<Result<_, _>>().map_err(DatasetError::Json)
}

/// An answer in a format, with the cursor of the page after it.
pub fn with_headers(format: Format, next: Option<String>, body: Body) -> Response {
    let mut response = body.into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, media_type(format));
    if let Some(next) = next.and_then(|next| HeaderValue::from_str(&next).ok()) {
        response.headers_mut().insert(HeaderName::from_static("x-next-cursor"), next);
    }
    response
}

fn internal(words: &str) -> ApiError {
    ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, words)
}
