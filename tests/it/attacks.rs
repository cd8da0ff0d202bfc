//! Requests that once took gigabytes, hours or a panic: each is refused with its bound, takes little, and
//! leaves little. Their memory and the stop meanwhile: `tests/figures/attacks.py`.

use std::time::Duration;

use reqwest::Method;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::datasets::filled::Filled;

/// Length of the bodies and messages that are refused, bytes.
const LENGTH: usize = 1 << 30;

/// Most that may be taken of one of them, bytes: several times what the kernels of both ends buffer
/// (`tcp_rmem` and `tcp_wmem`, tens of MiB) before a connection that is no longer read is closed.
const TAKEN_MAX: usize = LENGTH / 4;

/// Sends a head, then `a` until the service closes the connection: the number of bytes that it took, and
/// the start of its answer.
async fn flooded(lab: &Filled, head: &[u8]) -> (usize, String) {
    let address = lab.url("");
    let mut wire = TcpStream::connect(address.trim_start_matches("http://")).await.unwrap();
    wire.write_all(head).await.unwrap();
    let (piece, mut taken) = (vec![b'a'; 1 << 16], 0);
    let flood = async {
        while taken < LENGTH && wire.write_all(&piece).await.is_ok() {
            taken += piece.len();
        }
    };
    timeout(Duration::from_secs(120), flood).await.expect("the connection is closed");
    let mut answer = [0; 200];
    let read = wire.read(&mut answer).await.unwrap_or_default();
    (taken, String::from_utf8_lossy(&answer[..read]).into())
}

async fn refused(lab: &Filled, method: Method, path: &str, body: Value) -> (u16, String) {
    let answer = lab.http.request(method, lab.url(path)).json(&body).send().await.unwrap();
    (answer.status().as_u16(), answer.text().await.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn what_would_take_much_is_refused_with_its_bound() {
    let lab = Filled::open("attacks").await;
    lab.make("run-1").await;
    let rows = "/api/v1/datasets/run-1/rows";
    let filters = vec!["tips=4"; 2000].join("&");
    let values = vec!["4"; 32_000].join(",");
    for (path, status, words) in [
        (format!("{rows}?map=2x320&limit=3000&columns=trial_id"), 400, "numbers per row"),
        (format!("{rows}?sort=tips&cursor=18446744073709551615"), 400, "cursor"),
        (format!("/api/v1/trials?{filters}"), 400, "at most 100 parameters"),
        (format!("/api/v1/trials?tips__in={}", &values[..20_000]), 400, "at most 1000 values"),
        (format!("/api/v1/trials?tips__in={values}"), 414, "bytes"),
        ("/api/v1/actions?limit=2147483648".into(), 400, "from 1 to 1000"),
    ] {
        lab.refuses_get(&path, status, words).await;
    }
    let frames = json!({ "frames": vec![vec![0; 784]; 2001], "method": "fast" });
    let (status, words) = refused(&lab, Method::POST, "/api/v1/infer", frames).await;
    assert!(status == 422 && words.contains("2000"), "{status} {words:.300}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_refused_is_not_taken_whole() {
    let lab = Filled::open("attacks-taken").await;
    for part in ["who", "name"] {
        let head = format!("--XX\r\nContent-Disposition: form-data; name=\"{part}\"\r\n\r\n");
        let head = format!(
            "POST /api/v1/imports HTTP/1.1\r\nhost: localhost\r\ncontent-type: \
             multipart/form-data; boundary=XX\r\ncontent-length: {LENGTH}\r\n\r\n{head}"
        );
        let (taken, answer) = flooded(&lab, head.as_bytes()).await;
        assert!(taken < TAKEN_MAX, "{part}: {taken}");
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 413"), "{part}: {answer}");
    }
    // A WebSocket that announces a message as long.
    let mut head = Vec::from(
        b"GET /api/v1/frames/live HTTP/1.1\r\nhost: localhost\r\nupgrade: websocket\r\n\
         connection: upgrade\r\nsec-websocket-version: 13\r\n\
         sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
    );
    // A part of a text, masked with zeros; the service refuses one without a mask for that alone.
    let length = LENGTH as u64;
    head.extend([0x01, 0xff].into_iter().chain(length.to_be_bytes()).chain([0; 4]));
    let (taken, _) = flooded(&lab, &head).await;
    assert!(taken < TAKEN_MAX, "WebSocket: {taken}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_refused_is_not_kept() {
    let lab = Filled::open("attacks-kept").await;
    let long = "x".repeat(20_000);
    for (method, path, body) in [
        (Method::PUT, "/api/v1/lock", json!({ "note": long })),
        (Method::PUT, "/api/v1/lock", json!({ "note": "n", "holder": long })),
        (Method::POST, "/api/v1/keys", json!({ "name": long, "role": "viewer" })),
        (Method::POST, "/api/v1/serving", json!({ "what": long, "why": long, "who": long })),
    ] {
        let (status, words) = refused(&lab, method, path, body).await;
        let is_short = words.len() < long.len() + 1000;
        assert!(matches!(status, 404 | 422) && is_short, "{path}: {status} {words:.200}");
    }
    let why = json!({ "why": long, "who": long });
    assert_eq!(refused(&lab, Method::POST, "/api/v1/estop", why).await.0, 200);
    let mut logged = lab.get("/api/v1/actions").await["items"].clone();
    while logged[0]["action"] != "estop" {
        tokio::time::sleep(Duration::from_millis(20)).await;
        logged = lab.get("/api/v1/actions").await["items"].clone();
    }
    for entry in logged.as_array().unwrap() {
        for (field, text) in entry.as_object().unwrap() {
            let length = text.as_str().unwrap_or_default().chars().count();
            assert!(length <= 2000, "{field} of {}: {length}", entry["action"]);
        }
    }
    let status = lab.answer("/api/v1/status").await.bytes().await.unwrap();
    assert!(status.len() < 8000, "{}", status.len());
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_becomes_somebody_else() {
    let lab = Filled::open("attacks-who").await;
    let new = json!({ "name": "eve", "role": "viewer" });
    let (_, secret) = lab.key("eve", "viewer").await;
    let keys = lab.url("/api/v1/keys");
    for (authorization, wanted) in [
        (format!("bearer {secret}"), 403),
        (format!("BEARER {secret}"), 403),
        (format!("Basic {secret}"), 401),
        (secret.clone(), 401),
        (String::new(), 401),
    ] {
        let asked = lab.http.post(&keys).header("authorization", &authorization).json(&new);
        assert_eq!(asked.send().await.unwrap().status(), wanted, "{authorization}");
    }
    // A key in an address is no key: an unknown parameter, of a caller without a key.
    let lab = Filled::serve_keys(lab.end().await).await;
    lab.refuses_get(&format!("/api/v1/status?key={secret}"), 401, "").await;
    // A page of another site may not even read.
    let foreign = lab.http.get(lab.url("/api/v1/datasets/real")).bearer_auth(&secret);
    let foreign = foreign.header("sec-fetch-site", "cross-site").send().await.unwrap();
    assert_eq!(foreign.status(), 403);
    lab.close().await;
}
