//! What trips by itself, measured: how soon z stops, how deep the tips come, how hard they press. Each has the machine
//! to itself: their names follow one another, so that the other tests make room for them once.

use std::time::Duration;

use palpate::campaign::bench::interlock::TripKind;
use serde_json::json;

use super::harness::{Harness, committing};
use super::journal::Mood;

/// Deepest z below the nominal surface since the peaks were cleared, mm, and the largest force, N.
async fn peaks(harness: &Harness) -> (f64, f64) {
    let truth = harness.truth().await;
    let number = |key: &str| truth[key].as_f64().unwrap_or(f64::NEG_INFINITY);
    (number("deepest_below_surface_mm"), number("peak_force_n"))
}

#[tokio::test(flavor = "multi_thread")]
async fn over_force_raises_and_the_force_stays_within_limit_and_margin() {
    let harness = Harness::homed_alone().await;
    harness.run(2, "[limits]\nforce_n = 15.0\n").await;
    let status = harness.tripped_by(TripKind::Force, "over its limit 15 N").await;
    harness.diary_tells("force").await;
    let (_, peak_n) = peaks(&harness).await;
    let most = 15.0 + harness.config.limits.force_margin_n;
    assert!(peak_n < most, "{peak_n} N, limit and margin {most} N");
    let end = status.rig.safe_end.unwrap();
    let ms = end.sample_to_stop_ms.unwrap();
    assert!(ms < 1000.0 * 0.1, "{ms} ms from the sample to z's stop");
    // Measured next to computed.
    let shown = harness.handle.status().rig.stopping.unwrap();
    let travelled_mm = end.travelled_mm.expect("z moved when the limit was exceeded");
    assert!(travelled_mm <= shown.travel_mm, "{travelled_mm} mm of {shown:?}");
    assert!(shown.measured_mm.unwrap() >= travelled_mm && shown.measured_ms.unwrap() >= ms);
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_that_stands_at_its_zero_before_the_touch_off_stops_it_early() {
    let harness = Harness::homed_alone().await;
    harness.mount(1, 1).await;
    harness.fault("frozen_cell", "cells", json!({ "arm": 1 })).await;
    harness.tell(json!({ "cmd": "clear_peaks" })).await;
    harness.start_unmounted(1).await;
    let status = harness.tripped().await;
    let trip = status.rig.trip.clone().unwrap();
    assert!(matches!(trip.kind, TripKind::Stale | TripKind::Cell), "{trip:?}");
    harness.is_safe().await;
    let (deepest_mm, peak_n) = peaks(&harness).await;
    assert!(deepest_mm < 2.0 && peak_n < 30.0, "{deepest_mm} mm below the surface, {peak_n} N");
    assert!(harness.journal.taken().trials.is_empty());
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_that_lost_its_tip_is_found_out_by_the_skin() {
    // Its zero is alive with noise: nothing in the cell's own voltage shows it.
    let harness = Harness::homed_alone().await;
    harness.mount(1, 1).await;
    harness.fault("uncoupled_cell", "cells", json!({ "arm": 1 })).await;
    harness.tell(json!({ "cmd": "clear_peaks" })).await;
    harness.start_unmounted(1).await;
    harness.tripped_by(TripKind::Cell, "the skin detects a touch").await;
    let (deepest_mm, peak_n) = peaks(&harness).await;
    assert!(peak_n < 60.0, "{deepest_mm} mm below the surface, {peak_n} N");
    harness.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_the_store_hangs_forces_are_watched_and_the_diary_is_complete_afterwards() {
    let harness = Harness::homed_alone().await;
    harness.run(2, "").await;
    harness.stored(2).await;
    harness.journal.set(Mood::Hangs);
    harness.until("a commit", committing).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(committing(&harness.handle.status()), "the stage does not move on");
    // A load comes while the commit is pending.
    harness.fault("drifting_cell", "cells", json!({ "arm": 1, "n_per_s": 200.0 })).await;
    let status = harness.tripped_by(TripKind::Force, "force on arm 1").await;
    let ms = status.rig.safe_end.unwrap().sample_to_stop_ms.unwrap();
    assert!(ms < 100.0, "{ms} ms from the sample to z's stop while the store hangs");
    let written = harness.journal.taken().order.len();
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!(harness.journal.taken().order.len(), written, "the store hung all the while");
    harness.journal.set(Mood::Sound);
    harness.diary_tells("force").await;
    harness.close().await;
}
