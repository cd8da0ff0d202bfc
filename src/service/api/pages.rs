//! Pages of lists: `{items, next}`, and cursors that fit only the list and the selection that they
//! began in.
//! Uses: axum, base64. Never: a read.

use std::fmt::Display;
use std::str::FromStr;

use axum::Json;
use axum::extract::{FromRequestParts, Query};
use axum::http::request::Parts;
use axum::http::{HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::limits::{LIST_MAX, LIST_PAGE};
use super::problem::{ApiError, ApiResult};
use crate::digest::sha256_hex;

/// Parameters that change neither the list nor the selection of its entries.
const OF_PAGES: [&str; 3] = ["cursor", "limit", "format"];
/// Number of hexadecimal digits that identify a list and a selection in a cursor.
const CURSOR_DIGITS: usize = 12;

/// A page of a list.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct Page<T> {
    /// Entries of the page.
    pub items: Vec<T>,
    /// Value of `cursor` for the next page; absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<String>,
}

impl<T> Page<T> {
    /// The only page of a list.
    pub fn whole(items: Vec<T>) -> Self {
        Self { items, next: None }
    }
}

impl<T: Serialize> IntoResponse for Page<T> {
    fn into_response(self) -> Response {
        Json(self).into_response()
    }
}

/// Size and position of a page.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "describes the parameters that `PageRequest` reads")]
pub struct PageParams {
    /// Largest number of entries in a page, default 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next` of the previous page.
    cursor: Option<String>,
}

/// The page of a list that a request asks for.
#[derive(Debug)]
pub struct PageRequest {
    /// Largest number of entries.
    pub limit: u32,
    cursors: Cursors,
    at: Option<String>,
}

impl PageRequest {
    /// Position after which the page begins; absent for the first page.
    ///
    /// # Errors
    /// 400 if it is not a position of this list.
    pub fn after<T: FromStr>(&self) -> ApiResult<Option<T>> {
        self.at.as_deref().map(|at| at.parse().map_err(|_| foreign(at))).transpose()
    }

    /// A page that ends at the position `next`, or at the end of the list.
    pub fn page<T>(&self, items: Vec<T>, next: Option<impl Display>) -> Page<T> {
        Page { items, next: next.map(|at| self.cursors.cursor(at)) }
    }

    /// A page of the entries from its beginning on; further ones than `limit` show that it is not the
    /// last page. `id` is the position of an entry.
    pub fn first<T, I: Display>(&self, mut entries: Vec<T>, id: impl Fn(&T) -> I) -> Page<T> {
        let more = entries.len() > self.limit as usize;
        entries.truncate(self.limit as usize);
        let next = entries.last().filter(|_| more).map(id);
        self.page(entries, next)
    }

    /// A page of a list of which all entries are given; `id` identifies an entry.
    ///
    /// # Errors
    /// 400 if the entry after which the page begins no longer exists.
    pub fn of_all<T, I: Display>(
        &self,
        mut all: Vec<T>,
        id: impl Fn(&T) -> I,
    ) -> ApiResult<Page<T>> {
        if let Some(at) = &self.at {
            let found = all.iter().position(|entry| id(entry).to_string() == *at);
            all.drain(..=found.ok_or_else(|| foreign(at))?);
        }
        Ok(self.first(all, id))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for PageRequest {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> ApiResult<Self> {
        let Query(pairs) = Query::<Vec<(String, String)>>::from_request_parts(parts, state).await?;
        let cursors = Cursors::of(parts.uri.clone(), &pairs);
        let limit = match pairs.iter().find(|(key, _)| key == "limit") {
            None => LIST_PAGE,
            Some((_, text)) => match text.parse() {
                Ok(limit @ 1..=LIST_MAX) => limit,
                _ => {
                    let limit = format!("must be from 1 to {LIST_MAX}");
                    return Err(ApiError::query("limit", text, &limit));
                }
            },
        };
        let at = cursors.position(&pairs)?;
        Ok(Self { limit, cursors, at })
    }
}

/// The cursors of one list with one selection: address and parameters, apart from those of pages.
#[derive(Debug)]
pub struct Cursors {
    uri: Uri,
    list: String,
}

impl Cursors {
    fn of(uri: Uri, pairs: &[(String, String)]) -> Self {
        let mut selection: Vec<_> =
            pairs.iter().filter(|(key, _)| !OF_PAGES.contains(&key.as_str())).collect();
        selection.sort();
        let mut list = sha256_hex(format!("{} {selection:?}", uri.path()));
        list.truncate(CURSOR_DIGITS);
        Self { uri, list }
    }

    /// The cursor of a position.
    pub fn cursor(&self, at: impl Display) -> String {
        URL_SAFE_NO_PAD.encode(format!("{}{at}", self.list))
    }

    /// The position in `cursor` of these parameters; absent without it.
    ///
    /// # Errors
    /// 400 if the cursor is not `next` of a page of this list with this selection.
    pub fn position<T: FromStr>(&self, pairs: &[(String, String)]) -> ApiResult<Option<T>> {
        let Some((_, cursor)) = pairs.iter().find(|(key, _)| key == "cursor") else {
            return Ok(None);
        };
        let decoded = URL_SAFE_NO_PAD.decode(cursor).ok().and_then(|b| String::from_utf8(b).ok());
        let at = decoded.as_deref().and_then(|text| text.strip_prefix(&self.list)?.parse().ok());
        at.map(Some).ok_or_else(|| foreign(cursor))
    }

    /// The header `Link` with the address of the page that begins at a cursor.
    pub fn link(&self, cursor: &str) -> Option<(header::HeaderName, HeaderValue)> {
        let path = self.uri.path();
        let query = self.uri.query().unwrap_or_default();
        let kept = query.split('&').filter(|pair| !pair.is_empty() && !pair.starts_with("cursor="));
        let cursor = format!("cursor={cursor}");
        let query = kept.chain([cursor.as_str()]).collect::<Vec<_>>().join("&");
        let link = HeaderValue::from_str(&format!("<{path}?{query}>; rel=\"next\""));
        link.ok().map(|link| (header::LINK, link))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Cursors {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> ApiResult<Self> {
        let Query(pairs) = Query::<Vec<(String, String)>>::from_request_parts(parts, state).await?;
        Ok(Self::of(parts.uri.clone(), &pairs))
    }
}

fn foreign(cursor: &str) -> ApiError {
    let limit = "must be `next` of the page before, of the same address and parameters";
    ApiError::query("cursor", super::audit::cut(cursor, 100), limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(address: &str) -> ApiResult<PageRequest> {
        let uri: Uri = address.parse().unwrap();
        let (mut parts, ()) =
            axum::http::Request::builder().uri(uri).body(()).unwrap().into_parts();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(PageRequest::from_request_parts(&mut parts, &()))
    }

    #[test]
    fn pages_of_a_list_in_memory_hold_each_entry_once() {
        let mut seen = Vec::new();
        let mut address = "/list?limit=2&of=a".to_owned();
        loop {
            let page = request(&address).unwrap().of_all((0..5).collect(), |n| *n).unwrap();
            seen.extend(page.items);
            let Some(next) = page.next else { break };
            address = format!("/list?limit=2&of=a&cursor={next}");
        }
        assert_eq!(seen, [0, 1, 2, 3, 4]);
        let whole = request("/list?limit=5").unwrap().of_all((0..5).collect(), |n| *n).unwrap();
        assert!(whole.next.is_none());
    }

    #[test]
    fn a_cursor_fits_only_its_list_and_its_selection() {
        let next = request("/list?of=a").unwrap().page(vec![()], Some(7)).next.unwrap();
        let after = |address: String| request(&address)?.after::<i64>();
        assert_eq!(after(format!("/list?limit=3&of=a&cursor={next}")).unwrap(), Some(7));
        for other in ["/list?of=b", "/list?of=a&of=a", "/lists?of=a"] {
            assert!(after(format!("{other}&cursor={next}")).is_err(), "{other}");
        }
        for wrong in ["", "7", "%00", &next[1..]] {
            assert!(after(format!("/list?of=a&cursor={wrong}")).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_link_repeats_the_parameters_with_the_new_cursor() {
        let cursors = Cursors::of("/list?a=1&cursor=x&b=%20".parse().unwrap(), &[]);
        let (_, link) = cursors.link("y").unwrap();
        assert_eq!(link, "</list?a=1&b=%20&cursor=y>; rel=\"next\"");
    }
}
