//! Who asks, and whether they may: keys and roles, and on loopback the checks that keep a foreign
//! page from moving the rig.
//! Uses: `store` (the keys in memory). Never: a key's text in a log; a wait for the store.

use std::net::IpAddr;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;

use super::App;
use super::problem::ApiError;
use crate::store::{KEYLESS, KEYLESS_SUFFIX, Key, Role};

/// Who asks.
#[derive(Debug, Clone)]
pub struct Asker {
    /// The key, or absent on loopback without one.
    pub key: Option<Key>,
    /// What they may do.
    pub role: Role,
}

impl Asker {
    /// The name for the log: the key's where there is one, else what they call themselves.
    pub fn name(&self, claimed: Option<&str>) -> String {
        let key = self.key.as_ref().map(|key| key.name.as_str());
        match (key, claimed) {
            (Some(key), Some(who)) if who != key => format!("{key} ({who})"),
            (Some(key), _) => key.into(),
            (None, Some(who)) if !who.is_empty() => who.into(),
            (None, _) => KEYLESS.into(),
        }
    }

    /// Who they are for the operator lock: the key's name, which nobody can have by claiming it;
    /// without a key the claimed name, marked as such.
    pub fn identity(&self, claimed: Option<&str>) -> String {
        match (&self.key, claimed) {
            (Some(key), _) => key.name.clone(),
            (None, Some(who)) if !who.is_empty() => format!("{who}{KEYLESS_SUFFIX}"),
            (None, _) => KEYLESS.into(),
        }
    }

    /// Refuses who has less than this role.
    pub fn require(&self, role: Role) -> Result<(), ApiError> {
        if self.role >= role {
            return Ok(());
        }
        let words = format!("needs the role {role:?}, this key is {:?}", self.role).to_lowercase();
        Err(ApiError::new(StatusCode::FORBIDDEN, words))
    }
}

/// Lets a request in: a key that is known, or loopback with our own host and origin. Looks at
/// nothing but the request and the keys in memory.
pub async fn admit(
    State(app): State<App>,
    mut request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let asker = identify(&app, request.headers(), request.uri().query())?;
    let path = request.uri().path();
    let reads = matches!(*request.method(), Method::GET | Method::HEAD) || is_reading(path);
    if !reads && !may_stop(path) {
        asker.require(Role::Operator)?;
    }
    if let Some(key) = &asker.key {
        app.keys.note_use(key);
    }
    request.extensions_mut().insert(asker);
    Ok(next.run(request).await)
}

/// Who asks, by the head of a request. Neither waits nor writes.
pub fn identify(app: &App, headers: &HeaderMap, query: Option<&str>) -> Result<Asker, ApiError> {
    if app.loopback() {
        own_host(headers)?;
    }
    match secret(headers, query)? {
        Some(secret) => {
            let key = app.keys.find(&secret);
            let key = key.ok_or_else(|| unauthorized("this key is not known or was revoked"))?;
            Ok(Asker { role: key.role, key: Some(key) })
        }
        None if app.loopback() => Ok(Asker { key: None, role: Role::Admin }),
        None => Err(unauthorized("a key is needed: Authorization: Bearer KEY")),
    }
}

/// Any valid key may stop a run: its actions look at the role themselves. The e-stop does not come
/// by here.
fn may_stop(path: &str) -> bool {
    path.starts_with("/api/v1/runs/") && path.ends_with("/actions")
}

/// An export only reads what its asker could read in pieces; frames are answered and not kept.
fn is_reading(path: &str) -> bool {
    matches!(path, "/api/v1/exports" | "/api/v1/infer")
}

fn unauthorized(words: &str) -> ApiError {
    ApiError::new(StatusCode::UNAUTHORIZED, words)
}

/// The key: a bearer, or `key=` in the query, because a browser's WebSocket sends no headers. A
/// header that is not understood is refused: read as "no key" it would make its sender local.
fn secret(headers: &HeaderMap, query: Option<&str>) -> Result<Option<String>, ApiError> {
    let Some(value) = headers.get(header::AUTHORIZATION) else {
        let key = query.and_then(|q| q.split('&').find_map(|pair| pair.strip_prefix("key=")));
        return Ok(key.map(|key| key.trim().to_owned()));
    };
    let credentials = value.to_str().ok().and_then(|value| value.split_once(' '));
    match credentials {
        Some((scheme, key)) if scheme.eq_ignore_ascii_case("bearer") => Ok(Some(key.trim().into())),
        Some(_) | None => Err(unauthorized("Authorization: must be Bearer KEY")),
    }
}

/// On loopback `Host` must be this machine (against DNS rebinding), and `Origin`, which a browser
/// sends with what a page does, must be one of ours.
fn own_host(headers: &HeaderMap) -> Result<(), ApiError> {
    let text = |name| headers.get(name).map(|v| v.to_str().unwrap_or_default());
    let host = text(header::HOST).unwrap_or_default();
    if !is_local(host) {
        let words = format!("Host = {host}: must be this machine's loopback name");
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
