//! What ends an automatic resume before and while the rig homes for it: a person who operates the rig, takes the lock or
//! switches a drive off; and a pause that comes too late.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::time::Instant;

use super::super::decide::OPERATED_WITHIN;
use super::super::recovery::BY_HAND;
use super::super::{Attempts, Engine, Next};
use super::{asked_while_moving, begin, job, signs, trip, waiting_for, with_handle};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stand_in::{soon, until};
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::{Beginning, Job};
use crate::campaign::run::run_state::{PausedWhy, RunEvent, RunState};
use crate::campaign::shown::command::{Handle, Request};
use crate::campaign::shown::status::Status;
use crate::rig::traits::AxisStatus;

/// Whether the run waits for what begins with these words.
fn waits_for(now: &Status, words: &str) -> bool {
    let shown = now.run.as_ref().and_then(|run| run.waiting_for.as_deref());
    shown.is_some_and(|shown| shown.starts_with(words))
}

/// What follows in a tripped run, of which the status shows that it waits for what begins with these words.
async fn waited_for(engine: &mut Engine, job: &Job, handle: Handle, words: &str) -> Next {
    let mut status = handle.watch_status();
    let shown = async move {
        let _handle = handle;
        status.wait_for(|now| waits_for(now, words)).await.is_ok()
    };
    let (mut attempts, mut resumes) = (Attempts::default(), 1);
    let waits = engine.wait(job, &mut attempts, Some(&mut resumes));
    let (next, is_shown) = soon(async { tokio::join!(waits, shown) }).await;
    assert!(is_shown, "{words}");
    next
}

#[tokio::test]
async fn nothing_homes_by_itself_after_a_request_to_the_rig_while_the_devices_were_read() {
    let (mut job, (axes, mut engine, handle)) = (job(), with_handle());
    job.plan.policy.auto_resume_after_s = 0.0;
    trip(&mut engine, &job);
    *axes.cells.takes.lock() = Duration::from_millis(50);
    let cells = axes.cells.clone();
    let asks = async move {
        until(|| cells.readings.load(Ordering::SeqCst) > 0).await;
        handle.ask(Request::Home).await
    };
    let (mut attempts, mut resumes) = (Attempts::default(), 1);
    let waits = engine.wait(&job, &mut attempts, Some(&mut resumes));
    let (next, asked) = futures::join!(waits, asks);
    assert!(matches!(next, Next::Leave) && asked.is_err(), "{asked:?}");
    let starts = [&axes.x, &axes.z].map(|axis| axis.starts.load(Ordering::SeqCst));
    assert_eq!((starts, engine.control.rig()), ([0, 0], RigState::Disarmed));
    assert_eq!(waiting_for(&engine).as_deref(), Some(BY_HAND));
}

#[tokio::test]
async fn a_homing_for_an_automatic_resume_ends_once_a_person_takes_the_lock_or_operates_the_rig() {
    for is_locked in [true, false] {
        let (mut job, (axes, mut engine, handle)) = (job(), with_handle());
        job.plan.policy.auto_resume_after_s = 0.0;
        trip(&mut engine, &job);
        // It would home for minutes.
        let homes = AxisStatus { moving: true, homed: false, ..axes.x.present() };
        *axes.x.after_start.lock() = Some(homes);
        let (x, journal) = (axes.x.clone(), axes.journal.clone());
        let comes = async move {
            x.started().await;
            if is_locked {
                journal.lock(0);
            } else {
                handle.ask(Request::Tare).await.unwrap_err();
            }
            until(|| x.stops.load(Ordering::SeqCst) > 0).await;
            x.status.lock().moving = false;
            let awaited = if is_locked { "the release of the operator lock (ada" } else { BY_HAND };
            let mut status = handle.watch_status();
            status.wait_for(|now| waits_for(now, awaited)).await.is_ok()
        };
        let (mut attempts, mut resumes) = (Attempts::default(), 1);
        let waits = engine.wait(&job, &mut attempts, Some(&mut resumes));
        let (next, is_held) = soon(async { tokio::join!(waits, comes) }).await;
        assert!(matches!(next, Next::Leave) && is_held);
        let states = (engine.control.rig(), engine.control.run());
        assert_eq!(states, (RigState::Disarmed, RunState::Paused(PausedWhy::Trip)));
    }
}

#[tokio::test]
async fn a_run_does_not_resume_by_itself_if_a_person_requested_a_motion_shortly_before_its_trip() {
    for is_operated in [false, true] {
        let (job, (_, mut engine, handle)) = (job(), with_handle());
        begin(&mut engine, &job);
        if is_operated {
            let (refused, moved) = asked_while_moving(&mut engine, &handle, Request::Home).await;
            assert!(refused.is_err() && moved.is_ok(), "{refused:?}");
        }
        drop(handle);
        let (mut attempts, mut resumes) = (Attempts::default(), 0);
        let halt = Halt::trip(TripKind::Wire, "no reply");
        let next = engine.decide(&job, halt, &mut attempts, &mut resumes).await;
        assert!(matches!(next, Next::Leave));
        assert_eq!(resumes, u32::from(!is_operated));
        let words = if is_operated { BY_HAND } else { "no reply" };
        assert_eq!(waiting_for(&engine).as_deref(), Some(words));
        engine.control.run_event(RunEvent::Resume).unwrap();
        assert!(!engine.control.take_operated(), "a person has resumed it");
    }
}

#[tokio::test]
async fn an_operation_before_a_run_that_begins_by_itself_counts_after_its_trip_too() {
    let (now, long_ago) = (Instant::now(), Instant::now() - OPERATED_WITHIN);
    let unasked = |operated| Beginning::Unasked { operated };
    // Whether a person operated the rig while the run before it moved, how it begins, and whether it waits for a
    // person: an earlier process may have stored the operation.
    let cases = [
        (true, unasked(None), true),
        (true, Beginning::OfPerson, false),
        (false, unasked(Some(now)), true),
        (false, unasked(Some(long_ago)), false),
        (false, unasked(None), false),
    ];
    for (is_operated, beginning, waits) in cases {
        let (before, (_, mut engine, handle)) = (job(), with_handle());
        begin(&mut engine, &before);
        if is_operated {
            let (refused, moved) = asked_while_moving(&mut engine, &handle, Request::Home).await;
            assert!(refused.is_err() && moved.is_ok(), "{refused:?}");
        }
        engine.end_unasked();
        engine.control.forget_run();
        drop(handle);
        let next = Job { beginning, ..job() };
        begin(&mut engine, &next);
        let (mut attempts, mut resumes) = (Attempts::default(), 0);
        let halt = Halt::trip(TripKind::Wire, "no reply");
        let left = engine.decide(&next, halt, &mut attempts, &mut resumes).await;
        assert!(matches!(left, Next::Leave));
        assert_eq!(resumes, u32::from(!waits), "{is_operated} {beginning:?}");
        let words = if waits { BY_HAND } else { "no reply" };
        assert_eq!(waiting_for(&engine).as_deref(), Some(words));
    }
}

#[tokio::test]
async fn no_waiting_run_begins_after_a_run_of_which_a_pause_was_requested_as_it_stopped() {
    for request in [Request::PauseAtCheckpoint, Request::PauseNow] {
        let (job, (_, mut engine, handle)) = (job(), with_handle());
        begin(&mut engine, &job);
        engine.control.run_event(RunEvent::Stop).unwrap();
        let (refused, moved) = asked_while_moving(&mut engine, &handle, request).await;
        assert!(refused.is_err() && moved.is_ok(), "{refused:?}");
        assert_eq!((engine.control.run(), signs(&engine)), (RunState::Stopping, 1));
    }
}

#[tokio::test]
async fn a_run_states_why_the_rig_could_not_be_armed_for_its_automatic_resume() {
    let (mut job, (_, mut engine, handle)) = (job(), with_handle());
    job.plan.policy.auto_resume_after_s = 0.0;
    trip(&mut engine, &job);
    // The wires were so slow that no press keeps the margin.
    engine.stage_mut().unwrap().stopping.note_poll(1e6);
    let next = waited_for(&mut engine, &job, handle, "limits.force_margin_n = ").await;
    // At rest the slow poll is forgotten within seconds: on a slow machine the next attempt may arm the rig.
    let wanted = if matches!(next, Next::Leave) { RigState::Homed } else { RigState::Armed };
    assert_eq!(engine.control.rig(), wanted);
}

#[tokio::test]
async fn a_run_does_not_resume_by_itself_if_a_drive_has_its_motor_off() {
    let (mut job, (axes, mut engine, handle)) = (job(), with_handle());
    job.plan.policy.auto_resume_after_s = 0.0;
    trip(&mut engine, &job);
    // It has kept its zero, and reports no alarm.
    axes.x.status.lock().ready = false;
    let next = waited_for(&mut engine, &job, handle, "x has its motor off").await;
    assert!(matches!(next, Next::Leave));
    assert_eq!(engine.control.rig(), RigState::Tripped);
    assert_eq!(axes.z.starts.load(Ordering::SeqCst), 0);
}
