//! Responses with files (ranges, entity tags, sha256) and with rows in the requested format.
//! Uses: tower-http's file service, `dataset::format`. Never: a file that can still change.

use std::io::Write;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::{DataType, FieldRef, Schema, SchemaRef};
use axum::Json;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use parking_lot::Mutex;
use serde::Serialize;
use serde_json::value::RawValue;
use tower_http::services::ServeFile;

use super::edited::lists;
use super::limits::PAGE_NUMBERS_MAX;
use super::problem::ApiError;
use crate::dataset::error::DatasetError;
use crate::dataset::export::ExportFile;
use crate::dataset::format::{Format, Stream};

/// Media type of a format, as a header value.
fn media_type(format: Format) -> HeaderValue {
    HeaderValue::from_static(format.media_type())
}

/// Response with a new object, and with its address in the header `Location`.
pub struct Created<T> {
    status: StatusCode,
    location: String,
    object: T,
}

impl<T> Created<T> {
    /// The object exists (201).
    pub fn at(location: String, object: T) -> Self {
        Self { status: StatusCode::CREATED, location, object }
    }

    /// The object shows the state of work that has been accepted (202).
    pub fn later(location: String, object: T) -> Self {
        Self { status: StatusCode::ACCEPTED, location, object }
    }
}

impl<T: Serialize> IntoResponse for Created<T> {
    fn into_response(self) -> Response {
        (self.status, [(header::LOCATION, self.location)], Json(self.object)).into_response()
    }
}

/// Name and lifetime of a downloaded file.
#[derive(Debug, Clone, Copy)]
pub struct Download<'a> {
    /// File name shown to the client.
    pub name: &'a str,
    /// True if the address always returns the same file.
    pub immutable: bool,
}

/// Returns a file, or the requested part of it. The entity tag is the sha256 of the file, so that
/// parts of different files are never combined.
///
/// # Errors
/// 500 if the file cannot be read.
pub async fn file(
    mut request: Request,
    export_file: &ExportFile,
    format: Format,
    Download { name, immutable }: Download<'_>,
) -> Result<Response, ApiError> {
    let tag = format!("\"{}\"", export_file.sha256);
    let unchanged = lists(request.headers(), &header::IF_NONE_MATCH, &tag);
    if text(request.headers(), &header::IF_RANGE).is_some_and(|wanted| wanted != tag) {
        // The client has parts of another file: the whole file is sent.
        request.headers_mut().remove(header::RANGE);
    }
    // Units other than bytes must be ignored (RFC 9110, 14.2).
    if text(request.headers(), &header::RANGE).is_some_and(|range| !range.starts_with("bytes=")) {
        request.headers_mut().remove(header::RANGE);
    }
    // Only the tag is compared, not the time of the file.
    for name in [header::IF_RANGE, header::IF_NONE_MATCH, header::IF_MODIFIED_SINCE] {
        request.headers_mut().remove(name);
    }
    let mut response = if unchanged {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let mime = format.media_type().parse().map_err(|_| internal("invalid media type"))?;
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

/// Digest in the form of RFC 9530; `None` if the text is not hexadecimal.
fn digest(sha256: &str) -> Option<String> {
    let bytes = hex::decode(sha256).ok()?;
    Some(format!("sha-256=:{}:", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// Returns the format that an `Accept` header names; `None` if it names none.
pub fn accepted(headers: &HeaderMap) -> Option<Format> {
    let accept = headers.get(header::ACCEPT)?.to_str().ok()?;
    let types: Vec<&str> =
        accept.split(',').filter_map(|part| part.split(';').next()).map(str::trim).collect();
    Format::ALL
        .into_iter()
        .find(|format| types.iter().any(|name| format.media_type().split(';').next() == Some(name)))
}

/// Output buffer of a stream of rows, emptied piece by piece. Clones share it.
#[derive(Debug, Clone, Default)]
pub struct Piece(Arc<Mutex<Vec<u8>>>);

impl Piece {
    /// Removes and returns the buffered bytes.
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

/// Returns batches as a response in a row format.
///
/// # Errors
/// An error of the format if a batch cannot be encoded, or for NPZ.
pub fn batches(
    format: Format,
    schema: &SchemaRef,
    batches: &[RecordBatch],
) -> Result<Response, ApiError> {
    let out = || -> Result<Vec<u8>, DatasetError> {
        let mut stream = Stream::new(format, schema, Vec::new())?;
        for batch in batches {
            stream.push(batch)?;
        }
        Ok(stream.finish()?)
    };
    Ok(in_format(format, Body::from(out()?)))
}

/// Splits JSON lines into raw values.
///
/// # Errors
/// `DatasetError::Json` if a line is not valid JSON.
pub fn values(lines: &[u8]) -> Result<Vec<Box<RawValue>>, DatasetError> {
    let lines = lines.split(|&byte| byte == b'\n').filter(|line| !line.is_empty());
    lines.map(serde_json::from_slice).collect::<Result<_, _>>().map_err(DatasetError::Json)
}

/// Returns a response with the media type of a format.
pub fn in_format(format: Format, body: Body) -> Response {
    ([(header::CONTENT_TYPE, media_type(format))], body).into_response()
}

fn internal(words: &str) -> ApiError {
    ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, words)
}

/// Number of values in the frames and the map of a row.
pub fn numbers_per_row(table: &Schema) -> u64 {
    let length = |field: &FieldRef| match field.data_type() {
        DataType::FixedSizeList(_, length) => u64::try_from(*length).unwrap_or_default(),
        _ => 0,
    };
    table.fields().iter().map(length).sum()
}

/// Checks that a page of `rows` rows has at most `PAGE_NUMBERS_MAX` numbers in frames and maps.
///
/// # Errors
/// 400 with the largest number of rows that is possible.
pub fn check_numbers(per_row: u64, rows: u32) -> Result<(), ApiError> {
    let most = PAGE_NUMBERS_MAX / per_row.max(1);
    if u64::from(rows) <= most {
        return Ok(());
    }
    let limit = format!(
        "must be at most {most} with these columns ({per_row} numbers per row, {PAGE_NUMBERS_MAX} per \
         page); for more request an export"
    );
    Err(ApiError::query("limit", rows, &limit))
}
