//! The lock, the queue and the serving models have entity tags: who changes what another person has
//! changed meanwhile is refused.

use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::datasets::filled::{Filled, folder};
use crate::support::SENSOR;

const LOCK: &str = "/api/v1/lock";
const QUEUE: &str = "/api/v1/queue";
const SERVING: &str = "/api/v1/serving";
const QUICKSTART: &str = include_str!("../../experiments/quickstart.toml");

impl Filled {
    async fn with(
        &self,
        method: Method,
        path: &str,
        (header, tags): (&str, &str),
        body: Value,
    ) -> Response {
        let request = self.http.request(method, self.url(path)).header(header, tags);
        request.json(&body).send().await.unwrap()
    }

    async fn enqueued(&self) -> String {
        let run = json!({ "file": "q.toml", "definition": QUICKSTART, "sensor": SENSOR });
        let run = self.posted(QUEUE, run, 201).await;
        run["uid"].as_str().unwrap().to_owned()
    }
}

fn uids(queue: &Value) -> Vec<&str> {
    queue["items"].as_array().unwrap().iter().map(|run| run["uid"].as_str().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_client_has_is_not_sent_again() {
    let lab = Filled::serve(folder("edited-tags")).await;
    for path in [LOCK, QUEUE, SERVING] {
        let tag = lab.tag(path).await;
        assert!(tag.len() == 66 && tag.starts_with('"'), "{tag}");
        assert_eq!(lab.tag(path).await, tag);
        let head = lab.http.head(lab.url(path)).send().await.unwrap();
        assert_eq!(head.headers()["etag"], tag, "{path}");
        for tags in [tag.clone(), format!("W/{tag}"), format!("\"a\", {tag}"), "*".into()] {
            let known = ("if-none-match", tags.as_str());
            let response = lab.with(Method::GET, path, known, Value::Null).await;
            assert_eq!(response.status(), 304, "{path}: {tags}");
            assert_eq!(response.headers()["etag"], tag);
            assert!(response.bytes().await.unwrap().is_empty());
        }
        let other = ("if-none-match", "\"a\"");
        assert_eq!(lab.with(Method::GET, path, other, Value::Null).await.status(), 200);
    }
    lab.enqueued().await;
    assert!(!lab.answer("/api/v1/runs/1").await.headers().contains_key("etag"));
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_second_of_two_editors_is_refused() {
    let lab = Filled::serve(folder("edited")).await;
    let runs = [lab.enqueued().await, lab.enqueued().await, lab.enqueued().await];
    let seen = lab.tag(QUEUE).await;
    let seen = ("if-match", seen.as_str());
    let last = format!("{QUEUE}/{}/move", runs[2]);
    let moved = lab.with(Method::POST, &last, seen, json!({ "position": 1 })).await;
    assert_eq!(moved.status(), 200);
    // The other person saw the queue before.
    let first = format!("{QUEUE}/{}", runs[0]);
    let refused = lab.with(Method::DELETE, &first, seen, Value::Null).await;
    assert_eq!(refused.status(), 412);
    assert_eq!(refused.headers()["content-type"], "application/problem+json");
    let words = refused.json::<Value>().await.unwrap()["detail"].clone();
    assert!(words.as_str().unwrap().contains("GET /api/v1/queue"), "{words}");
    let again = lab.with(Method::POST, &last, seen, json!({ "position": 3 })).await;
    assert_eq!(again.status(), 412);
    assert_eq!(uids(&lab.get(QUEUE).await), [&*runs[2], &runs[0], &runs[1]]);
    // With the new tag, with any, and without.
    let now = lab.tag(QUEUE).await;
    let weak = format!("W/{now}");
    let weak = lab.with(Method::DELETE, &first, ("if-match", &weak), Value::Null).await;
    assert_eq!(weak.status(), 412, "a weak tag is no proof");
    let removed = lab.with(Method::DELETE, &first, ("if-match", &now), Value::Null).await;
    assert_eq!(removed.status(), 200);
    let any = lab.with(Method::POST, &last, ("if-match", "*"), json!({ "position": 2 })).await;
    assert_eq!(any.status(), 200);
    lab.posted(&last, json!({ "position": 1 }), 200).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_many_editors_who_saw_the_same_one_changes_it() {
    let lab = Filled::serve(folder("edited-lock")).await;
    for round in 0..5 {
        let tag = lab.tag(LOCK).await;
        let take = async |n: usize| {
            let note = json!({ "note": format!("round {round}, editor {n}") });
            lab.with(Method::PUT, LOCK, ("if-match", &tag), note).await.status().as_u16()
        };
        let taken = futures::future::join_all((0..8).map(take)).await;
        let count = |status| taken.iter().filter(|taken| **taken == status).count();
        assert_eq!((count(200), count(412)), (1, 7), "{taken:?}");
    }
    let free = lab.with(Method::DELETE, LOCK, ("if-match", "\"0\""), Value::Null).await;
    assert_eq!(free.status(), 412);
    lab.posted(SERVING, json!({ "what": "none-such" }), 409).await;
    let tag = lab.tag(LOCK).await;
    let free = lab.with(Method::DELETE, LOCK, ("if-match", &tag), Value::Null).await;
    assert_eq!(free.status(), 204);
    let none = json!({ "what": "none-such" });
    let old = lab.with(Method::POST, SERVING, ("if-match", "\"0\""), none.clone()).await;
    assert_eq!(old.status(), 412);
    let tag = lab.tag(SERVING).await;
    assert_eq!(lab.with(Method::POST, SERVING, ("if-match", &tag), none).await.status(), 404);
    lab.close().await;
}
