//! Trials: stored and read bit for bit, once per key, labelled by the deadband, discarded, in pages.
//! Uses: `store`, `campaign`. Never: processes (see `tests/it/store_durability.rs`).

use std::sync::Arc;

use super::{
    EARLY_RUN, Folder, execute, hex_trial, is_intact, new_run, now, random_trial, time, with_run,
};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::Journal;
use crate::record::{Flag, TrialScalars, Untouched};
use crate::{Condition, Order, RunKind, SettingCount, StoreError, TrialQuery};

fn that(condition: &str) -> Condition {
    Condition::parse(condition).unwrap()
}

#[tokio::test]
async fn a_trial_comes_back_bit_for_bit() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let put = hex_trial(3, 7, &[0.1 + 0.2, 5.0, 4.999_999_999, -0.31, 41.7]);
    let id = store.trial(run, &put).await.unwrap();
    let got = store.trial_by_id(id).await.unwrap().unwrap();
    assert_eq!((got.run, got.configuration, got.depth_index, got.attempt), (run, 3, 7, 1));
    assert_eq!((got.target, got.reached, got.depth_mm), (put.target, put.reached, put.depth_mm));
    assert_eq!(got.arms, put.arms);
    assert_eq!(
        got.forces_n,
        [Some(0.1 + 0.2), Some(5.0), Some(4.999_999_999), Some(-0.31), Some(41.7), None]
    );
    assert_eq!((got.settle_ms, got.scalars), (Some(put.settle_ms), put.scalars));
    let times = (Some(put.started_at), Some(put.measured_at));
    assert_eq!((got.started_at, got.measured_at), times);
    assert_eq!(got.quality, put.quality);
    assert_eq!(got.flags, []);
    // A force at the deadband counts, a force just below it does not.
    assert_eq!((got.contact_count, got.max_force_n), (2, Some(41.7)));
    let contacts: Vec<_> = got.contacts.iter().map(|c| (c.force_n, c.diameter_mm)).collect();
    assert_eq!(contacts, [(Some(5.0), Some(20.0)), (Some(41.7), Some(20.0))]);

    assert_eq!(store.frames(id).await.unwrap(), put.frames);
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let mean = bits(&put.mean_voltages_v());
    assert_eq!(bits(&store.trial_voltages(id).await.unwrap().unwrap()), mean);
    assert_eq!(bits(&got.voltages_v.unwrap()), mean);
    assert_eq!(store.trial_by_id(TrialId(id.0 + 1)).await.unwrap(), None);
}

#[tokio::test]
async fn weights_under_the_deadband_stay_contacts() {
    let (_folder, store, run) = with_run(RunKind::RealRandom).await;
    let put = random_trial(0, 3);
    let id = store.trial(run, &put).await.unwrap();
    let got = store.trial_by_id(id).await.unwrap().unwrap();
    assert_eq!((got.contact_count, got.max_force_n), (3, Some(4.905)));
    assert_eq!(got.contacts.len(), 3);
    assert_eq!((got.depth_mm, got.target), (None, None));
    assert_eq!(got.scalars, TrialScalars::default());
    assert_eq!(got.forces_n, [None; 6]);
    assert_eq!((got.placed_by.as_deref(), got.frame_count), (Some("Ada"), 2));
    assert_eq!(got.flags, put.flags);
    assert_eq!(store.frames(id).await.unwrap(), put.frames);
    assert_eq!(store.contact_counts(run).await.unwrap(), [0, 0, 0, 1, 0, 0, 0]);
}

#[tokio::test]
async fn a_key_is_stored_once() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let first = hex_trial(0, 0, &[9.0]);
    let id = store.trial(run, &first).await.unwrap();
    let mut second = hex_trial(0, 0, &[11.0, 12.0]);
    second.attempt = 2;
    assert_eq!(store.trial(run, &second).await.unwrap(), id);
    let got = store.trial_by_id(id).await.unwrap().unwrap();
    assert_eq!((got.attempt, got.arms), (1, first.arms));
    assert_eq!(store.progress(run).await.unwrap().stored.len(), 1);
    // The same key in another run is another trial.
    let other = store.create_run(new_run(RunKind::RealHex)).await.unwrap().uid;
    assert_ne!(store.trial(other, &second).await.unwrap(), id);
}

#[tokio::test]
async fn a_bad_record_is_refused_whole() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let mut none = hex_trial(0, 0, &[9.0]);
    none.frames.clear();
    let mut nan = hex_trial(0, 0, &[9.0]);
    nan.scalars = TrialScalars::all(f64::NAN);
    let mut uneven = hex_trial(0, 0, &[9.0]);
    uneven.frames.push(uneven.frames[0].clone());
    uneven.frames[1].counts.pop();
    let mut arm = hex_trial(0, 0, &[9.0, 9.0]);
    arm.arms[1].arm = 7;
    for bad in [none, nan, uneven, arm] {
        store.trial(run, &bad).await.unwrap_err();
    }
    assert!(store.trials(&TrialQuery { limit: 9, ..Default::default() }).await.unwrap().is_empty());
    // The refusals left the writer usable.
    store.trial(run, &hex_trial(0, 0, &[9.0])).await.unwrap();
}

#[tokio::test]
async fn a_commit_that_failed_but_was_stored_is_found() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let trial = hex_trial(0, 0, &[9.0]);
    store.inner.writer.fail_after_next_commit().await.unwrap();
    let id = store.trial(run, &trial).await.unwrap();
    assert_eq!(store.trial(run, &trial).await.unwrap(), id);
    assert_eq!(store.contact_counts(run).await.unwrap().iter().sum::<u64>(), 1);
    // A write without a key cannot be found again: the failure is returned.
    store.inner.writer.fail_after_next_commit().await.unwrap();
    store.append_event(None, "state", serde_json::json!({})).await.unwrap_err();
    store.append_event(None, "state", serde_json::json!({})).await.unwrap();
    // A trial is discarded by a commit that only reported a failure.
    store.inner.writer.fail_after_next_commit().await.unwrap();
    store.discard(run, trial.key, "again").await.unwrap();
    assert_eq!(store.trial_by_id(id).await.unwrap(), None);
}

#[tokio::test]
async fn a_full_disk_is_an_error_and_later_trials_are_stored() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    store
        .write("filling the disk", async |c| {
            let pages: i64 =
                sqlx::query_scalar("PRAGMA page_count").fetch_one(&mut *c).await.unwrap();
            let sql = format!("PRAGMA max_page_count = {}", pages + 2);
            sqlx::query(sqlx::AssertSqlSafe(sql)).execute(c).await.unwrap();
            Ok(())
        })
        .await
        .unwrap();
    let mut stored = 0;
    let error = loop {
        match store.trial(run, &hex_trial(stored, 0, &[9.0, 3.0])).await {
            Ok(_) => stored += 1,
            Err(error) => break error,
        }
        assert!(stored < 1000, "the limit did not hold");
    };
    let cause = error.source.downcast_ref::<StoreError>().unwrap();
    let StoreError::NotStored { source, .. } = cause else { panic!("{cause:?}") };
    let words = std::error::Error::source(source).unwrap().to_string();
    assert!(words.contains("full"), "{words}");
    assert_eq!(store.progress(run).await.unwrap().stored.len(), stored as usize);
    // The writer opened a new connection, without the limit: there is space again.
    store.trial(run, &hex_trial(stored, 0, &[9.0, 3.0])).await.unwrap();
    is_intact(&store).await;
}

#[tokio::test]
async fn labels_follow_from_raw_forces_and_any_deadband() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    for (c, forces) in [&[1.0, 2.0][..], &[6.0, 2.0], &[6.0, 7.0], &[20.0], &[4.0, 9.0, 9.0]]
        .into_iter()
        .enumerate()
    {
        store.trial(run, &hex_trial(c as u32, 0, forces)).await.unwrap();
    }
    assert_eq!(store.contact_counts(run).await.unwrap(), [1, 2, 2, 0, 0, 0, 0]);
    let trials = store.trials(&TrialQuery { limit: 9, ..Default::default() }).await.unwrap();
    let counts_at = |deadband_n: f64| {
        let mut counts = [0; 7];
        for trial in &trials {
            let forces_n = trial.forces_n.iter().flatten();
            counts[forces_n.filter(|force_n| **force_n >= deadband_n).count()] += 1;
        }
        counts
    };
    assert_eq!(counts_at(5.0), store.contact_counts(run).await.unwrap());
    assert_eq!(counts_at(0.0), [0, 1, 3, 1, 0, 0, 0]);
    assert_eq!(counts_at(8.0), [3, 1, 1, 0, 0, 0, 0]);
    let settings = store.stored_per_setting(run).await.unwrap();
    let row = |tips, stored| SettingCount { tips, stored };
    assert_eq!(settings, [row(1, 1), row(2, 3), row(3, 1)]);
}

#[tokio::test]
async fn a_trial_taken_back_keeps_its_record_and_frees_its_key() {
    let (_folder, store, run) = with_run(RunKind::RealRandom).await;
    let (kept, back) = (random_trial(0, 2), random_trial(1, 4));
    store.trial(run, &kept).await.unwrap();
    let id = store.trial(run, &back).await.unwrap();
    store.discard(run, back.key, "a weight fell").await.unwrap();
    assert_eq!(store.trial_by_id(id).await.unwrap(), None);
    assert!(store.frames(id).await.unwrap().is_empty());
    let progress = store.progress(run).await.unwrap();
    assert_eq!(progress.stored.into_iter().collect::<Vec<_>>(), [kept.key]);
    assert_eq!((progress.retries, store.attempts(run, 9).await.unwrap().len()), (1, 1));
    let attempts = store.attempts(run, 10).await.unwrap();
    assert_eq!((attempts[0].key, attempts[0].reason.as_str()), (back.key, "a weight fell"));

    let (record, frames): (String, i64) = sqlx::query_as(
        "SELECT record, (SELECT count(*) FROM attempt_frames) FROM attempts WHERE trial = ?1",
    )
    .bind(id.0)
    .fetch_one(&store.inner.readers)
    .await
    .unwrap();
    let record: crate::TrialRow = serde_json::from_str(&record).unwrap();
    assert_eq!((record.trial_id, record.contacts.len(), frames), (id, 4, 2));

    // Measured again, it is another trial with another id.
    let again = store.trial(run, &back).await.unwrap();
    assert!(again > id);
    store.discard(run, TrialKey { configuration: 9, depth_index: 9 }, "no").await.unwrap_err();
    is_intact(&store).await;
}

#[tokio::test]
async fn pages_meet_every_trial_once_and_filters_hold() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let other = store.create_run(new_run(RunKind::RealHex)).await.unwrap().uid;
    for c in 0..15 {
        for d in 0..3 {
            let mut trial = hex_trial(c, d, &[f64::from(c), f64::from(d) * 4.0]);
            if c == 4 {
                trial.flags.push(Flag::DepthMissed);
            }
            store.trial(run, &trial).await.unwrap();
            store.trial(other, &trial).await.unwrap();
        }
    }
    for order in [Order::OldestFirst, Order::NewestFirst] {
        let mut query = TrialQuery { run: Some(run), limit: 7, order, ..Default::default() };
        let mut seen = Vec::new();
        loop {
            let page = store.trials(&query).await.unwrap();
            let Some(last) = page.last() else { break };
            query.after = Some(last.trial_id);
            seen.extend(page.iter().map(|t| (t.configuration, t.depth_index)));
        }
        if order == Order::NewestFirst {
            seen.reverse();
        }
        let all: Vec<_> = (0..15).flat_map(|c| (0..3).map(move |d| (c, d))).collect();
        assert_eq!(seen, all);
    }

    let ask = async |filters: Vec<Condition>| {
        let query = TrialQuery { run: Some(run), filters, limit: 100, ..Default::default() };
        store.trials(&query).await.unwrap()
    };
    // Forces are c and 4 d, N: both at or above 5 N for c >= 5 and d = 2.
    let two = ask(vec![that("contact_count__eq=2.0")]).await;
    assert_eq!(two.len(), 10);
    assert!(two.iter().all(|t| t.depth_index == 2 && t.contacts.len() == 2));
    let strong = ask(vec![that("contact_count__eq=2.0"), that("max_force_n__gt=12.0")]).await;
    assert_eq!(strong.iter().map(|t| t.configuration).collect::<Vec<_>>(), [13, 14]);
    let some = ask(vec![that("configuration__in=1,3"), that("depth_index__lte=1")]).await;
    assert_eq!(some.len(), 4);
    assert!(ask(vec![that("tips__in=77,78")]).await.is_empty());
    assert!(ask(vec![that("seed=1")]).await.is_empty(), "no stored trial has a seed");
    let late = that("started_at__gte=2026-11-20T18:00:00.123Z");
    assert_eq!(ask(vec![late]).await.len(), 45);
    assert_eq!(ask(vec![that(&format!("run={run}"))]).await.len(), 45);
    assert!(ask(vec![that("label__in=virtual,none"), that("experiment=other")]).await.is_empty());
}

#[tokio::test]
async fn flags_and_voltages_are_brought_when_asked_for() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let mut flagged = hex_trial(1, 0, &[9.0]);
    flagged.flags = vec![Flag::Unsettled, Flag::DroppedFrames];
    store.trial(run, &hex_trial(0, 0, &[9.0])).await.unwrap();
    store.trial(run, &flagged).await.unwrap();
    let base = TrialQuery { run: Some(run), limit: 9, ..Default::default() };
    let found = async |query: TrialQuery| -> Vec<u32> {
        store.trials(&query).await.unwrap().iter().map(|t| t.configuration).collect()
    };
    assert_eq!(found(TrialQuery { flagged: Some(true), ..base.clone() }).await, [1]);
    assert_eq!(found(TrialQuery { flagged: Some(false), ..base.clone() }).await, [0]);
    let both = vec![Flag::DroppedFrames, Flag::Unsettled];
    assert_eq!(found(TrialQuery { flags: both, ..base.clone() }).await, [1]);
    let other = vec![Flag::StillCell];
    assert!(found(TrialQuery { flags: other, ..base.clone() }).await.is_empty());
    assert!(store.trials(&base).await.unwrap().iter().all(|t| t.voltages_v.is_none()));
    let with = store.trials(&TrialQuery { with_voltages: true, ..base }).await.unwrap();
    assert_eq!(with[1].voltages_v, Some(flagged.mean_voltages_v()));
}

#[tokio::test]
async fn pages_follow_an_index_without_sorting() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let after = Some(TrialId(0));
    let of_run = TrialQuery { run: Some(run), after, limit: 10, ..Default::default() };
    let steps = store.explain(&of_run).await.unwrap();
    assert!(steps[0].contains("INDEX trials_in_order (run=? AND id>?)"), "{steps:?}");
    let all = TrialQuery { after, limit: 10, with_voltages: true, ..Default::default() };
    let plain = store.explain(&all).await.unwrap();
    assert!(plain[0].contains("INTEGER PRIMARY KEY"), "{plain:?}");
    for step in steps.iter().chain(&plain) {
        assert!(!step.contains("TEMP B-TREE"), "{step}");
    }
    let filters = vec![that("contact_count__eq=3.0"), that("max_force_n__gt=10.0")];
    let query = TrialQuery { filters, after, limit: 10, ..Default::default() };
    let steps = store.explain(&query).await.unwrap();
    assert!(steps[0].contains("SEARCH b USING INTEGER PRIMARY KEY (rowid>?)"), "{steps:?}");
    let index = "COVERING INDEX trials_by_contacts (contact_count=? AND id>? AND id<?)";
    assert!(steps[1].contains(index) && steps.len() == 2, "{steps:?}");
}

#[tokio::test]
async fn the_lengths_of_frames_are_those_of_the_given_trials() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let other = store.create_run(new_run(RunKind::RealHex)).await.unwrap().uid;
    let mut ids = Vec::new();
    for n in 0..3 {
        let mut trial = hex_trial(n, 0, &[9.0]);
        ids.push(store.trial(run, &trial).await.unwrap());
        trial.frames[0].counts.truncate(100);
        ids.push(store.trial(other, &trial).await.unwrap());
    }
    let lengths = async |at: &[usize]| {
        let ids: Vec<TrialId> = at.iter().map(|&at| ids[at]).collect();
        store.frame_lengths(&ids).await.unwrap()
    };
    assert!(lengths(&[]).await.is_empty());
    assert_eq!(lengths(&[0]).await, [784]);
    assert_eq!(lengths(&[5]).await, [100]);
    assert_eq!(lengths(&[4, 0]).await, [784], "the other run has trials between them");
    assert_eq!(lengths(&[3, 2, 1]).await, [100, 784]);
    // A page that was found before a trial of it was discarded.
    store.discard(other, TrialKey { configuration: 1, depth_index: 0 }, "late").await.unwrap();
    assert!(lengths(&[3]).await.is_empty());
    assert_eq!(lengths(&[2, 3]).await, [784]);
    assert_eq!(lengths(&[3, 2, 1]).await, [100, 784]);
}

#[tokio::test]
async fn a_trial_has_the_untouched_skin_that_was_measured_last_before_it() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let trial = |configuration| hex_trial(configuration, 0, &[10.0]);
    let started_at = trial(0).started_at;
    let skin = |before_s: i64, volts: f32| Untouched {
        voltages_v: vec![volts, -volts, 1e-3],
        at: started_at - jiff::SignedDuration::from_secs(before_s),
        frames: 4,
        run: Some(run),
        stream_since: (before_s < 60).then_some(started_at),
    };
    let first = store.trial(run, &trial(0)).await.unwrap();
    assert!(store.untouched_before(&[first]).await.unwrap().is_empty());
    for (before_s, volts) in [(60, 1.0), (2, 2.0)] {
        store.untouched(run, &skin(before_s, volts)).await.unwrap();
    }
    let early = store.trial(run, &trial(1)).await.unwrap();
    let late = store.trial(run, &trial(2)).await.unwrap();
    // Between these two the clock is set back by an hour.
    for (before_s, volts) in [(-5, 3.0), (3600, 4.0)] {
        store.untouched(run, &skin(before_s, volts)).await.unwrap();
    }
    let last = store.trial(run, &trial(3)).await.unwrap();
    let before = store.untouched_before(&[first, early, late, last, TrialId(99)]).await.unwrap();
    let found = before.get(&early).unwrap();
    assert_eq!((*found.skin).clone(), skin(2, 2.0));
    assert_eq!((found.trial_started_at, before.len()), (started_at, 3));
    assert!(Arc::ptr_eq(&found.skin, &before[&late].skin));
    assert_eq!((*before[&last].skin).clone(), skin(3600, 4.0));
    let all = store.untouched_frames(run, 3).await.unwrap();
    assert_eq!(all, [skin(60, 1.0), skin(2, 2.0), skin(-5, 3.0)]);
    let nothing = Untouched { voltages_v: vec![f32::NAN], ..skin(1, 0.0) };
    assert!(store.untouched(run, &nothing).await.unwrap_err().refused);
    execute(&store, "UPDATE untouched_frames SET voltages_v = zeroblob(12)").await;
    let error = store.untouched_before(&[early]).await.unwrap_err().to_string();
    assert!(error.contains("the untouched skin 2 was changed"), "{error}");
}

/// A file of the version that did not store the order of trials and frames: their times determine it.
#[tokio::test]
async fn untouched_frames_of_an_earlier_version_are_placed_by_their_times() {
    let folder = Folder::new();
    let filled =
        "INSERT INTO trials (id, run, configuration, depth_index, attempt, tips, flags, settle_ms,
             contact_count, frame_count, started_at, measured_at)
         VALUES (5, 1, 0, 0, 1, 1, '[]', 1.5, 1, 1, '2026-11-20T18:00:01.000Z',
             '2026-11-20T18:00:02.000Z'),
             (6, 1, 1, 0, 1, 1, '[]', 1.5, 1, 1, '2026-11-20T18:00:05.000Z',
             '2026-11-20T18:00:06.000Z'),
             (7, 1, 2, 0, 1, 1, '[]', 1.5, 1, 1, '2026-11-20T18:00:08.000Z',
             '2026-11-20T18:00:09.000Z');
         INSERT INTO untouched_frames (id, run, at, frame_count, voltages_v, crc32)
         VALUES (1, 1, '2026-11-20T18:00:03.000Z', 30, x'0000803f', 2896259690),
             (2, 1, '2026-11-20T18:00:05.000Z', 30, x'00000040', 1469619852);";
    let store = folder.open_from_before(25, &[EARLY_RUN, filled]).await;
    is_intact(&store).await;
    let run = store.run_by_scan_id(1).await.unwrap().unwrap().uid;
    let skin = Untouched {
        voltages_v: vec![3.0],
        at: time("2026-11-20T17:00:00Z"),
        frames: 30,
        run: Some(run),
        stream_since: None,
    };
    store.untouched(run, &skin).await.unwrap();
    let next = store.trial(run, &random_trial(3, 1)).await.unwrap();
    let trials = [TrialId(5), TrialId(6), TrialId(7), next];
    let before = store.untouched_before(&trials).await.unwrap();
    let volts = trials.map(|trial| before.get(&trial).map(|found| found.skin.voltages_v[0]));
    assert_eq!(volts, [None, Some(2.0), Some(2.0), Some(3.0)]);
}

#[tokio::test]
async fn a_skip_keeps_its_first_reason_and_time() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let at = time("2026-11-20T18:00:00.5Z");
    store.skip(run, 5, "cell 2: 0 V three times", at).await.unwrap();
    store.skip(run, 5, "again", now()).await.unwrap();
    let skips = store.skips(run).await.unwrap();
    assert_eq!((skips.len(), skips[0].reason.as_str()), (1, "cell 2: 0 V three times"));
    assert_eq!(skips[0].at, at, "when it happened, not when it was written");
    let skipped = store.progress(run).await.unwrap().skipped;
    assert_eq!(skipped.into_iter().collect::<Vec<_>>(), [5]);
    let missing = store.skip(RunUid::new(), 5, "cell 2: 0 V", at).await.unwrap_err();
    let cause = missing.source.downcast_ref::<StoreError>();
    assert!(matches!(cause, Some(StoreError::NoSuchRun(_))), "{missing:?}");
}

#[tokio::test]
async fn a_caller_that_goes_away_leaves_a_whole_trial() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    store.trial(run, &hex_trial(0, 0, &[9.0])).await.unwrap();
    let put = hex_trial(1, 0, &[9.0, 8.0]);
    // The first poll submits the trial; then its caller no longer waits.
    let gone = tokio::time::timeout(std::time::Duration::ZERO, store.trial(run, &put)).await;
    // The writer works in order: when this is stored, so is the trial.
    store.set_lock("Ada", "").await.unwrap();
    let stored = store.trials(&TrialQuery { limit: 9, ..Default::default() }).await.unwrap();
    assert_eq!(stored.len(), 2, "{gone:?}");
    assert_eq!(stored[1].arms, put.arms);
}

#[tokio::test]
async fn a_long_read_neither_waits_nor_is_waited_for() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    store.trial(run, &hex_trial(0, 0, &[9.0])).await.unwrap();
    let mut view = store.read("a long read").await.unwrap();
    let count = "SELECT count(*) FROM trials";
    let before: i64 = sqlx::query_scalar(count).fetch_one(&mut *view).await.unwrap();
    for c in 1..20 {
        store.trial(run, &hex_trial(c, 0, &[9.0])).await.unwrap();
    }
    let within: i64 = sqlx::query_scalar(count).fetch_one(&mut *view).await.unwrap();
    assert_eq!((before, within), (1, 1));
    assert_eq!(store.progress(run).await.unwrap().stored.len(), 20);
}
