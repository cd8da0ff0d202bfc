//! Sends a request; one that creates or starts something is repeated if its connection fails. A key
//! makes that safe: the service carries the request out once.
//! Uses: reqwest, the service's table of operations. Never: a repetition without a key.

use std::collections::HashSet;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use reqwest::header::RETRY_AFTER;
use reqwest::{Error, RequestBuilder, Response, StatusCode};
use uuid::Uuid;

use crate::api::operations;

/// Pauses before the repetitions of a request whose connection failed.
const PAUSES: [Duration; 3] =
    [Duration::from_millis(100), Duration::from_millis(400), Duration::from_millis(1000)];
/// Pause while the first request is in progress.
const IN_PROGRESS: Duration = Duration::from_secs(1);

/// The stop, which is not looked up among all operations first.
const ESTOP_CALL: &str = "POST /api/v1/estop";

/// Operations that a service carries out once per `Idempotency-Key`, such as `POST /api/v1/queue`.
static ONCE: LazyLock<HashSet<String>> = LazyLock::new(|| {
    let once = operations().into_iter().filter(|(.., needs)| needs.once);
    // An action on the rig must not wait for a write: a full disk does not prevent its reset.
    let once = once.filter(|(_, path, _)| path != "/api/v1/rig/actions");
    once.map(|(method, path, _)| format!("{method} {path}")).collect()
});

/// Sends a request. An operation that is carried out once is sent with a key, and again if the
/// connection fails before an answer arrives, at most three times; and while the service still carries
/// out the first one, within a time.
///
/// # Errors
/// The error of the last attempt.
pub async fn send(
    mut request: RequestBuilder,
    operation: &str,
    within: Duration,
) -> Result<Response, Error> {
    let once = operation != ESTOP_CALL && ONCE.contains(operation);
    if once {
        request = request.header("idempotency-key", Uuid::now_v7().to_string());
    }
    let (start, mut pauses) = (Instant::now(), PAUSES.into_iter());
    loop {
        let again = request.try_clone().filter(|_| once);
        let answer = request.send().await;
        let pause = match &answer {
            Err(error) if is_lost(error) => pauses.next(),
            Ok(answer) if is_in_progress(answer) && start.elapsed() < within => Some(IN_PROGRESS),
            Ok(_) | Err(_) => None,
        };
        let (Some(next), Some(pause)) = (again, pause) else { return answer };
        tokio::time::sleep(pause).await;
        request = next;
    }
}

/// Whether a connection failed before an answer arrived.
fn is_lost(error: &Error) -> bool {
    (error.is_connect() || error.is_request()) && !error.is_timeout()
}

/// Whether the service still carries out the first request with the same key.
fn is_in_progress(answer: &Response) -> bool {
    answer.status() == StatusCode::CONFLICT && answer.headers().contains_key(RETRY_AFTER)
}

#[cfg(test)]
pub(super) mod tests {
    use serde_json::json;
    use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;
    use tokio::task::JoinHandle;

    use super::super::trust;
    use super::*;

    /// Reads one request: those with a body end with it.
    async fn request(wire: &mut (impl AsyncRead + Unpin)) -> Vec<u8> {
        let mut request = Vec::new();
        while !(request.ends_with(b"}") || request.starts_with(b"GET"))
            || !request.windows(4).any(|end| end == b"\r\n\r\n")
        {
            let length = wire.read_buf(&mut request).await.unwrap();
            assert!(length > 0, "the client closed within a request: {request:?}");
        }
        request
    }

    /// Answers each connection in turn: with the text, or for an empty one by closing it. Returns the URL, and the
    /// requests in lower case.
    pub async fn answers(texts: Vec<String>) -> (String, JoinHandle<Vec<String>>) {
        let door = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", door.local_addr().unwrap());
        let heard = tokio::spawn(async move {
            let mut heard = Vec::new();
            for text in texts {
                let (mut wire, _) = door.accept().await.unwrap();
                let request = request(&mut wire).await;
                heard.push(String::from_utf8_lossy(&request).to_lowercase());
                wire.write_all(text.as_bytes()).await.unwrap();
            }
            heard
        });
        (url, heard)
    }

    async fn posted(url: &str, path: &str) -> Result<Response, Error> {
        let request = trust::http(trust::tls(url, None).unwrap()).unwrap();
        let request = request.post(format!("{url}{path}")).json(&json!({}));
        send(request, &format!("POST {path}"), Duration::from_secs(20)).await
    }

    fn key_of(head: &str) -> Option<&str> {
        head.lines().find_map(|line| line.strip_prefix("idempotency-key: "))
    }

    const DONE: &str = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-length: 2\r\n\r\n{}";

    #[tokio::test]
    #[should_panic(expected = "the client closed within a request")]
    async fn a_request_that_ends_early_fails_the_test() {
        request(&mut &b"POST / HTTP/1.1\r\n"[..]).await;
    }

    #[tokio::test]
    async fn a_request_that_starts_something_is_repeated_with_its_key() {
        const BUSY: &str = "HTTP/1.1 409 Conflict\r\nretry-after: 1\r\nconnection: close\r\n\
                            content-length: 0\r\n\r\n";
        let (url, heads) = answers(["", BUSY, DONE].map(String::from).into()).await;
        posted(&url, "/api/v1/queue").await.unwrap();
        let heads = heads.await.unwrap();
        let keys: HashSet<_> = heads.iter().map(|head| key_of(head).unwrap()).collect();
        assert_eq!((heads.len(), keys.len()), (3, 1), "{heads:?}");
    }

    #[tokio::test]
    async fn a_request_that_could_start_something_twice_is_not_repeated() {
        let (url, heads) = answers(["", DONE].map(String::from).into()).await;
        assert!(is_lost(&posted(&url, "/api/v1/keys").await.unwrap_err()));
        posted(&url, "/api/v1/queue").await.unwrap();
        let heads = heads.await.unwrap();
        assert_eq!(
            heads.iter().map(|head| key_of(head).is_some()).collect::<Vec<_>>(),
            [false, true]
        );
    }
}
