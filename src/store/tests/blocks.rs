//! Blocks of trials: a condition finds by their bounds what it finds one by one, and a bound that excludes a
//! stored trial is damage.
//! Uses: `store`. Never: a file of 1024 trials (ids are skipped instead).

use super::twins::{frame, model};
use super::{Folder, execute, findings, fresh, hex_trial, new_run, open};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::Journal;
use crate::record::Flag;
use crate::{Condition, Order, RunKind, Soundness, Store, TrialQuery};

/// Number of trials of each run.
const TRIALS: u32 = 12;

/// Two runs whose trials alternate, in four blocks. The largest force of trial n is 3 n N, its twin has an
/// FVU of n / 100; trial 5 has a flag, trials 2 and 3 have no twin, trial 11 of the second run is discarded.
async fn filled() -> (Folder, Store, [RunUid; 2]) {
    let (folder, store) = fresh().await;
    let mut runs = [RunUid::new(); 2];
    for run in &mut runs {
        *run = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    }
    let model = model(&store, "sim-1").await;
    for n in 0..TRIALS {
        let mut trial = hex_trial(n, 0, &[3.0 * f64::from(n)]);
        if n == 5 {
            trial.flags.push(Flag::Unsettled);
        }
        for run in runs {
            let id = store.trial(run, &trial).await.unwrap();
            if !(2..4).contains(&n) {
                let twin = frame(id, f64::from(n) / 100.0);
                store.insert_twins(model, vec![twin]).await.unwrap();
            }
        }
        if n % 3 == 2 {
            execute(&store, "UPDATE sqlite_sequence SET seq = seq + 1020 WHERE name = 'trials'")
                .await;
        }
    }
    let key = TrialKey { configuration: 11, depth_index: 0 };
    store.discard(runs[1], key, "a test").await.unwrap();
    (folder, store, runs)
}

fn that(conditions: &[&str]) -> Vec<Condition> {
    conditions.iter().map(|text| Condition::parse(text).unwrap()).collect()
}

/// The configurations of the found trials of the second run, in pages of two.
async fn found(store: &Store, query: &TrialQuery) -> Vec<u32> {
    let mut query = TrialQuery { limit: 2, ..query.clone() };
    let mut all = Vec::new();
    loop {
        let page = store.trials(&query).await.unwrap();
        let Some(last) = page.last() else { return all };
        query.after = Some(last.trial_id);
        all.extend(page.iter().map(|trial| trial.configuration));
    }
}

#[tokio::test]
async fn a_condition_finds_the_same_trials_by_blocks_as_one_by_one() {
    let (_folder, store, [_, run]) = filled().await;
    let base = TrialQuery { run: Some(run), ..Default::default() };
    let ids: Vec<TrialId> = store
        .trials(&TrialQuery { limit: 100, ..base.clone() })
        .await
        .unwrap()
        .iter()
        .map(|trial| trial.trial_id)
        .collect();
    let blocks: Vec<i64> = ids.iter().map(|id| id.0 >> 10).collect();
    assert_eq!(blocks, [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3]);
    let (fifth, ninth) = (ids[5].0, ids[9].0);
    for (conditions, expected) in [
        (vec!["max_force_n__gt=24"], vec![9, 10]),
        (vec!["max_force_n__gte=24", "depth_error_mm__lt=1"], vec![8, 9, 10]),
        (vec!["max_force_n__lt=3"], vec![0]),
        (vec!["max_force_n__lte=3"], vec![0, 1]),
        (vec!["max_force_n__in=6,27,5000"], vec![2, 9]),
        (vec!["max_force_n=1000|fvu__gte=0.09"], vec![9, 10]),
        (vec!["fvu__lt=0.02"], vec![0, 1]),
        (vec!["fvu__gt=0.11"], vec![]),
        (vec!["saturated_channels__gt=8", "contact_count=1"], vec![9, 10]),
        (vec!["experiment=quickstart", "configuration=4"], vec![4]),
        (vec!["experiment__in=other,none"], vec![]),
        (vec!["sim_model=sim-1", "max_force_n__lt=10"], vec![0, 1]),
        (vec!["measured_at__lt=2026-11-20T18:00:02Z"], vec![]),
        (vec!["measured_at=2026-11-20T18:00:02.004Z", "tips=1", "fvu__lte=0"], vec![0]),
    ] {
        let query = TrialQuery { filters: that(&conditions), ..base.clone() };
        assert_eq!(found(&store, &query).await, expected, "{conditions:?}");
        let back = TrialQuery { order: Order::NewestFirst, ..query };
        let mut reversed = found(&store, &back).await;
        reversed.reverse();
        assert_eq!(reversed, expected, "{conditions:?}, newest first");
    }
    for (condition, expected) in [
        (format!("trial_id__gt={fifth}"), vec![6, 7]),
        (format!("trial_id__in={fifth},{ninth}"), vec![5]),
        (format!("trial_id__lt={fifth}"), vec![1, 4]),
    ] {
        let filters = that(&[condition.as_str(), "max_force_n__lt=23", "fvu__gt=0"]);
        let query = TrialQuery { filters, ..base.clone() };
        assert_eq!(found(&store, &query).await, expected, "{condition}");
    }
    for (flagged, expected) in [(true, vec![5]), (false, vec![0, 1, 2, 3, 4, 6, 7, 8, 9, 10])] {
        let query = TrialQuery { flagged: Some(flagged), ..base.clone() };
        assert_eq!(found(&store, &query).await, expected, "flagged: {flagged}");
    }
    let flags = vec![Flag::Unsettled];
    assert_eq!(found(&store, &TrialQuery { flags, ..base }).await, [5]);
}

#[tokio::test]
async fn pages_by_blocks_are_not_sorted_and_end_at_the_page() {
    let (_folder, store, [run, _]) = filled().await;
    for conditions in [
        vec!["fvu__gt=0.5"],
        vec!["tips=4|fvu__gt=0.5"],
        vec!["contact_count=3", "max_force_n__gt=10"],
        vec!["trial_id__gt=5", "contact_count=3"],
        vec!["experiment=quickstart", "measured_at__gt=2026-11-20T18:00:00Z"],
        vec!["sim_model=sim-1", "settle_ms__lt=5"],
        // For an automatic index SQLite would read every trial.
        vec!["tips=1", "max_force_n__gt=20"],
    ] {
        for (run, order, after) in [
            (None, Order::OldestFirst, Some(TrialId(4000))),
            (Some(run), Order::NewestFirst, Some(TrialId(4000))),
            (None, Order::NewestFirst, None),
        ] {
            let filters = that(&conditions);
            let query = TrialQuery { run, filters, order, after, limit: 10, ..Default::default() };
            let steps = store.explain(&query).await.unwrap();
            let first = if after.is_some() { "SEARCH b USING" } else { "SCAN b" };
            let of_blocks = steps.iter().position(|step| step.starts_with(first));
            let of_trials = steps.iter().position(|step| step.starts_with("SEARCH t USING"));
            assert!(of_blocks.is_some() && of_blocks < of_trials, "{conditions:?}: {steps:?}");
            let sorts = steps.iter().any(|step| step.contains("TEMP B-TREE"));
            assert!(!sorts, "{conditions:?}: {steps:?}");
        }
    }
}

#[tokio::test]
async fn a_bound_that_excludes_a_stored_trial_is_found() {
    for (change, block) in [
        ("UPDATE trial_blocks SET max_force_n_most = 26.5 WHERE block = 3", "3072 to 4095"),
        ("UPDATE trial_blocks SET fvu_least = 0.01 WHERE block = 0", "0 to 1023"),
        ("UPDATE trial_blocks SET flags_least = '[]' WHERE block = 1", "1024 to 2047"),
        ("UPDATE trial_blocks SET depth_error_mm_least = NULL WHERE block = 2", "2048 to 3071"),
        ("DELETE FROM trial_blocks WHERE block = 1", "1024 to 2047"),
    ] {
        let (_folder, store, _) = filled().await;
        assert_eq!(store.examine(1).await.unwrap(), Soundness::Sound);
        execute(&store, change).await;
        let findings = findings(&store).await;
        let [finding] = &findings[..] else { panic!("{change}: {findings:?}") };
        assert!(finding.contains(&format!("the trials {block} ")), "{change}: {finding}");
    }
}

/// Computes the bounds again from the trials; the manual repairs wrong bounds so.
const BOUNDS_AGAIN: &str =
    "DELETE FROM trial_blocks; INSERT INTO trial_blocks SELECT * FROM trial_bounds";

#[tokio::test]
async fn wrong_bounds_are_computed_again_as_the_manual_says() {
    let manual = include_str!("../../../docs/how-to/run-overnight.md");
    assert!(manual.contains(BOUNDS_AGAIN));
    let (folder, store, [_, run]) = filled().await;
    execute(&store, "UPDATE trial_blocks SET max_force_n_most = 1").await;
    execute(&store, BOUNDS_AGAIN).await;
    store.close().await;
    let store = open(&folder.file()).await;
    assert_eq!(store.examine(1).await.unwrap(), Soundness::Sound);
    for (condition, expected) in
        [("max_force_n__gt=24", vec![9, 10]), ("fvu__lt=0.02", vec![0, 1]), ("fvu__gt=0.1", vec![])]
    {
        let filters = that(&[condition]);
        let query = TrialQuery { run: Some(run), filters, ..Default::default() };
        assert_eq!(found(&store, &query).await, expected, "{condition}");
    }
    // Further trials widen them.
    let trial = hex_trial(TRIALS, 0, &[300.0]);
    store.trial(run, &trial).await.unwrap();
    let filters = that(&["max_force_n__gt=100"]);
    let query = TrialQuery { run: Some(run), filters, ..Default::default() };
    assert_eq!(found(&store, &query).await, [TRIALS]);
}
