//! A homing, a jog and a tare outside a run: what the status shows, what an abort ends, and what a motion waits for.

use std::cell::Cell;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::super::Engine;
use super::{answered, engine, latched, parts, signs, suspensions, tripped, with_handle};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stage::{AxisName, Height};
use crate::campaign::bench::stand_in::{StandIn, soon, until};
use crate::campaign::bench::tare::{Accept, tare_on_request, tare_untouched};
use crate::campaign::bench::travel::Target;
use crate::campaign::run::halt::Halt;
use crate::campaign::safe_end::raise_as_planned;
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::rig_action::RigAction;
use crate::campaign::shown::status::Motion;
use crate::clock::Clock;
use crate::rig::traits::AxisStatus;

#[tokio::test]
async fn a_homing_and_a_jog_are_shown_until_they_end() {
    let (axes, mut engine, handle) = with_handle();
    let mut status = handle.watch_status();
    let home = async {
        handle.ask(Request::Home).await.unwrap();
        drop(status.wait_for(|status| status.rig.motion == Some(Motion::Homing)).await.unwrap());
        let ends = status.wait_for(|status| status.rig.state == RigState::Homed);
        ends.await.unwrap().rig.motion
    };
    assert_eq!(answered(&mut engine, home).await, None);
    axes.x.keep_moving();
    let jog = async {
        let further = || handle.ask(Request::Jog { axis: "x".into(), to_mm: 100.0 });
        further().await.unwrap();
        drop(status.wait_for(|status| status.rig.motion == Some(Motion::Jog)).await.unwrap());
        handle.ask(Request::AbortMotion).await.unwrap();
        axes.x.status.lock().moving = false;
        drop(status.wait_for(|status| status.rig.motion.is_none()).await.unwrap());
        drop(status.wait_for(|status| status.rig.safe_end.is_some()).await.unwrap());
        further().await
    };
    let words = "jog is not possible within 5 s of an abort".to_owned();
    assert_eq!(answered(&mut engine, jog).await, Err(Refusal::Busy(words)));
    assert_eq!(latched(&engine), None);
}

#[tokio::test]
async fn an_abort_during_a_raise_is_accepted_at_once_and_ends_the_motion_once_z_is_up() {
    let (axes, mut engine, handle) = with_handle();
    assert!(engine.home().await);
    let starts = |axis: &StandIn| axis.starts.load(Ordering::SeqCst);
    let (x_starts, z_starts) = (starts(&axes.x), starts(&axes.z));
    // Below the clearance, to which a lateral jog raises it first; it moves until it is up.
    let down = AxisStatus { position: 60.0, ..axes.z.present() };
    *axes.z.status.lock() = down;
    *axes.z.after_start.lock() = Some(AxisStatus { position: 55.0, moving: true, ..down });
    let mut status = handle.watch_status();
    let jog = async {
        handle.ask(Request::Jog { axis: "x".into(), to_mm: 100.0 }).await.unwrap();
        until(|| starts(&axes.z) > z_starts).await;
        let aborted = handle.ask(Request::AbortMotion).await;
        let stops = axes.stops();
        *axes.z.status.lock() = AxisStatus { position: 40.0, ..down };
        drop(status.wait_for(|status| status.rig.safe_end.is_some()).await.unwrap());
        (aborted, stops)
    };
    let (aborted, stops) = answered(&mut engine, soon(jog)).await;
    assert_eq!((aborted, stops), (Ok(()), 0), "accepted while z rises, which no stop ends");
    assert_eq!(starts(&axes.x), x_starts);
    assert_eq!(latched(&engine), None);
}

#[tokio::test]
async fn a_raise_that_fails_after_an_abort_is_not_repeated_before_the_safe_end() {
    let (axes, mut engine, handle) = with_handle();
    // It moves until it reports an alarm.
    let down = AxisStatus { position: 60.0, ..axes.z.present() };
    *axes.z.status.lock() = down;
    *axes.z.after_start.lock() = Some(AxisStatus { position: 55.0, moving: true, ..down });
    let abort = async {
        axes.z.started().await;
        let aborted = handle.ask(Request::AbortMotion).await;
        axes.z.status.lock().alarm = Some(1);
        aborted
    };
    let (stage, control) = parts(&mut engine);
    let raise = raise_as_planned(control, stage);
    let (aborted, raised) = tokio::join!(abort, raise);
    assert!(aborted.is_ok() && matches!(raised, Err(Halt::Asked)), "{raised:?}");
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_suspension_of_the_computer_during_a_raise_trips_although_a_request_came_before() {
    let (_, mut engine, handle) = with_handle();
    let suspended_s = suspensions(&mut engine);
    let raise = async {
        let aborted = handle.ask(Request::AbortMotion).await;
        suspended_s.store(3600, Ordering::SeqCst);
        // It is answered once the suspension was noticed.
        (aborted, handle.ask(Request::CameLate).await)
    };
    let (both, asked) = engine.control.attending_to_the_end(raise, &Cell::default()).await;
    assert_eq!(both, (Ok(()), Ok(())));
    tripped(asked, TripKind::Service);
}

#[tokio::test]
async fn an_abort_while_nothing_moves_holds_the_queue_only_if_a_motion_has_just_ended() {
    let (_, mut engine, handle) = with_handle();
    let refused = Err(Refusal::State("abort is not possible: nothing moves".into()));
    let abort = || handle.ask(Request::AbortMotion);
    assert_eq!((answered(&mut engine, abort()).await, signs(&engine)), (refused.clone(), 0));
    engine.home().await;
    let before = signs(&engine);
    assert_eq!((answered(&mut engine, abort()).await, signs(&engine)), (refused, before + 1));
    // Of a button that is held: its jogs are shorter than the pauses between them.
    let jog = handle.ask(Request::Jog { axis: "x".into(), to_mm: 100.0 });
    let words = "jog is not possible within 5 s of an abort".to_owned();
    assert_eq!(answered(&mut engine, jog).await, Err(Refusal::Busy(words)));
}

#[tokio::test]
async fn a_motion_waits_for_a_drive_that_is_ready_a_moment_after_its_last_motion() {
    // Also for z, on which a lateral motion depends.
    for is_z in [false, true] {
        let (axes, mut engine) = engine();
        let late = if is_z { &axes.z } else { &axes.x };
        late.status.lock().ready = false;
        let (stage, control) = parts(&mut engine);
        let target = [Target::of(AxisName::X, 100.0)];
        let travel = stage.travel(control, &target);
        let follows = async {
            tokio::time::sleep(Duration::from_millis(30)).await;
            late.status.lock().ready = true;
        };
        // In this order: if both are due, the drive is ready before it is read again.
        let ((), moved) = futures::join!(follows, travel);
        assert!(moved.is_ok(), "{moved:?}");
        assert_eq!(axes.x.present().position, 100.0);
    }
}

#[tokio::test]
async fn an_abort_during_a_tare_waits_for_no_frame() {
    // While the cells are read, and once only the frames are awaited.
    for samples in [100, 1] {
        let (axes, mut engine, handle) = with_handle();
        *axes.skin.takes.lock() = Duration::from_secs(600);
        let (stage, control) = parts(&mut engine);
        let tare = tare_untouched(stage, control, samples, Accept::AnyZero);
        let abort = async {
            tokio::time::sleep(Duration::from_millis(300)).await;
            handle.ask(Request::AbortMotion).await
        };
        let (tared, aborted) = soon(async { tokio::join!(tare, abort) }).await;
        assert!(matches!(tared, Err(Halt::Asked)) && aborted.is_ok(), "{tared:?}");
    }
}

#[tokio::test]
async fn untouched_frames_of_a_stream_that_is_opened_again_meanwhile_are_in_no_mean_with_others() {
    let (axes, mut engine, handle) = with_handle();
    let opened_at = jiff::Timestamp::UNIX_EPOCH;
    *axes.skin.since.lock() = Some(opened_at);
    let (stage, control) = parts(&mut engine);
    tare_untouched(stage, control, 1, Accept::AnyZero).await.unwrap();
    assert_eq!(handle.untouched().expect("frames").stream_since, Some(opened_at));
    let again = async { *axes.skin.since.lock() = Some(jiff::Timestamp::now()) };
    // In this order: the frames are awaited before it is opened again.
    let tare = tare_untouched(stage, control, 1, Accept::AnyZero);
    let (tared, ()) = futures::join!(tare, again);
    tared.unwrap();
    let skin = handle.untouched().expect("frames");
    assert_eq!(skin.stream_since, Some(skin.at));
}

#[tokio::test]
async fn a_tare_on_request_is_refused_unless_z_is_measured_clear_of_the_skin() {
    let (axes, mut engine, handle) = with_handle();
    // A few newtons, which a tare accepts as an offset.
    axes.cells.volts.lock()[0] = 0.65;
    let zeros_v = |engine: &Engine| engine.stage().expect("a stage").tare_v;
    let (before_v, clear) = (zeros_v(&engine), axes.z.present());
    let [home, clears] = ["home it first (palpate rig home)", "clear the cause, then home it "];
    for (z, why, next) in [
        (AxisStatus { position: 60.0, ..clear }, "z at 60.000 mm, limit ", home),
        (AxisStatus { moving: true, ..clear }, "z still moves, at 0.000 mm", "wait until z is at"),
        (AxisStatus { homed: false, ..clear }, "z is not homed, and its position is not", home),
        (AxisStatus { position: -30.0, ..clear }, "z measured at -30.000, outside its", clears),
        (AxisStatus { alarm: Some(1), ..clear }, "z reports alarm 0x1", clears),
        (AxisStatus { ready: false, ..clear }, "z is not ready, without an alarm", clears),
    ] {
        *axes.z.status.lock() = z;
        let refused = answered(&mut engine, handle.ask(Request::Tare)).await;
        let Err(Refusal::State(words)) = &refused else { panic!("{why}: {refused:?}") };
        let (begins, next) =
            (format!("tare is not possible: {why}"), format!("; the rig is disarmed: {next}"));
        assert!(words.starts_with(&begins) && words.contains(&next), "{words}");
        engine.look().await;
        let offered = RigAction::Tare.refused_now(&handle.status());
        assert_eq!(offered.as_ref(), Some(words), "it is not offered");
    }
    assert_eq!(zeros_v(&engine), before_v);
    let starts = axes.z.starts.load(Ordering::SeqCst);
    assert_eq!((starts, axes.stops(), latched(&engine)), (0, 0, None), "nothing moves for it");
    *axes.z.status.lock() = clear;
    engine.look().await;
    assert_eq!(RigAction::Tare.refused_now(&handle.status()), None);
    assert_eq!(answered(&mut engine, handle.ask(Request::Tare)).await, Ok(()));
    assert!(zeros_v(&engine)[0] > before_v[0]);
}

#[tokio::test]
async fn a_tare_on_request_keeps_the_last_zeros_if_z_sinks_meanwhile() {
    let (axes, mut engine) = engine();
    axes.cells.volts.lock()[0] = 0.65;
    let (stage, control) = parts(&mut engine);
    let before_v = stage.tare_v;
    let tare = tare_on_request(stage, control, None, 4);
    let sinks = async {
        until(|| axes.cells.readings.load(Ordering::SeqCst) > 0).await;
        axes.z.status.lock().position = 60.0;
    };
    let (tared, ()) = soon(async { tokio::join!(tare, sinks) }).await;
    let Err(Halt::Failed(words)) = &tared else { panic!("{tared:?}") };
    assert!(words.starts_with("tare is not possible: z at 60.000 mm, limit "), "{words}");
    assert_eq!(stage.tare_v, before_v);
}

#[tokio::test]
async fn a_moving_axis_that_loses_its_zero_or_its_motor_ends_the_motion_before_its_deadline() {
    type Change = fn(&mut AxisStatus);
    let restarts = |axis: &mut AxisStatus| axis.homed = false;
    let is_off = |axis: &mut AxisStatus| axis.ready = false;
    // A drive that has restarted may report its target.
    let restarts_there =
        |axis: &mut AxisStatus| (axis.position, axis.moving, axis.homed) = (100.0, false, false);
    let losses: [(Change, TripKind, &str); 3] = [
        (restarts, TripKind::Position, "is not homed any more"),
        (restarts_there, TripKind::Position, "is not homed any more"),
        (is_off, TripKind::Device, "is not ready, without an alarm"),
    ];
    for name in [AxisName::X, AxisName::Y, AxisName::Z, AxisName::Radial] {
        for (change, kind, words) in losses {
            let (axes, mut engine) = engine();
            let axis = match name {
                AxisName::X => &axes.x,
                AxisName::Y => &axes.y,
                AxisName::Z => &axes.z,
                AxisName::Radial => &axes.radial,
            };
            axis.keep_moving();
            let (stage, control) = parts(&mut engine);
            let target = [Target::of(name, 100.0)];
            let travel = stage.travel(control, &target);
            let fails = async {
                axis.started().await;
                change(&mut axis.status.lock());
            };
            let (moved, ()) = tokio::join!(travel, fails);
            let detail = tripped(moved, kind);
            assert!(detail.contains(words), "{name:?}: {detail}");
        }
    }
}

#[tokio::test]
async fn an_axis_whose_motor_goes_off_as_it_homes_ends_the_homing_before_its_deadline() {
    // One that keeps its earlier zero is not homed, either.
    for (is_z, homed) in [(true, false), (false, false), (false, true)] {
        let (axes, mut engine) = engine();
        let axis = if is_z { &axes.z } else { &axes.radial };
        let before = AxisStatus { homed, ..axis.present() };
        *axis.status.lock() = before;
        *axis.after_start.lock() = Some(AxisStatus { ready: false, ..before });
        let (stage, control) = parts(&mut engine);
        stage.clock = Clock::new(10.0);
        let detail = tripped(stage.home(control, None).await, TripKind::Device);
        let words = if is_z { "z is not ready" } else { "radial is not ready" };
        assert!(detail.starts_with(words) && detail.contains("its motor is off"), "{detail}");
    }
}

#[tokio::test]
async fn a_raise_without_the_motor_of_z_states_it_before_its_deadline_and_is_tried_again() {
    let (axes, mut engine) = engine();
    let off = AxisStatus { position: 60.0, ready: false, ..axes.z.present() };
    *axes.z.status.lock() = off;
    *axes.z.after_start.lock() = Some(off);
    let (stage, control) = parts(&mut engine);
    stage.clock = Clock::new(10.0);
    let words = stage.raise_once(Height::Clear, &control.estop).await.unwrap_err();
    let begins = "z at 60.000 mm, to be raised to ";
    let states = ": z is not ready, without an alarm: its motor is off";
    assert!(words.starts_with(begins) && words.contains(states), "{words}");
    // The second attempt of a safe end moves it.
    *axes.z.after_start.lock() = Some(off);
    assert!(engine.make_safe(None, Height::Clear).await, "the tips are up");
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 3);
    assert!(axes.z.present().position < 60.0);
    assert_eq!(latched(&engine), None);
}
