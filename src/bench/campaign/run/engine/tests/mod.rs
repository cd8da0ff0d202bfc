//! The engine on a bench of stand-ins: what resets, arms and moves, and what does not.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::Instant;

use super::{Answer, Attempts, Engine, Next, OWED_AGAIN, Owed};
use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::rig_state::{RigEvent, RigState};
use crate::campaign::bench::stage::{AxisName, Height, Stage};
pub(super) use crate::campaign::bench::stand_in::job;
use crate::campaign::bench::stand_in::{StandIns, config, until};
use crate::campaign::bench::travel::Target;
use crate::campaign::diary::Diary;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunEvent, RunState};
use crate::campaign::shown::command::{Handle, Refusal, Request, channel};
use crate::campaign::shown::show;
use crate::campaign::shown::status::{Done, Wanted};
use crate::clock::Clock;
use crate::ids::TrialKey;
use crate::journal::{ExitStatus, Journal};
use crate::record::TouchOffRecord;
use crate::rig::setup::RigSetup;
use crate::schedule::plan::Kind;
use crate::suspension::Suspensions;

mod attended;
mod beginning;
mod frames;
mod motions;
mod owed;
mod pausing;
mod placing;
mod pressing;
mod sideways;

/// An engine whose wires to the axes of stand-ins are open; the rig is disarmed.
pub(super) fn engine() -> (StandIns, Engine) {
    let (axes, engine, _) = with_handle();
    (axes, engine)
}

/// As `engine`, with the handle for requests. A run that waits is left once the handle is dropped.
pub(super) fn with_handle() -> (StandIns, Engine, Handle) {
    let axes = StandIns::default();
    let (engine, handle) = on(&axes);
    (axes, engine, handle)
}

/// As `with_handle`, on these axes.
fn on(axes: &StandIns) -> (Engine, Handle) {
    let (setup, estop) = (RigSetup::from(config()), StopSwitch::default());
    let (handle, inbox) = channel(estop.clone(), show::closed(&setup));
    let journal: Arc<dyn Journal> = axes.journal.clone();
    let (diary, _writing) = Diary::open(journal.clone());
    let mut engine = Engine::new(setup, Control::new(inbox, estop, diary, journal));
    let (stage, clock) = (axes.stage(), Clock::new(1.0));
    let wires = engine.control.inbox.wires.take().expect("the wires are free");
    let (skin, tasks) = (stage.bench.skin.clone(), engine.serve_stops(&stage.bench));
    engine.connected(skin, BTreeMap::new(), Some(stage), clock, wires, tasks).unwrap();
    (engine, handle)
}

/// The stage and the control of an engine.
fn parts(engine: &mut Engine) -> (&mut Stage, &mut Control) {
    let stage = engine.connection.as_mut().and_then(|open| open.stage.as_mut());
    (stage.expect("a stage"), &mut engine.control)
}

/// The surface of a touch-off with one tip.
fn surface() -> TouchOffRecord {
    TouchOffRecord {
        tips: 1,
        surface_z_mm: 60.0,
        tip_offset_mm: vec![(1, 0.0)],
        touches: Vec::new(),
        at: jiff::Timestamp::UNIX_EPOCH,
    }
}

/// The run is active.
fn begin(engine: &mut Engine, job: &Job) {
    engine.control.show(|status| status.run = Some(show::started(job)));
    engine.control.begin(job.run, job.beginning).unwrap();
}

/// The run is paused after a trip of its wires, and the rig is tripped.
pub(super) fn trip(engine: &mut Engine, job: &Job) {
    begin(engine, job);
    engine.control.latch(&Trip { kind: TripKind::Wire, detail: "no reply".into() });
    engine.control.run_event(RunEvent::Suspend(PausedWhy::Trip)).unwrap();
    engine.control.run_event(RunEvent::Raised).unwrap();
}

/// Seconds for which the computer was suspended, as the engine will read them.
pub(super) fn suspensions(engine: &mut Engine) -> Arc<AtomicU64> {
    let suspended_s = Arc::<AtomicU64>::default();
    let read = suspended_s.clone();
    engine.control.suspensions =
        Suspensions::of(move || Duration::from_secs(read.load(Ordering::SeqCst)));
    suspended_s
}

/// Signs of a person so far, for the queue.
fn signs(engine: &Engine) -> u64 {
    engine.control.inbox.status.borrow().attended.signs
}

/// The trip that is latched.
fn latched(engine: &Engine) -> Option<Trip> {
    engine.control.inbox.status.borrow().rig.trip.clone()
}

/// What the run waits for, as text.
pub(super) fn waiting_for(engine: &Engine) -> Option<String> {
    engine.control.inbox.status.borrow().run.as_ref().expect("a run").waiting_for.clone()
}

/// The message of the trip of this kind that has ended a motion.
fn tripped<T: Debug>(ended: Result<T, Halt>, kind: TripKind) -> String {
    match ended {
        Err(Halt::Trip(trip)) if trip.kind == kind => trip.detail,
        _ => panic!("no trip {kind:?}: {ended:?}"),
    }
}

/// The answer of a request whose caller was told that it failed.
fn abandoned() -> Answer {
    oneshot::channel().0
}

/// The e-stop is pressed and latched, and every axis has acknowledged it.
async fn stop(engine: &mut Engine) {
    engine.control.estop.press("test");
    engine.control.latch(&Trip { kind: TripKind::Estop, detail: "test".into() });
    let known = || engine.control.estop.pressed().and_then(|press| press.acknowledged_ms());
    until(|| known().is_some()).await;
}

/// The answer to a request that arrives while something moves, and whether the motion continues.
async fn asked_while_moving(
    engine: &mut Engine,
    handle: &Handle,
    request: Request,
) -> (Result<(), Refusal>, Result<(), Halt>) {
    let moves = async {
        tokio::task::yield_now().await;
        engine.control.attend()
    };
    tokio::join!(handle.ask(request), moves)
}

#[tokio::test]
async fn a_start_and_a_resume_whose_caller_was_told_that_they_failed_are_not_carried_out() {
    let (job, (_, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    assert_eq!(engine.arm(&job, &abandoned()).await, Err(Refusal::Gone));
    let states = |engine: &Engine| (engine.control.rig(), engine.control.run());
    assert_eq!(states(&engine), (RigState::Homed, RunState::Idle));

    trip(&mut engine, &job);
    engine.control.rig_event(RigEvent::Reset).unwrap();
    engine.control.rig_event(RigEvent::Homed).unwrap();
    let paused = RunState::Paused(PausedWhy::Trip);
    assert_eq!(engine.resume(&job, Some(&abandoned())).await, Err(Refusal::Gone));
    assert_eq!(states(&engine), (RigState::Homed, paused));
    let (waited_for, _caller) = oneshot::channel();
    assert_eq!(engine.resume(&job, Some(&waited_for)).await, Ok(()));
    assert_eq!(states(&engine), (RigState::Armed, RunState::Running));
}

#[tokio::test]
async fn no_run_begins_or_resumes_under_a_lock_that_was_taken_while_it_was_armed() {
    let (axes, job) = (StandIns::default(), Arc::new(job()));
    let is_held = |answer: Result<(), Refusal>| {
        let Err(Refusal::Busy(words)) = answer else { return false };
        words.starts_with("nothing moves before the release of the operator lock (ada")
    };
    let (mut started, handle) = on(&axes);
    started.control.rig_event(RigEvent::Homed).unwrap();
    axes.journal.lock(1);
    assert!(is_held(answered(&mut started, handle.ask(Request::Start(job.clone()))).await));
    assert_eq!((started.control.rig(), started.control.run()), (RigState::Homed, RunState::Idle));
    // The caller of a later start knows of it.
    axes.journal.lock(-1);
    assert_eq!(answered(&mut started, handle.ask(Request::Start(job.clone()))).await, Ok(()));

    let (mut paused, _) = on(&axes);
    trip(&mut paused, &job);
    paused.control.rig_event(RigEvent::Reset).unwrap();
    paused.control.rig_event(RigEvent::Homed).unwrap();
    let (waited_for, _caller) = oneshot::channel();
    axes.journal.lock(1);
    assert!(is_held(paused.resume(&job, Some(&waited_for)).await));
    let halted = RunState::Paused(PausedWhy::Trip);
    assert_eq!((paused.control.rig(), paused.control.run()), (RigState::Homed, halted));
    axes.journal.lock(-1);
    assert_eq!(paused.resume(&job, Some(&waited_for)).await, Ok(()));
}

#[tokio::test]
async fn a_drive_that_cannot_move_as_slowly_as_it_must_is_not_armed() {
    let (job, (axes, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    let (waited_for, _caller) = oneshot::channel();
    *axes.z.slowest.lock() = 5.0;
    let refused = engine.arm(&job, &waited_for).await.unwrap_err().to_string();
    assert!(refused.ends_with("the slowest press of axes.z is 5.0000"), "{refused}");
    *axes.z.slowest.lock() = 0.01;
    *axes.radial.slowest.lock() = 150.0;
    let refused = engine.arm(&job, &waited_for).await.unwrap_err().to_string();
    assert!(refused.starts_with("axes.radial.speed_deg_s = 120: must be"), "{refused}");
    assert_eq!(engine.control.rig(), RigState::Homed);
    *axes.radial.slowest.lock() = 120.0;
    assert_eq!(engine.arm(&job, &waited_for).await, Ok(()));
}

#[tokio::test]
async fn a_confirmation_whose_caller_was_told_that_it_failed_resumes_nothing() {
    let (job, (_, mut engine)) = (job(), engine());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    begin(&mut engine, &job);
    engine.control.run_event(RunEvent::Need(PausedWhy::TipChange)).unwrap();
    engine.control.run_event(RunEvent::Raised).unwrap();
    engine.control.show_run(|run| run.wanted = Some(Wanted::Tips { tips: 1 }));
    let (waits, done) = (RunState::Paused(PausedWhy::TipChange), Done::default());
    let confirmed = engine.confirmed(&job, "ada", done, &abandoned()).await;
    assert_eq!(confirmed, Err(Refusal::Gone));
    assert_eq!((engine.control.rig(), engine.control.run()), (RigState::Homed, waits));
    let (waited_for, _caller) = oneshot::channel();
    assert_eq!(engine.confirmed(&job, "ada", done, &waited_for).await, Ok(()));
    assert_eq!(engine.control.run(), RunState::Running);
}

#[tokio::test]
async fn a_reset_whose_caller_was_told_that_it_failed_releases_no_stop() {
    let (_, mut engine) = engine();
    stop(&mut engine).await;
    let presses = engine.control.estop.presses();
    assert_eq!(engine.reset(presses, Some(&abandoned())).await, Err(Refusal::Gone));
    assert!(engine.control.estop.pressed().is_some());
    assert_eq!(engine.control.rig(), RigState::Tripped);
    assert_eq!(engine.reset(presses, None).await, Ok(()));
    assert!(engine.control.estop.pressed().is_none());
}

#[tokio::test]
async fn after_a_suspension_of_the_computer_nothing_moves_before_a_person_resets() {
    let (mut job, (axes, mut engine)) = (job(), engine());
    let suspended_s = suspensions(&mut engine);
    engine.control.rig_event(RigEvent::Homed).unwrap();
    suspended_s.store(60, Ordering::SeqCst);
    let (stage, control) = parts(&mut engine);
    let moved = stage.travel(control, &[Target::of(AxisName::X, 100.0)]).await;
    let detail = tripped(moved, TripKind::Service);
    assert_eq!(detail, "the computer was suspended for 60 s");
    assert_eq!(axes.x.starts.load(Ordering::SeqCst), 0);

    // A run that was to begin in the night.
    suspended_s.store(36_060, Ordering::SeqCst);
    let (waited_for, _caller) = oneshot::channel();
    let refused = engine.arm(&job, &waited_for).await.unwrap_err().to_string();
    assert!(refused.starts_with("the computer was suspended for 36000 s: reset"), "{refused}");
    assert_eq!((engine.control.rig(), engine.control.run()), (RigState::Tripped, RunState::Idle));
    engine.control.rig_event(RigEvent::Reset).unwrap();
    assert!(engine.home().await, "it is told once");

    // A manual run moves nothing.
    job.plan.kind = Kind::RealRandom;
    suspended_s.store(36_120, Ordering::SeqCst);
    let refused = engine.arm(&job, &waited_for).await.unwrap_err().to_string();
    assert_eq!(refused, "the computer was suspended for 60 s: reset, then start the run");
}

#[tokio::test]
async fn neither_a_reset_nor_closing_the_wires_is_possible_while_an_axis_moves_after_its_stop() {
    let (axes, mut engine) = engine();
    axes.x.status.lock().moving = true;
    stop(&mut engine).await;
    let presses = engine.control.estop.presses();
    let words = engine.reset(presses, None).await.unwrap_err().to_string();
    assert!(words.starts_with("not reset: x is not stopped: ") && words.contains("STILL MOVES"));
    let words = engine.disconnect().await.unwrap_err().to_string();
    assert!(words.starts_with("disconnect is not possible: x is not stopped"), "{words}");
    axes.x.status.lock().moving = false;
    // It is read again every 50 ms; until then its fault stands.
    while engine.reset(presses, None).await.is_err() {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(engine.control.rig(), RigState::Disarmed);
}

#[tokio::test]
async fn an_e_stop_while_the_wires_are_opened_leaves_them_open_for_the_stops_and_trips() {
    let text = include_str!("../../../../../../experiments/rigs/virtual.toml");
    // Nobody listens there.
    let text = text.replace("\"127.0.0.1:50", "\"127.0.0.1:1");
    let setup = RigSetup::from_toml("virtual.toml", &text).expect("sound");
    let estop = StopSwitch::default();
    let (_handle, inbox) = channel(estop.clone(), show::closed(&setup));
    let journal: Arc<dyn Journal> = StandIns::default().journal;
    let (diary, _writing) = Diary::open(journal.clone());
    let mut engine = Engine::new(setup, Control::new(inbox, estop.clone(), diary, journal));
    // After the request for the connection.
    estop.press("hands");
    let words = engine.connect(0).await.unwrap_err().to_string();
    assert!(words.contains("the stop was pressed while the wires were opened"), "{words}");
    assert_eq!(engine.control.rig(), RigState::Tripped);
    let trip = latched(&engine).expect("latched");
    assert_eq!((trip.kind, trip.detail.as_str()), (TripKind::Estop, "hands"));
    // Each axis is tried, and none counts as stopped.
    let is_tried = || {
        let stops = estop.pressed().map_or_else(Vec::new, |press| press.stops());
        stops.len() == 4 && stops.iter().all(|stop| stop.error.is_some())
    };
    until(is_tried).await;
    assert!(engine.reset(estop.presses(), None).await.is_err());
}

#[tokio::test]
async fn after_an_e_stop_a_reset_raises_no_tips_by_itself() {
    let (axes, mut engine) = engine();
    axes.z.status.lock().position = 60.0;
    // The safe end before had no wires to raise them.
    engine.owed = Owed::Wires(Instant::now(), Height::Clear);
    stop(&mut engine).await;
    engine.reset(engine.control.estop.presses(), None).await.unwrap();
    tokio::time::sleep(OWED_AGAIN + Duration::from_millis(50)).await;
    engine.look().await;
    assert_eq!((axes.z.starts.load(Ordering::SeqCst), axes.z.present().position), (0, 60.0));
    // Without an e-stop the safe end is completed.
    engine.owed = Owed::Wires(Instant::now(), Height::Clear);
    tokio::time::sleep(OWED_AGAIN + Duration::from_millis(50)).await;
    engine.look().await;
    assert!(axes.z.present().position < 50.0 && engine.owed == Owed::Nothing);
}

#[tokio::test]
async fn an_end_brings_a_person_to_the_rig_unless_the_run_was_stopped_as_it_moved_or_gave_up() {
    let job = job();
    let policy = &job.plan.policy;
    // The request before the halt, the halt, the end, and whether the queue waits for a person.
    let failed = || Halt::Failed("no frames".into());
    for (request, halt, end, is_sign) in [
        (None, failed(), ExitStatus::Fail, false),
        (Some(RunEvent::PauseAtCheckpoint), failed(), ExitStatus::Fail, true),
        (Some(RunEvent::Stop), Halt::Checkpoint, ExitStatus::Stopped, false),
        (Some(RunEvent::Abort), Halt::Asked, ExitStatus::Abort, true),
    ] {
        let (_, mut engine) = engine();
        begin(&mut engine, &job);
        if let Some(event) = request {
            engine.control.run_event(event).unwrap();
        }
        // The last attempt that the policy allows.
        let (of_configuration, skipped) = (policy.retries + 1, policy.max_skipped);
        let mut attempts = Attempts { of_configuration, skipped, ..Attempts::default() };
        let next = engine.decide(&job, halt, &mut attempts, &mut 0).await;
        assert!(matches!(next, Next::End(status, _) if status == end), "{request:?}");
        assert_eq!(signs(&engine), u64::from(is_sign), "{request:?}");
    }
}

#[tokio::test]
async fn the_status_counts_the_failed_attempts_that_are_stored() {
    let (job, (_, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    let at = Some(TrialKey { configuration: 0, depth_index: 1 });
    // A touch-off is not an attempt at a trial.
    for (trial, retries) in [(None, 0), (at, 1)] {
        engine.control.show_run(|run| run.trial = trial);
        let halt = Halt::Failed("no frames".into());
        let next = engine.decide(&job, halt, &mut Attempts::default(), &mut 0).await;
        assert!(matches!(next, Next::Again), "{trial:?}");
        let status = engine.control.inbox.status.borrow();
        assert_eq!(status.run.as_ref().unwrap().retries, retries, "{trial:?}");
    }
}

#[tokio::test]
async fn an_abort_of_a_jog_and_each_trip_for_a_person_hold_the_queue() {
    let (job, (axes, mut engine, handle)) = (job(), with_handle());
    axes.x.keep_moving();
    let (stage, control) = parts(&mut engine);
    let target = [Target::of(AxisName::X, 100.0)];
    let travel = stage.travel(control, &target);
    let abort = async {
        tokio::time::sleep(Duration::from_millis(30)).await;
        handle.ask(Request::AbortMotion).await
    };
    let (moved, aborted) = tokio::join!(travel, abort);
    assert!(matches!(moved, Err(Halt::Asked)) && aborted.is_ok());
    assert_eq!(signs(&engine), 1);
    // A lost wire may pass while a run is active; what comes to it may not.
    trip(&mut engine, &job);
    assert_eq!(signs(&engine), 1);
    let detail = "the computer was suspended".to_owned();
    engine.control.latch(&Trip { kind: TripKind::Service, detail });
    assert_eq!(signs(&engine), 2);
    engine.control.forget_run();
    engine.control.show(|status| status.run = None);
    engine.control.latch(&Trip { kind: TripKind::Wire, detail: "no reply".into() });
    assert_eq!(signs(&engine), 3);
}

#[tokio::test]
async fn an_abort_of_a_motion_that_arrives_once_a_run_has_begun_aborts_that_run() {
    let job = job();
    let (_, mut engine, handle) = with_handle();
    begin(&mut engine, &job);
    let (aborted, moved) = asked_while_moving(&mut engine, &handle, Request::AbortMotion).await;
    assert!(aborted.is_ok() && matches!(moved, Err(Halt::Asked)), "{aborted:?}");
    assert_eq!(engine.control.run(), RunState::Aborting);
}

/// The answer to requests that the engine takes up.
async fn answered<T>(engine: &mut Engine, asked: impl Future<Output = T>) -> T {
    let answer = tokio::select! {
        () = engine.take_requests() => None,
        answer = asked => Some(answer),
    };
    answer.expect("the engine serves")
}

#[tokio::test]
async fn no_run_begins_if_the_run_before_it_was_aborted_as_it_ended() {
    let (job, (_, mut engine, handle)) = (Arc::new(job()), with_handle());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    // The abort waited until the run had ended, and the next one was requested before it was taken up.
    let start = || handle.ask(Request::Start(job.clone()));
    let both = async { tokio::join!(handle.ask(Request::Abort), start()) };
    let (aborted, started) = answered(&mut engine, both).await;
    assert!(matches!(aborted, Err(Refusal::State(_))), "{aborted:?}");
    assert!(matches!(started, Err(Refusal::Busy(_))), "{started:?}");
    assert_eq!((engine.control.run(), signs(&engine)), (RunState::Idle, 1));
    assert_eq!(answered(&mut engine, start()).await, Ok(()), "a person starts it again");
}

#[tokio::test]
async fn no_run_begins_if_a_pause_or_an_abort_came_after_the_end_of_the_run_before_it() {
    let (job, (_, mut engine, handle)) = (Arc::new(job()), with_handle());
    engine.control.rig_event(RigEvent::Homed).unwrap();
    let start = handle.ask(Request::Start(job.clone()));
    let both = async { tokio::join!(handle.ask(Request::CameLate), start) };
    let (noted, started) = answered(&mut engine, both).await;
    assert_eq!((noted, signs(&engine)), (Ok(()), 1));
    assert!(matches!(started, Err(Refusal::Busy(_))), "{started:?}");
    // One that has begun before it continues; what waits for its end is dropped.
    begin(&mut engine, &job);
    let (noted, moved) = asked_while_moving(&mut engine, &handle, Request::CameLate).await;
    assert!(noted.is_ok() && moved.is_ok(), "{moved:?}");
    assert_eq!((engine.control.run(), signs(&engine)), (RunState::Running, 2));
}

#[tokio::test]
async fn an_entry_of_tips_whose_caller_was_told_that_it_failed_is_not_carried_out() {
    let (_, mut engine) = engine();
    let (answer, caller) = oneshot::channel();
    drop(caller);
    assert_eq!(engine.mounted(1, "ada", &answer).await, Err(Refusal::Gone));
    assert!(engine.mounting.is_none());
}
