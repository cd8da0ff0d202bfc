//! Keys and lock without a running service, what needs no rig next to the service that has it, and what only reads next
//! to a command that uses the folder.

use std::path::Path;
use std::process::Output;

use palpate::api::{LockFile, Offline};
use palpate::rig::setup::RigSetup;
use palpate::store::Role;
use serde_json::{Value, json};

use super::datasets::filled::{Filled, copy_filled, folder, rig, store};
use crate::support::{answered, command, finished, not_done, succeeded};

/// Runs a command on a data folder to its end.
async fn on(data: &Path, arguments: &[&str]) -> Output {
    let data = data.to_str().unwrap();
    finished(command(&[arguments, &["--data", data]].concat())).await
}

/// Number of items that a command on a data folder lists.
async fn listed(data: &Path, arguments: &[&str]) -> usize {
    let output = on(data, &[arguments, &["--json"]].concat()).await;
    let list: Value = serde_json::from_str(&succeeded(&output)).unwrap();
    list["items"].as_array().unwrap().len()
}

#[tokio::test]
async fn a_command_that_only_reads_works_while_another_one_uses_the_folder() {
    let data = folder("offline-beside");
    copy_filled(&data).await;
    // As `palpate evaluate` starts one: it has no address in the folder.
    let first = Filled::serve_as(data.clone(), |options| options.desk = true).await;
    assert_eq!(listed(&data, &["runs"]).await, 2);
    assert_eq!(listed(&data, &["trials", "1", "--limit", "3"]).await, 3);
    succeeded(&on(&data, &["show", "1"]).await);
    // The first command stores more.
    let definition = include_str!("../../experiments/quickstart.toml");
    let run = json!({ "file": "q.toml", "definition": definition, "who": "ada" });
    first.posted("/api/v1/queue", run, 201).await;
    assert_eq!(listed(&data, &["runs"]).await, 3);
    let holder = format!("in use by process {}", std::process::id());
    not_done(&on(&data, &["dataset", "make", "run-1"]).await, 1, &holder);
    let serve = ["serve", "--desk", "--bind", "127.0.0.1:0"];
    not_done(&on(&data, &serve).await, 1, &holder);
    first.close().await;
}

#[tokio::test]
async fn a_service_without_a_rig_works_next_to_the_one_that_has_it() {
    let text = rig();
    let lab = folder("offline-lab");
    let lab = Filled::serve_as(lab, |options| options.rig_text.clone_from(&text)).await;
    let setup = RigSetup::from_toml("rig.toml", &text).unwrap();
    let refused = LockFile::of_rig(&setup).unwrap_err().to_string();
    assert!(refused.contains("in use by process"), "{refused}");
    // As a command on data starts one.
    let desk = Filled::serve_as(folder("offline-desk"), |options| {
        options.rig_text.clone_from(&text);
        options.desk = true;
    });
    let desk = desk.await;
    assert_eq!(desk.get("/api/v1/runs").await["items"], json!([]));
    desk.close().await;
    lab.close().await;
    LockFile::of_rig(&setup).unwrap();
}

#[tokio::test]
async fn keys_and_lock_need_neither_a_service_nor_a_rig() {
    let data = folder("offline");
    let offline = Offline::open(&data).await.unwrap();
    let made = offline.create_key("ada", Role::Admin).await.unwrap();
    offline.create_key("ada", Role::Viewer).await.unwrap_err();
    offline.take_lock("ben", "hands in the rig").await.unwrap();
    assert_eq!(offline.lock().await.unwrap().unwrap().holder, "ben (local)");
    offline.clear_lock().await.unwrap();
    assert!(offline.revoke_key(made.key.id).await.unwrap());
    assert!(!offline.revoke_key(made.key.id).await.unwrap());
    assert_eq!(offline.keys().await.unwrap().len(), 1);
    offline.close().await;
    let store = store(&data).await;
    let mut log = store.actions(None, 10, None).await.unwrap();
    log.reverse();
    let shown: Vec<_> = log.iter().map(|a| (&*a.action, &*a.who, a.accepted)).collect();
    let local = |action, accepted| (action, "local", accepted);
    let all = [
        local("key", true),
        local("key", false),
        ("lock", "ben (local)", true),
        local("unlock", true),
        local("revoke_key", true),
        local("revoke_key", false),
    ];
    assert_eq!(shown, all);
    store.close().await;
    let lab = Filled::serve(data.clone()).await;
    let refused = Offline::open(&data).await.err().unwrap().to_string();
    assert!(refused.contains("in use by process"), "{refused}");
    // It has a rig and no address in the folder, as `serve` before it listens.
    not_done(&on(&data, &["runs"]).await, 1, "in use by process");
    let note = json!({ "note": "gone\u{1b}[2J" });
    let (status, problem) = answered(lab.http.put(lab.url("/api/v1/lock")).json(&note)).await;
    let detail = "request: note = 8 characters: must have no control characters";
    assert_eq!((status, &problem["detail"]), (422, &json!(detail)));
    lab.close().await;
}
