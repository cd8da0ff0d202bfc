//! The file of a run's dataset is begun while the run is active: its rows are those of a file that is
//! written after the run's end, byte for byte, whatever has changed meanwhile.

use std::fs::{hard_link, read_dir};
use std::ops::Range;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use arrow_array::Array;
use palpate::clock::Clock;
use palpate::dataset::build::data_file;
use palpate::dataset::catalog::Catalog;
use palpate::dataset::definition::Definition;
use palpate::dataset::making::{Making, MakingKind};
use palpate::ids::{RunUid, TrialKey};
use palpate::journal::Journal;
use palpate::record::FrameRecord;
use palpate::store::{
    DatasetRow, RunKind, RunRow, Store, TrialQuery, Twin, TwinModelId, TwinOutcome,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tokio::sync::OnceCell;

use super::filled::{copied, end, folder, new_run, press, store, twin_model};

/// Values of a frame: short ones are written faster.
const CHANNELS: i16 = 8;
/// Trials in the folder of a test.
const TRIALS: u32 = 2300;

/// A folder with an active run of 2300 trials without twins.
struct Lab {
    data: PathBuf,
    store: Store,
    datasets: Catalog,
    run: RunUid,
    scan_id: i64,
}

impl Lab {
    async fn open(name: &str) -> Self {
        static KEPT: OnceCell<PathBuf> = OnceCell::const_new();
        let data = folder(name);
        copied(&data, &KEPT, "ahead-kept", pressed).await;
        let store = store(&data).await;
        let RunRow { uid: run, scan_id, .. } = store.run_by_scan_id(1).await.unwrap().unwrap();
        let datasets = Catalog::open(store.clone(), &data, Clock::new(1.0)).unwrap();
        Self { data, store, datasets, run, scan_id }
    }

    async fn model(&self, hash: &str) -> TwinModelId {
        self.store.twin_model(twin_model(hash)).await.unwrap()
    }

    /// Stores twins of the trials from `first` to `end`, in the order of storing.
    async fn twins(&self, model: TwinModelId, first: usize, end: usize) {
        let query = TrialQuery { run: Some(self.run), limit: 10_000, ..TrialQuery::default() };
        let trials = self.store.trials(&query).await.unwrap();
        let twins = trials[first..end].iter().map(|trial| {
            let voltages_v = vec![0.5; CHANNELS as usize];
            let outcome = TwinOutcome::Frame { voltages_v, rmse_v: 0.1, fvu: Some(0.2) };
            Twin { trial: trial.trial_id, outcome }
        });
        self.store.insert_twins(model, twins.collect()).await.unwrap();
    }

    /// Writes ahead, and returns the numbers of the unfinished files in the folder of datasets. A link keeps
    /// each of these files, so that no other one gets its number.
    async fn ahead(&self) -> Vec<u64> {
        self.datasets.write_ahead(self.run, self.scan_id).await.unwrap();
        let number = |path: PathBuf| {
            let kept = self.data.join(path.file_name().unwrap());
            if !kept.exists() {
                hard_link(&path, &kept).unwrap();
            }
            kept.metadata().unwrap().ino()
        };
        unfinished(&self.datasets.datasets()).into_iter().map(number).collect()
    }

    /// Ends the run, makes its dataset, and makes it a second time of the stored trials alone.
    async fn made_twice(&self) -> [(DatasetRow, u64); 2] {
        end(&self.store, self.run).await;
        let first = self.make().await;
        std::fs::remove_file(data_file(&self.datasets.datasets(), &first.0.id)).unwrap();
        [first, self.make().await]
    }

    async fn make(&self) -> (DatasetRow, u64) {
        let row = self.datasets.make(&Definition::of_run(self.scan_id)).await.unwrap();
        let file = data_file(&self.datasets.datasets(), &row.id).metadata().unwrap().ino();
        assert_eq!(self.datasets.begun(), None);
        assert!(unfinished(&self.datasets.datasets()).is_empty());
        (row, file)
    }

    async fn close(self) {
        self.store.close().await;
        std::fs::remove_dir_all(&self.data).unwrap();
    }
}

/// Fills a folder with the run.
async fn pressed(data: &Path) {
    let store = store(data).await;
    let run = store.create_run(new_run(RunKind::RealHex, "made-up")).await.unwrap().uid;
    add_trials(&store, run, 0..TRIALS).await;
    store.close().await;
}

async fn add_trials(store: &Store, run: RunUid, configurations: Range<u32>) {
    let mut chance = ChaCha8Rng::seed_from_u64(3);
    for configuration in configurations {
        let key = TrialKey { configuration, depth_index: 4 };
        let mut trial = press(key, 1, &[[100.0, 200.0], [300.0, 250.0]], &mut chance);
        let counts = (0..CHANNELS).map(|n| n * 7 + configuration as i16).collect();
        let (sequence, device_time_us, volts_per_count) = (1, 2, 12.0 / 32_768.0);
        trial.frames = vec![FrameRecord { sequence, device_time_us, volts_per_count, counts }];
        store.trial(run, &trial).await.unwrap();
    }
}

fn unfinished(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = read_dir(folder) else { return Vec::new() };
    entries
        .map(|entry| entry.unwrap())
        .filter(|entry| entry.file_name().to_string_lossy().starts_with("_partial"))
        .map(|entry| entry.path())
        .collect()
}

#[tokio::test]
async fn a_file_that_was_begun_is_continued_and_has_the_same_bytes() {
    let lab = Lab::open("ahead").await;
    let model = lab.model("sim-1").await;
    lab.twins(model, 0, 999).await;
    assert!(lab.ahead().await.is_empty(), "a trial of the first thousand has no twin");
    lab.twins(model, 999, 2200).await;
    let begun = lab.ahead().await;
    assert_eq!((begun.len(), lab.datasets.begun()), (1, Some(lab.scan_id)));
    assert_eq!(lab.ahead().await, begun);
    assert_eq!(lab.ahead().await, begun, "the third thousand is not complete");
    lab.twins(model, 2200, TRIALS as usize).await;
    let [(first, file), (again, other)] = lab.made_twice().await;
    assert_eq!((first.rows, file), (u64::from(TRIALS), begun[0]), "it is the begun file");
    assert_ne!(other, file);
    assert_eq!((&first.id, &first.sha256), (&again.id, &again.sha256));
    assert_eq!((first.bytes, first.report), (again.bytes, again.report));
    lab.close().await;
}

#[tokio::test]
async fn a_begun_file_without_twins_is_not_used_once_they_are_there() {
    let lab = Lab::open("ahead-late-twins").await;
    // Nothing simulates here: trials have no twins, and their rows are complete.
    let begun = lab.ahead().await;
    assert_eq!(begun.len(), 1);
    let model = lab.model("sim-1").await;
    lab.twins(model, 0, TRIALS as usize).await;
    let [(first, file), (again, _)] = lab.made_twice().await;
    assert_ne!(file, begun[0]);
    assert_eq!((&first.id, &first.sha256), (&again.id, &again.sha256));
    let rows = lab.datasets.pages(&first.id, &Default::default()).unwrap();
    let (page, _) = rows.page(0, 1000).unwrap();
    for batch in page {
        assert_eq!(batch.column_by_name("sim_voltages_v").unwrap().null_count(), 0);
    }
    lab.close().await;
}

#[tokio::test]
async fn a_begun_file_with_a_withdrawn_trial_is_written_again() {
    let lab = Lab::open("ahead-withdrawn").await;
    let begun = lab.ahead().await;
    let key = TrialKey { configuration: 17, depth_index: 4 };
    lab.store.discard(lab.run, key, "a hand slipped").await.unwrap();
    assert!(lab.ahead().await.is_empty(), "the next thousand shows that the file is outdated");
    let second = lab.ahead().await;
    assert!(second.len() == 1 && second != begun, "{begun:?} {second:?}");
    add_trials(&lab.store, lab.run, TRIALS..TRIALS + 200).await;
    let [(first, file), (again, _)] = lab.made_twice().await;
    assert_eq!((first.rows, file), (u64::from(TRIALS) + 199, second[0]));
    assert_eq!((&first.id, &first.sha256), (&again.id, &again.sha256));
    lab.close().await;
}

#[tokio::test]
async fn a_begun_file_of_a_killed_process_is_removed_and_nothing_is_lost() {
    let lab = Lab::open("ahead-killed").await;
    assert_eq!(lab.ahead().await.len(), 1);
    let killed = lab.datasets.clone();
    let datasets = Catalog::open(lab.store.clone(), &lab.data, Clock::new(1.0)).unwrap();
    assert!(unfinished(&datasets.datasets()).is_empty());
    let lab = Lab { datasets, ..lab };
    assert_eq!(lab.ahead().await.len(), 1);
    let [(first, _), (again, _)] = lab.made_twice().await;
    assert_eq!((first.rows, &first.sha256), (u64::from(TRIALS), &again.sha256));
    drop(killed);
    lab.close().await;
}

#[tokio::test]
async fn a_dataset_is_listed_while_it_is_made() {
    let lab = Lab::open("ahead-listed").await;
    let definition = Definition::of_run(lab.scan_id);
    let mut made = Box::pin(lab.datasets.make(&definition));
    assert!(futures::poll!(made.as_mut()).is_pending());
    let kind = MakingKind::Dataset;
    let listed = Making { kind, name: definition.name.clone(), rows_done: 0, rows_total: 0 };
    assert_eq!(lab.datasets.making().list(), [listed]);
    drop(made);
    lab.close().await;
}
