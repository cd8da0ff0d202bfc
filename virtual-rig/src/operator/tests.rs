//! The operator against a rig and a service that answer as the real ones do.

use super::*;
use std::sync::{Arc, Mutex};
use tokio::io::AsyncReadExt;
use tokio::net::TcpListener;

type Heard = Arc<Mutex<Vec<String>>>;

/// A control socket that accepts every command.
async fn willing_rig(heard: Heard) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    tokio::spawn(async move {
        let (stream, _) = listener.accept().await.unwrap();
        let mut stream = BufReader::new(stream);
        let mut line = String::new();
        while stream.read_line(&mut line).await.unwrap() > 0 {
            heard.lock().unwrap().push(line.trim().to_owned());
            line.clear();
            stream.get_mut().write_all(b"{\"ok\":true}\n").await.unwrap();
        }
    });
    address
}

/// A service whose status is the first of `requests` that has not been confirmed.
async fn service(requests: Vec<&'static str>, heard: Heard) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        let mut requests = std::collections::VecDeque::from(requests);
        while !requests.is_empty() {
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut request = vec![0; 4096];
            let mut have = 0;
            let text = loop {
                have += stream.read(&mut request[have..]).await.unwrap();
                let text = String::from_utf8_lossy(&request[..have]).into_owned();
                if text.starts_with("GET") && text.ends_with("\r\n\r\n") || text.ends_with('}') {
                    break text;
                }
            };
            let body = if text.starts_with("GET /api/v1/status ") {
                format!("{{\"run\":{{\"uid\":\"u1\",{}}}}}", requests[0])
            } else if text.starts_with("GET /api/v1/frames/untouched ") {
                r#"{"at":"2026-11-20T18:00:00Z"}"#.to_owned()
            } else if text.starts_with("POST /api/v1/rig/actions ") {
                heard.lock().unwrap().push(text.lines().last().unwrap().to_owned());
                "{}".to_owned()
            } else {
                assert!(text.starts_with("POST /api/v1/runs/u1/actions "), "{text}");
                assert!(text.to_lowercase().contains("authorization: bearer k"));
                heard.lock().unwrap().push(text.lines().last().unwrap().to_owned());
                requests.pop_front();
                "{}".to_owned()
            };
            let reply = format!(
                "HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\
                 connection: close\r\n\r\n{body}",
                body.len()
            );
            stream.write_all(reply.as_bytes()).await.unwrap();
        }
    });
    url
}

#[tokio::test]
async fn it_does_what_the_run_asks_says_so_and_goes_home() {
    let heard = Heard::default();
    let control = willing_rig(Arc::clone(&heard)).await;
    let requests = vec![
        r#""state":"paused","paused_why":"manual_trial",
           "wanted":{"trial":12,"contacts":[{"x_mm":100.0,"y_mm":80.0,"force_n":4.905}]}"#,
        r#""state":"paused","paused_why":"tip_change","wanted":{"tips":4}"#,
    ];
    let url = service(requests, Arc::clone(&heard)).await;
    let who = "virtual operator".to_owned();
    let args = OperatorArgs { speed: 20.0, who, ..args(url.clone(), control) };
    let mut operator = Operator::new(args, None, Some("k".into())).unwrap();
    let work = operator.work(Duration::from_millis(300));
    let away = timeout(Duration::from_secs(10), work).await.unwrap().to_string();
    assert!(away.starts_with(&format!("no answer of a palpate service at {url} for ")), "{away}");
    let heard: Vec<Value> =
        heard.lock().unwrap().iter().map(|l| serde_json::from_str(l).unwrap()).collect();
    let who = "virtual operator";
    let weight = json!({ "x_mm": 100.0, "y_mm": 80.0, "force_n": 4.905 });
    let placed = "placed 1 weight for trial 12";
    assert_eq!(
        heard,
        [
            json!({ "cmd": "clear" }),
            json!({ "action": "tare", "who": who, "why": "the skin is clear" }),
            json!({ "cmd": "place", "weights": [weight] }),
            json!({ "action": "confirm", "who": who, "why": placed, "trial": 12 }),
            json!({ "cmd": "clear" }),
            json!({ "cmd": "mount", "tips": 4 }),
            json!({ "action": "confirm", "who": who, "why": "mounted 4 tips", "tips": 4 }),
        ]
    );
}

fn args(url: String, control: String) -> OperatorArgs {
    OperatorArgs {
        url,
        control,
        speed: 1.0,
        who: "virtual operator".into(),
        mistakes: 0.0,
        seed: 1,
        with_parent: false,
    }
}

#[test]
fn a_pause_by_the_operator_is_nothing_to_confirm() {
    let run = |why: &str| Run {
        uid: "u".into(),
        state: "paused".into(),
        paused_why: Some(why.into()),
        wanted: Some(json!({ "tips": 3 })),
    };
    assert_eq!(run("tip_change").requested(), Some(Requested::Tips(3)));
    assert_eq!(run("operator").requested(), None);
    let running = Run { state: "running".into(), ..run("tip_change") };
    assert_eq!(running.requested(), None);
}
