//! What the engine does, and does not do, while a safe end is not complete.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::Instant;

use super::super::{Attempts, Engine, Next, OWED_AGAIN, Owed};
use super::{answered, begin, engine, job, signs, with_handle};
use crate::campaign::bench::rig_state::{RigEvent, RigState};
use crate::campaign::bench::stage::Height;
use crate::campaign::run::eta::Pace;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::run_state::{PausedWhy, RunState};
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::status::{Status, Wanted};
use crate::schedule::plan::Kind;

#[tokio::test]
async fn no_run_is_armed_while_an_axis_owes_the_acknowledgement_of_its_stop() {
    let (mut job, (axes, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    axes.x.replies.store(false, Ordering::SeqCst);
    assert!(engine.make_safe(None, Height::Clear).await, "the tips are up");
    let (waited_for, _caller) = oneshot::channel();
    // A manual run would call hands to the skin.
    for kind in [Kind::RealRandom, Kind::RealHex] {
        job.plan.kind = kind;
        let refused = engine.arm(&job, &waited_for).await;
        assert!(matches!(refused, Err(Refusal::Busy(_))), "{refused:?}");
    }
    assert_eq!(engine.control.rig(), RigState::Homed);
    axes.x.replies.store(true, Ordering::SeqCst);
    tokio::time::sleep(OWED_AGAIN + Duration::from_millis(50)).await;
    engine.look().await;
    assert_eq!(engine.arm(&job, &waited_for).await, Ok(()));
}

#[tokio::test]
async fn nothing_moves_on_request_while_an_axis_owes_the_acknowledgement_of_its_stop() {
    let (axes, mut engine, handle) = with_handle();
    engine.control.rig_event(RigEvent::Homed).unwrap();
    axes.x.replies.store(false, Ordering::SeqCst);
    assert!(engine.make_safe(None, Height::Clear).await, "the tips are up");
    let jog = || Request::Jog { axis: "y".into(), to_mm: 10.0 };
    for request in [jog(), Request::Home] {
        let refused = answered(&mut engine, handle.ask(request)).await;
        assert!(matches!(refused, Err(Refusal::Busy(_))), "{refused:?}");
    }
    assert_eq!(axes.y.starts.load(Ordering::SeqCst), 0);
    axes.x.replies.store(true, Ordering::SeqCst);
    assert_eq!(answered(&mut engine, handle.ask(jog())).await, Ok(()));
}

#[tokio::test]
async fn nothing_moves_under_a_lock_that_was_taken_while_the_safe_end_was_completed_first() {
    let (axes, mut engine, handle) = with_handle();
    engine.control.rig_event(RigEvent::Homed).unwrap();
    // Only the request completes it.
    engine.owed_pause = Duration::from_secs(3600);
    let jog = || Request::Jog { axis: "y".into(), to_mm: 10.0 };
    for request in [jog(), Request::Home] {
        engine.owed = Owed::Wires(Instant::now(), Height::Clear);
        axes.journal.lock(60);
        let refused = answered(&mut engine, handle.ask(request)).await;
        let Err(Refusal::Busy(words)) = &refused else { panic!("{refused:?}") };
        let expected = "nothing moves before the release of the operator lock (ada";
        assert!(words.starts_with(expected), "{words}");
        assert_eq!(engine.owed, Owed::Nothing);
    }
    assert_eq!(axes.y.starts.load(Ordering::SeqCst), 0);
    // The caller of a later request knows of it.
    engine.owed = Owed::Wires(Instant::now(), Height::Clear);
    axes.journal.lock(-60);
    assert_eq!(answered(&mut engine, handle.ask(jog())).await, Ok(()));
}

#[tokio::test]
async fn nothing_moves_under_a_lock_that_was_taken_while_the_request_waited() {
    let (axes, mut engine, handle) = with_handle();
    engine.control.rig_event(RigEvent::Homed).unwrap();
    axes.journal.lock(-1);
    let jog = || Request::Jog { axis: "y".into(), to_mm: 10.0 };
    for request in [jog(), Request::Home] {
        // A safe end was completed meanwhile.
        let before = Duration::from_secs(3);
        let decided_at = (jiff::Timestamp::now() - before, Instant::now() - before);
        let asked = handle.ask_since(request, signs(&engine), decided_at);
        let refused = answered(&mut engine, asked).await;
        let Err(Refusal::Busy(words)) = &refused else { panic!("{refused:?}") };
        assert!(words.starts_with("nothing moves before the release"), "{words}");
    }
    assert_eq!(axes.y.starts.load(Ordering::SeqCst), 0);
    // The caller of a later request knows of it.
    assert_eq!(answered(&mut engine, handle.ask(jog())).await, Ok(()));
}

#[tokio::test]
async fn a_safe_end_is_not_complete_while_an_axis_moves_after_its_stop() {
    let (job, (axes, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    axes.y.status.lock().moving = true;
    assert!(engine.make_safe(None, Height::Clear).await, "the tips are up");
    let end = engine.control.inbox.status.borrow().rig.safe_end.clone().unwrap();
    let moving: Vec<&str> =
        end.stops.iter().filter(|stop| !stop.is_done()).map(|stop| stop.axis.as_str()).collect();
    assert_eq!(moving, ["y"], "{end:?}");
    assert_eq!(end.stops.iter().filter(|stop| stop.stood_ms.is_some()).count(), 3, "{end:?}");
    let (waited_for, _caller) = oneshot::channel();
    let refused = engine.arm(&job, &waited_for).await;
    assert!(matches!(refused, Err(Refusal::Busy(_))), "{refused:?}");
    let stops = axes.y.stops.load(Ordering::SeqCst);
    axes.y.status.lock().moving = false;
    tokio::time::sleep(OWED_AGAIN + Duration::from_millis(50)).await;
    engine.look().await;
    assert!(axes.y.stops.load(Ordering::SeqCst) > stops, "sent again");
    assert_eq!(engine.arm(&job, &waited_for).await, Ok(()));
}

#[tokio::test]
async fn a_safe_end_is_repeated_later_each_time_and_stored_again_only_if_it_ends_otherwise() {
    let (axes, mut engine) = engine();
    axes.y.status.lock().moving = true;
    assert!(engine.make_safe(None, Height::Clear).await, "the tips are up");
    assert_eq!(engine.owed_pause, OWED_AGAIN);
    let stops = axes.y.stops.load(Ordering::SeqCst);
    engine.repeat_safe_end(Height::Clear).await;
    assert_eq!(engine.owed_pause, 2 * OWED_AGAIN);
    assert_eq!(axes.y.stops.load(Ordering::SeqCst), stops + 1, "sent again");
    let stored = async |engine: &Engine| {
        engine.control.flush().await.unwrap();
        axes.journal.events.lock().iter().filter(|kind| *kind == "safe_end").count()
    };
    assert_eq!(stored(&engine).await, 1);
    axes.y.status.lock().moving = false;
    engine.repeat_safe_end(Height::Clear).await;
    assert_eq!((stored(&engine).await, engine.owed), (2, Owed::Nothing));
}

#[tokio::test]
async fn a_failed_attempt_is_not_repeated_before_each_axis_stands() {
    let (job, (axes, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    axes.y.status.lock().moving = true;
    let (failed, mut attempts) = (Halt::Failed("no frames".into()), Attempts::default());
    assert!(matches!(engine.decide(&job, failed, &mut attempts, &mut 0).await, Next::Again));
    // Only the axis is awaited here.
    assert!(std::mem::take(&mut attempts.has_failed));
    let mut pace = Pace::predicted(1.0);
    let waits = engine.advance(&job, &mut pace, &mut attempts);
    assert!(tokio::time::timeout(OWED_AGAIN / 2, waits).await.is_err(), "it waits");
    axes.y.status.lock().moving = false;
    let first = engine.advance(&job, &mut pace, &mut attempts).await;
    // The first step of the plan.
    assert!(matches!(first, Err(Halt::Needs(Wanted::Tips { tips: 1 }))), "{first:?}");
    assert_eq!(engine.owed, Owed::Nothing);
}

#[tokio::test]
async fn hands_are_called_to_raised_tips_only_if_each_axis_stands_and_no_cell_reads_a_load() {
    let job = job();
    for (is_moving, volts, why) in [
        (false, 0.5, PausedWhy::TipChange),
        (true, 0.5, PausedWhy::Trip),
        // z repeats where it was.
        (false, 1.0, PausedWhy::Trip),
    ] {
        let (axes, mut engine) = engine();
        engine.stage_mut().unwrap().tips = 1;
        axes.cells.volts.lock()[0] = volts;
        begin(&mut engine, &job);
        axes.radial.status.lock().moving = is_moving;
        let (wanted, mut attempts) = (Halt::Needs(Wanted::Tips { tips: 1 }), Attempts::default());
        let next = engine.decide(&job, wanted, &mut attempts, &mut 0).await;
        assert!(matches!(next, Next::Leave));
        assert_eq!(engine.control.run(), RunState::Paused(why), "{is_moving} {volts}");
        let is_called = |status: &Status| status.run.as_ref().is_some_and(|r| r.wanted.is_some());
        let is_called = is_called(&engine.control.inbox.status.borrow());
        assert_eq!(is_called, why == PausedWhy::TipChange);
    }
}

#[tokio::test]
async fn a_suspension_while_the_cells_are_asked_before_a_tip_change_states_its_reason() {
    let (job, (axes, mut engine, handle)) = (job(), with_handle());
    begin(&mut engine, &job);
    *axes.cells.takes.lock() = Duration::from_millis(300);
    let request = Request::Suspend(job.run, "a full disk".into());
    let suspend = async move { handle.ask(request).await };
    let (wanted, mut attempts) = (Halt::Needs(Wanted::Tips { tips: 1 }), Attempts::default());
    let mut resumes = 0;
    let decided = engine.decide(&job, wanted, &mut attempts, &mut resumes);
    let (suspended, next) = tokio::join!(suspend, decided);
    assert!(suspended.is_ok() && matches!(next, Next::Leave));
    assert_eq!(engine.control.run(), RunState::Paused(PausedWhy::Suspender));
    let run = engine.control.inbox.status.borrow().run.clone().unwrap();
    assert_eq!((run.waiting_for.as_deref(), run.wanted), (Some("a full disk"), None));
}

#[tokio::test]
async fn after_a_safe_end_that_itself_fails_the_rig_is_tripped_and_arms_no_run_before_a_homing() {
    let (job, (axes, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    axes.x.stop_panics.store(true, Ordering::SeqCst);
    engine.after_panic("a plan with wrong places").await;
    assert_eq!((engine.control.rig(), engine.owed), (RigState::Tripped, Owed::Person));
    axes.x.stop_panics.store(false, Ordering::SeqCst);
    engine.reset(0, None).await.unwrap();
    let (waited_for, _caller) = oneshot::channel();
    let refused = engine.arm(&job, &waited_for).await;
    assert!(matches!(refused, Err(Refusal::Busy(_))), "{refused:?}");
    assert!(engine.home().await);
    assert_eq!(engine.arm(&job, &waited_for).await, Ok(()));
}
