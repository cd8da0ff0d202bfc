//! Requests that are carried out once: what is kept of them, and how many.
//! Uses: `store`. Never: HTTP.

use super::{execute, fresh, open};
use crate::{OnceKey, OnceResponse, Store};

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
