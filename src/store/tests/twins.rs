//! Twins: pending until they are stored, stored once, deleted with a discarded trial.
//! Uses: `store`. Never: a model (the numbers here are invented).

use super::{hex_trial, is_intact, with_run};
use crate::ids::{TrialId, TrialKey};
use crate::journal::Journal;
use crate::{NewTwinModel, RunKind, Store, Twin, TwinModelId, TwinOutcome};

pub(super) async fn model(store: &Store, hash: &str) -> TwinModelId {
    let new = NewTwinModel {
        hash: hash.into(),
        sensor_sha256: "s".into(),
        calibration_id: None,
        version: "0.1.0".into(),
        git_commit: None,
    };
    store.twin_model(new).await.unwrap()
}

pub(super) fn frame(trial: TrialId, fvu: f64) -> Twin {
    let voltages_v = vec![0.25; 784];
    Twin { trial, outcome: TwinOutcome::Frame { voltages_v, rmse_v: 0.01, fvu: Some(fvu) } }
}

#[tokio::test]
async fn what_is_pending_is_what_is_not_there() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let mut ids = Vec::new();
    for configuration in 0..5 {
        ids.push(store.trial(run, &hex_trial(configuration, 0, &[7.0])).await.unwrap());
    }
    let first = model(&store, "sim-1").await;
    assert_eq!(model(&store, "sim-1").await, first, "a model is stored once");
    let pending = async |model, after| -> Vec<TrialId> {
        let trials = store.pending_twins(run, model, after, 3).await.unwrap();
        assert!(trials.iter().all(|t| t.voltages_v.as_ref().is_some_and(|v| v.len() == 784)));
        trials.iter().map(|t| t.trial_id).collect()
    };
    assert_eq!(pending(first, TrialId(0)).await, ids[..3]);
    assert_eq!(pending(first, ids[2]).await, ids[3..]);

    let failure = TwinOutcome::Failure("a contact off the skin".into());
    let twins = vec![frame(ids[0], 0.1), Twin { trial: ids[1], outcome: failure }];
    store.insert_twins(first, twins.clone()).await.unwrap();
    // Again, with another number: the stored twin does not change.
    store.insert_twins(first, vec![frame(ids[0], 0.9)]).await.unwrap();
    assert_eq!(pending(first, TrialId(0)).await, ids[2..]);
    assert_eq!(store.twins_of(first, &ids).await.unwrap(), twins);
    assert_eq!(store.twins_of(first, &ids[1..2]).await.unwrap(), twins[1..]);
    let count = store.twin_count(run, first).await.unwrap();
    assert_eq!((count.trials, count.twins, count.failures, count.pending()), (5, 1, 1, 3));
    assert_eq!(store.runs_with_trials().await.unwrap(), [run]);

    // Another model has no twins yet, and trials show the newest one.
    let second = model(&store, "sim-2").await;
    assert_eq!(pending(second, TrialId(0)).await, ids[..3]);
    let shown = async || store.trial_by_id(ids[0]).await.unwrap().unwrap();
    assert_eq!(shown().await.fvu, Some(0.1));
    store.insert_twins(second, vec![frame(ids[0], 0.05)]).await.unwrap();
    let trial = shown().await;
    assert_eq!((trial.fvu, trial.rmse_v), (Some(0.05), Some(0.01)));
    assert_eq!(trial.sim_voltages_v, Some(vec![0.25; 784]));
    assert_eq!(store.trial_by_id(ids[1]).await.unwrap().unwrap().fvu, None, "a failure has none");

    let newest = store.newest_twins(run, TrialId(0), 10).await.unwrap();
    assert_eq!(newest.iter().map(|(trial, _)| *trial).collect::<Vec<_>>(), ids);
    let models: Vec<i64> = newest.iter().map(|(_, model)| *model).collect();
    assert!(models[0] > models[1] && models[1] > 0 && models[2..] == [0_i64; 3], "{models:?}");
    assert_eq!(store.newest_twins(run, ids[0], 2).await.unwrap(), newest[1..3]);

    let fits = store.fits(run).await.unwrap();
    let [fit] = &fits[..] else { panic!("one trial has a frame: {fits:?}") };
    assert_eq!((fit.trial, fit.fvu, fit.contact_count), (ids[0], Some(0.05), 1));
    assert!(fit.single_tip_mm.is_some());
    is_intact(&store).await;
}

#[tokio::test]
async fn a_trial_that_was_taken_back_has_no_twin() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let trial = store.trial(run, &hex_trial(0, 0, &[7.0])).await.unwrap();
    let other = store.trial(run, &hex_trial(1, 0, &[7.0])).await.unwrap();
    let model = model(&store, "sim-1").await;
    store.insert_twins(model, vec![frame(trial, 0.1)]).await.unwrap();
    let key = TrialKey { configuration: 0, depth_index: 0 };
    store.discard(run, key, "a hand slipped").await.unwrap();
    // Its twin was being stored, together with another one.
    store.insert_twins(model, vec![frame(trial, 0.2), frame(other, 0.3)]).await.unwrap();
    let count = store.twin_count(run, model).await.unwrap();
    assert_eq!((count.trials, count.twins, count.pending()), (1, 1, 0));
    is_intact(&store).await;
}
