//! A service with the addresses of a queue, and a script in place of `palpate-worker`: what it answers, and that what
//! it gathers ends with it.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use reqwest::Method;
use rustix::process::Signal;
use serde_json::{Value, json};

use crate::support::{Folder, PALPATE, answered, eventually, http, is_refused, served, signal};

/// Longest wait for anything.
const LIMIT: Duration = Duration::from_secs(60);
/// Answers `status`; `fetch` lasts, and leaves the id of its process in FILE; everything else is invalid.
const SCRIPT: &str = r#"#!/bin/sh
case "$1" in
status) echo '{"workers": [], "orders": []}' ;;
fetch) echo $$ > FILE.part; mv FILE.part FILE; exec sleep 600 ;;
*) echo 'error: order ab: not in the store' >&2; exit 2 ;;
esac
"#;

#[tokio::test]
async fn a_service_submits_cancels_and_gathers_and_its_gather_ends_with_it() {
    let folder = Folder::new("workers");
    let (data, script, process) =
        (folder.join("data"), folder.join("worker"), folder.join("process"));
    fs::write(&script, SCRIPT.replace("FILE", process.to_str().unwrap())).unwrap();
    fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
    let order = data.join("cluster").join("bulk");
    fs::create_dir_all(&order).unwrap();
    let text = json!({ "id": "ab".repeat(32), "kind": "sim-random" }).to_string();
    fs::write(order.join("order.json"), text).unwrap();
    let mut serve = Command::new(PALPATE);
    serve.args(["serve", "--desk", "--twin-workers", "0", "--bind", "127.0.0.1:0", "--data"]);
    serve.arg(&data).env("PALPATE_WORKER", &script).env("PALPATE_STORE", folder.join("store"));
    serve.env("PALPATE_QUEUE", "postgres://owner:hush@localhost/queue");
    let (mut service, url) = served(&mut serve);
    let client = http();
    let ask = async |method: Method, path: &str| {
        answered(client.request(method, format!("{url}/api/v1/workers{path}"))).await
    };

    let (status, found) = ask(Method::GET, "").await;
    assert_eq!((status, &found["configured"]), (200, &json!(true)), "{found}");
    assert_eq!((&found["unsubmitted"], &found["gather"]), (&json!(["bulk"]), &Value::Null));
    for (method, path, expected, words) in [
        (Method::POST, "/folders/bulk", 409, "order ab: not in the store"),
        (Method::POST, "/folders/none", 404, "cluster/none"),
        (Method::POST, "/folders/none/gather", 404, "cluster/none"),
        (Method::DELETE, "/orders/abababab", 409, "order ab: not in the store"),
        (Method::DELETE, "/orders/none", 404, "must be an id"),
    ] {
        is_refused(ask(method, path).await, expected, words);
    }

    let (status, begun) = ask(Method::POST, "/folders/bulk/gather").await;
    let expected = json!({
        "folder": "bulk", "into": "sim-random/bulk", "state": "running", "error": null
    });
    assert_eq!((status, &begun), (202, &expected));
    is_refused(ask(Method::POST, "/folders/bulk/gather").await, 409, "bulk is being gathered");
    let (_, found) = ask(Method::GET, "").await;
    assert_eq!(found["gather"], expected);
    let fetching = async || fs::read_to_string(&process).ok();
    let fetching = eventually("the script fetches", LIMIT, fetching).await;
    let fetching = Path::new("/proc").join(fetching.trim());
    assert!(fetching.exists());
    signal(&service.0, Signal::TERM);
    let ended = async || service.0.try_wait().unwrap();
    let ended = eventually("the service ends", LIMIT, ended).await;
    assert!(ended.success(), "{ended}");
    assert!(!fetching.exists(), "what it gathered continues");
}
