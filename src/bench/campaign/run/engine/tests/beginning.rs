//! A wire that fails as a run begins: a run that begins by itself keeps the rig, and resumes as after a trip in it; a
//! person starts the run again.

use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::oneshot;

use super::{job, latched, signs, with_handle};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::rig_state::{RigEvent, RigState};
use crate::campaign::run::run_state::RunState;
use crate::campaign::shown::command::Refusal;
use crate::campaign::shown::run_action;

#[tokio::test]
async fn a_run_that_begins_by_itself_survives_a_wire_that_fails_for_a_moment() {
    let (mut job, (axes, mut engine, handle)) = (job(), with_handle());
    job.has_waited = true;
    job.plan.policy.auto_resume_after_s = 0.0;
    engine.control.rig_event(RigEvent::Homed).unwrap();
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
    let resumed = tokio::time::timeout(Duration::from_secs(60), resumed).await;
    let resumed = resumed.expect("it resumes").expect("the run stays active");
    assert_eq!((resumed.rig.trip, resumed.attended.signs), (None, 0), "the queue waits behind it");
    assert!(axes.z.starts.load(Ordering::SeqCst) > 0, "the rig was homed before");
}

#[tokio::test]
async fn a_wire_that_fails_as_a_run_is_armed_begins_nothing_for_a_person_or_under_a_lock() {
    for has_waited in [false, true] {
        let (mut job, (axes, mut engine, _handle)) = (job(), with_handle());
        job.has_waited = has_waited;
        engine.control.rig_event(RigEvent::Homed).unwrap();
        axes.z.replies.store(false, Ordering::SeqCst);
        if has_waited {
            axes.journal.lock(1);
        }
        let (answer, begun) = oneshot::channel();
        engine.start(&job, answer, 0).await;
        let is_refused = match begun.await {
            Ok(Err(Refusal::Fault(kind, _))) => !has_waited && kind == TripKind::Wire,
            Ok(Err(Refusal::Busy(_))) => has_waited,
            _ => false,
        };
        assert!(is_refused, "{has_waited}");
        assert_eq!((engine.control.rig(), engine.control.run()), (RigState::Homed, RunState::Idle));
        assert_eq!((latched(&engine), signs(&engine), axes.stops()), (None, 0, 0));
    }
}
