//! What a person at the rig may rely on: nothing moves that was not asked for since.

use std::sync::Arc;
use std::time::Duration;

use palpate::campaign::bench::interlock::TripKind;
use palpate::campaign::bench::rig_state::RigState;
use palpate::campaign::shown::command::{Refusal, Request};
use palpate::campaign::shown::placement::Confirmation;
use palpate::campaign::shown::safe_end::Tips;
use palpate::campaign::shown::status::{Done, Motion, Phase, Status};
use palpate::state::{PausedWhy, StoredState};
use serde_json::json;

use super::harness::{Harness, experiment};
use crate::bench::rig_args;

/// A homed rig, faster than those whose forces are compared: here only what follows what counts.
async fn homed() -> Harness {
    Harness::homed_on(&rig_args("virtual", 20.0)).await
}

fn confirm() -> Request {
    let confirmation = Confirmation::of("ada".into());
    Request::Confirm { done: Done { tips: Some(2), ..Done::default() }, confirmation }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_confirmed_tip_change_moves_only_a_rig_that_was_homed_after_a_stop() {
    let harness = homed().await;
    harness.start_unmounted(2).await;
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
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_automatic_resume_waits_for_the_release_of_a_lock_that_was_taken_after_the_trip() {
    let harness = tripped_by_its_wires().await;
    harness.journal.taken().locked_at = Some(jiff::Timestamp::now());
    stays_for(&harness, "ada").await;
    assert_eq!(harness.handle.status().rig.state, RigState::Tripped);
    harness.journal.taken().locked_at = None;
    harness.stores_another().await;
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_that_lost_its_zero_is_not_moved() {
    let harness = homed().await;
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

#[tokio::test(flavor = "multi_thread")]
async fn the_limits_of_a_run_hold_after_its_wires_were_opened_again() {
    let harness = homed().await;
    harness.run(2, "[limits]\nforce_n = 15.0\n").await;
    harness
        .until("a touch-off", |s| s.run.as_ref().is_some_and(|r| r.phase == Phase::TouchOff))
        .await;
    harness.tripped_by_its_wires(60.0).await;
    // The module replies again.
    tokio::time::sleep(Duration::from_secs(4)).await;
    harness.ask(Request::Disconnect).await.unwrap();
    let rig = harness.handle.status().rig;
    assert!(rig.pose.is_none() && rig.forces_n.is_empty() && rig.wires.is_empty(), "{rig:#?}");
    harness.ask(Request::Connect).await.unwrap();
    harness.reset_and_home().await;
    harness.ask(Request::Resume).await.unwrap();
    harness.tripped_by(TripKind::Force, "over its limit 15 N").await;
    harness.close().await;
}

/// A run that resumes automatically a second after a trip that passes, tripped by its wires, which fail for two seconds.
async fn tripped_by_its_wires() -> Harness {
    let harness = homed().await;
    harness.run_that_resumes("").await;
    harness.tripped_by_its_wires(40.0).await;
    harness
}

/// Nothing is stored in three seconds more.
async fn stays(harness: &Harness) {
    let stored = harness.taken_trials();
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(harness.taken_trials(), stored);
}

/// The run waits, for what these words name.
async fn stays_for(harness: &Harness, words: &str) {
    let waits = |s: &Status| {
        let run = s.run.as_ref();
        run.and_then(|r| r.waiting_for.as_ref()).is_some_and(|found| found.contains(words))
    };
    harness.until(words, waits).await;
    stays(harness).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pause_holds_a_run_that_was_to_resume_automatically() {
    let harness = tripped_by_its_wires().await;
    harness.ask(Request::PauseAtCheckpoint).await.unwrap();
    stays(&harness).await;
    let status = harness.handle.status();
    assert_eq!(status.run.unwrap().paused_why, Some(PausedWhy::Operator));
    // The pause may have come while the rig was reset.
    match status.rig.state {
        RigState::Disarmed => {}
        RigState::Tripped => harness.ask(Request::Reset).await.unwrap(),
        other => panic!("the rig is {other:?}"),
    }
    harness.home().await;
    harness.ask(Request::Resume).await.unwrap();
    harness.stores_another().await;
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_that_was_without_power_waits_for_a_person() {
    let harness = tripped_by_its_wires().await;
    harness.fault("power_loss", "x", json!({ "count": 1 })).await;
    stays_for(&harness, "x is not homed any more").await;
    assert_eq!(harness.handle.status().rig.state, RigState::Tripped);
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lock_that_is_taken_while_the_rig_homes_automatically_holds_the_run() {
    let harness = tripped_by_its_wires().await;
    harness.until("an automatic homing", |s| s.rig.motion == Some(Motion::Homing)).await;
    harness.journal.taken().locked_at = Some(jiff::Timestamp::now());
    harness.until("the end of the homing", |s| s.rig.motion.is_none()).await;
    stays_for(&harness, "ada").await;
    let status = harness.handle.status();
    let run = status.run.unwrap();
    assert_eq!((run.state, run.paused_why), (StoredState::Paused, Some(PausedWhy::Trip)));
    // A homing that has just ended needs no end.
    assert!(matches!(status.rig.state, RigState::Disarmed | RigState::Homed), "{:?}", status.rig);
    harness.journal.taken().locked_at = None;
    harness.stores_another().await;
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_who_operates_the_rig_while_it_homes_automatically_holds_the_run() {
    let harness = tripped_by_its_wires().await;
    harness.until("an automatic homing", |s| s.rig.motion == Some(Motion::Homing)).await;
    let refused = harness.ask(Request::Tare).await.unwrap_err();
    assert!(refused.to_string().contains("tare is not possible"), "{refused}");
    stays_for(&harness, "a person has operated the rig").await;
    let run = harness.handle.status().run.unwrap();
    assert_eq!((run.state, run.paused_why), (StoredState::Paused, Some(PausedWhy::Trip)));
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn hands_are_not_called_to_tips_that_are_not_raised() {
    let harness = homed().await;
    harness.ask(Request::Jog { axis: "z".into(), to_mm: 40.0 }).await.unwrap();
    let is_down = |s: &Status| s.rig.pose.is_some_and(|pose| (pose.z_mm - 40.0).abs() < 0.1);
    harness.until("z at 40 mm", is_down).await;
    // It reports no alarm: the raise to the top for the tip change does not arrive.
    harness.fault("stuck_axis", "z", json!({ "for_s": 6000.0 })).await;
    harness.start_unmounted(2).await;
    let status = harness.tripped().await;
    assert!(matches!(status.rig.safe_end.unwrap().tips, Tips::NotRaised(_)));
    harness.run_is(StoredState::Panicked).await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    assert_eq!(harness.handle.status().run.unwrap().wanted, None);
    assert!(!harness.journal.taken().order.iter().any(|taken| taken == "wanted"));
    // Once a person has raised them, they are called for.
    harness.tell(json!({ "cmd": "mend" })).await;
    harness.reset_and_home().await;
    harness.ask(Request::Resume).await.unwrap();
    harness.until("a tip change", |s| s.run.as_ref().is_some_and(|r| r.wanted.is_some())).await;
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wires_have_one_owner() {
    let harness = homed().await;
    let wires = harness.handle.wires();
    assert!(wires.take().is_none(), "the rig is connected");
    harness.ask(Request::Disconnect).await.unwrap();
    let check = wires.take().expect("the rig is disconnected");
    let refused = harness.ask(Request::Connect).await.unwrap_err().to_string();
    assert!(refused.contains("a check of the rig uses its wires"), "{refused}");
    assert_eq!(harness.handle.status().rig.state, RigState::Disconnected);
    drop(check);
    harness.ask(Request::Connect).await.unwrap();
    assert!(wires.take().is_none());
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_during_a_jog_is_told_that_the_rig_is_busy() {
    let harness = Harness::homed().await;
    // A quarter of a second of the wall.
    harness.ask(Request::Jog { axis: "x".into(), to_mm: 550.0 }).await.unwrap();
    let job = harness.job(&experiment(1, ""), |_| {});
    let refused = harness.ask(Request::Start(Arc::new(job))).await.unwrap_err();
    assert!(matches!(refused, Refusal::Busy(_)), "{refused:?}");
    harness.close().await;
}
