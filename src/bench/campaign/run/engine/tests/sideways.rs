//! When an axis moves or homes sideways, and when none does.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::Instant;

use super::{engine, job, latched, parts, tripped, with_handle};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stage::AxisName;
use crate::campaign::bench::stand_in::{StandIn, StandIns};
use crate::campaign::bench::travel::Target;
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::command::Request;
use crate::rig::traits::AxisStatus;
use crate::schedule::configuration::Stand;

/// Longest wait of a test for a motion that must end, also on a loaded machine.
const ENDS_WITHIN: Duration = Duration::from_secs(60);

/// Motions and homings of x, y and the rotary actuator that were started.
fn lateral_starts(axes: &StandIns) -> [u64; 3] {
    [&axes.x, &axes.y, &axes.radial].map(|axis| axis.starts.load(Ordering::SeqCst))
}

#[tokio::test]
async fn no_axis_homes_sideways_before_z_is_measured_clear() {
    let (axes, mut engine) = engine();
    // A drive whose zero is where it happens to be.
    let unhomed = AxisStatus { position: 60.0, homed: false, ..axes.z.present() };
    *axes.z.status.lock() = unhomed;
    *axes.z.after_start.lock() = Some(AxisStatus { homed: true, ..unhomed });
    assert!(!engine.home().await);
    assert_eq!((lateral_starts(&axes), engine.control.rig()), ([0; 3], RigState::Tripped));
}

#[tokio::test]
async fn no_axis_homes_sideways_while_an_attached_cell_reads_a_load_and_z_is_raised_before() {
    let (axes, mut engine) = engine();
    axes.z.status.lock().position = 60.0;
    axes.cells.volts.lock()[1] = 1.0;
    // After a start of the service no tips are known: each live cell counts.
    assert!(!engine.home().await);
    assert_eq!((lateral_starts(&axes), axes.z.present().position), ([0; 3], 0.0));
    let trip = latched(&engine).expect("a trip");
    assert_eq!(trip.kind, TripKind::Cell);
    assert!(trip.detail.contains("cell 2 reads 13.9 N (limit 10 N"), "{}", trip.detail);
    // Of one tip, on arm 1.
    let (answer, _caller) = oneshot::channel();
    engine.mounted(1, "ada", &answer).await.unwrap();
    engine.reset(0, None).await.unwrap();
    assert!(engine.home().await);
}

#[tokio::test]
async fn a_homing_does_not_end_before_its_drives_can_have_begun() {
    let (_, mut engine) = engine();
    let began = Instant::now();
    // Each reports its zero, at rest.
    assert!(engine.home().await);
    let [z, other_axes] = [Duration::from_millis(200); 2];
    assert!(began.elapsed() >= z + other_axes);
}

#[tokio::test]
async fn z_that_homes_into_a_load_is_stopped() {
    let (axes, mut engine) = engine();
    axes.cells.volts.lock()[0] = 1.5;
    // It moves until it is stopped.
    let moving = AxisStatus { position: 60.0, homed: false, moving: true, ..axes.z.present() };
    *axes.z.status.lock() = AxisStatus { moving: false, ..moving };
    *axes.z.after_start.lock() = Some(moving);
    let grows = async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        axes.cells.volts.lock()[0] = 2.0;
        tokio::time::sleep(Duration::from_millis(200)).await;
        axes.z.status.lock().moving = false;
    };
    let (is_homed, ()) = tokio::join!(engine.home(), grows);
    assert!(!is_homed && axes.z.stops.load(Ordering::SeqCst) > 0);
    let trip = latched(&engine).expect("a trip");
    assert_eq!(trip.kind, TripKind::Force);
    assert!(trip.detail.starts_with("cell 1 reads 13.9 N more than"), "{}", trip.detail);
}

#[tokio::test]
async fn z_that_homes_into_a_load_before_its_start_is_acknowledged_is_stopped() {
    let (axes, mut engine) = engine();
    let down = AxisStatus { position: 60.0, homed: false, ..axes.z.present() };
    *axes.z.status.lock() = down;
    *axes.z.after_start.lock() = Some(AxisStatus { moving: true, ..down });
    *axes.z.starts_take.lock() = Duration::from_millis(100);
    let (stage, control) = parts(&mut engine);
    let homing = tokio::time::timeout(ENDS_WITHIN, stage.home(control, None));
    let grows = async {
        axes.z.started().await;
        axes.cells.volts.lock()[0] = 1.0;
    };
    let (homed, ()) = tokio::join!(homing, grows);
    tripped(homed.expect("it ends"), TripKind::Force);
}

#[tokio::test]
async fn z_homes_although_no_cell_replies_and_no_other_axis_does() {
    let (axes, mut engine) = engine();
    axes.cells.replies.store(false, Ordering::SeqCst);
    let rising = AxisStatus { position: 60.0, homed: false, moving: true, ..axes.z.present() };
    *axes.z.status.lock() = AxisStatus { moving: false, ..rising };
    *axes.z.after_start.lock() = Some(rising);
    let arrives = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(axes.z.stops.load(Ordering::SeqCst), 0, "it is not stopped on its way");
        *axes.z.status.lock() = AxisStatus { position: 0.0, homed: true, moving: false, ..rising };
    };
    let (is_homed, ()) = tokio::join!(engine.home(), arrives);
    assert!(!is_homed);
    assert_eq!((lateral_starts(&axes), axes.z.present().position), ([0; 3], 0.0));
    assert_eq!(latched(&engine).map(|trip| trip.kind), Some(TripKind::Wire));
}

#[tokio::test]
async fn no_axis_homes_while_another_is_in_alarm() {
    let (axes, mut engine) = engine();
    axes.radial.status.lock().alarm = Some(1);
    assert!(!engine.home().await);
    assert_eq!((lateral_starts(&axes), engine.control.rig()), ([0; 3], RigState::Tripped));
}

#[tokio::test]
async fn no_axis_moves_sideways_unless_z_is_homed_at_rest_and_clear() {
    let (axes, mut engine) = engine();
    let clear = axes.z.present();
    let down = AxisStatus { position: 60.0, ..clear };
    let (rises, unhomed) =
        (AxisStatus { moving: true, ..clear }, AxisStatus { homed: false, ..clear });
    // Its drive has lost its zero and does not know it.
    let beyond = AxisStatus { position: -30.0, ..clear };
    let (faulty, off) =
        (AxisStatus { alarm: Some(1), ..clear }, AxisStatus { ready: false, ..clear });
    for name in [AxisName::X, AxisName::Y, AxisName::Radial] {
        for z in [down, rises, unhomed, beyond, faulty, off] {
            let is_fault = z.alarm.is_some() || !z.ready;
            let kind = if is_fault { TripKind::Device } else { TripKind::Position };
            *axes.z.status.lock() = z;
            let (stage, control) = parts(&mut engine);
            tripped(stage.travel(control, &[Target::of(name, 10.0)]).await, kind);
        }
    }
    assert_eq!(lateral_starts(&axes), [0; 3]);
    *axes.z.status.lock() = clear;
    let (stage, control) = parts(&mut engine);
    let target = [Target::of(AxisName::X, 10.0), Target::of(AxisName::Y, 10.0)];
    // None is started before each is known, nor while one is in alarm or has its motor off.
    let sound = axes.y.present();
    let (y_beyond, y_faulty) =
        (AxisStatus { position: -30.0, ..sound }, AxisStatus { alarm: Some(1), ..sound });
    for y in [y_beyond, y_faulty, AxisStatus { ready: false, ..sound }] {
        *axes.y.status.lock() = y;
        assert!(stage.travel(control, &target).await.is_err());
        assert_eq!(axes.x.starts.load(Ordering::SeqCst), 0);
    }
    *axes.y.status.lock() = sound;
    // Nor while the cells contradict z.
    stage.tips = 1;
    axes.cells.volts.lock()[0] = 1.0;
    assert!(stage.travel(control, &target).await.is_err());
    assert_eq!(axes.x.starts.load(Ordering::SeqCst), 0);
    axes.cells.volts.lock()[0] = 0.5;
    assert!(stage.travel(control, &target).await.is_ok());
}

#[tokio::test]
async fn no_axis_moves_sideways_if_z_sinks_while_the_cells_are_awaited() {
    // A module that still returns the load, and one whose reply takes long.
    for (volts, takes) in [(1.0, Duration::ZERO), (0.5, Duration::from_millis(200))] {
        let (axes, mut engine) = engine();
        let (stage, control) = parts(&mut engine);
        stage.tips = 1;
        axes.cells.volts.lock()[0] = volts;
        *axes.cells.takes.lock() = takes;
        let target = [Target::of(AxisName::X, 10.0)];
        let travel = stage.travel(control, &target);
        let sinks = async {
            tokio::time::sleep(Duration::from_millis(50)).await;
            axes.z.status.lock().position = 60.0;
            axes.cells.volts.lock()[0] = 0.5;
        };
        // In this order: if both are due, z has sunk before the reply arrives.
        let ((), moved) = futures::join!(sinks, travel);
        assert!(moved.is_err() && axes.x.starts.load(Ordering::SeqCst) == 0, "{moved:?}");
    }
}

#[tokio::test]
async fn nothing_moves_under_a_load_before_its_first_sample() {
    let (axes, mut engine) = engine();
    let (stage, control) = parts(&mut engine);
    stage.tips = 1;
    let target = Target::of(AxisName::Z, 10.0);
    axes.cells.volts.lock()[0] = 4.0;
    tripped(stage.checked_travel(control, target).await, TripKind::Force);
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 0);
    axes.cells.volts.lock()[0] = 0.5;
    stage.begin_watch();
    assert!(stage.checked_travel(control, target).await.is_ok());
}

#[tokio::test]
async fn a_lateral_motion_ends_when_z_sinks_or_a_cell_reads_a_load() {
    for (z_mm, ready, volts, kind, words) in [
        (60.0, true, 0.5, TripKind::Position, "z sank to 60.000 mm"),
        (0.0, false, 0.5, TripKind::Device, "z is not ready"),
        (0.0, true, 1.0, TripKind::Cell, "no lateral motion: z reports to be clear, and cell 1"),
    ] {
        let (axes, mut engine) = engine();
        axes.x.keep_moving();
        let (stage, control) = parts(&mut engine);
        stage.tips = 1;
        let target = [Target::of(AxisName::X, 100.0)];
        let travel = stage.travel(control, &target);
        let touches = async {
            tokio::time::sleep(Duration::from_millis(30)).await;
            *axes.z.status.lock() = AxisStatus { position: z_mm, ready, ..axes.z.present() };
            axes.cells.volts.lock()[0] = volts;
        };
        let (moved, ()) = tokio::join!(travel, touches);
        let detail = tripped(moved, kind);
        assert!(detail.starts_with(words), "{detail}");
        assert_eq!(axes.x.starts.load(Ordering::SeqCst), 1);
    }
}

#[tokio::test]
async fn a_jog_on_slow_wires_counts_each_reading_of_the_cells() {
    let (axes, mut engine) = engine();
    // From its first sample to the next one four replies are awaited.
    for takes in [&axes.cells.takes, &axes.z.status_takes, &axes.x.status_takes] {
        *takes.lock() = Duration::from_millis(300);
    }
    let (stage, control) = parts(&mut engine);
    stage.config.limits.sample_age_ms = Some(1100);
    let target = Target::of(AxisName::X, 100.0);
    let jogged = stage.checked_travel(control, target).await;
    assert!(jogged.is_ok(), "{jogged:?}");
}

/// Waits until an axis was started; from then on the cells do not reply.
async fn silence(axes: &StandIns, axis: &StandIn) {
    axis.started().await;
    *axes.cells.takes.lock() = 2 * ENDS_WITHIN;
}

#[tokio::test]
async fn an_abort_of_a_lateral_motion_or_homing_waits_for_no_cell() {
    for homes in [true, false] {
        let (axes, mut engine, handle) = with_handle();
        axes.x.keep_moving();
        let abort = async {
            silence(&axes, &axes.x).await;
            tokio::time::sleep(Duration::from_millis(200)).await;
            let asked = Instant::now();
            handle.ask(Request::Abort).await.unwrap();
            axes.x.status.lock().moving = false;
            asked.elapsed()
        };
        let moves = async {
            if homes {
                return engine.home().await;
            }
            let (stage, control) = parts(&mut engine);
            let target = [Target::of(AxisName::X, 100.0)];
            !matches!(stage.travel(control, &target).await, Err(Halt::Asked))
        };
        let (moved, took) = tokio::join!(moves, abort);
        assert!(!moved && took < ENDS_WITHIN, "{took:?}");
        assert_eq!(axes.x.stops.load(Ordering::SeqCst), u64::from(homes), "by its safe end");
        assert_eq!(latched(&engine), None);
    }
}

#[tokio::test]
async fn no_axis_goes_on_while_the_wire_still_waits_for_a_sample_or_the_reply_to_its_start() {
    for (name, is_started) in
        [(AxisName::Z, true), (AxisName::Z, false), (AxisName::X, true), (AxisName::X, false)]
    {
        let (axes, mut engine) = engine();
        let axis = if name == AxisName::Z { &axes.z } else { &axes.x };
        if is_started {
            axis.keep_moving();
        } else {
            *axis.starts_take.lock() = 2 * ENDS_WITHIN;
        }
        let (stage, control) = parts(&mut engine);
        stage.config.limits.sample_age_ms = Some(100);
        let began = Instant::now();
        let target = Target::of(name, 100.0);
        let travel = async {
            if name == AxisName::Z {
                return stage.checked_travel(control, target).await;
            }
            stage.travel(control, &[target]).await
        };
        let falls_silent = async {
            if is_started {
                silence(&axes, axis).await;
            }
        };
        let (moved, ()) = tokio::join!(travel, falls_silent);
        tripped(moved, TripKind::Stale);
        assert!(began.elapsed() < ENDS_WITHIN, "{:?}", began.elapsed());
    }
}

#[tokio::test]
async fn no_axis_goes_on_sideways_while_z_is_read_too_rarely_although_each_reply_is_in_time() {
    // Neither the reply of z nor the one that is awaited before it takes too long, but both together do.
    for (homes, is_start_slow) in [(false, false), (false, true), (true, false), (true, true)] {
        let (axes, mut engine) = engine();
        axes.x.keep_moving();
        *axes.x.starts_take.lock() = Duration::from_millis(20);
        let (stage, control) = parts(&mut engine);
        stage.config.limits.sample_age_ms = Some(300);
        let moves = async {
            if homes {
                return stage.home(control, None).await;
            }
            let targets = [Target::of(AxisName::X, 100.0), Target::of(AxisName::Y, 100.0)];
            stage.travel(control, &targets).await
        };
        let slows = async {
            axes.x.started().await;
            let slow = if is_start_slow { &axes.y.starts_take } else { &axes.x.status_takes };
            for takes in [slow, &axes.z.status_takes] {
                *takes.lock() = Duration::from_millis(200);
            }
        };
        // In this order: if both are due, they are slow before the start is acknowledged.
        let ((), moved) = futures::join!(slows, tokio::time::timeout(ENDS_WITHIN, moves));
        tripped(moved.expect("it ends"), TripKind::Stale);
    }
}

#[tokio::test]
async fn no_axis_goes_on_homing_without_its_status_or_the_reply_to_its_start() {
    for (name, is_started) in
        [(AxisName::Z, true), (AxisName::Z, false), (AxisName::X, true), (AxisName::X, false)]
    {
        let (axes, mut engine) = engine();
        let axis = if name == AxisName::Z { &axes.z } else { &axes.x };
        // It moves until it is stopped. z without a zero homes at once.
        let homes = AxisStatus { moving: true, homed: false, ..axis.present() };
        *axis.status.lock() = AxisStatus { moving: false, ..homes };
        *axis.after_start.lock() = Some(homes);
        if !is_started {
            *axis.starts_take.lock() = 2 * ENDS_WITHIN;
        }
        let (stage, control) = parts(&mut engine);
        stage.config.limits.sample_age_ms = Some(100);
        let homing = tokio::time::timeout(ENDS_WITHIN, stage.home(control, None));
        let falls_silent = async {
            axis.started().await;
            *axis.status_takes.lock() = 2 * ENDS_WITHIN;
        };
        let (homed, ()) = tokio::join!(homing, falls_silent);
        tripped(homed.expect("it ends"), TripKind::Stale);
    }
}

#[tokio::test]
async fn z_that_homes_is_read_although_the_cells_are_silent() {
    let (axes, mut engine) = engine();
    *axes.cells.takes.lock() = 2 * ENDS_WITHIN;
    let rising = AxisStatus { position: 60.0, homed: false, moving: true, ..axes.z.present() };
    *axes.z.status.lock() = AxisStatus { moving: false, ..rising };
    *axes.z.after_start.lock() = Some(rising);
    let (stage, control) = parts(&mut engine);
    stage.config.limits.sample_age_ms = Some(100);
    let homing = tokio::time::timeout(ENDS_WITHIN, stage.home(control, None));
    let fails = async {
        axes.z.started().await;
        axes.z.status.lock().alarm = Some(1);
    };
    let (homed, ()) = tokio::join!(homing, fails);
    tripped(homed.expect("it ends"), TripKind::Device);
}

#[tokio::test]
async fn a_lateral_motion_continues_while_z_jitters_at_rest() {
    let (axes, mut engine) = engine();
    let (stage, control) = parts(&mut engine);
    // As far down as a raise leaves it.
    let at_rest = stage.clear_z_mm() + stage.config.axes.z.tolerance_mm;
    axes.z.status.lock().position = at_rest;
    let moving = AxisStatus { moving: true, ..axes.x.present() };
    *axes.x.after_start.lock() = Some(moving);
    let target = [Target::of(AxisName::X, 100.0)];
    let travel = stage.travel(control, &target);
    let jitters = async {
        tokio::time::sleep(Duration::from_millis(30)).await;
        axes.z.status.lock().position = at_rest + 0.02;
        tokio::time::sleep(Duration::from_millis(60)).await;
        *axes.x.status.lock() = AxisStatus { position: 100.0, moving: false, ..moving };
    };
    let (moved, ()) = tokio::join!(travel, jitters);
    assert!(moved.is_ok(), "{moved:?}");
}

#[tokio::test]
async fn a_drive_in_alarm_that_keeps_its_zero_is_not_homed() {
    let (axes, mut engine) = engine();
    *axes.x.after_start.lock() = Some(AxisStatus { alarm: Some(1), ..axes.x.present() });
    assert!(!engine.home().await);
    assert_eq!(latched(&engine).map(|trip| trip.kind), Some(TripKind::Device));
}

#[tokio::test]
async fn a_drive_whose_motor_is_off_and_that_keeps_its_zero_is_not_homed() {
    let (axes, mut engine) = engine();
    axes.radial.status.lock().ready = false;
    assert!(!engine.home().await);
    assert_eq!(latched(&engine).map(|trip| trip.kind), Some(TripKind::Device));
    assert_eq!(lateral_starts(&axes), [0; 3]);
}

#[tokio::test]
async fn a_homing_that_ends_outside_the_travel_is_none() {
    let (axes, mut engine) = engine();
    *axes.radial.after_start.lock() = Some(AxisStatus { position: -30.0, ..axes.radial.present() });
    assert!(!engine.home().await);
    assert_eq!(latched(&engine).map(|trip| trip.kind), Some(TripKind::Position));
}

#[tokio::test]
async fn a_radius_is_approached_by_the_backlash_although_a_motion_has_ended_close_below_it() {
    let (job, (axes, mut engine)) = (job(), engine());
    let (stage, control) = parts(&mut engine);
    let slot = stage.config.slot.clone();
    assert_eq!(slot.backlash_mm, 0.3);
    let first = job.plan.configurations().next().expect("a configuration");
    let stand = |radius_mm| Stand { radius_mm, ..first.stand.clone() };
    // Radii that were commanded since the last call.
    let commanded = || {
        let angles = std::mem::take(&mut *axes.radial.targets.lock());
        angles.iter().map(|deg| (slot.radius_mm(*deg) * 1e3).round() / 1e3).collect::<Vec<_>>()
    };
    // A decrease was interrupted here.
    axes.radial.status.lock().position = slot.angle_deg(59.9);
    stage.go_over(control, &stand(60.0)).await.unwrap();
    assert_eq!(commanded(), [59.7, 60.0]);
    stage.go_over(control, &stand(60.2)).await.unwrap();
    assert_eq!(commanded(), [60.2], "it only grew");
    // A jog.
    let jog = [Target::of(AxisName::Radial, slot.angle_deg(60.1))];
    stage.travel(control, &jog).await.unwrap();
    stage.go_over(control, &stand(60.2)).await.unwrap();
    assert_eq!(commanded(), [60.1, 59.9, 60.2]);
}
