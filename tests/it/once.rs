//! Requests with an `Idempotency-Key`: sent again, together, after a restart, after a crash, after a
//! refusal, and by a client that does not wait. Each is carried out once.

use std::path::Path;
use std::time::Duration;

use reqwest::Response;
use serde_json::{Value, json};
use sqlx::Connection;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

use crate::datasets::filled::{Filled, folder};
use crate::support::{SENSOR, database, until};

const QUEUE: &str = "/api/v1/queue";
const QUICKSTART: &str = include_str!("../../experiments/quickstart.toml");

/// A submission in the name of a person.
fn submission(who: &str) -> Value {
    json!({ "file": "quickstart.toml", "definition": QUICKSTART, "sensor": SENSOR, "who": who })
}

impl Filled {
    async fn keyed(&self, path: &str, key: &str, body: &Value) -> Response {
        let request = self.http.post(self.url(path)).header("idempotency-key", key);
        request.json(body).send().await.unwrap()
    }

    async fn queued(&self) -> usize {
        self.items(QUEUE).await.len()
    }

    /// The newest actions: name, whether it was accepted, number of the API key.
    async fn logged(&self, n: usize) -> Vec<Value> {
        let actions = self.items(&format!("/api/v1/actions?limit={n}")).await;
        let shown =
            |action: &Value| json!([action["action"], action["accepted"], action["key_id"]]);
        actions.iter().map(shown).collect()
    }
}

/// Status, address of the new object, whether it was given before, and body.
async fn parts(response: Response) -> (u16, Option<String>, bool, Value) {
    let header = |name| Some(response.headers().get(name)?.to_str().unwrap().to_owned());
    let (status, location) = (response.status().as_u16(), header("location"));
    let replayed = header("idempotency-replayed").is_some_and(|text| text == "true");
    (status, location, replayed, response.json().await.unwrap_or_default())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_repeated_request_does_nothing_and_gets_the_first_response() {
    let lab = Filled::serve(folder("once")).await;
    let first = parts(lab.keyed(QUEUE, "night-7", &submission("ada")).await).await;
    let (201, Some(location), false, run) = &first else { panic!("{first:?}") };
    assert_eq!(*location, format!("/api/v1/runs/{}", run["uid"].as_str().unwrap()));
    let again = (201, Some(location.clone()), true, run.clone());
    for key in ["night-7", "\"night-7\""] {
        assert_eq!(parts(lab.keyed(QUEUE, key, &submission("ada")).await).await, again);
    }
    assert_eq!(lab.queued().await, 1);
    assert_eq!(lab.logged(9).await, [json!(["queue", true, null])], "a repetition is no action");
    // The key identifies one request of one caller.
    let (status, .., refused) = parts(lab.keyed(QUEUE, "night-7", &submission("eve")).await).await;
    assert_eq!(status, 422, "{refused}");
    let (id, eve) = lab.key("eve", "operator").await;
    let request = lab.http.post(lab.url(QUEUE)).bearer_auth(eve);
    let request = request.header("idempotency-key", "night-7").json(&submission("ada"));
    assert_eq!(parts(request.send().await.unwrap()).await.0, 201);
    assert_eq!(lab.queued().await, 2);
    assert_eq!(lab.logged(1).await, [json!(["queue", true, id])]);
    // What is refused for its key changes nothing either.
    for key in ["", "two words", "\"open", &"x".repeat(129)] {
        assert_eq!(lab.keyed(QUEUE, key, &submission("ada")).await.status(), 400, "{key}");
    }
    let ticket = async || parts(lab.keyed("/api/v1/tickets", "t", &Value::Null).await).await.3;
    assert_ne!(ticket().await, ticket().await, "no secret is stored");
    assert_eq!(lab.queued().await, 2);
    let lab = Filled::serve(lab.end().await).await;
    assert_eq!(parts(lab.keyed(QUEUE, "night-7", &submission("ada")).await).await, again);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_requests_at_once_give_one_run() {
    let lab = Filled::serve(folder("once-together")).await;
    for n in 1..=8 {
        let (key, body) = (format!("k-{n}"), submission("ada"));
        let (one, two) = tokio::join!(lab.keyed(QUEUE, &key, &body), lab.keyed(QUEUE, &key, &body));
        let mut created = 0;
        for response in [one, two] {
            match response.status().as_u16() {
                201 => created += usize::from(!parts(response).await.2),
                409 => assert_eq!(response.headers()["retry-after"], "1"),
                other => panic!("{other}"),
            }
        }
        assert_eq!((created, lab.queued().await), (1, n));
    }
    lab.close().await;
}

/// Removes the responses, as if the service had been killed before it could store them.
async fn forget_responses(data: &Path) {
    let mut connection = database(data).await;
    let statement = "UPDATE requests_once SET status = NULL, body = NULL";
    assert_eq!(sqlx::query(statement).execute(&mut connection).await.unwrap().rows_affected(), 1);
    connection.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_a_crash_interrupted_is_not_carried_out_again() {
    let lab = Filled::serve(folder("once-crash")).await;
    assert_eq!(lab.keyed(QUEUE, "k", &submission("ada")).await.status(), 201);
    let data = lab.end().await;
    forget_responses(&data).await;
    let lab = Filled::serve(data).await;
    let response = lab.keyed(QUEUE, "k", &submission("ada")).await;
    assert!(!response.headers().contains_key("retry-after"), "no repetition will help");
    let (status, .., body) = parts(response).await;
    assert_eq!(status, 409);
    assert!(body["detail"].as_str().unwrap().contains("outcome is unknown"), "{body}");
    assert_eq!(lab.keyed(QUEUE, "k", &submission("eve")).await.status(), 422);
    assert_eq!(lab.queued().await, 1);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_request_may_be_repeated_after_its_cause_is_gone() {
    let lab = Filled::open("once-refused").await;
    let export = json!({ "dataset": "mine", "format": "csv" });
    let (status, .., refused) = parts(lab.keyed("/api/v1/exports", "e", &export).await).await;
    assert_eq!(status, 404, "{refused}");
    lab.defined(json!({ "name": "mine", "task": "real", "runs": ["1"] })).await;
    let first = parts(lab.keyed("/api/v1/exports", "e", &export).await).await;
    assert_eq!((first.0, first.2), (202, false), "{first:?}");
    let again = parts(lab.keyed("/api/v1/exports", "e", &export).await).await;
    assert_eq!((again.0, again.2, &again.3["id"]), (202, true, &first.3["id"]));
    // A lock refuses before the key counts.
    let note = json!({ "note": "hands in the rig" });
    let lock = lab.url("/api/v1/lock");
    assert_eq!(lab.http.put(&lock).json(&note).send().await.unwrap().status(), 200);
    assert_eq!(lab.keyed(QUEUE, "q", &submission("ada")).await.status(), 409);
    assert_eq!(lab.http.delete(&lock).send().await.unwrap().status(), 204);
    assert_eq!(lab.keyed(QUEUE, "q", &submission("eve")).await.status(), 201);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_of_a_client_that_does_not_wait_is_carried_out_once() {
    let lab = Filled::serve(folder("once-gone")).await;
    let body = submission("ada").to_string();
    let to = lab.url("");
    let to = to.trim_start_matches("http://");
    let n = 12;
    for i in 0..n {
        let mut wire = TcpStream::connect(to).await.unwrap();
        let request = format!(
            "POST {QUEUE} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n\
             idempotency-key: gone-{i}\r\ncontent-length: {}\r\n\r\n{body}",
            body.len()
        );
        wire.write_all(request.as_bytes()).await.unwrap();
        // From before the request is read to after its response.
        tokio::time::sleep(Duration::from_millis(8 * i)).await;
    }
    for i in 0..n {
        let key = format!("gone-{i}");
        loop {
            let response = lab.keyed(QUEUE, &key, &submission("ada")).await;
            if response.status() == 201 {
                break;
            }
            assert_eq!(response.headers()["retry-after"], "1", "it is in progress, not unknown");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
    assert_eq!(lab.queued().await, n as usize);
    // Each is logged once, soon after its response is stored.
    let once = vec![json!(["queue", true, null]); n as usize];
    let logged = async || lab.logged(99).await;
    until("the log", Duration::from_secs(20), logged, |found| *found == once).await;
    lab.close().await;
}
