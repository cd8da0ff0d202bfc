//! A jog that is sent twice with one `Idempotency-Key` moves once; one that comes long after its status (`Status-At`) moves
//! nothing.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use reqwest::Response;
use serde_json::{Value, json};

use super::bench::{LIMIT, Lab, ONE_TIP, WAITS, http, tell, until};

/// Requests a jog of x with a key.
async fn jog(lab: &Lab, key: &str, to_mm: f64) -> Response {
    jog_with(lab, ("idempotency-key", key), to_mm).await
}

/// Requests a jog of x with a header.
async fn jog_with(lab: &Lab, (name, value): (&str, &str), to_mm: f64) -> Response {
    let url = format!("{}/api/v1/rig/actions", lab.service.url());
    let body = json!({ "action": "jog", "axis": "x", "to_mm": to_mm, "who": "test" });
    let request = http().post(url).header(name, value).json(&body);
    request.send().await.unwrap()
}

/// Waits until x is at rest at a place, in truth.
async fn is_at(lab: &Lab, to_mm: f64) {
    let rests = |truth: &Value| {
        let x = &truth["axes"][0];
        let off_mm = (x["position"].as_f64().unwrap() - to_mm).abs();
        off_mm < 0.5 && x["moving"] == false
    };
    let truth = async || tell(&lab.rig, json!({ "cmd": "status" })).await;
    until("x at rest", LIMIT, truth, rests).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_that_is_sent_twice_with_one_key_moves_once() {
    let lab = Lab::homed("once", 20.0, WAITS).await;
    for (key, to_mm) in [("a", 100.0), ("b", 140.0)] {
        assert_eq!(jog(&lab, key, to_mm).await.status(), 202);
        is_at(&lab, to_mm).await;
        lab.until("homed again", |s| s["rig"]["state"] == "homed").await;
    }
    let again = jog(&lab, "a", 100.0).await;
    assert_eq!(again.status(), 202);
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    // Ten process seconds: a jog of 40 mm takes about one.
    tokio::time::sleep(Duration::from_millis(500)).await;
    is_at(&lab, 140.0).await;
    // The same request with a new key moves back.
    assert_eq!(jog(&lab, "c", 100.0).await.status(), 202);
    is_at(&lab, 100.0).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_that_comes_long_after_its_status_moves_nothing() {
    let lab = Lab::homed("late", 20.0, WAITS).await;
    let at = lab.get("/api/v1/status").await["at"].as_str().unwrap().to_owned();
    let before = at.parse::<Timestamp>().unwrap() - SignedDuration::from_secs(11);
    let late = jog_with(&lab, ("status-at", &before.to_string()), 100.0).await;
    assert_eq!(late.status(), 409);
    let words = late.text().await.unwrap();
    assert!(words.contains("nothing was done, nothing moves"), "{words}");
    let logged = lab.get("/api/v1/actions?limit=1").await["items"][0].clone();
    assert_eq!((&logged["action"], &logged["accepted"]), (&json!("jog"), &json!(false)));
    // It would be refused if the other one moved the rig.
    assert_eq!(jog_with(&lab, ("status-at", &at), 140.0).await.status(), 202);
    is_at(&lab, 140.0).await;
    lab.until("homed again", |s| s["rig"]["state"] == "homed").await;
    // A start that comes late begins nothing; an abort is never late.
    let run = lab.queue(ONE_TIP).await;
    let armed = lab.posted(&format!("/api/v1/runs/{run}/arm"), json!({ "who": "test" })).await;
    let start = json!({ "action": "start", "code": armed["code"], "who": "test" });
    let url = format!("{}/api/v1/runs/{run}/actions", lab.service.url());
    let act = async |at: &str, body: &Value| {
        let answer = http().post(&url).header("status-at", at).json(body).send().await.unwrap();
        (answer.status().as_u16(), answer.text().await.unwrap())
    };
    let (status, words) = act(&before.to_string(), &start).await;
    assert!(status == 409 && words.contains("Status-At"), "{status} {words}");
    lab.rests("homed").await;
    assert_eq!(lab.get(&format!("/api/v1/runs/{run}")).await["state"], "queued");
    let at = lab.get("/api/v1/status").await["at"].as_str().unwrap().to_owned();
    let (status, words) = act(&at, &start).await;
    assert_eq!(status, 202, "{words}");
    let (status, words) = act(&before.to_string(), &json!({ "action": "abort" })).await;
    assert_eq!(status, 202, "{words}");
    assert_eq!(lab.ended(&run).await["run"]["exit_status"], "abort");
    lab.close().await;
}
