//! Imports, datasets and exports in the store; and that tables which a migration rebuilds lose nothing.
//! Uses: `store`. Never: files of datasets (see `dataset` and `tests/it/datasets`).

use serde_json::json;

use super::{EARLY_RUN, Folder, execute, findings, fresh, is_intact, new_run, random_trial, time};
use crate::ids::{DatasetId, ModelId, RunUid, TrialKey};
use crate::journal::Journal;
use crate::state::StoredState;
use crate::{
    Condition, Contact, DatasetRow, ImportedTrial, Label, ModelRow, NewRun, RunKind, Soundness,
    Store, TaskEnd, TaskKind, TrialQuery,
};

fn imported() -> NewRun {
    NewRun {
        seed: None,
        rig: None,
        label: Label::Measured,
        deadband_n: 0.0,
        ..new_run(RunKind::Imported)
    }
}

fn elsewhere(configuration: u32) -> ImportedTrial {
    let place = Contact { x_mm: Some(10.0), y_mm: Some(20.5), force_n: None, diameter_mm: None };
    let force = Contact { force_n: Some(3.5), ..Contact::default() };
    ImportedTrial {
        configuration,
        contacts: vec![place, force],
        voltages_v: vec![0.5, f32::NAN, -0.25],
        sim_voltages_v: Some(vec![0.4, 0.0, -0.2]),
        fit: Some((0.07, None)),
        frame_count: 3 * configuration,
        split: (configuration > 0).then(|| "test".to_owned()),
        tag: (configuration > 0).then(|| "tip B".to_owned()),
        ..ImportedTrial::default()
    }
}

async fn all(store: &Store, run: RunUid) -> Vec<crate::TrialRow> {
    let query =
        TrialQuery { run: Some(run), limit: 100, with_voltages: true, ..TrialQuery::default() };
    store.trials(&query).await.unwrap()
}

#[tokio::test]
async fn an_import_is_a_run_whose_trials_lack_what_was_not_known() {
    let (_folder, store) = fresh().await;
    let run = store.begin_import(imported()).await.unwrap();
    assert_eq!(store.run(run.uid).await.unwrap().unwrap().state, StoredState::Removed);
    let model = super::twins::model(&store, "sim-1").await;
    store.import_trials(run.uid, Some(model), vec![elsewhere(0), elsewhere(4)]).await.unwrap();
    let ended = store.end_import(run.uid).await.unwrap();
    assert_eq!((ended.state, ended.seed, ended.rig), (StoredState::Ended, None, None));
    let trials = all(&store, run.uid).await;
    assert_eq!(trials.len(), 2);
    let trial = &trials[1];
    assert_eq!((trial.configuration, trial.tips, trial.contact_count), (4, 2, 2));
    assert_eq!(trial.contacts[0].pressed(), None);
    assert_eq!(trial.contacts[0].diameter_mm, Some(20.0));
    assert_eq!(trial.max_force_n, Some(3.5));
    assert_eq!((trial.settle_ms, trial.started_at, trial.frame_count), (None, None, 12));
    assert_eq!((&trials[0].imported_split, trial.imported_split.as_deref()), (&None, Some("test")));
    assert_eq!((&trials[0].imported_tag, trial.imported_tag.as_deref()), (&None, Some("tip B")));
    assert!(trial.voltages_v.as_ref().unwrap()[1].is_nan());
    assert_eq!(trial.sim_voltages_v, Some(vec![0.4, 0.0, -0.2]));
    assert_eq!((trial.sim_model.as_deref(), trial.rmse_v), (Some("sim-1"), Some(0.07)));
    let twice = store.import_trials(run.uid, None, vec![elsewhere(9), elsewhere(0)]).await;
    let refused = twice.unwrap_err().to_string();
    assert!(refused.contains("its key"), "{refused}");
    assert_eq!(all(&store, run.uid).await.len(), 2);
}

#[tokio::test]
async fn raw_frames_of_an_import_are_kept_as_those_of_a_rig() {
    let (_folder, store) = fresh().await;
    let run = store.begin_import(imported()).await.unwrap();
    let frames_v = vec![vec![0.5, -1e-3, 0.25], vec![0.1, 2e-3, -0.4]];
    let raw = |frame_count, frames_v: &[Vec<f32>]| ImportedTrial {
        voltages_v: vec![0.3, 5e-4, -0.075],
        frame_count,
        frames_v: frames_v.to_vec(),
        ..ImportedTrial::default()
    };
    store.import_trials(run.uid, None, vec![raw(2, &frames_v)]).await.unwrap();
    let trial = all(&store, run.uid).await.remove(0);
    assert_eq!((trial.frame_count, trial.voltages_v), (2, Some(vec![0.3, 5e-4, -0.075])));
    let stored = store.frames(trial.trial_id).await.unwrap();
    assert_eq!(stored.len(), 2);
    for (frame, wanted) in stored.iter().zip(&frames_v) {
        for (count, wanted) in frame.counts.iter().zip(wanted) {
            let off_v = f32::from(*count) * frame.volts_per_count - wanted;
            assert!(off_v.abs() <= 0.51 * 0.5 / 32_767.0, "{off_v} V of {wanted} V");
        }
    }
    for (count, frames_v) in
        [(3, &frames_v[..]), (1, &[vec![0.1, 0.2]][..]), (1, &[vec![0.1, f32::NAN, 0.2]][..])]
    {
        let trial = ImportedTrial { configuration: 7, ..raw(count, frames_v) };
        let refused = store.import_trials(run.uid, None, vec![trial]).await.unwrap_err();
        assert!(refused.to_string().contains("frames_v"), "{refused}");
    }
    store.end_import(run.uid).await.unwrap();
    assert_eq!(store.examine(10).await.unwrap(), Soundness::Sound);
    // One of several is missing: no mean alone.
    execute(&store, "DELETE FROM frames WHERE n = 1").await;
    assert!(!findings(&store).await.is_empty());
}

#[tokio::test]
async fn half_a_large_import_is_removed_in_several_transactions() {
    let (_folder, store) = fresh().await;
    let run = store.begin_import(imported()).await.unwrap();
    let trial = |configuration| ImportedTrial { configuration, ..elsewhere(0) };
    store.import_trials(run.uid, None, (0..501).map(trial).collect()).await.unwrap();
    // The writer takes its jobs in their order: this one comes after the first transaction.
    let counted = store.write("counting the trials of a test", async move |c| {
        let left: i64 =
            sqlx::query_scalar("SELECT count(*) FROM trials").fetch_one(c).await.unwrap();
        Ok(left)
    });
    let (removed, left) = futures::join!(store.sweep_imports(), counted);
    assert_eq!((removed.unwrap(), left.unwrap()), (501, 1));
    assert!(all(&store, run.uid).await.is_empty());
    is_intact(&store).await;
}

#[tokio::test]
async fn of_two_equal_imports_at_once_one_is_a_run_and_nothing_of_the_other_stays() {
    let (_folder, store) = fresh().await;
    let begin = async |experiment: &str| {
        let new = NewRun { experiment: experiment.into(), ..imported() };
        let run = store.begin_import(new).await.unwrap().uid;
        store.import_trials(run, None, vec![elsewhere(0), elsewhere(1)]).await.unwrap();
        run
    };
    let (first, second, other) = (begin("a").await, begin("a").await, begin("b").await);
    let listed = async || {
        let query = TrialQuery { limit: 100, ..TrialQuery::default() };
        let trials = store.trials(&query).await.unwrap();
        let ids: Vec<_> = trials.iter().map(|trial| trial.trial_id).collect();
        assert_eq!(store.trial_ids(&query).await.unwrap(), ids);
        trials.into_iter().map(|trial| trial.run).collect::<Vec<_>>()
    };
    assert!(store.runs_with_trials().await.unwrap().is_empty(), "none is complete");
    assert!(listed().await.is_empty());
    assert_eq!(store.end_import(second).await.unwrap().uid, second);
    assert_eq!(store.end_import(first).await.unwrap().uid, second, "it is stored already");
    assert_eq!(store.run(first).await.unwrap().unwrap().state, StoredState::Removed);
    assert_eq!(listed().await, [second; 2]);
    assert_eq!(store.end_import(other).await.unwrap().uid, other);
    for run in [first, second, other] {
        store.discard_import(run).await.unwrap();
    }
    assert!(all(&store, first).await.is_empty());
    for run in [second, other] {
        assert_eq!(all(&store, run).await.len(), 2, "an ended one stays");
    }
    assert_eq!(store.runs_with_trials().await.unwrap(), [other, second]);
    is_intact(&store).await;
}

fn dataset() -> DatasetRow {
    DatasetRow {
        id: DatasetId::unchecked("ds-1"),
        name: "real".into(),
        definition: json!({ "name": "real" }),
        rows: 3,
        bytes: 4,
        sha256: "ab".into(),
        report: json!({}),
        lineage: json!({ "runs": [] }),
        created_at: time("2026-11-20T18:00:00Z"),
    }
}

#[tokio::test]
async fn what_waits_for_a_dataset_by_its_id_refers_to_it_until_it_ends() {
    let (_folder, store) = fresh().await;
    store.insert_dataset(dataset(), "one").await.unwrap();
    let users = async || store.dataset_users().await.unwrap().into_values().next();
    for (kind, request) in [
        (TaskKind::Export, json!({ "dataset": "ds-1", "format": "csv" })),
        (TaskKind::Training, json!({ "recipe": "dataset = \"ds-1\"\n" })),
    ] {
        assert_eq!(users().await, None);
        let task = store.create_task(kind, request, "ada").await.unwrap();
        assert_eq!(users().await, Some(format!("{kind} {}", task.id)));
        assert!(store.end_task(task.id, TaskEnd::Stopped).await.unwrap());
    }
    assert_eq!(users().await, None);
    store.remove_datasets(vec![dataset().id]).await.unwrap();
    assert!(store.datasets().await.unwrap().is_empty());
}

#[tokio::test]
async fn a_dataset_is_stored_once_and_found_by_its_inputs() {
    let (_folder, store) = fresh().await;
    let row = dataset();
    let stored = store.insert_dataset(row.clone(), "one").await.unwrap();
    assert_eq!(stored, row);
    let later = DatasetRow { created_at: time("2026-11-21T18:00:00Z"), ..row.clone() };
    assert_eq!(store.insert_dataset(later, "two").await.unwrap(), row);
    for inputs in ["one", "two"] {
        assert_eq!(store.dataset_of_inputs(inputs).await.unwrap().as_ref(), Some(&row));
    }
    assert_eq!(store.dataset_of_inputs("three").await.unwrap(), None);
    assert_eq!(store.newest_dataset("real").await.unwrap(), Some(row.clone()));
    assert_eq!(store.datasets().await.unwrap(), [row]);
}

#[tokio::test]
async fn the_newest_of_a_name_is_the_last_one_although_the_clock_was_set_back() {
    let (_folder, store) = fresh().await;
    let made_at = [time("2026-11-20T18:00:00Z"), time("2026-11-20T17:00:00Z")];
    for (n, created_at) in made_at.into_iter().enumerate() {
        let id = DatasetId::unchecked(format!("ds-{n}"));
        let row = DatasetRow { id, created_at, ..dataset() };
        store.insert_dataset(row, &n.to_string()).await.unwrap();
        let model = ModelRow {
            id: ModelId::unchecked(format!("mdl-{n}")),
            name: "net".into(),
            task: "transfer".into(),
            manifest: "datasets = [\"ds-0\"]\n".into(),
            created_at,
        };
        store.insert_model(model).await.unwrap();
    }
    assert_eq!(store.newest_dataset("real").await.unwrap().unwrap().id.as_str(), "ds-1");
    let datasets = store.datasets().await.unwrap();
    assert_eq!(datasets.iter().map(|row| row.id.as_str()).collect::<Vec<_>>(), ["ds-1", "ds-0"]);
    assert_eq!(store.model("net").await.unwrap().unwrap().id.as_str(), "mdl-1");
    let of_dataset = store.models_of(&datasets[1].id).await.unwrap();
    for models in [store.models().await.unwrap(), of_dataset] {
        let ids: Vec<&str> = models.iter().map(|row| row.id.as_str()).collect();
        assert_eq!(ids, ["mdl-1", "mdl-0"]);
    }
}

/// A file of the previous version, with a discarded trial, keeps everything.
#[tokio::test]
async fn tables_made_anew_lose_nothing() {
    let folder = Folder::new();
    let filled =
        "INSERT INTO trials (id, run, configuration, depth_index, attempt, tips, flags, settle_ms,
             contact_count, frame_count, started_at, measured_at)
         VALUES (5, 1, 0, 0, 1, 1, '[]', 1.5, 1, 1, '2026-11-20T18:00:00.000Z',
             '2026-11-20T18:00:01.000Z'),
             (6, 1, 1, 0, 1, 1, '[]', 1.5, 1, 1, '2026-11-20T18:00:00.000Z',
             '2026-11-20T18:00:01.000Z');
         INSERT INTO placed_contacts VALUES (5, 0, 1.5, 2.5, 4.905);
         INSERT INTO trial_voltages VALUES (5, x'0000803f');
         INSERT INTO frames VALUES (5, 0, 1, 2, 0.5, x'0200');
         DELETE FROM trials WHERE id = 6;";
    let store = folder.open_from_before(3, &[EARLY_RUN, filled]).await;
    is_intact(&store).await;
    let run = store.run_by_scan_id(1).await.unwrap().unwrap();
    assert_eq!((run.seed, run.rig.as_deref()), (Some(7), Some("r")));
    let trials = all(&store, run.uid).await;
    assert_eq!(trials.len(), 1);
    let trial = &trials[0];
    assert_eq!((trial.trial_id.0, trial.settle_ms), (5, Some(1.5)));
    // Conditions read by the bounds of its block, which are newer than it.
    let filters = vec![Condition::parse("settle_ms__gt=1").unwrap()];
    let query = TrialQuery { run: Some(run.uid), filters, limit: 10, ..Default::default() };
    assert_eq!(store.trials(&query).await.unwrap().len(), 1);
    assert_eq!(trial.contacts[0].pressed(), Some([1.5, 2.5, 4.905]));
    assert_eq!(trial.voltages_v, Some(vec![1.0]));
    assert_eq!(trial.quality.saturated_channels, None);
    assert_eq!(store.frames(trial.trial_id).await.unwrap().len(), 1);
    // The id of the discarded trial is not used again.
    let mut next = random_trial(1, 1);
    next.key = TrialKey { configuration: 1, depth_index: 0 };
    assert_eq!(store.trial(run.uid, &next).await.unwrap().0, 7);
}
