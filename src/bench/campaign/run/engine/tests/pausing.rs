//! Where a requested pause takes effect, and what a suspension of a run states.

use std::sync::atomic::Ordering;
use std::time::Duration;

use jiff::Timestamp;

use super::super::{Attempts, Next};
use super::pressing::places;
use super::{
    asked_while_moving, begin, engine, job, parts, surface, trip, waiting_for, with_handle,
};
use crate::campaign::bench::touch_off::touch_off;
use crate::campaign::run::eta::Pace;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::run_state::{PausedWhy, RunEvent, RunState};
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::status::{Motion, Status, Wanted};
use crate::campaign::trial::press::Pressing;
use crate::ids::RunUid;
use crate::schedule::plan::Step;

#[tokio::test]
async fn a_pause_or_a_stop_that_is_requested_before_a_press_waits_for_no_press() {
    let job = job();
    for request in [RunEvent::PauseAtCheckpoint, RunEvent::Stop] {
        let (axes, mut engine) = engine();
        begin(&mut engine, &job);
        engine.control.run_event(request).unwrap();
        let (stage, control) = parts(&mut engine);
        stage.tips = 1;
        stage.surface = Some(surface());
        let pressing = Pressing { run: job.run, plan: &job.plan, attempt: 1 };
        let mut presses = 0;
        for step in &job.plan.steps {
            let halted = match step {
                Step::Reference(press) => pressing.reference(stage, control, press).await,
                Step::Configuration(c) => {
                    pressing.configuration(stage, control, c, &[0, 1]).await.map(drop)
                }
                Step::TipChange { .. } | Step::TouchOff { .. } | Step::Manual(_) => continue,
            };
            assert!(matches!(halted, Err(Halt::Checkpoint)), "{request:?}: {halted:?}");
            presses += 1;
        }
        // The reference, and two configurations: each is over its place, and no tip went down.
        let starts = [&axes.x, &axes.z].map(|axis| axis.starts.load(Ordering::SeqCst));
        assert!(presses >= 3 && starts[0] >= presses && starts[1] == 0, "{presses}: {starts:?}");
    }
}

#[tokio::test]
async fn the_attempt_after_a_failed_one_is_late_and_a_pause_or_a_stop_meanwhile_is_not() {
    let job = job();
    for request in [None, Some(Request::PauseAtCheckpoint), Some(Request::Stop)] {
        let (_, mut engine, handle) = with_handle();
        begin(&mut engine, &job);
        let failed = Halt::Failed("cell 1 varies by 3.00 N in the air".into());
        let (mut attempts, mut pace) = (Attempts::default(), Pace::predicted(1.0));
        let next = engine.decide(&job, failed, &mut attempts, &mut 0).await;
        assert!(matches!(next, Next::Again));
        let again = engine.advance(&job, &mut pace, &mut attempts);
        let Some(request) = request else {
            let waited = tokio::time::timeout(Duration::from_millis(300), again).await;
            assert!(waited.is_err(), "{waited:?}");
            continue;
        };
        // It is far shorter than the wait.
        let limit = Duration::from_secs(5);
        let both = async { tokio::join!(handle.ask(request), again) };
        let (asked, again) = tokio::time::timeout(limit, both).await.expect("the wait ends");
        assert_eq!(asked, Ok(()));
        assert!(matches!(again, Err(Halt::Checkpoint)), "{again:?}");
    }
}

#[tokio::test]
async fn a_run_that_is_resumed_after_a_pause_waits_for_no_failed_attempt_before_it() {
    let (job, (_, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    // The pause was requested before the safe end of the attempt was complete.
    let mut attempts = Attempts { has_failed: true, ..Attempts::default() };
    engine.control.run_event(RunEvent::PauseNow).unwrap();
    let next = engine.decide(&job, Halt::Asked, &mut attempts, &mut 0).await;
    assert!(matches!(next, Next::Leave));
    engine.control.run_event(RunEvent::Resume).unwrap();
    let mut pace = Pace::predicted(1.0);
    let resumed = engine.advance(&job, &mut pace, &mut attempts);
    // It is far shorter than the wait.
    let resumed = tokio::time::timeout(Duration::from_secs(10), resumed).await;
    let first = resumed.expect("it does not wait");
    assert!(matches!(first, Err(Halt::Needs(Wanted::Tips { tips: 1 }))), "{first:?}");
}

/// What a run that waits after a trip shows, and the state that it reaches, once it is suspended for this reason.
async fn suspended_while_it_waits(why: &str) -> (Option<String>, RunState) {
    let (job, (_, mut engine, handle)) = (job(), with_handle());
    trip(&mut engine, &job);
    let request = Request::Suspend(job.run, why.to_owned());
    let suspend = async move { handle.ask(request).await };
    let mut attempts = Attempts::default();
    let (suspended, next) = tokio::join!(suspend, engine.wait(&job, &mut attempts, None));
    assert!(suspended.is_ok() && matches!(next, Next::Leave), "{suspended:?}");
    assert_eq!(engine.control.take_suspended_for(), None, "it is stated once");
    (waiting_for(&engine), engine.control.run())
}

#[tokio::test]
async fn a_suspension_of_a_run_that_waits_states_its_reason() {
    let why = "the model does not fit the skin";
    let (waiting_for, state) = suspended_while_it_waits(why).await;
    assert_eq!(waiting_for.as_deref(), Some(why));
    assert_eq!(state, RunState::Paused(PausedWhy::Suspender));
}

#[tokio::test]
async fn a_suspension_while_the_rig_homes_for_an_automatic_resume_states_its_reason() {
    let (mut job, (_, mut engine, handle)) = (job(), with_handle());
    job.plan.policy.auto_resume_after_s = 0.0;
    trip(&mut engine, &job);
    let request = Request::Suspend(job.run, "a full disk".into());
    let suspends = async move {
        let mut status = handle.watch_status();
        drop(status.wait_for(|now| now.rig.motion == Some(Motion::Homing)).await.unwrap());
        handle.ask(request).await.unwrap();
        let waiting_for = |now: &Status| now.run.as_ref()?.waiting_for.clone();
        let is_stated = |now: &Status| waiting_for(now).as_deref() == Some("a full disk");
        let stated = status.wait_for(is_stated);
        tokio::time::timeout(Duration::from_secs(30), stated).await.is_ok()
    };
    let (mut attempts, mut resumes) = (Attempts::default(), 1);
    let waits = engine.wait(&job, &mut attempts, Some(&mut resumes));
    let (is_stated, _) = tokio::join!(suspends, waits);
    assert!(is_stated, "it is stated");
    assert_eq!(engine.control.run(), RunState::Paused(PausedWhy::Suspender));
}

#[tokio::test]
async fn the_reason_of_a_suspension_is_not_that_of_the_next_run() {
    let (job, (_, mut engine)) = (job(), engine());
    // The twins are behind: the run has ended.
    let late = Request::Suspend(RunUid::new(), "the model does not fit the skin".into());
    engine.control.run_request(&late);
    begin(&mut engine, &job);
    assert_eq!(engine.control.take_suspended_for(), None);
}

#[tokio::test]
async fn the_reason_of_a_suspension_that_was_refused_or_is_over_is_not_that_of_a_later_halt() {
    let (job, (_, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    let suspend = Request::Suspend(job.run, "the model does not fit the skin".into());
    // A panicked run refuses it.
    engine.control.run_event(RunEvent::RaiseFailed).unwrap();
    engine.control.run_request(&suspend);
    engine.control.run_event(RunEvent::Reset).unwrap();
    assert_eq!(engine.control.take_suspended_for(), None);
    // A run that waits takes it, and a person resumes the run.
    engine.control.run_request(&suspend);
    engine.control.run_event(RunEvent::Resume).unwrap();
    assert_eq!(engine.control.take_suspended_for(), None);
}

#[tokio::test]
async fn a_suspension_of_a_run_that_has_ended_does_not_halt_the_next_one() {
    let (job, (_, mut engine, handle)) = (job(), with_handle());
    begin(&mut engine, &job);
    let late = Request::Suspend(RunUid::new(), "the model does not fit the skin".into());
    let (suspended, moved) = asked_while_moving(&mut engine, &handle, late).await;
    let words = "suspend is not possible: run 1 is active";
    assert_eq!(suspended, Err(Refusal::State(words.into())));
    assert!(moved.is_ok(), "{moved:?}");
    assert_eq!(engine.control.run(), RunState::Running);
    assert_eq!(engine.control.take_suspended_for(), None);
}

#[tokio::test]
async fn a_pause_that_is_requested_in_a_touch_off_waits_for_no_further_place() {
    let (job, (axes, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    engine.control.run_event(RunEvent::PauseAtCheckpoint).unwrap();
    let (stage, control) = parts(&mut engine);
    stage.tips = 1;
    let found = touch_off(stage, control, places(&job), 1, Timestamp::UNIX_EPOCH).await;
    assert!(matches!(found, Err(Halt::Checkpoint)), "{found:?}");
    assert_eq!(axes.z.present().position, 0.0);
}
