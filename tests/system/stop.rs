//! A stop needs a valid key and nothing else: whatever its body, however many have come before,
//! whatever is read meanwhile. And who holds the operator lock is not a matter of claiming it.

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use futures::StreamExt;
use reqwest::Method;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{sleep, timeout};
use tokio_tungstenite::connect_async;

use super::bench::{LIMIT, Lab, WHOLE, answered, http, rig_args};

const ESTOP: &str = "/api/v1/estop";
const RIG: &str = "/api/v1/rig/actions";
/// Longest time from a request's first byte to its answer, which comes after the latch.
const LATCHED: Duration = Duration::from_millis(100);
/// The same while all else that connects or reads has filled the machine.
const LATCHED_IN_A_CROWD: Duration = Duration::from_secs(1);
const IDLE_CONNECTIONS: usize = 1_100;
const READERS: usize = 40;
const STOPS: usize = 100;
/// Clients that stop at once: more than there are places.
const STOPPING: usize = 700;
/// Keys of those who keep all connections busy.
const KEYS: usize = 8;
/// Twelve trials, whose voltages are read.
const SMALL: &str = "name = 'small'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [4]\n\
     configurations = 3\ndepths = 4\ndepth_step_mm = 1.25\nblock = 3\n[measure]\nsettle_ms = 400.0\n";

// ---------------------------------------------------------------- asking

/// A request with or without a key: its status and its body.
async fn ask(
    lab: &Lab,
    method: Method,
    path: &str,
    key: Option<&str>,
    body: Value,
) -> (u16, Value) {
    let url = format!("{}{path}", lab.service.url());
    let mut request = http().request(method, url).json(&body);
    if let Some(key) = key {
        request = request.bearer_auth(key);
    }
    answered(request).await
}

/// A key's text.
async fn key(lab: &Lab, name: &str, role: &str) -> String {
    let made = lab.posted("/api/v1/keys", json!({ "name": name, "role": role })).await;
    made["secret"].as_str().unwrap().to_owned()
}

fn address(lab: &Lab) -> String {
    lab.service.url().trim_start_matches("http://").to_owned()
}

async fn connect(lab: &Lab) -> TcpStream {
    TcpStream::connect(address(lab)).await.unwrap()
}

/// The head of a request, as it goes over the wire.
fn head(start: &str, key: Option<&str>, more: &str) -> String {
    let key = key.map_or(String::new(), |key| format!("authorization: Bearer {key}\r\n"));
    format!("{start} HTTP/1.1\r\nhost: localhost\r\n{key}{more}\r\n")
}

/// Sends bytes and reads up to the end of a JSON answer, whether the bytes were all taken or not;
/// its status, all of it, and how long it took from the connection on. On a separate thread, as
/// another process would be: what the service's threads do then tells nothing about the client.
async fn exchange(lab: &Lab, head: String, body: Vec<u8>) -> (u16, String, Duration) {
    let address = address(lab);
    let work = move || {
        let start = Instant::now();
        let mut reading = std::net::TcpStream::connect(address).unwrap();
        reading.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let mut writing = reading.try_clone().unwrap();
        // The rest of what is announced could still come until the answer is there.
        let sending = std::thread::spawn(move || {
            let sent = writing.write_all(head.as_bytes());
            sent.and_then(|()| writing.write_all(&body))
        });
        let (mut answer, mut piece) = (String::new(), [0; 4096]);
        while !answer.trim_end().ends_with('}') {
            let n = reading.read(&mut piece).unwrap();
            assert!(n > 0, "the connection ends in {answer:?}");
            answer.push_str(std::str::from_utf8(&piece[..n]).unwrap());
        }
        let took = start.elapsed();
        let _ = reading.shutdown(std::net::Shutdown::Both);
        let _ = sending.join().unwrap();
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        (status, answer, took)
    };
    tokio::task::spawn_blocking(work).await.unwrap()
}

/// A stop over a separate connection; how long it took to be answered.
async fn stop(lab: &Lab, key: &str, framing: &str, body: Vec<u8>) -> Duration {
    let head = head(&format!("POST {ESTOP}"), Some(key), framing);
    let (status, answer, took) = exchange(lab, head, body).await;
    assert_eq!(status, 200, "{answer}");
    assert!(answer.contains("\"latched\":true"), "{answer}");
    took
}

fn is_stopped(status: &Value) -> bool {
    status["rig"]["state"] == "tripped" && status["rig"]["trip"]["kind"] == "estop"
}

async fn reset(lab: &Lab) {
    lab.posted(RIG, json!({ "action": "reset", "who": "test" })).await;
    lab.until("a reset", |s| s["rig"]["state"] == "disarmed").await;
}

// ---------------------------------------------------------------- keys, bodies, the lock

/// Any role stops the rig, and nobody else does.
async fn any_valid_key_stops(lab: &Lab, viewer: &str) {
    for wrong in ["palpate_00", "nonsense", ""] {
        let (status, _) = ask(lab, Method::POST, ESTOP, Some(wrong), Value::Null).await;
        assert_eq!(status, 401, "{wrong:?}");
    }
    sleep(Duration::from_millis(500)).await;
    assert_eq!(lab.get("/api/v1/status").await["rig"]["state"], "disarmed");
    let (operator, admin) = (key(lab, "o", "operator").await, key(lab, "a", "admin").await);
    for (name, key) in [("viewer key", viewer), ("o", &operator), ("a", &admin)] {
        let took = stop(lab, key, "", Vec::new()).await;
        assert!(took < LATCHED, "{name}: {took:?}");
        let status = lab.until("a stop", is_stopped).await;
        assert_eq!(status["rig"]["trip"]["detail"], format!("emergency stop ({name})"));
        reset(lab).await;
    }
    // What a viewer may not do stays so.
    let act = json!({ "action": "tare" });
    assert_eq!(ask(lab, Method::POST, RIG, Some(viewer), act).await.0, 403);
}

/// The stop comes first, whatever the body is, and whether it comes or not.
async fn any_body_stops(lab: &Lab, viewer: &str) {
    let whole = |body: &[u8]| (format!("content-length: {}\r\n", body.len()), body.to_vec());
    let bodies = [
        ("none", (String::new(), Vec::new())),
        ("not UTF-8", whole(b"{\"why\":\"H\xe4nde!\"}")),
        ("JSON garbage", whole(b"[{")),
        ("10 MB", whole(&vec![b'x'; 10 << 20])),
        ("never sent", ("content-length: 10\r\n".into(), Vec::new())),
        ("withheld", ("content-length: 10\r\nexpect: 100-continue\r\n".into(), Vec::new())),
        ("never ended", ("transfer-encoding: chunked\r\n".into(), b"5\r\n{\"who".to_vec())),
    ];
    for (what, (framing, body)) in bodies {
        let took = stop(lab, viewer, &framing, body).await;
        eprintln!("a stop with a body that is {what}: answered after {took:?}");
        assert!(took < LATCHED, "{what}: {took:?}");
        lab.until("a stop", is_stopped).await;
        reset(lab).await;
    }
}

/// Who and why are written down afterwards, and cut to their bounds.
async fn the_log_says_who_and_why(lab: &Lab, viewer: &str) {
    let body = json!({ "who": "eve", "why": format!("smoke{}", "!".repeat(3000)) });
    assert_eq!(ask(lab, Method::POST, "/estop", Some(viewer), body).await.0, 200);
    let written = |actions: &Value| {
        let mut actions = actions["items"].as_array().unwrap().iter();
        actions.any(|a| {
            let why = a["why"].as_str().unwrap_or_default();
            a["action"] == "estop"
                && a["who"] == "viewer key (eve)"
                && why.starts_with("smoke!")
                && why.len() == 500
        })
    };
    lab.eventually("the log of the stop", "/api/v1/actions", written).await;
    let names = |status: &Value| {
        is_stopped(status) && status["rig"]["trip"]["detail"] == "emergency stop (viewer key (eve))"
    };
    lab.until("the name of the person", names).await;
    reset(lab).await;
}

/// A lock that was taken with a key is passed with that key alone; one without holds for everybody.
async fn a_lock_is_held_by_who_took_it(lab: &Lab) {
    let alice = key(lab, "alice", "operator").await;
    let take = |holder: &str| json!({ "holder": holder, "note": "tips are being changed" });
    let enter = |who: &str| json!({ "action": "tips", "tips": 0, "who": who });
    let (_, lock) = ask(lab, Method::PUT, "/api/v1/lock", Some(&alice), take("al")).await;
    assert_eq!(lock["holder"], "alice", "{lock}");
    for claimed in ["alice", "al", "alice (al)", ""] {
        assert_eq!(ask(lab, Method::POST, RIG, None, enter(claimed)).await.0, 409, "{claimed}");
    }
    assert_eq!(ask(lab, Method::POST, RIG, Some(&alice), enter("al")).await.0, 202);
    assert_eq!(ask(lab, Method::DELETE, "/api/v1/lock", None, Value::Null).await.0, 204);
    let (_, lock) = ask(lab, Method::PUT, "/api/v1/lock", None, take("eve")).await;
    assert_eq!(lock["holder"], "eve (local)", "{lock}");
    assert_eq!(ask(lab, Method::POST, RIG, None, enter("bob")).await.0, 409);
    assert_eq!(ask(lab, Method::POST, RIG, Some(&alice), enter("eve")).await.0, 409);
    assert_eq!(ask(lab, Method::POST, RIG, None, enter("eve")).await.0, 409);
    assert_eq!(ask(lab, Method::DELETE, "/api/v1/lock", None, Value::Null).await.0, 204);
    assert_eq!(ask(lab, Method::POST, RIG, None, enter("eve")).await.0, 202);
    let actions = lab.get("/api/v1/actions?limit=1").await;
    assert_eq!(actions["items"][0]["who"], "eve (local)");
    // Nor by a key of the same name, nor by one that is called like somebody without a key.
    for name in ["alice", "eve (local)", "local", ""] {
        let body = json!({ "name": name, "role": "operator" });
        assert_eq!(lab.post("/api/v1/keys", body).await.0, 422, "{name}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_needs_a_valid_key_of_any_role_and_no_body() {
    let lab = Lab::open("stop-keys", rig_args("virtual", 1.0), WHOLE).await;
    lab.posted(RIG, json!({ "action": "connect", "who": "test" })).await;
    let viewer = key(&lab, "viewer key", "viewer").await;
    any_valid_key_stops(&lab, &viewer).await;
    any_body_stops(&lab, &viewer).await;
    the_log_says_who_and_why(&lab, &viewer).await;
    a_lock_is_held_by_who_took_it(&lab).await;
    lab.close().await;
}

// ---------------------------------------------------------------- crowds

/// Raises the limit of open files for both ends of all connections; false if the system does not
/// let it.
fn many_files() -> bool {
    let limit = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: Some(4096), ..limit };
    limit.current.is_none_or(|now| now >= 4096) || setrlimit(Resource::Nofile, wanted).is_ok()
}

/// A head that does not end is given up, and a connection between two requests is not.
async fn a_slow_head_is_given_up(address: String) {
    let (mut slow, mut idle) =
        (TcpStream::connect(&address).await.unwrap(), TcpStream::connect(&address).await.unwrap());
    let get = head("GET /health/live", None, "");
    let mut piece = [0; 4096];
    idle.write_all(get.as_bytes()).await.unwrap();
    assert!(idle.read(&mut piece).await.unwrap() > 0);
    let start = Instant::now();
    slow.write_all(b"GET /health/live HT").await.unwrap();
    let end = timeout(Duration::from_secs(20), slow.read(&mut piece)).await;
    assert!(matches!(end, Ok(Ok(0) | Err(_))), "{end:?}");
    let took = start.elapsed();
    eprintln!("a head that does not end was given up after {took:?}");
    assert!(took > Duration::from_secs(4), "{took:?}");
    idle.write_all(get.as_bytes()).await.unwrap();
    assert!(idle.read(&mut piece).await.unwrap() > 0, "it was cut with the slow one");
}

/// Reads all trials with their voltages until told to end; counts the answers.
async fn read_on(url: String, over: Arc<AtomicBool>, read: Arc<AtomicUsize>) {
    let client = http();
    while !over.load(Ordering::Relaxed) {
        let answer = client.get(&url).send().await.unwrap();
        assert_eq!(answer.status(), 200);
        answer.bytes().await.unwrap();
        read.fetch_add(1, Ordering::Relaxed);
    }
}

/// Many stops; none takes long.
async fn stops_in_a_crowd(lab: &Lab, viewer: &str, crowd: &str) {
    let mut took = Vec::new();
    for _ in 0..STOPS {
        took.push(stop(lab, viewer, "", Vec::new()).await);
        sleep(Duration::from_millis(20)).await;
    }
    took.sort();
    let (median, longest) = (took[STOPS / 2], took[STOPS - 1]);
    eprintln!("{crowd}: {STOPS} stops, p50 {median:?}, longest {longest:?}");
    assert!(longest < LATCHED_IN_A_CROWD, "{took:?}");
}

/// Connections that wait make room for one another; readers do not hold a stop up.
async fn behind_idle_connections_and_readers(lab: &Lab, viewer: &str) {
    let url = lab.service.url().replacen("http", "ws", 1);
    let (mut socket, _) = connect_async(format!("{url}/api/v1/frames/live")).await.unwrap();
    let mut idle = Vec::new();
    for _ in 0..IDLE_CONNECTIONS {
        idle.push(connect(lab).await);
    }
    stops_in_a_crowd(lab, viewer, "1,100 idle connections").await;
    lab.until("a stop", is_stopped).await;
    let (over, read) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let url = format!("{}/api/v1/trials?voltages=true&limit=10000", lab.service.url());
    let readers: Vec<_> = (0..READERS)
        .map(|_| tokio::spawn(read_on(url.clone(), over.clone(), read.clone())))
        .collect();
    sleep(Duration::from_secs(1)).await;
    stops_in_a_crowd(lab, viewer, "40 readers of voltages, too").await;
    over.store(true, Ordering::Relaxed);
    for reader in readers {
        reader.await.unwrap();
    }
    eprintln!("the readers had {} answers", read.load(Ordering::Relaxed));
    let gone = |wire: &TcpStream| match wire.try_read(&mut [0]) {
        Ok(n) => n == 0,
        Err(error) => error.kind() != std::io::ErrorKind::WouldBlock,
    };
    let gone = idle.iter().filter(|wire| gone(wire)).count();
    assert!(gone >= IDLE_CONNECTIONS - 544, "{gone} have made room");
    let frame = timeout(LIMIT, socket.next()).await.unwrap().unwrap().unwrap();
    assert!(frame.is_text(), "the WebSocket was there first and stays: {frame:?}");
}

/// Stops that come faster than the door accepts connections are all answered.
async fn from_a_crowd(lab: &Lab, viewer: &str) {
    let (address, stop) = (address(lab), head(&format!("POST {ESTOP}"), Some(viewer), ""));
    let connect = move |_| {
        let mut wire = std::net::TcpStream::connect(&address).unwrap();
        wire.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        wire.write_all(stop.as_bytes()).unwrap();
        wire
    };
    let is_answered = |mut wire: std::net::TcpStream| {
        let mut start = [0; 13];
        wire.read_exact(&mut start).is_ok() && start == *b"HTTP/1.1 200 "
    };
    let stops = move || {
        let wires: Vec<_> = (0..STOPPING).map(connect).collect();
        wires.into_iter().map(is_answered).filter(|is_answered| *is_answered).count()
    };
    assert_eq!(tokio::task::spawn_blocking(stops).await.unwrap(), STOPPING);
}

/// While every place is busy the stop and /health are reached, and nothing else.
async fn behind_busy_connections(lab: &Lab, viewer: &str) {
    let more = "content-type: application/json\r\ncontent-length: 10\r\n";
    // One key alone may not have that number of requests in progress.
    let mut never_end = Vec::new();
    for n in 0..KEYS {
        let key = key(lab, &format!("crowd {n}"), "operator").await;
        never_end.push(head("POST /api/v1/preflight", Some(&key), more));
    }
    let address = address(lab);
    let connect = move |n: usize| {
        let mut wire = std::net::TcpStream::connect(&address).unwrap();
        // One that comes too late is told so and closed.
        let _ = wire.write_all(never_end[n % KEYS].as_bytes());
        wire
    };
    // Faster than the door accepts them: it refuses those beyond its places.
    let (mut busy, connect) =
        tokio::task::spawn_blocking(|| ((0..700).map(&connect).collect::<Vec<_>>(), connect))
            .await
            .unwrap();
    let status = || exchange(lab, head("GET /api/v1/status", None, ""), Vec::new());
    let start = Instant::now();
    let refusal = loop {
        match status().await {
            (503, answer, _) => break answer,
            // It took the place of one whose head was not read yet.
            (200, ..) => busy.push(connect(0)),
            other => panic!("{other:?}"),
        }
        assert!(start.elapsed() < Duration::from_secs(10), "no place is ever busy");
    };
    assert!(refusal.contains("application/problem+json") && refusal.contains("all connections"));
    let live = exchange(lab, head("GET /health/live", None, ""), Vec::new()).await;
    assert_eq!(live.0, 200, "{}", live.1);
    stops_in_a_crowd(lab, viewer, "512 busy connections").await;
    drop(busy);
    let start = Instant::now();
    while status().await.0 != 200 {
        assert!(start.elapsed() < Duration::from_secs(10), "places are not given back");
        sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_gets_through_crowds() {
    if !many_files() {
        eprintln!("SKIPPED: this process may not have 4096 files open");
        return;
    }
    let lab = Lab::homed("stop-crowds", 20.0, WHOLE).await;
    let slow = tokio::spawn(a_slow_head_is_given_up(address(&lab)));
    let run = lab.begin(SMALL).await;
    lab.ended(&run).await;
    slow.await.unwrap();
    let viewer = key(&lab, "viewer key", "viewer").await;
    behind_idle_connections_and_readers(&lab, &viewer).await;
    from_a_crowd(&lab, &viewer).await;
    behind_busy_connections(&lab, &viewer).await;
    lab.close().await;
}
