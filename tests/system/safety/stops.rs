//! What a person, or the system, stops.

use std::time::{Duration, Instant};

use palpate::campaign::bench::interlock::TripKind;
use palpate::campaign::bench::rig_state::RigState;
use palpate::campaign::shown::command::Request;
use palpate::campaign::shown::safe_end::Tips;
use palpate::campaign::shown::status::Status;
use serde_json::{Value, json};

use super::harness::{Harness, no_axis_moves};

fn x(truth: &Value) -> (f64, bool) {
    (truth["axes"][0]["position"].as_f64().unwrap(), truth["axes"][0]["moving"] == true)
}

async fn jog_x(harness: &Harness) -> f64 {
    let (from, _) = x(&harness.truth().await);
    let to_mm = if from > 280.0 { 10.0 } else { 550.0 };
    harness.ask(Request::Jog { axis: "x".into(), to_mm }).await.unwrap();
    while !x(&harness.truth().await).1 {}
    to_mm
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_told_to_end_stops_a_jog_a_homing_and_a_press() {
    let harness = Harness::homed().await;
    let to_mm = jog_x(&harness).await;
    harness.ask(Request::Shutdown).await.unwrap();
    harness.until("a safe end", |s| s.rig.safe_end.is_some()).await;
    let truth = harness.truth().await;
    assert!(!x(&truth).1 && (x(&truth).0 - to_mm).abs() > 1.0, "{truth:#}");
    harness.close().await;

    // Far from its zero: homing takes longer than a second.
    let harness = Harness::homed().await;
    let to_mm = jog_x(&harness).await;
    let arrived = |s: &Status| s.rig.pose.is_some_and(|pose| (pose.x_mm - to_mm).abs() < 0.1);
    harness.until("the end of the jog", arrived).await;
    harness.ask(Request::Home).await.unwrap();
    assert_eq!(harness.handle.status().rig.state, RigState::Disarmed, "homing is not homed");
    harness.ask(Request::Shutdown).await.unwrap();
    harness.until("a safe end", |s| s.rig.safe_end.is_some()).await;
    let truth = harness.truth().await;
    assert!(x(&truth).0 > 1.0, "homing had ended before: {truth:#}");
    no_axis_moves(&truth);
    harness.close().await;

    let harness = Harness::pressing(1).await;
    harness.ask(Request::Shutdown).await.unwrap();
    harness.until("raised", |s| s.rig.safe_end.is_some()).await;
    harness.is_safe().await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_e_stop_that_finds_no_wire_is_sent_the_moment_the_wire_is_back() {
    let harness = Harness::homed().await;
    let to_mm = jog_x(&harness).await;
    let wall_s = 1.5;
    let for_s = wall_s * super::harness::SPEED;
    harness.fault("disconnect", "stage", json!({ "for_s": for_s })).await;
    let pressed = Instant::now();
    harness.handle.estop("test");
    let unacknowledged = |s: &Status| {
        s.rig.estop_stops.iter().any(|stop| stop.acknowledged_ms.is_none() && stop.error.is_some())
    };
    let status = harness.until("not acknowledged", unacknowledged).await;
    assert_eq!(status.rig.estop_acknowledged_ms, None);
    assert!(harness.ask(Request::Reset).await.is_err(), "no reset before every axis has stopped");
    let status = harness.until("acknowledged", |s| s.rig.estop_acknowledged_ms.is_some()).await;
    assert_eq!(status.rig.estop_stops.len(), 4);
    assert!(pressed.elapsed() > Duration::from_secs_f64(0.9 * wall_s));
    let truth = harness.truth().await;
    assert!(truth["stops"].as_u64().unwrap() >= 4, "{truth:#}");
    assert!(!x(&truth).1, "x stands, wherever it was sent ({to_mm}): {truth:#}");
    harness.reset_and_home().await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_that_does_not_reply_to_an_e_stop_is_named_and_requests_are_answered_meanwhile() {
    let harness = Harness::homed().await;
    let for_s = 8.0 * super::harness::SPEED;
    harness.fault("no_reply", "x", json!({ "for_s": for_s })).await;
    let pressed = Instant::now();
    harness.handle.estop("test");
    let is_named =
        |s: &Status| s.rig.estop_stops.iter().any(|stop| stop.axis == "x" && stop.error.is_some());
    harness.until("x is named", is_named).await;
    let refused = harness.ask(Request::Reset).await.unwrap_err().to_string();
    assert!(refused.contains("x has not acknowledged its stop"), "{refused}");
    assert!(pressed.elapsed() < Duration::from_secs(7), "{:?}", pressed.elapsed());
    harness.every_axis_stands().await;
    harness.reset_and_home().await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_e_stop_while_the_wires_are_opened_reaches_every_axis_and_ends_the_connection() {
    let harness = Harness::homed().await;
    harness.ask(Request::Disconnect).await.unwrap();
    let before = harness.truth().await["stops"].as_u64().unwrap();
    let mut connecting = Box::pin(harness.ask(Request::Connect));
    // The request is in the queue, wherever the campaign is with it when the stop is pressed.
    assert!(futures::poll!(&mut connecting).is_pending());
    harness.handle.estop("test");
    let refused = connecting.await.unwrap_err().to_string();
    assert!(refused.contains("the stop was pressed while the wires were opened"), "{refused}");
    assert_eq!(harness.handle.status().rig.state, RigState::Tripped);
    harness.every_axis_stands().await;
    assert!(harness.truth().await["stops"].as_u64().unwrap() >= before + 4);
    // The reset takes control of the devices, which the stop has prevented.
    harness.reset_and_home().await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_e_stop_in_a_press_stops_every_axis_and_moves_nothing_else() {
    let harness = Harness::pressing(1).await;
    harness.handle.estop("test");
    let status = harness.tripped().await;
    assert_eq!(status.rig.safe_end.unwrap().tips, Tips::HeldByEstop);
    let truth = harness.truth().await;
    no_axis_moves(&truth);
    assert_eq!(truth["lateral_in_contact"], 0);
    harness.diary_tells("estop").await;
    harness.reset_and_home().await;
    harness.ask(Request::Abort).await.unwrap();
    harness.until("the end", |s| s.run.is_none()).await;
    assert_eq!(harness.journal.taken().ends[0].0.as_str(), "abort");
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_an_alarm_or_a_loss_of_power_reset_and_home_are_enough() {
    for kind in ["alarm", "power_loss"] {
        let harness = Harness::homed().await;
        harness.fault(kind, "x", json!({ "count": 1 })).await;
        // Homing meets it, or brings it up.
        let _ = harness.ask(Request::Home).await;
        let seen = |s: &Status| matches!(s.rig.state, RigState::Homed | RigState::Tripped);
        harness.until(kind, seen).await;
        if harness.handle.status().rig.state == RigState::Tripped {
            // Also after the wires were closed and opened again.
            harness.ask(Request::Disconnect).await.unwrap();
            harness.ask(Request::Connect).await.unwrap();
            if harness.handle.status().rig.state == RigState::Tripped {
                harness.ask(Request::Reset).await.unwrap();
            }
            harness.home().await;
        }
        assert_eq!(harness.handle.status().rig.state, RigState::Homed, "{kind}");
        harness.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_e_stop_outlasts_an_automatic_resume_that_was_to_come() {
    let harness = Harness::homed().await;
    harness.run_that_resumes("").await;
    harness.tripped_by_its_wires(16.0).await;
    harness.handle.estop("test");
    let stopped = |s: &Status| s.rig.trip.as_ref().is_some_and(|t| t.kind == TripKind::Estop);
    harness.until("the stop is shown", stopped).await;
    harness.stays_tripped(5).await;
    assert!(harness.ask(Request::Resume).await.is_err());
    harness.reset_and_home().await;
    harness.abort_and_close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_automatic_resume_that_meets_an_alarm_leaves_it_to_a_person() {
    let harness = Harness::homed().await;
    harness.run_that_resumes("").await;
    harness.fault("no_reply", "cells", json!({ "for_s": 16.0 })).await;
    harness.tripped().await;
    // The homing of the automatic resume meets it; some seconds later another homing would succeed.
    let stuck = json!({ "alarm_after_s": 0.2, "for_s": 3.0 * super::harness::SPEED });
    harness.fault("stuck_axis", "x", stuck).await;
    let alarmed = |s: &Status| {
        let trip = s.rig.trip.as_ref().map(|t| t.kind);
        matches!(trip, Some(TripKind::Device | TripKind::Position))
    };
    harness.until("the alarm", alarmed).await;
    let status = harness.stays_tripped(14).await;
    assert!(alarmed(&status), "{:#?}", status.rig.trip);
    harness.reset_and_home().await;
    harness.resume_to_the_end().await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn failed_automatic_resumes_count_and_the_last_one_leaves_the_run_to_a_person() {
    let harness = Harness::homed().await;
    harness.run_that_resumes("max_auto_resumes = 1\n").await;
    harness.fault("no_reply", "cells", json!({ "for_s": 16.0 })).await;
    harness.tripped().await;
    // The homing of the only automatic resume loses its wire, a fault that may pass.
    harness.until("the reset", |s| s.rig.state == RigState::Disarmed).await;
    harness.fault("no_reply", "x", json!({ "for_s": 24.0 })).await;
    let status = harness.tripped().await;
    assert_eq!(status.rig.trip.map(|t| t.kind), Some(TripKind::Wire));
    harness.stays_tripped(12).await;
    let tries =
        harness.journal.taken().events.iter().filter(|(kind, ..)| kind == "recovering").count();
    assert_eq!(tries, 2, "one attempt and its end");
    harness.reset_and_home().await;
    harness.resume_to_the_end().await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_load_on_an_arm_without_a_tip_is_not_tared_away() {
    let harness = Harness::homed().await;
    harness.mount(2, 6).await;
    harness.fault("foreign_load", "cells", json!({ "arm": 5, "n": 20.0 })).await;
    harness.start_unmounted(2).await;
    let status = harness.tripped().await;
    let trip = status.rig.trip.unwrap();
    assert!(trip.detail.contains("in the air and no tip"), "{trip:?}");
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wires_are_not_closed_over_a_trip_and_opening_them_again_does_not_acknowledge_it() {
    let harness = Harness::homed().await;
    harness.handle.estop("test");
    harness.until("tripped", |s| s.rig.state == RigState::Tripped).await;
    harness.until("stopped", |s| s.rig.estop_acknowledged_ms.is_some()).await;
    harness.ask(Request::Disconnect).await.unwrap();
    harness.ask(Request::Connect).await.unwrap();
    assert_eq!(harness.handle.status().rig.state, RigState::Tripped);
    harness.reset_and_home().await;
    harness.close().await;
}
