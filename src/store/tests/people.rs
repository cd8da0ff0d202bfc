//! Events, the log of actions, keys, the lock.
//! Uses: `store`. Never: HTTP.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::json;

use super::{Folder, execute, fresh, hex_trial, new_run, now, open, time, with_run};
use crate::core::store::Inner;
use crate::journal::{ExitStatus, Journal, Mounting};
use crate::record::TrialRecord;
use crate::state::{StateChange, StoredState};
use crate::{KeyRing, NewAction, Role, RunKind, Store, StoreError};

#[tokio::test]
async fn events_are_numbered_without_gaps() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    assert_eq!(store.last_event_seq().await.unwrap(), 0);
    let mut sent = Vec::new();
    for i in 0..6 {
        let of = (i % 2 == 0).then_some(run);
        sent.push(store.append_event(of, "state", json!({"n": i, "x": 0.1})).await.unwrap());
    }
    assert_eq!(sent.iter().map(|e| e.seq).collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6]);
    assert_eq!(store.events_since(0, 100, None, &[]).await.unwrap(), sent);
    assert_eq!(store.events_since(2, 2, None, &[]).await.unwrap(), sent[2..4]);
    let of_run = store.events_since(1, 100, Some(run), &[]).await.unwrap();
    assert_eq!(of_run.iter().map(|e| e.seq).collect::<Vec<_>>(), [3, 5]);
    assert_eq!(store.last_event_seq().await.unwrap(), 6);
}

#[tokio::test]
async fn events_are_selected_by_kind_before_they_are_counted() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    for (of, kind) in [(Some(run), "state"), (Some(run), "trip"), (None, "trip"), (None, "keys")] {
        store.append_event(of, kind, json!({})).await.unwrap();
    }
    let of = async |run, limit, kinds: &[&str]| -> Vec<i64> {
        let kinds: Vec<String> = kinds.iter().map(|kind| (*kind).to_owned()).collect();
        let found = store.events_since(0, limit, run, &kinds).await.unwrap();
        found.iter().map(|event| event.seq).collect()
    };
    assert_eq!(of(None, 9, &["trip"]).await, [2, 3]);
    assert_eq!(of(None, 1, &["trip", "keys"]).await, [2]);
    assert_eq!(of(None, 9, &["trip", "keys"]).await, [2, 3, 4]);
    assert_eq!(of(None, 9, &["keys", "trip", "keys"]).await, [2, 3, 4], "a kind named twice");
    assert_eq!(of(Some(run), 9, &["trip"]).await, [2]);
    assert!(of(None, 9, &["tri'p", "%"]).await.is_empty());
    // The newest of a selection, however many others came since.
    let before = async |newest, run, kinds: &[&str]| -> i64 {
        let kinds: Vec<String> = kinds.iter().map(|kind| (*kind).to_owned()).collect();
        store.seq_before_newest(newest, run, &kinds).await.unwrap()
    };
    assert_eq!(before(1, None, &["trip"]).await, 2);
    assert_eq!(before(2, None, &["trip"]).await, 1);
    assert_eq!(before(3, None, &["trip"]).await, 0);
    assert_eq!(before(2, None, &["trip", "keys", "trip"]).await, 2);
    assert_eq!(before(3, None, &["trip", "keys", "trip"]).await, 1);
    assert_eq!(before(u64::MAX, None, &["trip", "keys"]).await, 0);
    assert_eq!(before(1, Some(run), &[]).await, 1);
    assert_eq!(before(1, Some(run), &["state"]).await, 0);
    assert_eq!(before(2, None, &[]).await, 2);
}

#[tokio::test]
async fn events_of_earlier_versions_have_the_kinds_of_today() {
    let folder = Folder::new();
    let filled = r#"INSERT INTO events (at, kind, data) VALUES
             ('2026-11-20T18:00:00.000Z', 'not_gone_on', '{"attempt":1,"why":"no answer"}'),
             ('2026-11-20T18:00:01.000Z', 'went_on', '{"attempt":2}'),
             ('2026-11-20T18:00:02.000Z', 'not_begun', '{"why":"a lock"}');"#;
    let store = folder.open_from_before(18, &[filled]).await;
    let events = store.events_since(0, 9, None, &[]).await.unwrap();
    let kinds: Vec<&str> = events.iter().map(|event| event.kind.as_str()).collect();
    assert_eq!(kinds, ["not_resumed", "resumed", "not_begun"]);
    assert_eq!(events[0].data, json!({ "attempt": 1, "why": "no answer" }));
    assert_eq!(events[0].at, time("2026-11-20T18:00:00Z"));
}

#[tokio::test]
async fn an_event_that_is_written_late_says_when_it_happened() {
    let (_folder, store) = fresh().await;
    let at = time("2026-11-20T18:00:00.123456Z");
    let event = store.event(None, "trip", json!({}), at).await.unwrap();
    assert_eq!(event.at, time("2026-11-20T18:00:00.123Z"));
    assert_eq!(store.events_since(0, 9, None, &[]).await.unwrap(), [event]);
}

#[tokio::test]
async fn what_was_said_last_of_the_tips_counts() {
    let (folder, store) = fresh().await;
    assert_eq!(store.last_mounted().await.unwrap(), None);
    let at = time("2026-11-20T18:00:00.5Z");
    let said = |tips, live_cells, who: &str| Mounting { tips, live_cells, who: who.into() };
    store.mounted(&said(4, 4, "Ada"), at).await.unwrap();
    store.mounted(&said(1, 6, "Bob"), at).await.unwrap();
    let refused = store.mounted(&said(7, 7, "Bob"), at).await.unwrap_err();
    assert!(refused.refused, "a repetition fails, too: {refused}");
    assert!(store.mounted(&said(3, 2, "Bob"), at).await.is_err(), "a tip without a cell");
    store.close().await;
    let last = open(&folder.file()).await.last_mounted().await.unwrap();
    assert_eq!(last, Some(said(1, 6, "Bob")));
}

#[tokio::test]
async fn tips_are_not_known_after_a_manual_run() {
    let (_folder, store, run) = with_run(RunKind::RealRandom).await;
    let said = Mounting { tips: 4, live_cells: 4, who: "Ada".into() };
    let (before, during, after) =
        (time("2026-11-20T18:00:00Z"), time("2026-11-20T19:00:00Z"), time("2026-11-20T20:00:00Z"));
    let running = StateChange::to(StoredState::Running);
    store.mounted(&said, before).await.unwrap();
    assert_eq!(store.last_mounted().await.unwrap(), Some(said.clone()));
    store.run_state(run, running, during).await.unwrap();
    assert_eq!(store.last_mounted().await.unwrap(), None, "weights may be on the skin");
    store.end_run(run, ExitStatus::Stopped, "by request", during).await.unwrap();
    assert_eq!(store.last_mounted().await.unwrap(), None);
    store.mounted(&said, after).await.unwrap();
    assert_eq!(store.last_mounted().await.unwrap(), Some(said), "entered again");
}

#[tokio::test]
async fn tips_are_not_known_after_a_manual_run_although_the_clock_was_set_back() {
    let (_folder, store, run) = with_run(RunKind::RealRandom).await;
    let said = Mounting { tips: 4, live_cells: 4, who: "Ada".into() };
    let (early, late) = (time("2026-11-20T18:00:00Z"), time("2026-11-20T20:00:00Z"));
    let mount = async |at| {
        store.mounted(&said, at).await.unwrap();
        store.event(None, "tips", json!({}), at).await.unwrap();
    };
    mount(late).await;
    assert_eq!(store.last_mounted().await.unwrap(), Some(said.clone()));
    store.run_state(run, StateChange::to(StoredState::Running), early).await.unwrap();
    store.event(Some(run), "state", json!({}), early).await.unwrap();
    store.end_run(run, ExitStatus::Success, "every trial", early).await.unwrap();
    assert_eq!(store.last_mounted().await.unwrap(), None);
    mount(time("2026-11-20T20:00:00.001Z")).await;
    assert_eq!(store.last_mounted().await.unwrap(), Some(said));
}

/// The records of the campaign wait for a disk that hangs; all other callers give up after 30 s.
#[tokio::test]
async fn a_disk_that_hangs_is_waited_for_by_the_campaign_alone() {
    let (_folder, store) = fresh().await;
    let hang = || {
        let store = store.clone();
        tokio::spawn(async move {
            let hanging = async |_: &mut sqlx::SqliteConnection| {
                std::thread::sleep(Duration::from_millis(200));
                Ok(())
            };
            store.inner.writer.patient().run("hanging", hanging).await
        })
    };
    let inner = &store.inner;
    let hurried = Store {
        inner: Arc::new(Inner {
            path: inner.path.clone(),
            clock: inner.clock.clone(),
            writer: inner.writer.hurried(Duration::from_millis(20)),
            readers: inner.readers.clone(),
            bulk: inner.bulk.clone(),
            runs: Mutex::default(),
            soundness: Mutex::default(),
            changes: Mutex::default(),
            leaves_open: AtomicBool::default(),
        }),
    };
    let hanging = hang();
    tokio::task::yield_now().await;
    let late = hurried.append_event(None, "state", json!({})).await.unwrap_err();
    assert!(matches!(late, StoreError::Late { .. }), "{late}");
    hanging.await.unwrap().unwrap();
    let hanging = hang();
    tokio::task::yield_now().await;
    let at = time("2026-11-20T18:00:00.5Z");
    hurried.event(None, "trip", json!({}), at).await.unwrap();
    hanging.await.unwrap().unwrap();
    let hanging = hang();
    tokio::task::yield_now().await;
    let mounting = Mounting { tips: 2, live_cells: 2, who: "Ada".into() };
    hurried.mounted(&mounting, at).await.unwrap();
    hanging.await.unwrap().unwrap();
}

#[tokio::test]
async fn actions_are_logged_newest_first() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let action = |name: &str, accepted: bool| NewAction {
        at: now(),
        run: accepted.then_some(run),
        action: name.into(),
        who: "local".into(),
        key_id: None,
        why: Some("tip loose".into()),
        accepted,
        detail: (!accepted).then(|| "run is not paused".into()),
    };
    store.log_action(action("pause", true)).await.unwrap();
    let refused = action("resume", false);
    store.log_action(refused.clone()).await.unwrap();
    // As after a failure with an unknown outcome.
    store.log_action(refused).await.unwrap();
    let all = store.actions(None, 10, None).await.unwrap();
    assert_eq!(all.iter().map(|a| a.action.as_str()).collect::<Vec<_>>(), ["resume", "pause"]);
    assert_eq!((all[0].accepted, all[0].run, all[1].run), (false, None, Some(run)));
    assert_eq!(all[0].detail.as_deref(), Some("run is not paused"));
    assert_eq!(store.actions(Some(run), 10, None).await.unwrap(), all[1..]);
    assert_eq!(store.actions(None, 10, Some(2)).await.unwrap(), all[1..]);
    assert_eq!(store.accepted_on(run, "pause").await.unwrap(), 1);
    assert_eq!(store.accepted_on(run, "resume").await.unwrap(), 0);
}

#[tokio::test]
async fn the_last_operation_of_the_rig_counts_until_a_run_is_started_or_resumed() {
    let (_folder, store) = fresh().await;
    let last = async || store.last_operated(&["home", "jog"], &["start", "resume"]).await.unwrap();
    assert_eq!(last().await, None);
    let [first, second] = [time("2026-11-20T18:00:00Z"), time("2026-11-20T18:01:00Z")];
    let log = async |at, action: &str, accepted| {
        let (action, who) = (action.into(), "local".into());
        let (run, key_id, why, detail) = (None, None, None, None);
        let new = NewAction { at, run, action, who, key_id, why, accepted, detail };
        store.log_action(new).await.unwrap();
    };
    log(first, "home", true).await;
    assert_eq!(last().await, Some(first));
    log(second, "jog", false).await;
    assert_eq!(last().await, Some(second), "a person may be at the rig after a refusal, too");
    for (action, accepted) in [("pause", true), ("resume", false)] {
        log(second, action, accepted).await;
        assert_eq!(last().await, Some(second));
    }
    log(second, "start", true).await;
    assert_eq!(last().await, None);
}

#[tokio::test]
async fn actions_of_two_keys_with_one_name_are_told_apart() {
    let (_folder, store) = fresh().await;
    let ring = KeyRing::load(store.clone()).await.unwrap();
    let at = now();
    let mut ids = Vec::new();
    for n in 0..2 {
        let (row, _) = ring.create("night shift", Role::Operator, [n; 32]).await.unwrap();
        assert!(ring.revoke(row.id).await.unwrap());
        let (run, why, detail) = (None, None, None);
        let (action, who, key_id) = ("tare".into(), row.name, Some(row.id));
        let new = NewAction { at, run, action, who, key_id, why, accepted: true, detail };
        store.log_action(new).await.unwrap();
        ids.insert(0, key_id);
    }
    let logged = store.actions(None, 9, None).await.unwrap();
    assert_eq!(logged.iter().map(|action| action.key_id).collect::<Vec<_>>(), ids);
}

#[tokio::test]
async fn a_key_opens_until_it_is_revoked_and_is_not_in_the_file() {
    let (folder, store) = fresh().await;
    let ring = KeyRing::load(store.clone()).await.unwrap();
    assert!(ring.is_empty());
    let (row, secret) = ring.create("night shift", Role::Operator, [0xAB; 32]).await.unwrap();
    assert_eq!(secret, format!("palpate_{}", "ab".repeat(32)));
    let known = |ring: &KeyRing, text: &str| ring.find(text).map(|k| (k.id, k.name, k.role));
    let expected = Some((row.id, row.name.clone(), row.role));
    assert_eq!(known(&ring, &secret), expected);
    for wrong in ["", "palpate_", &secret[..secret.len() - 1], &secret.to_uppercase()] {
        assert_eq!(known(&ring, wrong), None);
    }
    // As after a restart.
    assert_eq!(known(&KeyRing::load(store.clone()).await.unwrap(), &secret), expected);
    // The same random bytes result in the same key: it is refused.
    ring.create("again", Role::Viewer, [0xAB; 32]).await.unwrap_err();
    for name in ["", " ", "local", "eve (local)", "night shift", "a\u{1b}[m", &"x".repeat(101)] {
        let error = ring.create(name, Role::Viewer, [0xCD; 32]).await.unwrap_err();
        assert!(matches!(error, StoreError::Refused { field: "name", .. }), "{name}: {error}");
    }
    assert!(ring.revoke(row.id).await.unwrap());
    assert!(!ring.revoke(row.id).await.unwrap());
    assert_eq!(known(&ring, &secret), None);
    assert!(KeyRing::load(store.clone()).await.unwrap().is_empty());
    assert!(store.keys().await.unwrap()[0].revoked_at.is_some());
    store.close().await;
    let file = std::fs::read(folder.file()).unwrap();
    let found = file.windows(secret.len()).any(|w| w == secret.as_bytes());
    assert!(!found, "the key's text is in the file");
}

#[tokio::test]
async fn a_keys_use_is_noted_in_the_background_once_a_minute() {
    let (_folder, store) = fresh().await;
    let ring = KeyRing::load(store.clone()).await.unwrap();
    let (_, secret) = ring.create("night shift", Role::Operator, [0xAB; 32]).await.unwrap();
    let key = ring.find(&secret).unwrap();
    ring.note_use(&key);
    let start = std::time::Instant::now();
    let used = loop {
        if let Some(used) = store.keys().await.unwrap()[0].last_used_at {
            break used;
        }
        assert!(start.elapsed().as_secs() < 10, "the use is not stored");
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    };
    // Within one minute nothing is written again, neither by this ring nor after a restart.
    let restarted = KeyRing::load(store.clone()).await.unwrap();
    for ring in [ring, restarted] {
        ring.note_use(&ring.find(&secret).unwrap());
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        assert_eq!(store.keys().await.unwrap()[0].last_used_at, Some(used));
    }
}

#[test]
fn roles_grow() {
    assert!(Role::Viewer < Role::Operator && Role::Operator < Role::Admin);
}

#[tokio::test]
async fn the_lock_has_one_holder() {
    let (_folder, store) = fresh().await;
    assert_eq!(store.lock().await.unwrap(), None);
    let first = store.set_lock("Ada", "changing tips").await.unwrap();
    assert_eq!(store.lock().await.unwrap(), Some(first.clone()));
    let error = store.set_lock("Bob", "mine").await.unwrap_err();
    assert!(matches!(&error, StoreError::LockHeld { holder, .. } if holder == "Ada"), "{error}");
    let again = store.set_lock("Ada", "still changing tips").await.unwrap();
    // Taken again, it is as new: what it holds up depends on when it was taken.
    assert!(again.note == "still changing tips" && again.since > first.since, "{again:?}");
    assert_eq!(store.clear_lock().await.unwrap(), Some(again));
    assert_eq!(store.clear_lock().await.unwrap(), None);
    store.set_lock("Bob", "mine").await.unwrap();
}

#[tokio::test]
async fn a_lock_is_not_earlier_than_what_it_holds_up_although_the_clock_was_set_back() {
    let (_folder, store) = fresh().await;
    let waits = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    let driven = store.create_run(new_run(RunKind::RealHex)).await.unwrap().uid;
    store.set_waiting(waits).await.unwrap();
    let since = "UPDATE runs SET waiting_since = '2099-11-20T18:00:00.000Z' \
                 WHERE waiting_since IS NOT NULL";
    execute(&store, since).await;
    let lock = store.set_lock("Ada", "hands").await.unwrap();
    assert_eq!(lock.since, time("2099-11-20T18:00:00Z"));
    store.clear_waiting(waits).await.unwrap();
    assert!(store.set_lock("Ada", "hands").await.unwrap().since < time("2090-01-01T00:00:00Z"));
    let measured_at = time("2099-11-20T18:00:02.004Z");
    let trial = TrialRecord { measured_at, ..hex_trial(0, 0, &[5.0]) };
    store.trial(driven, &trial).await.unwrap();
    assert_eq!(store.set_lock("Ada", "hands").await.unwrap().since, measured_at);
}
