//! Responses with files (ranges, entity tags, sha256) and with rows in the requested format.
//! Uses: `ranges`, `dataset::format`. Never: a file that can still change.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::{DataType, FieldRef, Schema, SchemaRef};
use axum::Json;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use parking_lot::Mutex;
use serde::Serialize;
use serde_json::value::RawValue;

use super::limits::PAGE_NUMBERS_MAX;
use super::problem::{ApiError, ApiResult};
use super::ranges::{self, Selected};
use super::tags::lists;
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::export::ExportFile;
use crate::dataset::format::{Format, Stream};
use crate::dataset::used;

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

/// Returns a file, or the requested parts of it. The entity tag is the sha256 of the file, so that
/// parts of different files are never combined. The time at which the file was last read is noted.
///
/// # Errors
/// 412 if the client wants another file; 500 if the file cannot be read.
pub async fn file(
    request: Request,
    export_file: &ExportFile,
    format: Format,
    Download { name, immutable }: Download<'_>,
) -> ApiResult<Response> {
    used::note(&export_file.path);
    let sent = request.headers();
    let tag = format!("\"{}\"", export_file.sha256);
    if sent.contains_key(header::IF_MATCH) && !lists(sent, &header::IF_MATCH, &tag) {
        let words = format!("If-Match: the entity tag of this file is {tag}");
        return Err(ApiError::new(StatusCode::PRECONDITION_FAILED, words));
    }
    let mut response = if lists(sent, &header::IF_NONE_MATCH, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let opened = open(&export_file.path).await;
        let (opened, size) = opened.map_err(ApiError::internal)?;
        // A client that has parts of another file gets the whole file. HEAD has no ranges.
        let same = text(sent, &header::IF_RANGE).is_none_or(|wanted| wanted == tag);
        let range = text(sent, &header::RANGE).filter(|_| same && request.method() == Method::GET);
        match range.map_or(Selected::Whole, |range| Selected::of(range, size)) {
            Selected::Nothing => return Ok(beyond(size)),
            Selected::Whole => with_length(StatusCode::OK, ranges::one(opened, 0..size), format),
            Selected::Parts(parts) => match parts.as_slice() {
                [part] => {
                    let part = part.clone();
                    let shown = ranges::content_range(&part, size);
                    let body = ranges::one(opened, part);
                    let mut response = with_length(StatusCode::PARTIAL_CONTENT, body, format);
                    set(&mut response, header::CONTENT_RANGE, &shown);
                    response
                }
                _ => {
                    // The hash of the file is in no file that has it.
                    let (kind, boundary) = (format.media_type(), &export_file.sha256);
                    let body = ranges::several(opened, parts, size, kind, boundary);
                    let mut response = with_length(StatusCode::PARTIAL_CONTENT, body, format);
                    let kind = format!("multipart/byteranges; boundary={boundary}");
                    set(&mut response, header::CONTENT_TYPE, &kind);
                    response
                }
            },
        }
    };
    set(&mut response, header::ACCEPT_RANGES, "bytes");
    set(&mut response, header::ETAG, &tag);
    let disposition = format!("attachment; filename=\"{name}\"");
    set(&mut response, header::CONTENT_DISPOSITION, &disposition);
    if let Some(digest) = digest(&export_file.sha256) {
        set(&mut response, HeaderName::from_static("repr-digest"), &digest);
    }
    let cache = if immutable { "private, max-age=31536000, immutable" } else { "no-cache" };
    set(&mut response, header::CACHE_CONTROL, cache);
    Ok(response)
}

/// Opens a file; returns it with its size.
async fn open(path: &Path) -> io::Result<(std::fs::File, u64)> {
    let file = tokio::fs::File::open(path).await?;
    let size = file.metadata().await?.len();
    Ok((file.into_std().await, size))
}

/// Refusal of a range without a byte of the file.
fn beyond(size: u64) -> Response {
    let words = format!("Range: must begin before the end of the file, which has {size} bytes");
    let refused = ApiError::new(StatusCode::RANGE_NOT_SATISFIABLE, words);
    ([(header::CONTENT_RANGE, format!("bytes */{size}"))], refused).into_response()
}

fn with_length(status: StatusCode, (body, length): (Body, u64), format: Format) -> Response {
    let mut response = (status, [(header::CONTENT_TYPE, media_type(format))], body).into_response();
    response.headers_mut().insert(header::CONTENT_LENGTH, length.into());
    response
}

pub(super) fn set(response: &mut Response, name: HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        response.headers_mut().insert(name, value);
    }
}

fn text<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    headers.get(name)?.to_str().ok()
}

/// Digest in the form of RFC 9530; `None` if the text is not hexadecimal.
fn digest(sha256: &str) -> Option<String> {
    let bytes = hex::decode(sha256).ok()?;
    Some(format!("sha-256=:{}:", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// Output buffer of a stream of rows, emptied piece by piece. Clones share it.
#[derive(Debug, Clone, Default)]
pub struct Piece(Arc<Mutex<Vec<u8>>>);

impl Piece {
    /// Removes and returns the buffered bytes.
    pub fn take(&self) -> Vec<u8> {
        let mut bytes = self.0.lock();
        // The next piece is about as long.
        let next = Vec::with_capacity(bytes.len());
        std::mem::replace(&mut bytes, next)
    }
}

impl Write for Piece {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns batches in a row format.
///
/// # Errors
/// An error of the format if a batch cannot be encoded, or for NPZ.
pub fn encoded(
    format: Format,
    schema: &SchemaRef,
    batches: &[RecordBatch],
) -> DatasetResult<Vec<u8>> {
    let mut stream = Stream::new(format, schema, Vec::new())?;
    for batch in batches {
        stream.push(batch)?;
    }
    Ok(stream.finish()?)
}

/// Splits JSON lines into raw values.
///
/// # Errors
/// `DatasetError::Json` if a line is not valid JSON.
pub fn values(lines: &[u8]) -> DatasetResult<Vec<Box<RawValue>>> {
    let lines = lines.split(|&byte| byte == b'\n').filter(|line| !line.is_empty());
    lines.map(serde_json::from_slice).collect::<Result<_, _>>().map_err(DatasetError::Json)
}

/// Returns a response with the media type of a format.
pub fn in_format(format: Format, body: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, media_type(format))], body.into()).into_response()
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
pub fn check_numbers(per_row: u64, rows: u32) -> ApiResult<()> {
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
