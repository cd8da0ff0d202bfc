//! Records of the diary, which repeats a write that failed although it may be stored: each record is stored once.
//! Uses: `store`. Never: a trial.

use serde_json::json;

use super::{hex_trial, time, with_run};
use crate::RunKind;
use crate::ids::TrialKey;
use crate::journal::{Journal, Mounting};
use crate::record::{
    ArmTouch, AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, Untouched,
};

#[tokio::test]
async fn a_record_whose_commit_failed_but_was_stored_is_not_stored_again() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let at = time("2026-11-20T18:00:00.5Z");
    let like = hex_trial(2, 0, &[10.0, 11.0]);
    let key = TrialKey { configuration: 5, depth_index: 2 };
    let attempt = AttemptRecord { key, attempt: 1, reason: "cell 2: 0 V".into(), at };
    let tare =
        TareRecord { configuration: 3, volts: vec![(1, 0.501), (2, 0.4987)], samples: 4, at };
    let (voltages_v, stream_since) = (vec![1.0, -1.0], Some(at));
    let skin = Untouched { voltages_v, at, frames: 4, run: Some(run), stream_since };
    let press = ReferenceRecord {
        before_configuration: 0,
        reached: like.reached.unwrap(),
        depth_mm: 3.0,
        arms: like.arms.clone(),
        frame: like.frames[0].clone(),
        at,
    };
    let found = TouchOffRecord {
        tips: 2,
        surface_z_mm: 41.300_1,
        tip_offset_mm: vec![(1, -0.1), (2, 0.1)],
        touches: vec![
            ArmTouch { x_mm: 270.0, y_mm: 280.0, arm: 1, z_mm: 41.2 },
            ArmTouch { x_mm: 270.0, y_mm: 297.3, arm: 2, z_mm: 41.4 },
        ],
        at,
    };
    let mounting = Mounting { tips: 2, live_cells: 4, who: "Ada".into() };
    let data = json!({ "state": "homed" });
    for is_repeated in [false, true] {
        let fail = async || {
            if !is_repeated {
                store.inner.writer.fail_after_next_commit().await.unwrap();
            }
        };
        fail().await;
        assert_eq!(store.attempt(run, &attempt).await.is_ok(), is_repeated);
        fail().await;
        assert_eq!(store.tare(run, &tare).await.is_ok(), is_repeated);
        fail().await;
        assert_eq!(store.untouched(run, &skin).await.is_ok(), is_repeated);
        fail().await;
        assert_eq!(store.reference(run, &press).await.is_ok(), is_repeated);
        fail().await;
        assert_eq!(store.touch_off(run, &found).await.is_ok(), is_repeated);
        fail().await;
        assert_eq!(store.mounted(&mounting, at).await.is_ok(), is_repeated);
        for of in [None, Some(run)] {
            fail().await;
            assert_eq!(store.event(of, "rig", data.clone(), at).await.is_ok(), is_repeated);
        }
    }
    assert_eq!(store.attempts(run, 9).await.unwrap(), std::slice::from_ref(&attempt));
    let progress = store.progress(run).await.unwrap();
    assert_eq!(progress.retries, 1);
    assert!(progress.stored.is_empty(), "none of these is a trial");
    assert_eq!(store.untouched_frames(run, 9).await.unwrap(), [skin]);
    assert_eq!(store.touch_offs(run).await.unwrap(), [found]);
    let mountings = store.write("counting mountings", async |connection| {
        let count = "SELECT count(*) FROM mountings";
        let count: i64 = sqlx::query_scalar(count).fetch_one(connection).await.unwrap();
        Ok(count)
    });
    assert_eq!(mountings.await.unwrap(), 1);
    let events = store.events_since(0, 9, None, &[]).await.unwrap();
    assert_eq!(events.iter().map(|event| event.run).collect::<Vec<_>>(), [None, Some(run)]);
    let again = store.event(Some(run), "rig", data.clone(), at).await.unwrap();
    assert_eq!(again, events[1], "with its number");
    // Others are other records.
    let second = TareRecord { configuration: 4, ..tare.clone() };
    store.tare(run, &second).await.unwrap();
    assert_eq!(store.tares(run).await.unwrap(), [tare, second]);
    let second = ReferenceRecord { before_configuration: 100, ..press.clone() };
    store.reference(run, &second).await.unwrap();
    assert_eq!(store.references(run).await.unwrap(), [press, second]);
    let later = time("2026-11-20T18:00:00.501Z");
    store.event(Some(run), "rig", data, later).await.unwrap();
    assert_eq!(store.last_event_seq().await.unwrap(), events[1].seq + 1);
    store.attempt(run, &AttemptRecord { attempt: 2, ..attempt }).await.unwrap();
    assert_eq!(store.progress(run).await.unwrap().retries, 2);
}
