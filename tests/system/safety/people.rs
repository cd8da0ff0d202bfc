//! What a person at the rig may rely on: nothing moves that was not asked for since.

use std::time::Duration;

use palpate::campaign::bench::interlock::TripKind;
use palpate::campaign::bench::rig_state::RigState;
use palpate::campaign::shown::command::Request;
use palpate::campaign::shown::placement::Confirmation;
use palpate::campaign::shown::status::{Done, Status};
use palpate::state::StoredState;
use serde_json::json;

use super::harness::{Harness, experiment};

fn confirm() -> Request {
    let confirmation = Confirmation::of("ada".into());
    Request::Confirm { done: Done { tips: Some(2), ..Done::default() }, confirmation }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_confirmed_tip_change_moves_only_a_rig_that_was_homed_after_a_stop() {
    let harness = Harness::homed().await;
    harness.start(harness.job(&experiment(2, ""), |_| {})).await;
    let waits = |s: &Status| s.run.as_ref().is_some_and(|r| r.wanted.is_some());
    harness.until("a tip change", waits).await;
    harness.handle.estop("hands at the tips");
    harness.until("a trip", |s| s.rig.state == RigState::Tripped).await;
    harness.tell(json!({ "cmd": "mount", "tips": 2, "powered": 2 })).await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    let refused = harness.ask(confirm()).await.unwrap_err().to_string();
    assert!(refused.contains("tripped"), "{refused}");
    harness.until("acknowledged", |s| s.rig.estop_acknowledged_ms.is_some()).await;
    harness.ask(Request::Reset).await.unwrap();
    let refused = harness.ask(confirm()).await.unwrap_err().to_string();
    assert!(refused.contains("home"), "{refused}");
    assert_eq!(harness.handle.status().run.unwrap().state, StoredState::Paused);
    harness.home().await;
    harness.ask(confirm()).await.unwrap();
    harness.stored(1).await;
    harness.ask(Request::Abort).await.unwrap();
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_automatic_resume_waits_for_the_release_of_a_lock_that_was_taken_after_the_trip() {
    let harness = Harness::homed().await;
    harness.mount(2, 2).await;
    let definition = experiment(2, "[policy]\nauto_resume_after_s = 1.0\n");
    harness.start(harness.job(&definition, |job| job.auto_resume = true)).await;
    harness.stored(1).await;
    harness.fault("no_reply", "cells", json!({ "for_s": 16.0 })).await;
    let trip = harness.tripped().await.rig.trip.unwrap();
    assert_eq!(trip.kind, TripKind::Wire, "{trip:?}");
    harness.journal.taken().locked_at = Some(jiff::Timestamp::now());
    let locked = |s: &Status| {
        let run = s.run.as_ref();
        run.and_then(|r| r.waiting_for.as_ref()).is_some_and(|words| words.contains("ada"))
    };
    harness.until("the lock is shown", locked).await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(harness.handle.status().rig.state, RigState::Tripped);
    let stored = harness.journal.taken().trials.len() as u64;
    harness.journal.taken().locked_at = None;
    harness.stored(stored + 1).await;
    harness.ask(Request::Abort).await.unwrap();
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_that_lost_its_zero_is_not_moved() {
    let harness = Harness::homed().await;
    harness.fault("power_loss", "x", json!({ "count": 1 })).await;
    // The drive is off for a moment, then replies again.
    tokio::time::sleep(Duration::from_millis(500)).await;
    let before = harness.truth().await["axes"][0]["position"].as_f64().unwrap();
    let _ = harness.ask(Request::Jog { axis: "x".into(), to_mm: 200.0 }).await;
    let trip = harness.tripped().await.rig.trip.unwrap();
    let after = harness.truth().await["axes"][0]["position"].as_f64().unwrap();
    assert!((before - after).abs() < 1e-6, "x moved from {before} to {after}: {trip:?}");
    assert!(trip.detail.contains("not homed"), "{trip:?}");
    harness.close().await;
}
