//! Client of the service: requests with deadlines, refusals as errors.
//! Uses: reqwest, `view`, `repeat`. Never: the service's internals; a repetition except in `repeat`.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use jiff::Timestamp;
use nix::unistd::{User, geteuid};
use reqwest::multipart::{Form, Part};
use reqwest::{Method, RequestBuilder, Response, header};
use rustls::ClientConfig;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{Connector, connect_async_tls_with_config};

use super::error::{CliError, CliResult};
use super::progress::shown_wait;
use super::repeat;
use super::trust::{self, Certificates};
use crate::problem::Problem;

mod questions;

/// Longest wait for an answer; connecting a rig takes longest.
const ANSWER_WAIT: Duration = Duration::from_secs(60);
/// Longest time that a stream of events is open: longer than any run.
const STREAM: Duration = Duration::from_secs(400 * 86_400);
/// Longest wait when probing for a service.
const PROBE_WAIT: Duration = Duration::from_secs(2);

/// A client of one service. Clones share its connections.
#[derive(Debug, Clone)]
pub struct Client {
    url: String,
    http: reqwest::Client,
    tls: Arc<ClientConfig>,
    key: Option<String>,
    who: String,
    answer_within: Duration,
    /// Name of the work that is shown while an answer takes long.
    work: Option<&'static str>,
    /// Time of the status that its requests follow; none for requests that are never late.
    status_at: Option<Timestamp>,
    /// Whether the service is in this process, and ends with the command.
    is_own: bool,
}

/// What answers at a URL.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// A palpate service.
    Palpate,
    /// A program that does not reply as this service does.
    Stranger,
    /// No program accepts the connection and answers in time.
    Nothing,
}

/// Name of the person at this terminal, for the log of actions.
pub fn who() -> String {
    let user = std::env::var("USER").ok().filter(|u| !u.is_empty());
    // Services and containers have no USER.
    let listed = || User::from_uid(geteuid()).ok().flatten().map(|user| user.name);
    user.or_else(listed).unwrap_or_else(|| format!("user {}", geteuid()))
}

impl Client {
    /// Client of the service at a URL. `ca`: the certificate of the service or of its authority.
    ///
    /// # Errors
    /// `CliError::Http` if the HTTP client cannot be created; `Problems` if the URL is none, or if the
    /// certificate cannot be used; `Tls` likewise.
    pub fn new(url: &str, ca: Option<&Certificates>, key: Option<String>) -> CliResult<Self> {
        if let Some(limit) = url_limit(url) {
            return Err(CliError::argument("--url or PALPATE_URL", url, limit));
        }
        let tls = trust::tls(url, ca)?;
        let http = trust::http(tls.clone())?;
        let url = url.trim_end_matches('/').into();
        let (tls, who) = (tls.into(), who());
        let answer_within = ANSWER_WAIT;
        let (work, status_at, is_own) = (None, None, false);
        Ok(Self { url, http, tls, key, who, answer_within, work, status_at, is_own })
    }

    /// Returns the same client with another deadline for answers.
    pub fn patient(&self, answer_within: Duration) -> Self {
        Self { answer_within, ..self.clone() }
    }

    /// Returns the same client; while an answer takes longer than a moment, standard error names this work.
    pub fn showing(&self, work: &'static str) -> Self {
        Self { work: Some(work), ..self.clone() }
    }

    /// Returns the same client for requests next to a progress bar: it shows no wait.
    pub fn quiet(&self) -> Self {
        Self { work: None, ..self.clone() }
    }

    /// Returns the same client for an action upon a status of this time: the service refuses what may move the rig
    /// if it arrives long after. Not for a stop, a pause or an abort. `None`: an older service states no time.
    pub fn acting_on(&self, status_at: Option<Timestamp>) -> Self {
        Self { status_at, ..self.clone() }
    }

    /// Returns the same client of a service that is in this process, and ends with the command.
    pub fn of_own_service(self) -> Self {
        Self { is_own: true, ..self }
    }

    /// URL of the service.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// URL that is valid after the command; `None` for a service that ends with it.
    pub fn lasting_url(&self) -> Option<&str> {
        (!self.is_own).then_some(&*self.url)
    }

    /// Name of the client, for the log of actions.
    pub fn who(&self) -> &str {
        &self.who
    }

    /// What answers at the URL.
    ///
    /// # Errors
    /// `CliError::Untrusted` if its certificate is not trusted.
    pub async fn look(&self) -> CliResult<Found> {
        let url = format!("{}/health/live", self.url);
        let body: Value = match self.http.get(url).timeout(PROBE_WAIT).send().await {
            Ok(answer) => answer.json().await.unwrap_or_default(),
            Err(error) => match self.untrusted(&error) {
                Some(untrusted) => return Err(untrusted),
                None if error.is_connect() || error.is_timeout() => return Ok(Found::Nothing),
                None => return Ok(Found::Stranger),
            },
        };
        Ok(if body["service"] == "palpate" { Found::Palpate } else { Found::Stranger })
    }

    /// Sends a GET request and reads the answer.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub async fn get<T: DeserializeOwned>(&self, path: &str) -> CliResult<T> {
        self.ask(Method::GET, path, None::<&Value>).await
    }

    /// Sends a POST request with a body and reads the answer.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub async fn post<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
    ) -> CliResult<T> {
        self.ask(Method::POST, path, Some(body)).await
    }

    /// Sends a DELETE request in the client's name.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn delete(&self, path: &str) -> CliResult<()> {
        let who: String = self.who.bytes().map(|b| format!("%{b:02X}")).collect();
        let path = format!("{path}?who={who}");
        self.send(Method::DELETE, &path, None::<&Value>).await.map(|_| ())
    }

    /// Sends a request and reads the answer.
    ///
    /// # Errors
    /// As [`Self::send`]; `CliError::Http` if the answer has another form.
    pub async fn ask<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: Option<&impl Serialize>,
    ) -> CliResult<T> {
        Ok(self.send(method, path, body).await?.json().await?)
    }

    /// Sends a request.
    ///
    /// # Errors
    /// `CliError::NoServer` without a connection; `Http` without an answer; `Refused` or `Problems`
    /// if the service refuses.
    pub async fn send(
        &self,
        method: Method,
        path: &str,
        body: Option<&impl Serialize>,
    ) -> CliResult<Response> {
        self.carry_out(method, path, |request| match body {
            Some(body) => request.json(body),
            None => request,
        })
        .await
    }

    /// Asks for a part of a file.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn part(&self, path: &str, range: &str) -> CliResult<Response> {
        self.carry_out(Method::GET, path, |request| request.header(header::RANGE, range)).await
    }

    /// Opens a stream of server-sent events, after the event with this id if it continues one. It has no
    /// deadline once it is open.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn stream(&self, path: &str, last_id: Option<&str>) -> CliResult<Response> {
        let client = self.patient(STREAM);
        let sent = client.carry_out(Method::GET, path, |request| {
            let request = request.header(header::ACCEPT, "text/event-stream");
            match last_id {
                Some(id) => request.header("last-event-id", id),
                None => request,
            }
        });
        sent.await
    }

    /// Uploads a file with texts, each with the name of its part.
    ///
    /// # Errors
    /// As [`Self::ask`]; `CliError::Problems` if the file cannot be opened, `File` if it cannot be read.
    pub async fn upload<T: DeserializeOwned>(
        &self,
        path: &str,
        file: &Path,
        texts: impl IntoIterator<Item = (&'static str, Part)>,
    ) -> CliResult<T> {
        let opened = tokio::fs::File::open(file).await.map_err(CliError::input(file))?;
        let length = opened.metadata().await.map_err(CliError::file(file))?.len();
        let pieces = tokio_util::io::ReaderStream::new(opened);
        let body = reqwest::Body::wrap_stream(pieces);
        let name = file.display().to_string();
        let file = Part::stream_with_length(body, length).file_name(name);
        let form = Form::new().part("file", file);
        let form = texts.into_iter().fold(form, |form, (name, text)| form.part(name, text));
        let sent = self.carry_out(Method::POST, path, |request| request.multipart(form));
        Ok(sent.await?.json().await?)
    }

    /// Sends a POST request with a text and reads the answer.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub async fn post_text<T: DeserializeOwned>(&self, path: &str, text: String) -> CliResult<T> {
        let sent = self.carry_out(Method::POST, path, |request| {
            request.header(header::CONTENT_TYPE, "text/plain; charset=utf-8").body(text)
        });
        Ok(sent.await?.json().await?)
    }

    /// Reads the messages of a WebSocket until `take` returns `false`, or the stream ends.
    ///
    /// # Errors
    /// `CliError::Socket` if the connection fails.
    pub async fn messages(&self, path: &str, mut take: impl FnMut(&str) -> bool) -> CliResult<()> {
        let failed = |error: tungstenite::Error| match error {
            tungstenite::Error::Http(answer) => {
                let body = answer.body().as_deref().unwrap_or_default();
                let body = serde_json::from_slice(body).unwrap_or_default();
                let again = answer.headers().contains_key("retry-after");
                refusal(&format!("GET {path}"), answer.status().as_u16(), again, &body)
            }
            tungstenite::Error::Io(ref error) => self
                .untrusted(error)
                .unwrap_or_else(|| CliError::NoServer { url: self.url.clone() }),
            other => CliError::Socket(Box::new(other)),
        };
        let url = format!("{}{path}", self.url.replacen("http", "ws", 1));
        let mut request = url.into_client_request().map_err(failed)?;
        if let Some(key) = &self.key
            && let Ok(value) = format!("Bearer {key}").parse()
        {
            request.headers_mut().insert("authorization", value);
        }
        let tls = Some(Connector::Rustls(self.tls.clone()));
        let connected = connect_async_tls_with_config(request, None, false, tls).await;
        let (mut socket, _) = connected.map_err(failed)?;
        while let Some(message) = socket.next().await {
            match message.map_err(failed)? {
                Message::Text(text) if !take(&text) => break,
                Message::Close(_) => break,
                _ => {}
            }
        }
        // The reader does not wait for the other side's close message.
        socket.close(None).await.ok();
        Ok(())
    }

    /// Sends a request, to which `complete` adds its own headers and its body.
    async fn carry_out(
        &self,
        method: Method,
        path: &str,
        complete: impl FnOnce(RequestBuilder) -> RequestBuilder,
    ) -> CliResult<Response> {
        let operation = format!("{method} {path}");
        tracing::debug!(operation, url = self.url, "request");
        let request = complete(self.http.request(method, format!("{}{path}", self.url)));
        let mut request = request.timeout(self.answer_within);
        if let Some(key) = &self.key {
            request = request.bearer_auth(key);
        }
        if let Some(at) = self.status_at {
            request = request.header("status-at", at.to_string());
        }
        let sent = repeat::send(request, &operation, self.answer_within);
        let answer = match self.work {
            Some(work) => shown_wait(work, sent).await,
            None => sent.await,
        };
        let answer = answer.map_err(|source| {
            if let Some(untrusted) = self.untrusted(&source) {
                untrusted
            } else if source.is_connect() {
                CliError::NoServer { url: self.url.clone() }
            } else {
                CliError::Http(source)
            }
        })?;
        if answer.status().is_success() {
            return Ok(answer);
        }
        let status = answer.status().as_u16();
        let again = answer.headers().contains_key(header::RETRY_AFTER);
        let body: Value = answer.json().await.unwrap_or_default();
        Err(refusal(&operation, status, again, &body))
    }

    /// The error of a service whose certificate is not trusted, if this is the cause.
    fn untrusted(&self, error: &(dyn std::error::Error + 'static)) -> Option<CliError> {
        let why = trust::refused(error)?;
        Some(CliError::Untrusted { url: self.url.clone(), why })
    }

    fn body(&self, action: &str, mut more: Value) -> Value {
        more["action"] = action.into();
        more["who"] = self.who.clone().into();
        more
    }
}

/// What the URL of a service must be, if this is none.
pub fn url_limit(url: &str) -> Option<String> {
    match reqwest::Url::parse(url) {
        Ok(read) if matches!(read.scheme(), "http" | "https") && read.has_host() => None,
        _ if url.contains("://") => Some("must be like http://127.0.0.1:8080".into()),
        _ => Some(format!("must start with http:// or https://, as http://{url}")),
    }
}

/// The text of a field of an answer; empty if the field is absent or no text.
pub fn text_of(field: &Value) -> String {
    field.as_str().unwrap_or_default().to_owned()
}

/// Converts a problem body to an error: values outside their limits are bad input. `again`: the service stated when the
/// request may be sent again.
fn refusal(operation: &str, status: u16, again: bool, body: &Value) -> CliError {
    tracing::debug!(operation, status, "the service refused a request");
    // The service may have read another text, a recipe with changes: its places are not those of the file.
    let problems = Vec::<Problem>::deserialize(&body["errors"]).unwrap_or_default();
    let problems: Vec<Problem> = problems.into_iter().map(|problem| problem.at(None)).collect();
    if !problems.is_empty() {
        return CliError::Problems(problems);
    }
    let detail = match (body["detail"].as_str(), body["title"].as_str()) {
        (Some(detail), _) if !detail.is_empty() => detail.into(),
        (_, Some(title)) => title.into(),
        _ => format!("refused with status {status}"),
    };
    CliError::Refused { status, detail, again }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_refused_value_is_a_problem_and_a_refused_action_is_not() {
        let body = json!({ "title": "x", "errors": [
            { "file": "e.toml", "key": "seed", "value": "-1", "limit": "must be 0 or more" },
        ]});
        let error = refusal("POST /q", 422, false, &body);
        assert_eq!(error.to_string(), "e.toml: seed = -1: must be 0 or more");
        let body = json!({ "title": "Conflict", "detail": "run 3 is ended" });
        let error = refusal("POST /q", 409, false, &body);
        assert_eq!(error.to_string(), "run 3 is ended");
        let error = refusal("POST /q", 502, false, &Value::Null);
        assert!(error.to_string().contains("502"));
    }

    #[test]
    fn a_url_has_a_scheme_and_a_host() {
        for url in ["http://127.0.0.1:8080", "https://rig.example.org/lab", "http://[::1]:1"] {
            assert_eq!(url_limit(url), None);
        }
        assert!(url_limit("http://").is_some());
    }
}
