//! Requests that are carried out once: what is kept of them, and for how long.
//! Uses: `store`. Never: HTTP.

use std::time::Duration;

use super::{fresh, open};
use crate::{OnceKey, OnceResponse, Store};

const DAY: Duration = Duration::from_secs(86_400);

fn key(caller: Option<i64>, name: &str) -> OnceKey {
    OnceKey { caller, name: name.into() }
}

/// Whether a request is new.
async fn is_new(store: &Store, key: &OnceKey, kept: Duration, most: u32) -> bool {
    store.begin_once(key, "sha", kept, most).await.unwrap().is_none()
}

#[tokio::test]
async fn a_request_begins_once_and_its_response_outlives_the_process() {
    let (folder, store) = fresh().await;
    let (mine, other) = (key(None, "k"), key(Some(1), "k"));
    assert!(is_new(&store, &mine, DAY, 9).await && is_new(&store, &other, DAY, 9).await);
    let first = store.begin_once(&mine, "another", DAY, 9).await.unwrap().unwrap();
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
    let first = store.begin_once(&mine, "sha", DAY, 9).await.unwrap().unwrap();
    assert_eq!(first.response, Some(response));
    assert!(is_new(&store, &other, DAY, 9).await, "it was removed");
}

#[tokio::test]
async fn old_requests_are_removed_and_the_newest_of_each_caller_are_kept() {
    let (_folder, store) = fresh().await;
    let of = |n: u32| key(None, &n.to_string());
    assert!(is_new(&store, &key(Some(1), "other"), DAY, 3).await);
    for n in 0..5 {
        assert!(is_new(&store, &of(n), DAY, 3).await);
    }
    for n in [2, 3, 4] {
        assert!(!is_new(&store, &of(n), DAY, 3).await, "{n}");
    }
    assert!(!is_new(&store, &key(Some(1), "other"), DAY, 3).await);
    assert!(is_new(&store, &of(1), DAY, 3).await && is_new(&store, &of(2), DAY, 3).await);
    tokio::time::sleep(Duration::from_millis(20)).await;
    assert!(is_new(&store, &key(Some(1), "other"), Duration::from_millis(10), 3).await);
}
