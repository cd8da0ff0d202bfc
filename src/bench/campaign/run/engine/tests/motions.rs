//! A homing and a jog outside a run: what the status shows, and what an abort ends.

use super::{answered, signs, with_handle};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stand_in::StandIns;
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::status::Motion;
use crate::rig::traits::AxisStatus;

#[tokio::test]
async fn a_homing_and_a_jog_are_shown_until_they_end() {
    let axes = StandIns::default();
    let (mut engine, handle) = with_handle(&axes);
    let mut status = handle.watch_status();
    let home = async {
        handle.ask(Request::Home).await.unwrap();
        drop(status.wait_for(|status| status.rig.motion == Some(Motion::Homing)).await.unwrap());
        let ends = status.wait_for(|status| status.rig.state == RigState::Homed);
        ends.await.unwrap().rig.motion
    };
    assert_eq!(answered(&mut engine, home).await, None);
    // It moves until it is stopped.
    *axes.x.after_start.lock() = Some(AxisStatus { moving: true, ..axes.x.present() });
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
    assert_eq!(engine.control.inbox.status.borrow().rig.trip, None);
}

#[tokio::test]
async fn an_abort_while_nothing_moves_holds_the_queue_only_if_a_motion_has_just_ended() {
    let (mut engine, handle) = with_handle(&StandIns::default());
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
