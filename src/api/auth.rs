//! Who asks, and whether they may: keys and roles, and on loopback the checks that keep a foreign
//! page from moving the rig.
//! Uses: `store` (keys, lock). Never: a key's text in a log.

use std::net::IpAddr;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;

use super::App;
use super::problem::ApiError;
use crate::store::Role;

/// Who asks.
#[derive(Debug, Clone)]
pub struct Asker {
    /// Name of the key, or absent on loopback without one.
    pub key: Option<String>,
    /// What they may do.
    pub role: Role,
}

impl Asker {
    /// The name for the log: the key's where there is one, else what they call themselves.
    pub fn name(&self, claimed: Option<&str>) -> String {
        match (&self.key, claimed) {
            (Some(key), Some(who)) if who != key => format!("{key} ({who})"),
            (Some(key), _) => key.clone(),
            (None, Some(who)) if !who.is_empty() => who.into(),
            (None, _) => "local".into(),
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

/// Lets a request in: a key that is known, or loopback with our own host and origin.
pub async fn admit(
    State(app): State<App>,
    mut request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let headers = request.headers();
    if app.loopback() {
        own_host(headers)?;
    }
    let asker = match secret(headers, request.uri().query()) {
        Some(secret) => {
            let key = app.store.key_by_secret(&secret).await?;
            let key = key.ok_or_else(|| unauthorized("this key is not known or was revoked"))?;
            app.store.note_key_use(&key).await?;
            Asker { key: Some(key.name), role: key.role }
        }
        None if app.loopback() => Asker { key: None, role: Role::Admin },
        None => return Err(unauthorized("a key is needed: Authorization: Bearer KEY")),
    };
    let path = request.uri().path();
    let reads = matches!(*request.method(), Method::GET | Method::HEAD) || is_reading(path);
    if !reads && !may_stop(path) {
        asker.require(Role::Operator)?;
    }
    request.extensions_mut().insert(asker);
    Ok(next.run(request).await)
}

/// Any valid key may stop: the e-stop, and the actions on a run, which look at the role themselves.
fn may_stop(path: &str) -> bool {
    path.ends_with("/estop") || path.starts_with("/api/v1/runs/") && path.ends_with("/actions")
}

/// An export only reads what its asker could read in pieces; frames are answered and not kept.
fn is_reading(path: &str) -> bool {
    matches!(path, "/api/v1/exports" | "/api/v1/infer")
}

fn unauthorized(words: &str) -> ApiError {
    ApiError::new(StatusCode::UNAUTHORIZED, words)
}

/// The key: a bearer, or `key=` in the query, because a browser's WebSocket sends no headers.
fn secret(headers: &HeaderMap, query: Option<&str>) -> Option<String> {
    let bearer = headers
        .get(header::AUTHORIZATION)
        .and_then(|v| v.to_str().ok())
        .and_then(|v| v.strip_prefix("Bearer "));
    let in_query = || query?.split('&').find_map(|pair| pair.strip_prefix("key="));
    bearer.or_else(in_query).map(|s| s.trim().to_owned())
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
