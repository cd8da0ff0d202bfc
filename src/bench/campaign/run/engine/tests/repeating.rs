//! A placement that is repeated: what is withdrawn, and when.

use std::sync::atomic::Ordering;

use super::super::{Attempts, Next};
use super::{begin, job, with_handle};
use crate::campaign::run::run_state::{PausedWhy, RunEvent};
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::status::Wanted;
use crate::ids::TrialKey;

#[tokio::test]
async fn a_repeat_that_the_store_does_not_take_withdraws_nothing_later() {
    let (job, (axes, mut engine, handle)) = (job(), with_handle());
    let (journal, diary) = (axes.journal.clone(), engine.control.diary.clone());
    journal.stored.lock().insert(TrialKey { configuration: 0, depth_index: 0 });
    journal.discards_fail.store(true, Ordering::SeqCst);
    begin(&mut engine, &job);
    engine.control.run_event(RunEvent::Need(PausedWhy::ManualTrial)).unwrap();
    engine.control.run_event(RunEvent::Raised).unwrap();
    let wanted = Wanted::Placement { trial: 1, contacts: Vec::new() };
    engine.control.show_run(|run| run.wanted = Some(wanted));
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
