//! Requests that are carried out once: what is kept of them, and how many.
//! Uses: `store`. Never: HTTP.

use sqlx::{AssertSqlSafe, Row};

use super::{Folder, execute, fresh, open};
use crate::core::once::KEEP_NEWEST;
use crate::{KeyRing, OnceKey, OnceResponse, Role, Store};

fn key(caller: Option<i64>, name: &str) -> OnceKey {
    OnceKey { caller, name: name.into() }
}

/// Whether a request is new.
async fn is_new(store: &Store, key: &OnceKey, most: u32) -> bool {
    store.begin_once(key, "sha", most).await.unwrap().is_none()
}

#[tokio::test]
async fn a_request_begins_once_and_its_response_outlives_the_process() {
    let (folder, store) = fresh().await;
    let (mine, other) = (key(None, "k"), key(Some(1), "k"));
    assert!(is_new(&store, &mine, 9).await && is_new(&store, &other, 9).await);
    let first = store.begin_once(&mine, "another", 9).await.unwrap().unwrap();
    assert_eq!((first.request.as_str(), first.response), ("sha", None));
    let response = OnceResponse {
        status: 201,
        location: Some("/runs/1".into()),
        content_type: None,
        body: Vec::new(),
    };
    store.end_once(&mine, Some(response.clone())).await.unwrap();
    store.end_once(&other, None).await.unwrap();
    store.close().await;
    let store = open(&folder.file()).await;
    let first = store.begin_once(&mine, "sha", 9).await.unwrap().unwrap();
    assert_eq!(first.response, Some(response));
    assert!(is_new(&store, &other, 9).await, "it was removed");
}

#[tokio::test]
async fn the_newest_requests_of_each_caller_are_kept() {
    let (_folder, store) = fresh().await;
    let of = |n: u32| key(None, &n.to_string());
    assert!(is_new(&store, &key(Some(1), "other"), 3).await);
    for n in 0..5 {
        assert!(is_new(&store, &of(n), 3).await);
    }
    for n in [2, 3, 4] {
        assert!(!is_new(&store, &of(n), 3).await, "{n}");
    }
    assert!(!is_new(&store, &key(Some(1), "other"), 3).await);
    assert!(is_new(&store, &of(1), 3).await && is_new(&store, &of(2), 3).await);
}

/// A jog that is sent again after the clock was set must not move twice.
#[tokio::test]
async fn a_request_is_not_forgotten_because_the_clock_jumps() {
    let (_folder, store) = fresh().await;
    let (jog, other) = (key(None, "jog"), key(None, "other"));
    assert!(is_new(&store, &jog, 9).await);
    execute(&store, "UPDATE requests_once SET began_at = '2020-01-01T00:00:00.000Z'").await;
    assert!(is_new(&store, &other, 9).await && !is_new(&store, &jog, 9).await);
}

/// No trial is stored meanwhile, and there are 10,000 of each caller.
#[tokio::test]
async fn the_oldest_request_is_found_without_sorting_all() {
    let (_folder, store) = fresh().await;
    let explained = store.write("explaining a statement", async |connection| {
        let statement = AssertSqlSafe(format!("EXPLAIN QUERY PLAN {KEEP_NEWEST}"));
        let query = sqlx::query(statement).bind(1_i64).bind(3_u32);
        let rows = query.fetch_all(connection).await.unwrap();
        Ok(rows.iter().map(|row| row.get("detail")).collect::<Vec<String>>())
    });
    let steps = explained.await.unwrap();
    let is_bad = |step: &String| step.contains("TEMP B-TREE") || step.starts_with("SCAN");
    assert!(!steps.is_empty() && !steps.iter().any(is_bad), "{steps:?}");
}

#[tokio::test]
async fn requests_of_a_revoked_key_are_removed() {
    let (_folder, store) = fresh().await;
    let ring = KeyRing::load(store.clone()).await.unwrap();
    let (row, _) = ring.create("night shift", Role::Viewer, [7; 32]).await.unwrap();
    let (mine, other) = (key(Some(row.id), "k"), key(None, "k"));
    assert!(is_new(&store, &mine, 9).await && is_new(&store, &other, 9).await);
    assert!(ring.revoke(row.id).await.unwrap());
    assert!(is_new(&store, &mine, 9).await && !is_new(&store, &other, 9).await);
}

#[tokio::test]
async fn requests_of_keys_that_were_revoked_before_are_removed() {
    let folder = Folder::new();
    let filled = "INSERT INTO api_keys (id, name, sha256, role, created_at, revoked_at) VALUES
         (1, 'a', 'a', 'viewer', '2026-11-20T18:00:00.000Z', '2026-11-20T19:00:00.000Z'),
         (2, 'b', 'b', 'viewer', '2026-11-20T18:00:00.000Z', NULL);
         INSERT INTO requests_once (caller, name, request, began_at) VALUES
         (0, 'k', 'sha', '2026-11-20T18:00:00.000Z'), (1, 'k', 'sha', '2026-11-20T18:00:00.000Z'),
         (2, 'k', 'sha', '2026-11-20T18:00:00.000Z')";
    let store = folder.open_from_before(26, &[filled]).await;
    for (caller, is_removed) in [(None, false), (Some(1), true), (Some(2), false)] {
        assert_eq!(is_new(&store, &key(caller, "k"), 9).await, is_removed, "{caller:?}");
    }
}
