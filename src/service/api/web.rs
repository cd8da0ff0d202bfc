//! The dashboard: the files of `web/`, embedded, the API description, and the response for unknown
//! addresses.
//! Uses: nothing of the rig. Never: data (a page asks the API for it), a file from outside `web/`.
//!
//! Every page is the same document, `index.html`, whose script shows the module `pages/NAME.js` of
//! its address: a new page is its module and its row in `web/pages.js`.

use std::sync::LazyLock;

use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use bytes::Bytes;
use rust_embed::{EmbeddedFile, RustEmbed};

use super::App;
use super::problem::ApiError;

/// Content security policy of all pages: they load, connect to and are shown by nothing but this
/// service, and run no script and no style from inside a document.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    img-src 'self' data: blob:; connect-src 'self'; manifest-src 'self'; base-uri 'none'; \
    form-action 'none'; frame-ancestors 'none'";

/// Files of the dashboard, which are part of the program.
#[derive(RustEmbed)]
#[folder = "../../web"]
struct Files;

/// The routes of the pages and their files, and of the API description (`/openapi.json`). They need
/// no key: they contain no data.
pub fn routes() -> Router<App> {
    Router::new()
        .route("/openapi.json", get(description))
        .route("/", get(async |headers: HeaderMap| document(&headers)))
        .route("/docs", get(async |headers: HeaderMap| file("docs.html", &headers)))
        .route("/{page}", get(page))
        .route("/web/{*file}", get(async |path: Path<String>, head: HeaderMap| file(&path, &head)))
}

/// Returns the document if there is a module of the page.
async fn page(Path(page): Path<String>, uri: Uri, headers: HeaderMap) -> Response {
    match Files::get(&format!("pages/{page}.js")) {
        Some(_) => document(&headers),
        None => unknown(uri).await.into_response(),
    }
}

fn document(headers: &HeaderMap) -> Response {
    file("index.html", headers)
}

/// Returns a file with its entity tag, or 304 if the caller has it.
fn file(path: &str, headers: &HeaderMap) -> Response {
    let Some(EmbeddedFile { data, metadata, .. }) = Files::get(path) else {
        return ApiError::not_found(format!("/web/{path}: unknown file")).into_response();
    };
    let tag = format!("\"{}\"", hex::encode(&metadata.sha256_hash()[..16]));
    let known = headers.get(header::IF_NONE_MATCH).is_some_and(|known| *known == tag);
    let about = [
        (header::CONTENT_SECURITY_POLICY, POLICY.to_owned()),
        (header::CONTENT_TYPE, media_type(path).to_owned()),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
        (header::ETAG, tag),
    ];
    if known {
        return (StatusCode::NOT_MODIFIED, about).into_response();
    }
    (about, Bytes::from(data.into_owned())).into_response()
}

/// Media type of a file by the end of its name.
fn media_type(path: &str) -> &'static str {
    match path.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("webmanifest") => "application/manifest+json",
        _ => "text/plain; charset=utf-8",
    }
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

    fn text(path: &str) -> String {
        let file = Files::get(path).unwrap_or_else(|| panic!("{path} is missing"));
        String::from_utf8(file.data.into_owned()).unwrap()
    }

    #[test]
    fn a_page_is_a_module_and_a_row_and_nothing_comes_from_elsewhere() {
        let rows = text("pages.js");
        for path in Files::iter() {
            let content = text(&path);
            if let Some(name) = path.strip_prefix("pages/").and_then(|f| f.strip_suffix(".js")) {
                assert!(rows.contains(&format!("name: '{name}'")), "{path} has no row in pages.js");
            }
            if path.starts_with("vendor/") {
                continue;
            }
            for foreign in ["http://", "https://", "unsafe", "innerHTML", "eval(", " style=\""] {
                let licit = foreign.starts_with("http") && content.contains("www.w3.org/2000/svg");
                assert!(licit || !content.contains(foreign), "{path}: {foreign}");
            }
        }
        for name in rows.split("name: '").skip(1).filter_map(|rest| rest.split('\'').next()) {
            assert!(Files::get(&format!("pages/{name}.js")).is_some(), "page {name} has no module");
        }
    }

    #[test]
    fn files_of_other_authors_are_those_of_the_table() {
        let table = text("vendor/README.md");
        let rows = table.lines().filter_map(|line| line.strip_prefix("| `"));
        let rows: Vec<(&str, &str)> = rows.filter_map(|row| row.split_once("` |")).collect();
        for (file, row) in &rows {
            let digest =
                hex::encode(Files::get(&format!("vendor/{file}")).unwrap().metadata.sha256_hash());
            assert!(row.contains(&digest), "{file} has the sha256 {digest}");
        }
        let scripts = |path: &str| path.starts_with("vendor/") && !path.ends_with("LICENSE");
        let others = Files::iter().filter(|path| scripts(path) && !path.ends_with(".md")).count();
        assert_eq!(rows.len(), others);
    }

    #[test]
    fn the_document_has_the_stop_and_no_script_or_style_of_its_own() {
        let document = text("index.html");
        assert!(document.starts_with("<!doctype html>") && document.contains("id=\"stop\""));
        for document in [&document, &text("docs.html")] {
            let count = |part: &str| document.matches(part).count();
            assert_eq!(count("<script"), count(" src=\"/web/"));
            assert_eq!(count("<style") + count(" onclick"), 0);
        }
        assert!(!POLICY.contains("unsafe"));
    }
}
