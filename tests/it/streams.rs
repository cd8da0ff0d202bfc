//! What outlasts a moment: WebSockets and their tickets, streams whose key is revoked, bodies that
//! arrive slowly, and callers with many requests in progress.

use std::time::{Duration, Instant};

use futures::StreamExt;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::{Error, Message};

use super::datasets::filled::Filled;
use crate::support::eventually;

const LIMIT: Duration = Duration::from_secs(20);

async fn revoke(lab: &Filled, id: i64) {
    let answer = lab.http.delete(lab.url(&format!("/api/v1/keys/{id}"))).send().await.unwrap();
    assert_eq!(answer.status(), 204);
}

async fn ticket(lab: &Filled, key: &str) -> String {
    let asked = lab.http.post(lab.url("/api/v1/tickets")).bearer_auth(key).send().await.unwrap();
    let made: Value = asked.json().await.unwrap();
    made["ticket"].as_str().unwrap().into()
}

/// Status of an attempt to open a WebSocket; 101 with the socket.
async fn open(
    lab: &Filled,
    path: &str,
    ticket: &str,
) -> Result<impl StreamExt<Item = Result<Message, Error>> + Unpin + use<>, u16> {
    let url = format!("{}?ticket={ticket}", lab.url(path).replacen("http", "ws", 1));
    match connect_async(url).await {
        Ok((socket, _)) => Ok(socket),
        Err(Error::Http(answer)) => Err(answer.status().as_u16()),
        Err(other) => panic!("{other}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ticket_opens_one_websocket_and_nothing_else() {
    let lab = Filled::open("tickets").await;
    let (id, viewer) = lab.key("viewer", "viewer").await;
    let once = ticket(&lab, &viewer).await;
    let mut socket = open(&lab, "/api/v1/frames/live", &once).await.ok().unwrap();
    assert_eq!(open(&lab, "/api/v1/frames/live", &once).await.err(), Some(401), "used");
    assert_eq!(open(&lab, "/api/v1/frames/live", "0123").await.err(), Some(401), "unknown");
    // No model serves: the ticket is good, the request is not.
    let live = ticket(&lab, &viewer).await;
    assert_eq!(open(&lab, "/api/v1/live", &live).await.err(), Some(409));
    let live = ticket(&lab, &viewer).await;
    assert_eq!(open(&lab, "/api/v1/live/quantities", &live).await.err(), Some(409));
    // Elsewhere a ticket has no effect: what counts is the key, or none.
    let unused = ticket(&lab, &viewer).await;
    let to = lab.url(&format!("/api/v1/tickets?ticket={unused}"));
    let answer = lab.http.post(to).bearer_auth("palpate_00").send().await.unwrap();
    assert_eq!(answer.status(), 401);
    let to = lab.url("/api/v1/estop?ticket=0123");
    let stop = lab.http.post(to).bearer_auth(&viewer).send().await.unwrap();
    assert_eq!(stop.status(), 200, "a wrong ticket does not keep anybody from stopping");
    // Neither the socket nor a ticket outlives the key.
    revoke(&lab, id).await;
    let start = Instant::now();
    let end = async { while let Some(Ok(_)) = socket.next().await {} };
    timeout(LIMIT, end).await.expect("the socket ends");
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    assert_eq!(open(&lab, "/api/v1/frames/live", &unused).await.err(), Some(401), "revoked");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_of_events_ends_with_its_key() {
    let lab = Filled::open("revoked-stream").await;
    let (id, viewer) = lab.key("viewer", "viewer").await;
    let request = lab.http.get(lab.url("/api/v1/events?since=-3")).bearer_auth(&viewer);
    let answer = request.header("accept", "text/event-stream").send().await.unwrap();
    let mut events = answer.bytes_stream();
    assert!(timeout(LIMIT, events.next()).await.unwrap().unwrap().is_ok());
    revoke(&lab, id).await;
    let start = Instant::now();
    let end = async { while let Some(Ok(_)) = events.next().await {} };
    timeout(LIMIT, end).await.expect("the stream ends");
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lock_that_is_taken_while_a_body_arrives_counts() {
    let lab = Filled::open("late-body").await;
    let (_, eve) = lab.key("eve", "operator").await;
    let body = r#"{"action":"tare","who":"bob","why":"a slow client"}"#;
    let mut wire = TcpStream::connect(lab.url("").trim_start_matches("http://")).await.unwrap();
    let head = format!(
        "POST /api/v1/rig/actions HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n\
         content-length: {}\r\n\r\n{}",
        body.len(),
        &body[..5]
    );
    wire.write_all(head.as_bytes()).await.unwrap();
    tokio::time::sleep(Duration::from_millis(200)).await;
    let note = json!({ "note": "hands in the rig" });
    let taken = lab.http.put(lab.url("/api/v1/lock")).bearer_auth(&eve).json(&note).send().await;
    assert_eq!(taken.unwrap().status(), 200);
    wire.write_all(&body.as_bytes()[5..]).await.unwrap();
    let mut answer = vec![0; 4096];
    let n = timeout(LIMIT, wire.read(&mut answer)).await.unwrap().unwrap();
    let answer = String::from_utf8_lossy(&answer[..n]);
    assert!(answer.starts_with("HTTP/1.1 409") && answer.contains("eve holds"), "{answer}");
    let newest = &lab.get("/api/v1/actions?limit=1").await["items"][0];
    let signed = ["action", "who", "why"].map(|key| newest[key].as_str().unwrap_or_default());
    assert_eq!(signed, ["tare", "bob (local)", "a slow client"]);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_caller_with_too_many_requests_may_still_end_a_run() {
    let lab = Filled::open("too-many").await;
    let mut streams = Vec::new();
    for _ in 0..128 {
        let request = lab.http.get(lab.url("/api/v1/events")).header("accept", "text/event-stream");
        streams.push(request.send().await.unwrap());
    }
    lab.refuses_get("/api/v1/status", 429, "128 requests of local are in progress").await;
    lab.refuses("/api/v1/runs/1/actions", json!({ "action": "abort" }), 409, "not active").await;
    drop(streams);
    let answered = async || (lab.answer("/api/v1/status").await.status() == 200).then_some(());
    eventually("places are given back", LIMIT, answered).await;
    lab.close().await;
}
