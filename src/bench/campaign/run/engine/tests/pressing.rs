//! How fast z presses, what follows if its samples come late, and if another axis leaves its place.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::oneshot;

use super::super::Engine;
use super::{begin, engine, job, parts, surface, tripped, with_handle};
use crate::campaign::bench::descent::Descent;
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::RigEvent;
use crate::campaign::bench::stage::{AxisName, Stage};
use crate::campaign::bench::stand_in::{StandIn, StandIns, soon, until};
use crate::campaign::bench::touch_off;
use crate::campaign::bench::travel::{Target, predicted_s};
use crate::campaign::run::control::Control;
use crate::campaign::run::job::Job;
use crate::campaign::shown::status::{Phase, Status};
use crate::campaign::trial::press::Pressing;
use crate::rig::traits::AxisStatus;
use crate::schedule::configuration::Stand;
use crate::schedule::plan::Step;

/// Longest wait of a test for what must happen, also on a loaded machine.
const HAPPENS_WITHIN: Duration = Duration::from_secs(30);

/// Waits until z has received this number of stops.
async fn stopped(axes: &StandIns, stops: u64) {
    until(|| axes.z.stops.load(Ordering::SeqCst) >= stops).await;
}

/// The stage and the control of an engine whose samples do not count as stale within a test.
fn patient(engine: &mut Engine) -> (&mut Stage, &mut Control) {
    let (stage, control) = parts(engine);
    stage.config.limits.sample_age_ms = Some(60_000);
    (stage, control)
}

/// The places of the touch-off.
pub(super) fn places(job: &Job) -> &[Stand] {
    let places = job.plan.steps.iter().find_map(|step| match step {
        Step::TouchOff { places, .. } => Some(places),
        _ => None,
    });
    places.expect("a touch-off")
}

/// What z reports once its next motion was started: it moves until it is stopped.
fn moves_until_stopped(axes: &StandIns) -> AxisStatus {
    let moving = AxisStatus { position: 5.0, moving: true, ..axes.z.present() };
    *axes.z.after_start.lock() = Some(moving);
    moving
}

/// The speeds, mm/s, of a press before and after its stop. A reply takes this time until then.
async fn late_press(time: Duration, takes: impl Fn(&StandIns) -> &Mutex<Duration>) -> [f64; 2] {
    let (axes, mut engine) = engine();
    let (stage, control) = patient(&mut engine);
    moves_until_stopped(&axes);
    *takes(&axes).lock() = time;
    let press = stage.press_to(control, 10.0);
    let late = async {
        stopped(&axes, 1).await;
        let fast_mm_s = *axes.z.speed.lock();
        *takes(&axes).lock() = Duration::ZERO;
        axes.z.status.lock().moving = false;
        fast_mm_s
    };
    let (pressed, late) = tokio::join!(press, tokio::time::timeout(HAPPENS_WITHIN, late));
    let fast_mm_s = late.expect("z is stopped while the reply is awaited");
    assert!(pressed.is_ok() && axes.z.present().position == 10.0, "{pressed:?}");
    assert_eq!([&axes.z.starts, &axes.z.stops].map(|n| n.load(Ordering::SeqCst)), [2, 1]);
    let slow_mm_s = *axes.z.speed.lock();
    [fast_mm_s, slow_mm_s]
}

#[tokio::test]
async fn a_press_is_slower_once_the_wires_are_although_its_speed_was_chosen_before() {
    let (axes, mut engine) = engine();
    let (stage, control) = parts(&mut engine);
    let descent = Descent { z_mm: 10.0, speed_mm_s: 3.0 };
    stage.press_until(control, descent, |_| false).await.unwrap();
    assert_eq!(*axes.z.speed.lock(), 3.0);
    stage.stopping.note_poll(1.0);
    let deeper = Descent { z_mm: 20.0, ..descent };
    stage.press_until(control, deeper, |_| false).await.unwrap();
    let slower_mm_s = *axes.z.speed.lock();
    assert!(slower_mm_s < 0.5, "{slower_mm_s}");
}

#[tokio::test]
async fn a_slow_poll_that_does_not_recur_keeps_no_run_from_being_armed() {
    let (job, (_, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    let (waited_for, _caller) = oneshot::channel();
    // At this pace a press would be slower than 0.02 mm/s.
    parts(&mut engine).0.stopping.note_poll(12.0);
    assert_eq!(engine.arm(&job, &waited_for).await, Ok(()));
}

#[tokio::test]
async fn a_press_whose_sample_is_late_is_stopped_and_continues_more_slowly() {
    // Also before it starts, where nothing is late.
    let [fast, slow] = late_press(Duration::from_secs(1), |axes| &axes.cells.takes).await;
    assert!(slow < fast / 2.0, "{slow} mm/s after {fast} mm/s");
}

#[tokio::test]
async fn a_press_that_was_late_does_not_continue_if_the_sample_at_rest_meets_its_condition() {
    let (axes, mut engine) = engine();
    let (stage, control) = patient(&mut engine);
    let moving = moves_until_stopped(&axes);
    *axes.cells.takes.lock() = Duration::from_secs(1);
    let descent = Descent { z_mm: 10.0, speed_mm_s: 3.0 };
    let mut sampled_mm = Vec::new();
    let press = stage.press_until(control, descent, |sample| {
        sampled_mm.push(sample.z_mm);
        sample.z_mm == 5.5
    });
    let late = async {
        stopped(&axes, 1).await;
        *axes.cells.takes.lock() = Duration::ZERO;
        *axes.z.status.lock() = AxisStatus { position: 5.5, moving: false, ..moving };
    };
    let (pressed, late) = tokio::join!(press, tokio::time::timeout(HAPPENS_WITHIN, late));
    assert!(matches!(pressed, Ok(true)) && late.is_ok(), "{pressed:?}");
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 1, "z does not move again");
    assert_eq!(sampled_mm, [5.0, 5.5], "the late sample, and the one at rest");
}

#[tokio::test]
async fn a_press_ends_only_once_two_readings_show_z_at_rest() {
    let (axes, mut engine) = engine();
    let (stage, control) = patient(&mut engine);
    let moving = moves_until_stopped(&axes);
    let descent = Descent { z_mm: 10.0, speed_mm_s: 3.0 };
    let press = async {
        let pressed = stage.press_until(control, descent, |_| true).await;
        (pressed, axes.z.present().position)
    };
    // After its stop it reports rest, and coasts.
    let coasts = async {
        stopped(&axes, 1).await;
        for position in [5.5, 6.0, 6.5, 7.0] {
            *axes.z.status.lock() = AxisStatus { position, moving: false, ..moving };
            tokio::time::sleep(Duration::from_millis(40)).await;
        }
    };
    // In this order: if both are due, z is elsewhere before it is read again.
    let (coasted, (pressed, end_mm)) =
        futures::join!(tokio::time::timeout(HAPPENS_WITHIN, coasts), press);
    assert!(matches!(pressed, Ok(true)) && coasted.is_ok(), "{pressed:?}");
    assert_eq!(end_mm, 7.0);
}

#[tokio::test]
async fn a_press_whose_samples_are_late_at_the_slowest_motion_of_the_drive_trips() {
    let (axes, mut engine) = engine();
    let (stage, control) = patient(&mut engine);
    *axes.z.slowest.lock() = 3.0;
    *axes.cells.takes.lock() = Duration::from_millis(100);
    let moving = moves_until_stopped(&axes);
    let press = stage.press_to(control, 10.0);
    let stops = async {
        for stop in 1..=20 {
            stopped(&axes, stop).await;
            *axes.z.after_start.lock() = Some(moving);
            axes.z.status.lock().moving = false;
        }
    };
    let (pressed, all) = tokio::join!(press, tokio::time::timeout(HAPPENS_WITHIN, stops));
    tripped(pressed, TripKind::Stale);
    assert!(all.is_ok());
    assert_eq!(axes.z.stops.load(Ordering::SeqCst), 20, "by its safe end it is stopped again");
}

#[tokio::test]
async fn a_press_whose_start_is_not_acknowledged_is_stopped_and_continues_more_slowly() {
    // It moves, and its reply is lost.
    let [fast, slow] = late_press(2 * HAPPENS_WITHIN, |axes| &axes.z.starts_take).await;
    assert!(slow < fast, "{slow} mm/s after {fast} mm/s");
}

#[tokio::test]
async fn the_first_sample_of_a_press_is_late_from_when_its_start_was_sent() {
    let (axes, mut engine) = engine();
    let (stage, control) = patient(&mut engine);
    // A sample may be 0.4 s old. Neither the start nor the sample after it takes as long, but both together do.
    stage.stopping.note_poll(0.2);
    *axes.z.starts_take.lock() = Duration::from_millis(300);
    *axes.cells.takes.lock() = Duration::from_millis(300);
    axes.z.keep_moving();
    let press = stage.press_to(control, 10.0);
    let late = async {
        stopped(&axes, 1).await;
        *axes.z.starts_take.lock() = Duration::ZERO;
        *axes.cells.takes.lock() = Duration::ZERO;
        axes.z.status.lock().moving = false;
    };
    let (pressed, late) = tokio::join!(press, tokio::time::timeout(HAPPENS_WITHIN, late));
    assert!(late.is_ok() && pressed.is_ok(), "{pressed:?}");
    assert_eq!(axes.z.present().position, 10.0);
}

#[tokio::test]
async fn a_sample_of_a_press_is_as_old_as_its_request() {
    let (axes, mut engine) = engine();
    let (stage, control) = patient(&mut engine);
    // A sample may be 0.4 s old. No reply takes as long, but the force may begin just after the first was asked for, and
    // only the second shows it.
    stage.stopping.note_poll(0.2);
    *axes.cells.takes.lock() = Duration::from_millis(300);
    axes.z.keep_moving();
    let press = stage.press_to(control, 10.0);
    let late = async {
        stopped(&axes, 1).await;
        *axes.cells.takes.lock() = Duration::ZERO;
        axes.z.status.lock().moving = false;
    };
    let (pressed, late) = tokio::join!(press, tokio::time::timeout(HAPPENS_WITHIN, late));
    assert!(late.is_ok() && pressed.is_ok(), "{pressed:?}");
    assert_eq!(axes.z.present().position, 10.0);
}

#[tokio::test]
async fn a_press_does_not_start_on_a_sample_that_is_too_old_once_z_was_read() {
    let (axes, mut engine) = engine();
    let (stage, control) = parts(&mut engine);
    stage.config.limits.sample_age_ms = Some(100);
    // Before the start z is read after the cells.
    *axes.z.status_takes.lock() = Duration::from_millis(300);
    tripped(stage.press_to(control, 10.0).await, TripKind::Stale);
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 0);
}

#[tokio::test]
async fn a_touch_off_searches_no_tip_below_the_window_of_the_surface() {
    let job = job();
    let first = &places(&job)[..1];
    for (is_felt_again, kind, words) in [
        (true, TripKind::Cell, "arm 2 touched nowhere in the touch-off (skin.surface_z_mm"),
        (false, TripKind::Position, "no cell detected the surface down to z = 70.000 mm (skin."),
    ] {
        let (axes, mut engine) = engine();
        let (stage, control) = patient(&mut engine);
        stage.config.limits.frame_age_ms = 60_000;
        stage.tips = 2;
        let [_, bottom_mm] = stage.config.skin.surface_z_mm;
        // No arm but the first touches.
        *axes.cells.surface.lock() = Some((axes.z.clone(), bottom_mm - 1.0));
        let at = jiff::Timestamp::now();
        let touches = touch_off::touch_off(stage, control, first, 1, at);
        let sinks = async {
            stopped(&axes, 1).await;
            if !is_felt_again {
                *axes.cells.surface.lock() = None;
            }
        };
        // In this order: if both are due, the surface has sunk before the tips are raised from it.
        let (sunk, touched) = futures::join!(tokio::time::timeout(HAPPENS_WITHIN, sinks), touches);
        assert!(sunk.is_ok(), "{touched:?}");
        let detail = tripped(touched, kind);
        assert!(detail.starts_with(words), "{detail}");
        let deepest_mm = axes.z.targets.lock().iter().copied().fold(0.0, f64::max);
        assert_eq!(deepest_mm, bottom_mm);
    }
}

#[tokio::test]
async fn a_motion_has_the_time_that_it_takes_at_the_speed_to_which_its_drive_rounds() {
    let axes = StandIns::default();
    let stage = axes.stage();
    // At 1 rpm on a lead of 10 mm.
    *axes.z.slowest.lock() = 1.0 / 6.0;
    for (speed, rounded) in [(0.1, 1.0), (0.33, 1.0), (0.34, 2.0), (3.3, 19.0)] {
        let target = Target { axis: AxisName::Z, position: 10.0, speed: Some(speed) };
        let (predicted, takes) =
            (predicted_s(&stage.driven(AxisName::Z), &target, 0.0), 10.0 * 6.0 / rounded);
        assert!(takes <= predicted && predicted <= 2.1 * takes, "{predicted} s, {takes} s");
    }
}

/// As `disturbed_at`, of x.
async fn disturbed(during: Phase, change: fn(&mut AxisStatus)) -> (TripKind, Phase, u64) {
    disturbed_at(|axes| &axes.x, "x ", during, change).await
}

/// A press of a configuration, in which what an axis reports changes in this phase: the kind of the trip, whose message
/// begins like this, the phase in which it trips, and the motions of z that were started.
async fn disturbed_at(
    axis: impl Fn(&StandIns) -> &Arc<StandIn>,
    begins: &str,
    during: Phase,
    change: fn(&mut AxisStatus),
) -> (TripKind, Phase, u64) {
    let (mut job, (axes, mut engine, handle)) = (job(), with_handle());
    job.plan.measure.settle_ms = 0.0;
    begin(&mut engine, &job);
    // The press waits here, so that x changes while z moves.
    *axes.z.starts_take.lock() = Duration::from_millis(5);
    let (stage, control) = patient(&mut engine);
    stage.config.limits.frame_age_ms = 60_000;
    stage.tips = 1;
    stage.surface = Some(surface());
    let configuration = job.plan.configurations().next().expect("one");
    let pressing = Pressing { run: job.run, plan: &job.plan, attempt: 1 };
    let press = pressing.configuration(stage, control, configuration, &[0]);
    let mut status = handle.watch_status();
    let disturb = async {
        let is_in = |now: &Status| now.run.as_ref().is_some_and(|run| run.phase == during);
        drop(status.wait_for(is_in).await.unwrap());
        change(&mut axis(&axes).status.lock());
    };
    // In this order: it changes before z moves on.
    let ((), pressed) = soon(async { futures::join!(disturb, press) }).await;
    let halt = pressed.unwrap_err();
    let trip = halt.as_trip().expect("a trip");
    assert!(trip.detail.starts_with(begins), "{}", trip.detail);
    let phase = handle.status().run.expect("a run").phase;
    (trip.kind, phase, axes.z.starts.load(Ordering::SeqCst))
}

#[tokio::test]
async fn an_axis_that_leaves_its_place_ends_the_press_before_frames_are_taken_or_stored() {
    let leaves = |x: &mut AxisStatus| x.position += 1.0;
    let before = disturbed(Phase::Tare, leaves).await;
    assert_eq!(before, (TripKind::Position, Phase::Tare, 0), "no tip goes down");
    let trip = async |during, change: fn(&mut AxisStatus)| {
        let (kind, phase, _) = disturbed(during, change).await;
        (kind, phase)
    };
    assert_eq!(trip(Phase::Press, leaves).await, (TripKind::Position, Phase::Settle));
    assert_eq!(trip(Phase::Settle, leaves).await, (TripKind::Position, Phase::Measure));
    // It may be moved freely, or has another zero: where it reports to be proves nothing.
    let alarm = |x: &mut AxisStatus| x.alarm = Some(1);
    assert_eq!(trip(Phase::Press, alarm).await, (TripKind::Device, Phase::Settle));
    assert_eq!(trip(Phase::Settle, alarm).await, (TripKind::Device, Phase::Measure));
    let restarts = |x: &mut AxisStatus| x.homed = false;
    assert_eq!(trip(Phase::Press, restarts).await, (TripKind::Position, Phase::Settle));
    // Its motor is off, without an alarm.
    let is_off = |x: &mut AxisStatus| x.ready = false;
    assert_eq!(disturbed(Phase::Tare, is_off).await, (TripKind::Device, Phase::Tare, 0));
    assert_eq!(trip(Phase::Press, is_off).await, (TripKind::Device, Phase::Settle));
    assert_eq!(trip(Phase::Settle, is_off).await, (TripKind::Device, Phase::Measure));
}

#[tokio::test]
async fn no_tip_goes_down_if_z_has_sunk_during_the_tare() {
    // The surface is at 60 mm; the load on a tip may be in its zero.
    let sinks = |z: &mut AxisStatus| z.position = 60.0;
    let words = "z sank to 60.000 mm before a press, limit ";
    let sunk = disturbed_at(|axes| &axes.z, words, Phase::Tare, sinks).await;
    assert_eq!(sunk, (TripKind::Position, Phase::Tare, 0));
}

#[tokio::test]
async fn no_place_is_touched_that_an_axis_has_left_during_the_tare() {
    let (job, (axes, mut engine)) = (job(), engine());
    let (stage, control) = patient(&mut engine);
    stage.tips = 1;
    let (first, at) = (&places(&job)[..1], jiff::Timestamp::UNIX_EPOCH);
    let touches = touch_off::touch_off(stage, control, first, 1, at);
    let leave = async {
        axes.x.started().await;
        axes.x.status.lock().position += 1.0;
    };
    let ((), touched) = soon(async { futures::join!(leave, touches) }).await;
    let detail = tripped(touched, TripKind::Position);
    assert!(detail.starts_with("x measured at "), "{detail}");
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 1, "it was raised only");
}

#[tokio::test]
async fn no_height_is_kept_of_a_place_that_an_axis_has_left_during_the_touch() {
    let (job, (axes, mut engine)) = (job(), engine());
    let (stage, control) = patient(&mut engine);
    stage.config.limits.frame_age_ms = 60_000;
    stage.tips = 1;
    let [_, bottom_mm] = stage.config.skin.surface_z_mm;
    *axes.cells.surface.lock() = Some((axes.z.clone(), bottom_mm - 1.0));
    let (first, at) = (&places(&job)[..1], jiff::Timestamp::UNIX_EPOCH);
    let touches = touch_off::touch_off(stage, control, first, 1, at);
    let leave = async {
        // At the first touch of the place.
        stopped(&axes, 1).await;
        axes.x.status.lock().position += 1.0;
    };
    let ((), touched) = soon(async { futures::join!(leave, touches) }).await;
    let detail = tripped(touched, TripKind::Position);
    assert!(detail.starts_with("x measured at "), "{detail}");
}
