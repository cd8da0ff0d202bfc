//! Authentication and authorisation: API keys and roles; on loopback, checks that prevent a foreign
//! web page from moving the rig.
//! Uses: `store` (the keys in memory). Never: the text of a key in a log; a wait for the store.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::Instant;

use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use jiff::Timestamp;
use parking_lot::Mutex;

use super::App;
use super::limits::{TICKET, TICKETS};
use super::problem::{ApiError, ApiResult};
use crate::store::{KEYLESS, KEYLESS_SUFFIX, Key, LockRow, Role};

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
    /// a key the claimed name with a suffix, so that a claim never equals the name of a key.
    pub fn name(&self, claimed: Option<&str>) -> String {
        let key = self.key.as_ref().map(|key| key.name.as_str());
        match (key, claimed) {
            (Some(key), Some(who)) if who != key => format!("{key} ({who})"),
            (Some(key), _) => key.into(),
            (None, Some(who)) if !who.is_empty() => format!("{who}{KEYLESS_SUFFIX}"),
            (None, _) => KEYLESS.into(),
        }
    }

    /// Returns the holder of an operator lock that the caller takes: the name of the key, or without
    /// a key the claimed name with a suffix.
    pub fn holder(&self, claimed: Option<&str>) -> String {
        self.name(claimed.filter(|_| self.key.is_none()))
    }

    /// Whether the caller proves by its key to be the holder of a lock.
    pub fn holds(&self, lock: &LockRow) -> bool {
        self.key.as_ref().is_some_and(|key| key.name == lock.holder)
    }

    /// Whether the caller may release a lock: its holder, an admin, and for a lock that was taken
    /// without a key every caller without one.
    pub fn may_release(&self, lock: &LockRow) -> bool {
        self.holds(lock) || self.role == Role::Admin || (self.key.is_none() && lock.is_keyless())
    }

    /// Whether the key of the caller has not been revoked since.
    pub fn is_valid(&self, app: &App) -> bool {
        self.key.as_ref().is_none_or(|key| app.keys.is_valid(key))
    }

    /// Checks that the caller has at least this role.
    ///
    /// # Errors
    /// 403 if the role is lower.
    pub fn require(&self, role: Role) -> ApiResult<()> {
        if self.role >= role {
            return Ok(());
        }
        let mut words = format!("role = {:?}: must be at least {role:?}", self.role).to_lowercase();
        if self.key.is_none() {
            words.push_str(
                "; set PALPATE_KEY to the key of an admin, or stop the service and run `palpate key \
                 create`, or start it with --local-admin",
            );
        }
        Err(ApiError::new(StatusCode::FORBIDDEN, words))
    }
}

/// Determines the caller from the head of a request. Neither waits nor writes.
///
/// # Errors
/// 401 without a valid key; on loopback a key is only needed if the service requires one, or if a
/// proxy has forwarded the request. 403 on loopback for a foreign host or origin.
pub fn identify(app: &App, headers: &HeaderMap) -> ApiResult<Caller> {
    identify_with(app, headers, app.loopback(), app.facts.require_key)
}

/// Address from which a request came, as far as it is known.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub IpAddr);

/// Determines the caller of the e-stop: a caller on this machine needs no key, whatever the options
/// of the service.
///
/// # Errors
/// 401 for an invalid key, or without one from another machine, also through a proxy on this one;
/// 403 without one for a foreign host or origin.
pub fn identify_stop(app: &App, headers: &HeaderMap, peer: Option<Peer>) -> ApiResult<Caller> {
    let is_here = peer.map_or(app.loopback(), |Peer(ip)| ip.to_canonical().is_loopback());
    identify_with(app, headers, is_here, false)
}

/// Determines the caller; one who `is_here`, on this machine, needs a key only if it is `required`.
fn identify_with(
    app: &App,
    headers: &HeaderMap,
    is_here: bool,
    required: bool,
) -> ApiResult<Caller> {
    if let Some(secret) = secret(headers)? {
        let key = app.keys.find(&secret);
        let key = key.ok_or_else(|| unauthorized("this key is unknown or revoked"))?;
        own_origin(app, headers)?;
        return Ok(Caller { role: key.role, key: Some(key) });
    }
    if !is_here {
        return Err(unauthorized("no key: send the header Authorization: Bearer KEY"));
    }
    needs_key(required, headers)?;
    own_host(headers)?;
    is_own_origin(headers)?;
    let role = if app.facts.local_admin { Role::Admin } else { Role::Operator };
    Ok(Caller { key: None, role })
}

/// Checks that a caller on loopback without a key may be taken for a person on this machine.
///
/// # Errors
/// 401 if keys are required, or if a proxy has forwarded the request: its client may be anywhere.
fn needs_key(required: bool, headers: &HeaderMap) -> ApiResult<()> {
    if required {
        let words = "no key: the service was started with --require-key; send the header \
                     Authorization: Bearer KEY";
        return Err(unauthorized(words));
    }
    let by_proxy = |name: &&HeaderName| {
        let name = name.as_str();
        matches!(name, "forwarded" | "via" | "x-real-ip") || name.starts_with("x-forwarded-")
    };
    match headers.keys().find(by_proxy) {
        Some(name) => Err(unauthorized(&format!(
            "no key: the header {name} shows that a proxy has forwarded the request, so it needs a key; \
             send the header Authorization: Bearer KEY"
        ))),
        None => Ok(()),
    }
}

fn unauthorized(words: &str) -> ApiError {
    ApiError::new(StatusCode::UNAUTHORIZED, words)
}

/// Determines the caller of a WebSocket, for which a ticket in the query may stand.
///
/// # Errors
/// 401 for a ticket that is unknown, used or too old, or whose key has been revoked; otherwise as
/// [`identify`].
pub fn identify_socket(app: &App, headers: &HeaderMap, query: Option<&str>) -> ApiResult<Caller> {
    let ticket = match ticket(query) {
        Some(ticket) if !headers.contains_key(header::AUTHORIZATION) => ticket,
        Some(_) | None => return identify(app, headers),
    };
    let caller = app.facts.tickets.take(ticket).filter(|caller| caller.is_valid(app));
    let caller = caller.ok_or_else(|| unauthorized("this ticket is unknown, used or too old"))?;
    if caller.key.is_none() {
        own_host(headers)?;
    }
    own_origin(app, headers)?;
    Ok(caller)
}

/// Returns the text of the key, a bearer token. An invalid header is an error: treated as "no key" it
/// would count as local.
fn secret(headers: &HeaderMap) -> ApiResult<Option<String>> {
    let Some(value) = headers.get(header::AUTHORIZATION) else { return Ok(None) };
    let credentials = value.to_str().ok().and_then(|value| value.split_once(' '));
    match credentials {
        Some((scheme, key)) if scheme.eq_ignore_ascii_case("bearer") => Ok(Some(key.trim().into())),
        Some(_) | None => Err(unauthorized("header Authorization: must be Bearer KEY")),
    }
}

/// Returns the ticket of a query string: a browser's WebSocket sends no header with a key.
fn ticket(query: Option<&str>) -> Option<&str> {
    query?.split('&').find_map(|pair| pair.strip_prefix("ticket="))
}

/// Checks that a browser did not send the request for a page of another origin.
///
/// # Errors
/// 403 if it did.
pub fn same_origin(headers: &HeaderMap) -> ApiResult<()> {
    let site = headers.get("sec-fetch-site").map(|value| value.to_str().unwrap_or_default());
    match site {
        None | Some("same-origin" | "none") => Ok(()),
        Some(site) => {
            let words = format!("Sec-Fetch-Site = {site}: must be same-origin or none");
            Err(ApiError::new(StatusCode::FORBIDDEN, words))
        }
    }
}

/// Number of requests with a wrong key since the start, and the time of the last one.
#[derive(Debug, Default)]
pub struct WrongKeys(Mutex<(u64, Option<Timestamp>)>);

impl WrongKeys {
    /// Counts a request. The first one, and every hundredth, is logged.
    pub fn note(&self) {
        let mut noted = self.0.lock();
        *noted = (noted.0 + 1, Some(Timestamp::now()));
        if noted.0 % 100 == 1 {
            tracing::warn!(count = noted.0, "a request had no valid key");
        }
    }

    /// Returns number and time.
    pub fn count(&self) -> (u64, Option<Timestamp>) {
        *self.0.lock()
    }
}

/// Tickets for WebSockets: each stands for its caller, once and for a short time.
#[derive(Debug, Default)]
pub struct Tickets(Mutex<HashMap<String, (Caller, Instant)>>);

impl Tickets {
    /// Creates a ticket from random bytes; `None` if `TICKETS` of the caller wait to be used.
    pub fn create(&self, caller: Caller, random: [u8; 32]) -> Option<String> {
        let mut waiting = self.0.lock();
        let now = Instant::now();
        waiting.retain(|_, (_, until)| *until > now);
        let key = |caller: &Caller| caller.key.as_ref().map(|key| key.id);
        let of = key(&caller);
        if waiting.values().filter(|(caller, _)| key(caller) == of).count() >= TICKETS {
            return None;
        }
        let ticket = hex::encode(random);
        waiting.insert(ticket.clone(), (caller, now + TICKET));
        Some(ticket)
    }

    fn take(&self, ticket: &str) -> Option<Caller> {
        let (caller, until) = self.0.lock().remove(ticket)?;
        (until > Instant::now()).then_some(caller)
    }
}

/// Checks that `Host` is this machine, for a caller without a key (against DNS rebinding).
///
/// # Errors
/// 403 if it is not.
fn own_host(headers: &HeaderMap) -> ApiResult<()> {
    let host = text(headers, header::HOST).unwrap_or_default();
    if is_local(host) {
        return Ok(());
    }
    let words = format!("Host = {host}: must be localhost or a loopback address, or send a key");
    Err(ApiError::new(StatusCode::FORBIDDEN, words))
}

/// Checks, on loopback, that `Origin`, which a browser sends with the requests of a page, is this
/// service.
///
/// # Errors
/// 403 if it is not.
fn own_origin(app: &App, headers: &HeaderMap) -> ApiResult<()> {
    if app.loopback() { is_own_origin(headers) } else { Ok(()) }
}

fn is_own_origin(headers: &HeaderMap) -> ApiResult<()> {
    let Some(origin) = text(headers, header::ORIGIN) else { return Ok(()) };
    let host = text(headers, header::HOST).unwrap_or_default();
    // With TLS, here or in a proxy, the scheme is https. One port does not serve both.
    match ["http://", "https://"].iter().any(|scheme| origin.strip_prefix(scheme) == Some(host)) {
        true => Ok(()),
        false => {
            let words = format!("Origin = {origin}: must be http://{host} or https://{host}");
            Err(ApiError::new(StatusCode::FORBIDDEN, words))
        }
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).map(|value| value.to_str().unwrap_or_default())
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
            secret(&headers)
        };
        for value in ["Bearer k", "bearer k", "BEARER  k "] {
            assert_eq!(of(value).unwrap().as_deref(), Some("k"), "{value}");
        }
        for value in ["", "Basic k", "Bearer", "k"] {
            assert!(of(value).is_err(), "{value}");
        }
        assert_eq!(secret(&HeaderMap::new()).unwrap(), None);
        assert_eq!(ticket(Some("a=b&ticket=t")), Some("t"));
        assert_eq!(ticket(Some("a=b&key=k")), None, "no address holds a key");
    }

    #[test]
    fn a_ticket_stands_for_its_caller_once_and_is_soon_too_old() {
        let tickets = Tickets::default();
        let caller = || Caller { key: None, role: Role::Viewer };
        let ticket = tickets.create(caller(), [7; 32]).unwrap();
        assert_eq!(tickets.take(&ticket).unwrap().role, Role::Viewer);
        assert!(tickets.take(&ticket).is_none() && tickets.take("").is_none());
        let old = tickets.create(caller(), [8; 32]).unwrap();
        tickets.0.lock().get_mut(&old).unwrap().1 = Instant::now();
        assert!(tickets.take(&old).is_none());
        for n in 0..TICKETS as u64 {
            let mut random = [0; 32];
            random[..8].copy_from_slice(&n.to_le_bytes());
            assert!(tickets.create(caller(), random).is_some());
        }
        assert!(tickets.create(caller(), [9; 32]).is_none());
    }

    #[test]
    fn requests_for_pages_of_other_origins_are_refused() {
        let of = |site: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert("sec-fetch-site", site.parse().unwrap());
            same_origin(&headers).is_ok()
        };
        assert_eq!(["same-origin", "none"].map(of), [true; 2]);
        assert_eq!(["cross-site", "same-site", ""].map(of), [false; 3]);
        assert!(same_origin(&HeaderMap::new()).is_ok(), "not a browser");
    }

    #[test]
    fn a_foreign_origin_is_refused() {
        let headers = |origin: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "127.0.0.1:8080".parse().unwrap());
            headers.insert(header::ORIGIN, origin.parse().unwrap());
            headers
        };
        for own in ["http://127.0.0.1:8080", "https://127.0.0.1:8080"] {
            assert!(is_own_origin(&headers(own)).is_ok(), "{own}");
        }
        for foreign in ["http://evil.example", "https://127.0.0.1:8081", "127.0.0.1:8080", "null"] {
            assert!(is_own_origin(&headers(foreign)).is_err(), "{foreign}");
        }
        assert!(is_own_origin(&HeaderMap::new()).is_ok(), "not a browser");
    }

    #[test]
    fn who_comes_through_a_proxy_needs_a_key() {
        let with = |name: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert(name, "10.0.0.7".parse().unwrap());
            headers
        };
        for name in ["forwarded", "via", "x-real-ip", "x-forwarded-for", "x-forwarded-proto"] {
            let refused = needs_key(false, &with(name)).unwrap_err();
            assert_eq!(refused.status(), StatusCode::UNAUTHORIZED);
            assert!(refused.detail().contains(name) && refused.detail().contains("proxy"));
        }
        assert!(needs_key(false, &with("x-request-id")).is_ok());
        assert!(needs_key(false, &HeaderMap::new()).is_ok());
        assert!(needs_key(true, &HeaderMap::new()).is_err());
    }
}
