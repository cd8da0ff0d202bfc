//! Forms with files: their parts one after the other, each with a limit that holds while it arrives.
//! Uses: axum's multipart. Never: a part in memory beyond its limit.

use axum::extract::FromRequest;
use axum::extract::multipart::{Field, Multipart, MultipartError};
use axum::http::StatusCode;
use bytes::Bytes;

use super::audit::cut;
use super::limits::{PART_MAX_BYTES, WHO_MAX_CHARS};
use super::problem::{ApiError, ApiResult};
use crate::problem::Problem;

/// Extractor of a form; another body is answered with a problem body.
#[derive(FromRequest)]
#[from_request(rejection(ApiError))]
pub struct Form(Multipart);

/// Texts of the named parts of a form, in the order of the names.
pub type Texts<const N: usize> = [Option<String>; N];

impl Form {
    /// Returns the next part.
    ///
    /// # Errors
    /// 400 if the form is damaged, 408 if it arrives too slowly, 413 if it is too large.
    pub async fn next(&mut self) -> ApiResult<Option<Part<'_>>> {
        let field = self.0.next_field().await.map_err(refused)?;
        Ok(field.map(|field| Part { name: field.name().unwrap_or_default().to_owned(), field }))
    }

    /// Receives the part `file` and texts of these names; each may be absent.
    ///
    /// # Errors
    /// 400 if there is another part, 413 if the file is longer than `max_bytes`; otherwise as [`Part::text`].
    pub async fn parts<const N: usize>(
        mut self,
        max_bytes: usize,
        names: [&str; N],
    ) -> ApiResult<(Option<Vec<u8>>, Texts<N>)> {
        let mut file = None;
        let mut texts: Texts<N> = std::array::from_fn(|_| None);
        while let Some(part) = self.next().await? {
            if part.name == "file" {
                file = Some(part.bytes(max_bytes).await?);
            } else if let Some(at) = names.iter().position(|name| *name == part.name) {
                texts[at] = Some(part.text().await?);
            } else {
                let known = match names.split_last() {
                    Some((last, others)) => {
                        format!("{} or {last}", [&["file"][..], others].concat().join(", "))
                    }
                    None => "file".into(),
                };
                let limit = format!("unknown part: must be {known}");
                return Err(invalid(&cut(&part.name, WHO_MAX_CHARS), "..", &limit));
            }
        }
        Ok((file, texts))
    }
}

/// A part of a form.
pub struct Part<'a> {
    /// Name of the part; empty if it has none.
    pub name: String,
    field: Field<'a>,
}

impl Part<'_> {
    /// Returns the name of its file, or the name of the part.
    pub fn file_name(&self) -> String {
        self.field.file_name().unwrap_or(&self.name).to_owned()
    }

    /// Returns its next bytes.
    ///
    /// # Errors
    /// As [`Form::next`].
    pub async fn chunk(&mut self) -> ApiResult<Option<Bytes>> {
        self.field.chunk().await.map_err(refused)
    }

    /// Returns all of it.
    ///
    /// # Errors
    /// 413 if it is longer than `max_bytes`; otherwise as [`Form::next`].
    pub async fn bytes(mut self, max_bytes: usize) -> ApiResult<Vec<u8>> {
        let mut all = Vec::new();
        while let Some(piece) = self.chunk().await? {
            if all.len() + piece.len() > max_bytes {
                let words = format!("part {} must have at most {max_bytes} bytes", self.name);
                return Err(ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, words));
            }
            all.extend_from_slice(&piece);
        }
        Ok(all)
    }

    /// Returns all of it as text, of at most `PART_MAX_BYTES`.
    ///
    /// # Errors
    /// 400 if it is not UTF-8; otherwise as [`Part::bytes`].
    pub async fn text(self) -> ApiResult<String> {
        let name = self.name.clone();
        let bytes = self.bytes(PART_MAX_BYTES).await?;
        String::from_utf8(bytes).map_err(|_| invalid(&name, "bytes", "must be text, UTF-8"))
    }
}

/// The error of an invalid part (400).
pub fn invalid(part: &str, value: &str, limit: &str) -> ApiError {
    ApiError::bad_query(vec![Problem::new("form", part, value, limit)])
}

/// The error of a missing part (400).
pub fn missing(part: &str) -> ApiError {
    invalid(part, "absent", "must be given")
}

fn refused(error: MultipartError) -> ApiError {
    ApiError::of_body(error.status(), error.body_text(), &error)
}
