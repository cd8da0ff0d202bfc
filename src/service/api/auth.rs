//! Authentication and authorisation: API keys and roles; on loopback, checks that prevent a foreign
//! web page from moving the rig.
//! Uses: `store` (the keys in memory). Never: the text of a key in a log; a wait for the store.

use std::net::IpAddr;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;

use super::App;
use super::problem::ApiError;
use crate::store::{KEYLESS, KEYLESS_SUFFIX, Key, Role};

/// The sender of a request.
#[derive(Debug, Clone)]
pub struct Caller {
    /// The API key; `None` on loopback without a key.
    pub key: Option<Key>,
    /// Rights of the caller.
    pub role: Role,
}

impl Caller {
    /// Returns the name for the log: that of the key, with the claimed name in parentheses; without
    /// a key the claimed name.
    pub fn name(&self, claimed: Option<&str>) -> String {
        let key = self.key.as_ref().map(|key| key.name.as_str());
        match (key, claimed) {
            (Some(key), Some(who)) if who != key => format!("{key} ({who})"),
            (Some(key), _) => key.into(),
            (None, Some(who)) if !who.is_empty() => who.into(),
            (None, _) => KEYLESS.into(),
        }
    }

    /// Returns the identity for the operator lock: the name of the key, or without a key the
    /// claimed name with a suffix, so that a claim never equals the name of a key.
    pub fn identity(&self, claimed: Option<&str>) -> String {
        match (&self.key, claimed) {
            (Some(key), _) => key.name.clone(),
            (None, Some(who)) if !who.is_empty() => format!("{who}{KEYLESS_SUFFIX}"),
            (None, _) => KEYLESS.into(),
        }
    }

    /// Checks that the caller has at least this role.
    ///
    /// # Errors
    /// 403 if the role is lower.
    pub fn require(&self, role: Role) -> Result<(), ApiError> {
        if self.role >= role {
            return Ok(());
        }
        let words = format!("role = {:?}: must be at least {role:?}", self.role).to_lowercase();
        Err(ApiError::new(StatusCode::FORBIDDEN, words))
    }
}

/// Admits a request with a valid key, or on loopback with the local host and origin. Requests that
/// change something need the role `operator`. Uses only the request and the keys in memory.
///
/// # Errors
/// 401 or 403 as in [`identify`]; 403 if the role is too low.
pub async fn admit(
    State(app): State<App>,
    mut request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let caller = identify(&app, request.headers(), request.uri().query())?;
    let path = request.uri().path();
    tracing::Span::current().record("caller", caller.name(None));
    if !only_reads(request.method(), path) && !may_stop(path) {
        caller.require(Role::Operator)?;
    }
    if let Some(key) = &caller.key {
        app.keys.note_use(key);
    }
    request.extensions_mut().insert(caller);
    Ok(next.run(request).await)
}

/// Determines the caller from the head of a request. Neither waits nor writes.
///
/// # Errors
/// 401 without a valid key (on loopback only for an invalid one); 403 on loopback for a foreign
/// host or origin.
pub fn identify(app: &App, headers: &HeaderMap, query: Option<&str>) -> Result<Caller, ApiError> {
    if app.loopback() {
        own_host(headers)?;
    }
    match secret(headers, query)? {
        Some(secret) => {
            let key = app.keys.find(&secret);
            let key = key.ok_or_else(|| unauthorized("this key is unknown or revoked"))?;
            Ok(Caller { role: key.role, key: Some(key) })
        }
        None if app.loopback() => Ok(Caller { key: None, role: Role::Admin }),
        None => Err(unauthorized("no key: send the header Authorization: Bearer KEY")),
    }
}

/// True for the actions on runs: any valid key may stop a run, and the handler checks the role for
/// other actions. The e-stop has a separate route without this check.
fn may_stop(path: &str) -> bool {
    path.starts_with("/api/v1/runs/") && path.ends_with("/actions")
}

/// True for requests that only read. Two of them are POST requests: an export reads rows, an
/// inference stores nothing.
pub fn only_reads(method: &Method, path: &str) -> bool {
    matches!(*method, Method::GET | Method::HEAD)
        || matches!(path, "/api/v1/exports" | "/api/v1/infer")
}

fn unauthorized(words: &str) -> ApiError {
    ApiError::new(StatusCode::UNAUTHORIZED, words)
}

/// Returns the text of the key: a bearer token, or `key=` in the query, because a browser's
/// WebSocket sends no headers. An invalid header is an error: treated as "no key" it would count as
/// local.
fn secret(headers: &HeaderMap, query: Option<&str>) -> Result<Option<String>, ApiError> {
    let Some(value) = headers.get(header::AUTHORIZATION) else {
        let key = query.and_then(|q| q.split('&').find_map(|pair| pair.strip_prefix("key=")));
        return Ok(key.map(|key| key.trim().to_owned()));
    };
    let credentials = value.to_str().ok().and_then(|value| value.split_once(' '));
    match credentials {
        Some((scheme, key)) if scheme.eq_ignore_ascii_case("bearer") => Ok(Some(key.trim().into())),
        Some(_) | None => Err(unauthorized("header Authorization: must be Bearer KEY")),
    }
}

/// Checks, on loopback, that `Host` is this machine (against DNS rebinding) and that `Origin`,
/// which a browser sends with the requests of a page, is this service.
fn own_host(headers: &HeaderMap) -> Result<(), ApiError> {
    let text = |name| headers.get(name).map(|v| v.to_str().unwrap_or_default());
    let host = text(header::HOST).unwrap_or_default();
    if !is_local(host) {
        let words = format!("Host = {host}: must be localhost or a loopback address");
        return Err(ApiError::new(StatusCode::FORBIDDEN, words));
    }
    if let Some(origin) = text(header::ORIGIN) {
        let own = origin.strip_prefix("http://").is_some_and(|o| o == host);
        if !own {
            let words = format!("Origin = {origin}: must be http://{host}");
            return Err(ApiError::new(StatusCode::FORBIDDEN, words));
        }
    }
    Ok(())
}

fn is_local(host: &str) -> bool {
    let name = match host.strip_prefix('[').and_then(|h| h.split_once(']')) {
        Some((v6, _)) => v6,
        None => host.split(':').next().unwrap_or_default(),
    };
    name == "localhost" || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_names_are_local() {
        for host in ["localhost", "localhost:8080", "127.0.0.1:1", "[::1]:8080"] {
            assert!(is_local(host), "{host}");
        }
        for host in ["", "evil.example", "127.0.0.1.evil.example:80", "10.0.0.2:8080"] {
            assert!(!is_local(host), "{host}");
        }
    }

    #[test]
    fn a_key_is_a_bearer_in_any_case_and_nothing_else() {
        let of = |value: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::AUTHORIZATION, value.parse().unwrap());
            secret(&headers, Some("a=b&key=query"))
        };
        for value in ["Bearer k", "bearer k", "BEARER  k "] {
            assert_eq!(of(value).unwrap().as_deref(), Some("k"), "{value}");
        }
        for value in ["", "Basic k", "Bearer", "k"] {
            assert!(of(value).is_err(), "{value}");
        }
        let without = secret(&HeaderMap::new(), Some("a=b&key=query")).unwrap();
        assert_eq!(without.as_deref(), Some("query"));
        assert_eq!(secret(&HeaderMap::new(), None).unwrap(), None);
    }

    #[test]
    fn a_foreign_origin_is_refused() {
        let headers = |origin: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "127.0.0.1:8080".parse().unwrap());
            headers.insert(header::ORIGIN, origin.parse().unwrap());
            headers
        };
        assert!(own_host(&headers("http://127.0.0.1:8080")).is_ok());
        assert!(own_host(&headers("http://evil.example")).is_err());
        assert!(own_host(&headers("null")).is_err());
    }
}
