//! Placements of weights: what is withdrawn when one is repeated, and when the empty skin is tared.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::Instant;

use super::super::{Attempts, Engine, Next};
use super::{abandoned, begin, engine, job, with_handle};
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunEvent};
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::status::{Done, Wanted};
use crate::campaign::trial::untouched::Seen;
use crate::clock::Clock;
use crate::ids::TrialKey;
use crate::schedule::plan::Kind;

/// The run waits for its second placement.
fn await_placement(engine: &mut Engine, job: &Job) {
    begin(engine, job);
    engine.control.run_event(RunEvent::Need(PausedWhy::ManualTrial)).unwrap();
    engine.control.run_event(RunEvent::Raised).unwrap();
    let wanted = Wanted::Placement { trial: 1, contacts: Vec::new() };
    engine.control.show_run(|run| run.wanted = Some(wanted));
}

#[tokio::test]
async fn a_repeat_that_the_store_does_not_take_withdraws_nothing_later() {
    let (job, (axes, mut engine, handle)) = (job(), with_handle());
    let (journal, diary) = (axes.journal.clone(), engine.control.diary.clone());
    journal.stored.lock().insert(TrialKey { configuration: 0, depth_index: 0 });
    journal.discards_fail.store(true, Ordering::SeqCst);
    await_placement(&mut engine, &job);
    let repeats = async move {
        let repeat = || Request::Repeat { trial: Some(0), why: "a weight slipped".into() };
        let refused = handle.ask(repeat()).await;
        assert!(matches!(refused, Err(Refusal::State(_))), "{refused:?}");
        journal.discards_fail.store(false, Ordering::SeqCst);
        // What waits for the store is written.
        while diary.flush().await.is_err() {}
        assert_eq!(journal.stored.lock().len(), 1, "it was refused");
        handle.ask(repeat()).await.unwrap();
        assert!(journal.stored.lock().is_empty());
    };
    let mut attempts = Attempts::default();
    let ((), next) = tokio::join!(repeats, engine.wait(&job, &mut attempts, None));
    assert!(matches!(next, Next::Again));
}

#[tokio::test]
async fn a_repeat_that_may_still_withdraw_a_trial_is_answered_while_its_caller_waits() {
    let (job, (axes, mut engine, handle)) = (job(), with_handle());
    axes.journal.stored.lock().insert(TrialKey { configuration: 0, depth_index: 0 });
    *axes.journal.discards_take.lock() = Duration::from_secs(60);
    await_placement(&mut engine, &job);
    let repeat = Request::Repeat { trial: Some(0), why: "a weight slipped".into() };
    // Most of the time has passed.
    let decided_at = (jiff::Timestamp::now(), Instant::now() - Duration::from_secs(8));
    let repeats = async move { handle.ask_since(repeat, 0, decided_at).await };
    let mut attempts = Attempts::default();
    let (refused, next) = tokio::join!(repeats, engine.wait(&job, &mut attempts, None));
    let Err(Refusal::State(words)) = &refused else { panic!("{refused:?}") };
    assert!(words.starts_with("the store does not answer: "), "{words}");
    assert!(matches!(next, Next::Leave));
}

#[tokio::test]
async fn the_skin_is_not_tared_once_its_caller_was_told_that_it_failed() {
    let (_, mut engine) = engine();
    let skin = engine.connection.as_ref().map(|open| open.skin.clone()).expect("open wires");
    let seen = Seen::next(&skin, &Clock::new(1.0)).await.unwrap();
    let (answer, answered) = oneshot::channel();
    for (answer, is_tared) in [(abandoned(), false), (answer, true)] {
        engine.tare_skin(answer);
        // The second window shows that the skin is at rest.
        for _ in 0..2 {
            engine.saw(Ok(seen.clone()));
        }
        assert_eq!(engine.control.inbox.untouched.borrow().is_some(), is_tared);
    }
    assert_eq!(answered.await, Ok(Ok(())));
}

#[tokio::test]
async fn a_placement_is_refused_if_the_stream_was_opened_again_after_its_zero() {
    let (mut job, (axes, mut engine)) = (job(), engine());
    job.plan.kind = Kind::RealRandom;
    await_placement(&mut engine, &job);
    let skin = engine.connection.as_ref().map(|open| open.skin.clone()).expect("open wires");
    let clock = Clock::new(1.0);
    let (answer, _tared) = oneshot::channel();
    let (waited_for, _caller) = oneshot::channel();
    let done = Done::default();
    let confirmed = engine.confirmed(&job, "ada", done, &waited_for).await;
    assert_eq!(confirmed, Ok(()), "without a zero");
    engine.tare_skin(answer);
    for _ in 0..2 {
        engine.saw(Seen::next(&skin, &clock).await);
    }
    assert_eq!(engine.confirmed(&job, "ada", done, &waited_for).await, Ok(()));
    *axes.skin.since.lock() = Some(jiff::Timestamp::UNIX_EPOCH);
    let refused = engine.confirmed(&job, "ada", done, &waited_for).await;
    let Err(Refusal::State(words)) = &refused else { panic!("{refused:?}") };
    assert!(words.contains("the voltage stream was opened again"), "{words}");
    // The empty skin is seen: the first window follows none of its stream, and the last one is confirmed by none.
    for _ in 0..3 {
        engine.saw(Seen::next(&skin, &clock).await);
    }
    assert_eq!(engine.confirmed(&job, "ada", done, &waited_for).await, Ok(()));
}
