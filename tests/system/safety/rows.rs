//! What trips by itself.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use palpate::campaign::bench::interlock::TripKind;
use palpate::campaign::bench::rig_state::RigState;
use palpate::campaign::shown::safe_end::Tips;
use palpate::campaign::shown::status::Status;
use serde_json::json;
use virtual_rig::run::RigArgs;

use super::harness::{Harness, SPEED, committing, experiment};
use super::journal::Mood;
use crate::bench::{self, rig_args};
use palpate::state::StoredState;

/// Heights of the touches of one tip on a rig whose cells convert at this period, machine mm.
async fn heights(update_ms: f64) -> Vec<f64> {
    let text = std::fs::read_to_string(bench::file("rigs/virtual.toml")).unwrap();
    let from = text.lines().find(|line| line.starts_with("update_ms")).unwrap();
    let text = text.replace(from, &format!("update_ms = {update_ms:.1}"));
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("update-{update_ms}.toml"));
    std::fs::write(&file, text).unwrap();
    let args = RigArgs { rig: file, ..rig_args("virtual", SPEED) };
    let harness = Harness::homed_on(&args).await;
    harness.run(1, "").await;
    let status = harness.until("a surface", |s| s.rig.surface.is_some()).await;
    harness.close().await;
    status.rig.surface.unwrap().touches.iter().map(|touch| touch.z_mm).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_that_still_shows_the_coarse_touch_gives_no_height() {
    // The tips are raised in less time than a slow module needs for a conversion.
    let (fast, slow) = (heights(20.0).await, heights(400.0).await);
    assert!(fast.len() == slow.len() && fast.len() >= 5, "{fast:?} {slow:?}");
    for (fast_mm, slow_mm) in fast.iter().zip(&slow) {
        assert!((fast_mm - slow_mm).abs() < 0.5, "{fast:?} {slow:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn cells_that_stop_in_the_air_between_configurations_store_no_false_zero() {
    let harness = Harness::running(6).await;
    harness.fault("frozen_cell", "cells", json!({ "arm": 1 })).await;
    harness.fault("frozen_cell", "cells", json!({ "arm": 2 })).await;
    harness.tripped().await;
    harness.is_safe().await;
    for trial in &harness.journal.taken().trials {
        let deep = trial.depth_mm.unwrap() > 4.5;
        let heaviest = trial.arms.iter().map(|a| a.force_n).fold(0.0, f64::max);
        assert!(!deep || heaviest > 5.0, "{trial:?}");
    }
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_module_that_repeats_itself_under_load_trips_and_its_last_word_is_not_stored() {
    let harness = Harness::pressing(2).await;
    harness.fault("hung_module", "cells", json!({})).await;
    let before = harness.journal.taken().trials.len();
    harness.tripped_by(TripKind::Stale, "the module repeats itself").await;
    harness.diary_tells("stale").await;
    // The trial whose frames were under way may still have been measured before.
    assert!(harness.journal.taken().trials.len() <= before + 1);
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_motor_that_does_not_turn_trips_in_the_time_of_its_motion() {
    let harness = Harness::running(2).await;
    // It reports no alarm: only the time shows that it does not arrive.
    harness.fault("stuck_axis", "x", json!({ "for_s": 600.0 })).await;
    let before = harness.journal.taken().trials.len();
    harness.tripped_by(TripKind::Position, "did not arrive in time: x at ").await;
    harness.diary_tells("position").await;
    // The trials of this configuration need no motion of x.
    let configurations = |trials: &[palpate::record::TrialRecord]| {
        trials.iter().map(|t| t.key.configuration).collect::<BTreeSet<_>>()
    };
    let after = harness.journal.taken().trials.clone();
    assert_eq!(configurations(&after), configurations(&after[..before]));
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_force_below_the_tare_trips() {
    let harness = Harness::running(1).await;
    harness.fault("pulling_cell", "cells", json!({ "arm": 2, "n": 60.0 })).await;
    harness.tripped_by(TripKind::Cell, "below its tare").await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_module_a_lost_stream_and_a_stopped_axis_each_end_in_the_safe_end() {
    for (kind, device, more, trip) in [
        ("no_reply", "cells", json!({ "for_s": 30.0 }), "wire"),
        ("stall_stream", "ert", json!({ "for_s": 60.0 }), "stale"),
        ("alarm", "x", json!({ "count": 1 }), "device"),
    ] {
        let harness = Harness::running(1).await;
        harness.fault(kind, device, more).await;
        harness.tripped().await;
        harness
            .until("raised", |s| s.rig.safe_end.as_ref().is_some_and(|e| e.tips == Tips::Raised))
            .await;
        let truth = harness.truth().await;
        assert_eq!((&truth["pressing"], &truth["lateral_in_contact"]), (&json!(false), &json!(0)));
        harness.diary_tells(trip).await;
        harness.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alarm_of_z_in_contact_is_for_a_person_and_the_run_goes_on_afterwards() {
    let harness = Harness::pressing(2).await;
    harness.fault("alarm", "z", json!({ "count": 1 })).await;
    let status = harness.tripped().await;
    assert!(matches!(status.rig.safe_end.unwrap().tips, Tips::NotRaised(_)));
    harness.run_is(StoredState::Panicked).await;
    harness.tell(json!({ "cmd": "mend" })).await;
    harness.recovers().await;
    assert_eq!(harness.truth().await["lateral_in_contact"], 0);
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drive_that_switches_its_motor_off_ends_the_press_and_waits_for_a_person() {
    for (axis, place) in [("x", 0_usize), ("z", 2)] {
        let harness = Harness::homed().await;
        harness.run_that_resumes("").await;
        harness.stored(3).await;
        // A load is held and measured. A commit that had begun ends before the one that waits.
        harness.journal.set(Mood::Hangs);
        harness.until("a commit", committing).await;
        tokio::time::sleep(Duration::from_millis(50)).await;
        let waits = |status: &Status| {
            let stored = status.run.as_ref().map(|run| run.trials_stored);
            committing(status) && stored == Some(harness.taken_trials())
        };
        harness.until("a commit that waits", waits).await;
        let held = harness.truth().await;
        assert_eq!(held["pressing"], true, "{held:#}");
        let measured = harness.taken_trials() + 1;
        harness.fault("motor_off", axis, json!({ "count": 1 })).await;
        harness.journal.set(Mood::Sound);
        let status = harness.tripped().await;
        let (trip, end) = (status.rig.trip.unwrap(), status.rig.safe_end.unwrap());
        let words = format!("{axis} is not ready, without an alarm: its motor is off");
        assert!(trip.kind == TripKind::Device && trip.detail.starts_with(&words), "{trip:?}");
        // z without its motor cannot be raised, and is not moved.
        assert_eq!(end.tips == Tips::Raised, axis == "x", "{end:?}");
        if axis == "x" {
            harness.is_safe().await;
        } else {
            harness.run_is(StoredState::Panicked).await;
        }
        harness.stays_tripped(3).await;
        assert_eq!(harness.taken_trials(), measured, "the press is not stored");
        let after = harness.truth().await;
        assert_eq!(after["axes"][place]["servo"], false, "{after:#}");
        for i in [0, 1, 3, place] {
            let [before, now] = [&held, &after].map(|truth| truth["axes"][i]["position"].as_f64());
            assert!((before.unwrap() - now.unwrap()).abs() < 1e-6, "{after:#}");
        }
        harness.recovers().await;
        harness.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn six_powered_cells_under_two_tips_are_legal_and_a_load_without_a_tip_is_not() {
    let harness = Harness::homed().await;
    harness.mount(2, 6).await;
    harness.start_unmounted(2).await;
    harness.stored(2).await;
    assert_eq!(harness.handle.status().rig.tips, Some(2));
    harness.fault("foreign_load", "cells", json!({ "arm": 5, "n": 20.0 })).await;
    harness.tripped_by(TripKind::Cell, "cell 5 reads").await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_tip_that_is_not_there_is_named_by_the_touch_off() {
    let harness = Harness::homed().await;
    harness.mount(3, 3).await;
    harness.fault("missing_tip", "cells", json!({ "arm": 2 })).await;
    harness.start_unmounted(3).await;
    harness.tripped_by(TripKind::Cell, "arm 2 touched nowhere").await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_fails_raises_and_the_run_goes_on_when_it_is_back() {
    for mood in [Mood::Fails, Mood::Panics] {
        let harness = Harness::running(2).await;
        harness.journal.set(mood);
        harness.run_is(StoredState::Paused).await;
        harness.is_safe().await;
        assert_eq!(harness.handle.status().rig.state, RigState::Armed, "{mood:?}");
        harness.journal.set(Mood::Sound);
        harness.resume_to_the_end().await;
        let keys: Vec<_> = harness.journal.taken().trials.iter().map(|t| t.key).collect();
        let distinct: BTreeSet<_> = keys.iter().collect();
        assert_eq!((keys.len(), distinct.len()), (18, 18), "{mood:?}");
        harness.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_stalls_while_a_commit_is_pending_trips() {
    let harness = Harness::running(2).await;
    harness.journal.set(Mood::Hangs);
    harness.until("a commit", committing).await;
    harness.fault("stall_stream", "ert", json!({ "for_s": 600.0 })).await;
    harness.tripped_by(TripKind::Stale, "no frame of a held load").await;
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_contact_raises_the_tips_and_the_thread_goes_on_serving() {
    let harness = Harness::homed().await;
    harness.mount(2, 2).await;
    // A plan with wrong places: the touch-off fails on it, tips down.
    let job = harness.job(&experiment(2, ""), |job| {
        for step in &mut job.plan.steps {
            if let palpate::schedule::plan::Step::TouchOff { places, .. } = step {
                places.iter_mut().for_each(|p| p.tips_mm.clear());
            }
        }
    });
    harness.start(job).await;
    harness.tripped_by(TripKind::Service, "the campaign's thread failed").await;
    assert!(harness.handle.status().run.is_none());
    harness.reset_and_home().await;
    // The run was left to a person before the tips were raised.
    let order = harness.journal.taken().order.clone();
    let at = |kind: &str| order.iter().rposition(|taken| taken == kind);
    assert!(at("run interrupted").is_some() && at("run interrupted") < at("safe_end"), "{order:?}");
    harness.close().await;
}
