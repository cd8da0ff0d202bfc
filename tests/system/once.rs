//! A jog that is sent twice with one `Idempotency-Key` moves once.

use std::time::Duration;

use reqwest::Response;
use serde_json::json;

use super::bench::{LIMIT, Lab, WAITS, http, rig_args, tell};

/// Requests a jog of x with a key.
async fn jog(lab: &Lab, key: &str, to_mm: f64) -> Response {
    let url = format!("{}/api/v1/rig/actions", lab.service.url());
    let body = json!({ "action": "jog", "axis": "x", "to_mm": to_mm, "who": "test" });
    let request = http().post(url).header("idempotency-key", key).json(&body);
    request.send().await.unwrap()
}

/// Waits until x is at rest at a place, in truth.
async fn is_at(lab: &Lab, to_mm: f64) {
    let start = std::time::Instant::now();
    loop {
        let truth = tell(&lab.rig, json!({ "cmd": "status" })).await;
        let x = &truth["axes"][0];
        let off_mm = (x["position"].as_f64().unwrap() - to_mm).abs();
        if off_mm < 0.5 && x["moving"] == false {
            return;
        }
        assert!(start.elapsed() < LIMIT, "{truth:#}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_that_is_sent_twice_with_one_key_moves_once() {
    let lab = Lab::open("once", rig_args("virtual", 20.0), WAITS).await;
    lab.home().await;
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
