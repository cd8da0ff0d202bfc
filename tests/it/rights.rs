//! Every operation x every kind of caller x every state of the operator lock: who gets in, and what
//! the log of actions shows. The expectations follow from the table that the router uses.

use std::time::Duration;

use palpate::api::{Access, Lock, Needs, operations};
use palpate::store::Role;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

use super::datasets::filled::Filled;

/// A caller: its name, its key, and its role.
struct Caller {
    name: &'static str,
    key: Option<String>,
    /// `None`: the key is not valid.
    role: Option<Role>,
}

impl Filled {
    async fn send(&self, caller: &Caller, method: &Method, path: &str, body: &Value) -> Answer {
        let mut request = self.http.request(method.clone(), self.url(path));
        if let Some(key) = &caller.key {
            request = request.bearer_auth(key);
        }
        if !body.is_null() {
            request = request.json(body);
        }
        let answer = request.send().await.unwrap();
        let kind =
            answer.headers().get("content-type").map(|kind| kind.to_str().unwrap().to_owned());
        let status = answer.status();
        // Streams do not end.
        let body = match status.is_success() {
            true => String::new(),
            false => answer.text().await.unwrap(),
        };
        Answer { status, kind, body }
    }
}

struct Answer {
    status: StatusCode,
    kind: Option<String>,
    body: String,
}

async fn callers(lab: &Filled, admin: &Caller) -> Vec<Caller> {
    let mut all = Vec::new();
    for (name, role, word) in [
        ("viewer", Some(Role::Viewer), "viewer"),
        ("operator", Some(Role::Operator), "operator"),
        ("admin", Some(Role::Admin), "admin"),
        ("revoked", None, "admin"),
    ] {
        let (id, key) = lab.key(name, word).await;
        if role.is_none() {
            let path = format!("/api/v1/keys/{id}");
            let answer = lab.send(admin, &Method::DELETE, &path, &Value::Null).await;
            assert_eq!(answer.status, 204);
        }
        all.push(Caller { name, key: Some(key), role });
    }
    all.push(Caller { name: "a wrong key", key: Some("palpate_00".into()), role: None });
    all.push(Caller { name: "no key", key: None, role: Some(Role::Operator) });
    all
}

/// An address of the operation: nothing has the names that stand for its parameters.
fn address(path: &str) -> String {
    let mut parts: Vec<&str> = path.split('/').collect();
    for part in parts.iter_mut().filter(|part| part.starts_with('{')) {
        *part = "999999";
    }
    parts.join("/")
}

/// What the table states of a request: the status that refuses it, or none.
fn refusal(needs: &Needs, caller: &Caller, locked: bool) -> Option<u16> {
    let Some(role) = caller.role else {
        return (needs.access != Access::Open).then_some(401);
    };
    match needs.access {
        Access::From(least) if role < least => Some(403),
        _ if locked && needs.lock == Lock::Refuses => Some(409),
        _ => None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_operation_admits_and_logs_what_the_table_says() {
    let lab = Filled::open("rights").await;
    let local = Caller { name: "setting up", key: None, role: Some(Role::Admin) };
    let callers = callers(&lab, &local).await;
    let (_, other) = lab.key("eve", "operator").await;
    let other = Caller { name: "eve", key: Some(other), role: None };
    // As it is started by default.
    let lab = Filled::serve_with(lab.end().await, false).await;
    let table = operations();
    assert!(table.len() > 60, "{}", table.len());
    let mut asked = 0;
    for locked in [false, true] {
        // A lock changes nothing for a key that is not valid.
        for caller in callers.iter().filter(|caller| caller.role.is_some() || !locked) {
            for (method, path, needs) in &table {
                // The lock and the stop are what this test sets up.
                if path == "/api/v1/lock" && *method != Method::GET {
                    continue;
                }
                if locked {
                    let body = json!({ "note": "hands in the rig" });
                    let taken = lab.send(&other, &Method::PUT, "/api/v1/lock", &body).await;
                    assert_eq!(taken.status, 200, "{}", taken.body);
                }
                let before = newest_action(&lab).await;
                let what = format!("{method} {path} as {}, locked: {locked}", caller.name);
                let answer = lab.send(caller, method, &address(path), &Value::Null).await;
                asked += 1;
                let status = answer.status.as_u16();
                match refusal(needs, caller, locked) {
                    Some(refusal) => assert_eq!(status, refusal, "{what}: {}", answer.body),
                    None => {
                        let let_in = ![401, 403, 405, 500].contains(&status)
                            && !answer.body.contains("holds the operator lock");
                        assert!(let_in, "{what}: {status} {}", answer.body);
                    }
                }
                if answer.status.is_client_error() || answer.status.is_server_error() {
                    let kind = answer.kind.as_deref();
                    assert_eq!(kind, Some("application/problem+json"), "{what}: {status}");
                }
                // The stop is logged after it is answered.
                if needs.access == Access::Stop {
                    while status == 200 && newest_action(&lab).await == before {
                        tokio::time::sleep(Duration::from_millis(10)).await;
                    }
                } else {
                    let logged = newest_action(&lab).await != before;
                    // A viewer must not be able to fill the log with bodies that mean nothing.
                    let noise =
                        caller.role == Some(Role::Viewer) && [400, 415, 422].contains(&status);
                    let expected =
                        needs.action.is_some() && ![401, 403].contains(&status) && !noise;
                    assert_eq!(logged, expected, "{what}: {status}");
                }
            }
        }
        let admin = &callers[2];
        let answer = lab.send(admin, &Method::DELETE, "/api/v1/lock", &Value::Null).await;
        assert_eq!(answer.status, 204);
    }
    eprintln!("{asked} requests, {} operations", table.len());
    lab.close().await;
}

async fn newest_action(lab: &Filled) -> i64 {
    let actions = lab.get("/api/v1/actions?limit=1").await;
    actions["items"][0]["id"].as_i64().unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lock_without_a_key_holds_for_everybody_and_nobody_signs_as_another() {
    let lab = Filled::open("rights-lock").await;
    let (_, alice) = lab.key("alice", "operator").await;
    let alice = Caller { name: "alice", key: Some(alice), role: None };
    let local = Caller { name: "no key", key: None, role: None };
    let put = |holder: &str| json!({ "holder": holder, "note": "tips are being changed" });
    let tare = |who: &str| json!({ "action": "tare", "who": who });
    let (lock, rig) = ("/api/v1/lock", "/api/v1/rig/actions");
    assert_eq!(lab.send(&local, &Method::PUT, lock, &put("alice")).await.status, 200);
    let held = lab.get(lock).await;
    assert_eq!((&held["holder"], &held["keyless"]), (&json!("alice (local)"), &json!(true)));
    assert_eq!(lab.get("/api/v1/status").await["lock"], held);
    for (caller, who) in [(&local, "alice"), (&local, "alice (local)"), (&alice, "alice (local)")] {
        let answer = lab.send(caller, &Method::POST, rig, &tare(who)).await;
        assert_eq!(answer.status, 409, "{}", answer.body);
        assert!(answer.body.contains("alice (local) holds the operator lock"), "{}", answer.body);
    }
    assert_eq!(lab.send(&alice, &Method::DELETE, lock, &Value::Null).await.status, 403);
    assert_eq!(lab.send(&local, &Method::DELETE, lock, &Value::Null).await.status, 204);
    // The rig is not connected: the action is refused by its state, and signed.
    let answer = lab.send(&local, &Method::POST, rig, &tare("alice")).await;
    assert!(!answer.body.contains("operator lock"), "{}", answer.body);
    assert_eq!(lab.get("/api/v1/actions?limit=1").await["items"][0]["who"], "alice (local)");
    // Too long a note costs nothing: it is neither stored nor repeated.
    let long = json!({ "note": "x".repeat(60_000) });
    let answer = lab.send(&local, &Method::PUT, lock, &long).await;
    assert_eq!(answer.status, 422);
    assert!(answer.body.len() < 500, "{}", answer.body.len());
    let why = lab.get("/api/v1/actions?limit=1").await["items"][0]["why"].clone();
    assert_eq!(why.as_str().unwrap().len(), 500);
    lab.close().await;
}
