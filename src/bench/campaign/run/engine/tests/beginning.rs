//! A wire that fails as a run begins: a run that begins by itself keeps the rig, and resumes as after a trip in it; a
//! person starts the run again.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::Instant;

use super::super::Engine;
use super::super::decide::OPERATED_WITHIN;
use super::{answered, engine, job, latched, signs, suspensions, with_handle};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::{RigEvent, RigState};
use crate::campaign::bench::stand_in::soon;
use crate::campaign::run::run_state::RunState;
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::run_action;

/// No person has moved the rig for long, and the service has run for long.
fn left_alone(engine: &mut Engine) {
    engine.operated_at = Instant::now() - OPERATED_WITHIN - Duration::from_secs(1);
}

#[tokio::test]
async fn a_run_that_begins_by_itself_survives_a_wire_that_fails_for_a_moment() {
    let (mut job, (axes, mut engine, handle)) = (job(), with_handle());
    job.has_waited = true;
    job.plan.policy.auto_resume_after_s = 0.0;
    left_alone(&mut engine);
    // For the run before it, as it resumed automatically.
    assert!(engine.home().await);
    let starts = axes.z.starts.load(Ordering::SeqCst);
    engine.look().await;
    axes.z.replies.store(false, Ordering::SeqCst);
    let (answer, begun) = oneshot::channel();
    let mut status = handle.watch_status();
    let passes = async {
        assert_eq!(begun.await, Ok(Ok(())));
        let tripped = status.wait_for(|now| now.rig.trip.is_some()).await.unwrap().clone();
        assert_eq!(tripped.rig.trip.as_ref().map(|trip| trip.kind), Some(TripKind::Wire));
        assert!(tripped.run.is_some() && run_action::tripped(&tripped).is_none());
        axes.z.replies.store(true, Ordering::SeqCst);
        status.wait_for(|now| now.rig.state == RigState::Armed).await.unwrap().clone()
    };
    let resumed = async {
        tokio::select! {
            () = engine.start(&job, answer, 0) => None,
            resumed = passes => Some(resumed),
        }
    };
    let resumed = soon(resumed).await.expect("the run stays active");
    assert_eq!((resumed.rig.trip, resumed.attended.signs), (None, 0), "the queue waits behind it");
    assert!(axes.z.starts.load(Ordering::SeqCst) > starts, "the rig was homed before");
}

#[tokio::test]
async fn a_wire_that_fails_as_a_run_is_armed_begins_nothing_if_a_person_may_be_at_the_rig() {
    // Whose start it is, who holds the rig, since when a device is silent, who homed it, and when this process started.
    for case in ["started", "locked", "silent", "homed", "restarted"] {
        let (mut job, (axes, mut engine, _handle)) = (job(), with_handle());
        job.has_waited = case != "started";
        engine.control.rig_event(RigEvent::Homed).unwrap();
        if case != "restarted" {
            left_alone(&mut engine);
        }
        if case != "silent" {
            engine.look().await;
        }
        axes.z.replies.store(false, Ordering::SeqCst);
        match case {
            "locked" => axes.journal.lock(1),
            "homed" => engine.operated_at = Instant::now(),
            _ => {}
        }
        let (answer, begun) = oneshot::channel();
        soon(engine.start(&job, answer, 0)).await;
        let is_refused = match begun.await {
            Ok(Err(Refusal::Fault(kind, _))) => case != "locked" && kind == TripKind::Wire,
            Ok(Err(Refusal::Busy(_))) => case == "locked",
            _ => false,
        };
        assert!(is_refused, "{case}");
        assert_eq!((engine.control.rig(), engine.control.run()), (RigState::Homed, RunState::Idle));
        assert_eq!((latched(&engine), signs(&engine), axes.stops()), (None, 0, 0), "{case}");
    }
}

#[tokio::test]
async fn only_a_homing_that_a_person_has_requested_or_ended_shows_a_person_at_the_rig() {
    for (request, is_shown) in [(Request::Home, true), (Request::HomeForRun, false)] {
        let (_axes, mut engine, handle) = with_handle();
        left_alone(&mut engine);
        let mut status = handle.watch_status();
        let homes = async {
            handle.ask(request).await.unwrap();
            drop(status.wait_for(|now| now.rig.state == RigState::Homed).await.unwrap());
        };
        answered(&mut engine, soon(homes)).await;
        assert_eq!(engine.operated_at.elapsed() < OPERATED_WITHIN, is_shown);
    }
    let (axes, mut engine, handle) = with_handle();
    left_alone(&mut engine);
    axes.z.keep_moving();
    let aborts = async {
        axes.z.started().await;
        handle.ask(Request::AbortMotion).await.unwrap();
        axes.z.status.lock().moving = false;
    };
    let (homed, ()) = tokio::join!(engine.home(), aborts);
    assert!(!homed && engine.operated_at.elapsed() < OPERATED_WITHIN, "a person has ended it");
}

#[tokio::test]
async fn a_run_does_not_begin_tripped_after_a_stop_or_a_suspension_while_it_was_armed() {
    for is_suspended in [false, true] {
        let (job, (_axes, mut engine)) = (job(), engine());
        let suspended_s = suspensions(&mut engine);
        engine.control.rig_event(RigEvent::Homed).unwrap();
        if is_suspended {
            suspended_s.store(60, Ordering::SeqCst);
        } else {
            engine.control.estop.press("test");
        }
        let (waited_for, _caller) = oneshot::channel();
        let begun = engine.begin_halted(&job, &waited_for).await;
        assert!(matches!(begun, Err(Refusal::State(_))), "{begun:?}");
        assert_eq!(engine.control.run(), RunState::Idle);
    }
}
