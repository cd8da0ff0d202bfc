//! The pages of the web interface, the API description, and the response for unknown addresses.
//! Uses: nothing of the rig. Never: data (a page asks the API for it).
//!
//! A page is one answer with its style and script. Its HTML names the shared parts where it needs
//! them: `{{head}}` (style), `{{header}}` (links, the stop, the form for a key), `{{script}}` (the
//! begin of its module).

use std::sync::LazyLock;

use axum::Router;
use axum::http::{Method, StatusCode, Uri, header};
use axum::response::{Html, IntoResponse};
use axum::routing::get;
use base64::Engine;
use bytes::Bytes;

use super::App;
use super::problem::ApiError;
use crate::digest::sha256_hex;

/// Content security policy of a document: it loads and connects to nothing but this service, and runs
/// no script and no style except those it was sent with, by their sha256.
fn policy(document: &str) -> String {
    let hashes = |begin: &str, end: &str| {
        let inline = document.split(begin).skip(1).filter_map(|rest| rest.split(end).next());
        let hash = |text: &str| {
            let digest = hex::decode(sha256_hex(text)).unwrap_or_default();
            format!(" 'sha256-{}'", base64::prelude::BASE64_STANDARD.encode(digest))
        };
        inline.map(hash).collect::<String>()
    };
    let (scripts, styles) =
        (hashes("<script type=\"module\">", "</script>"), hashes("<style>", "</style>"));
    format!(
        "default-src 'none'; connect-src 'self'; img-src 'self' data:; script-src{scripts}; \
         style-src{styles}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// A page.
struct Page {
    path: &'static str,
    title: &'static str,
    html: &'static str,
}

/// The pages, in the order of the links. A new page is its HTML and its row; routes, headers, links
/// and tests follow.
const PAGES: &[Page] = &[Page { path: "/", title: "Rig", html: include_str!("rig.html") }];

/// The shared parts.
const PARTS: [(&str, &str); 3] = [
    ("{{head}}", include_str!("head.html")),
    ("{{header}}", include_str!("header.html")),
    ("{{script}}", include_str!("shared.js")),
];

impl Page {
    /// The complete document.
    fn document(&self) -> String {
        let parts = |text: String, (name, part): (&str, &str)| text.replace(name, part);
        let text = PARTS.into_iter().fold(self.html.to_owned(), parts);
        text.replace("{{title}}", self.title).replace("{{links}}", &self.links())
    }

    /// Links to the other pages.
    fn links(&self) -> String {
        let others = PAGES.iter().filter(|page| page.path != self.path);
        let link = |page: &Page| format!("<a href=\"{}\">{}</a>", page.path, page.title);
        let links: Vec<String> = others.map(link).collect();
        match links.is_empty() {
            true => String::new(),
            false => format!("<nav aria-label=\"Pages\">{}</nav> ", links.join(" ")),
        }
    }
}

/// The routes of the pages, and of the API description (`/openapi.json`). They need no key: a page
/// contains no data.
pub fn routes() -> Router<App> {
    let described = Router::new().route("/openapi.json", get(description));
    PAGES.iter().fold(described, |router, page| {
        let document = page.document();
        let policy = policy(&document);
        let document = Bytes::from(document);
        let send = || async { ([(header::CONTENT_SECURITY_POLICY, policy)], Html(document)) };
        router.route(page.path, get(send))
    })
}

/// Returns the API description.
async fn description() -> impl IntoResponse {
    static TEXT: LazyLock<Bytes> = LazyLock::new(|| {
        // The description is plain JSON: serialisation does not fail.
        serde_json::to_vec(&super::description()).unwrap_or_default().into()
    });
    ([(header::CONTENT_TYPE, "application/json")], TEXT.clone())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_page_has_the_stop_leads_to_the_others_and_loads_nothing_else() {
        for page in PAGES {
            let document = page.document();
            let has = |text: &str| document.matches(text).count();
            assert!(document.starts_with("<!doctype html>"), "{}", page.path);
            assert_eq!(has("{{"), 0, "{}: a part is unknown", page.path);
            assert_eq!(has(&format!("<title>{} · Palpate</title>", page.title)), 1);
            for once in ["<button id=\"estop\">", "$('estop').onclick", "id=\"key-form\""] {
                assert_eq!(has(once), 1, "{}: {once}", page.path);
            }
            assert_eq!(has("://") + has(" src=") + has("<link"), 0, "{}", page.path);
            let policy = policy(&document);
            assert_eq!(
                policy.matches("sha256-").count(),
                has("<script") + has("<style"),
                "{policy}"
            );
            assert!(!policy.contains("unsafe") && has(" style=") + has(" onclick=\"") == 0);
            for other in PAGES {
                let links = usize::from(other.path != page.path);
                assert_eq!(has(&format!("<a href=\"{}\">", other.path)), links, "{}", page.path);
            }
        }
        let mut paths: Vec<&str> = PAGES.iter().map(|page| page.path).collect();
        paths.sort_unstable();
        paths.dedup();
        assert_eq!(paths.len(), PAGES.len());
    }
}
