//! The store, function by function, on real files.
//! Uses: `store`. Never: a file outside its own temporary folder.

mod blocks;
mod bulk;
mod columns;
mod damage;
mod datasets;
mod in_place;
mod notes;
mod once;
mod people;
mod runs;
mod schema;
mod states;
mod task_queue;
mod tasks;
mod trials;
mod twins;

use std::convert::Infallible;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use sqlx::migrate::Migrator;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{Connection, SqliteConnection};
use tempfile::TempDir;

use crate::clock::Clock;
use crate::ids::{RunUid, TrialKey};
use crate::record::{
    ArmReading, Flag, FrameQuality, FrameRecord, PlacedContact, Pose, TrialRecord, TrialScalars,
};
use crate::{Label, NewRun, RunKind, Soundness, Store};

/// Run 1 in a file of an early version.
const EARLY_RUN: &str =
    "INSERT INTO runs (scan_id, uid, experiment, kind, definition, definition_sha256, seed, rig,
         rig_sha256, sensor, sensor_sha256, label, version, deadband_n, trials_planned,
         auto_resume, state, created_at, submitted_by)
     VALUES (1, '0190a0a0-0000-7000-8000-000000000001', 'e', 'real-random', 'd', 'h', 7, 'r', 'h',
         's', 'h', 'virtual', '0', 5.0, 3, 0, 'interrupted', '2026-11-20T18:00:00.000Z', 'a')";

/// A temporary folder, removed at the end of its test.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self) -> PathBuf {
        self.0.path().join("palpate.sqlite")
    }

    /// Opens the file behind the store, or makes it.
    async fn behind(&self) -> SqliteConnection {
        let options = SqliteConnectOptions::new().filename(self.file()).create_if_missing(true);
        SqliteConnection::connect_with(&options).await.unwrap()
    }

    /// Opens a file that the version before the migration of this number has made and filled.
    async fn open_from_before(&self, migration: i64, filled: &[&'static str]) -> Store {
        self.make_before(migration, filled).await;
        open(&self.file()).await
    }

    /// Makes and fills a file as the version before the migration of this number.
    async fn make_before(&self, migration: i64, filled: &[&'static str]) {
        let mut file = self.behind().await;
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../migrations"));
        let mut before = Migrator::new(folder).await.unwrap();
        before.migrations.to_mut().retain(|known| known.version < migration);
        before.run(&mut file).await.unwrap();
        for sql in filled {
            sqlx::raw_sql(*sql).execute(&mut file).await.unwrap();
        }
        file.close().await.unwrap();
    }
}

async fn open(path: &Path) -> Store {
    Store::open(path, Clock::new(1.0)).await.unwrap()
}

/// A new store, and its folder.
async fn fresh() -> (Folder, Store) {
    let folder = Folder::new();
    let store = open(&folder.file()).await;
    (folder, store)
}

/// A new store with a run, and its folder.
async fn with_run(kind: RunKind) -> (Folder, Store, RunUid) {
    let (folder, store) = fresh().await;
    let run = store.create_run(new_run(kind)).await.unwrap().uid;
    (folder, store, run)
}

/// Carries out statements behind the functions of the store.
async fn execute(store: &Store, sql: &'static str) {
    let executing = store.write("changing the tables of a test", async move |c| {
        sqlx::raw_sql(sql).execute(c).await.unwrap();
        Ok(())
    });
    executing.await.unwrap();
}

/// Checks the structure of the file, its indexes and its references as SQLite does.
async fn is_intact(store: &Store) {
    let readers = &store.inner.readers;
    let structure: Vec<String> =
        sqlx::query_scalar("PRAGMA integrity_check").fetch_all(readers).await.unwrap();
    assert_eq!(structure, ["ok"]);
    let orphans = sqlx::query("PRAGMA foreign_key_check").fetch_all(readers).await.unwrap();
    assert_eq!(orphans.len(), 0, "rows that refer to missing rows");
}

/// What an examination finds in a damaged file.
async fn findings(store: &Store) -> Vec<String> {
    match store.examine(2000).await.unwrap() {
        Soundness::Damaged(findings) => findings,
        other => panic!("{other:?}"),
    }
}

fn now() -> Timestamp {
    Timestamp::now()
}

fn time(text: &str) -> Timestamp {
    text.parse().unwrap()
}

fn new_run(kind: RunKind) -> NewRun {
    NewRun {
        uid: RunUid::new(),
        experiment: "quickstart".into(),
        kind,
        definition: "name = \"quickstart\"\n".into(),
        seed: Some(7),
        rig: Some("rig".into()),
        sensor: "sensor".into(),
        calibration_id: None,
        plan: None,
        label: Label::Virtual,
        version: "0.1.0".into(),
        git_commit: Some("abc".into()),
        deadband_n: 5.0,
        tip_diameter_mm: Some(20.0),
        trials_planned: 22,
        auto_resume: true,
        not_before: None,
        submitted_by: "local".into(),
    }
}

/// A trial whose numbers all depend on its key, so that an exchange is found.
fn hex_trial(configuration: u32, depth_index: u32, forces_n: &[f64]) -> TrialRecord {
    let c = f64::from(configuration);
    let at = |shift: f64| Pose { x_mm: 0.1 + c, y_mm: 0.2 * c, z_mm: shift, radius_mm: 34.641 };
    let arms = forces_n.iter().zip(1u8..).map(|(&force_n, arm)| ArmReading {
        arm,
        x_mm: c + f64::from(arm) / 3.0,
        y_mm: f64::from(arm) * 1.1,
        force_n,
        cell_v: 0.1 + force_n / 27.8,
        tare_v: 0.497,
    });
    let counts = (0..784).map(|i| (i * 83 + configuration as i32 * 31) as i16).collect();
    let mut scalar = 0.0;
    let Ok(scalars) = TrialScalars::of_columns(|_| {
        scalar += 0.125;
        Ok::<_, Infallible>(Some(scalar))
    });
    TrialRecord {
        key: TrialKey { configuration, depth_index },
        attempt: 1,
        tips: forces_n.len() as u8,
        depth_mm: Some(0.5 * f64::from(depth_index)),
        target: Some(at(0.5)),
        reached: Some(at(0.501)),
        arms: arms.collect(),
        placed: vec![],
        placed_by: None,
        frames: vec![FrameRecord {
            sequence: u32::MAX - configuration,
            device_time_us: u64::MAX - u64::from(depth_index),
            volts_per_count: 12.0 / 32_768.0 * 1.000_123,
            counts,
        }],
        quality: FrameQuality {
            saturated_channels: Some(configuration),
            stuck_channels: Some(0),
            missing_channels: Some(0),
            injection_sum_v: Some(0.001 * c),
            dropped_packets: Some(depth_index),
        },
        flags: vec![],
        settle_ms: 1800.25,
        scalars,
        started_at: time("2026-11-20T18:00:00.123Z"),
        measured_at: time("2026-11-20T18:00:02.004Z"),
    }
}

/// Manually placed weights, each below the deadband.
fn random_trial(configuration: u32, weights: usize) -> TrialRecord {
    let mut trial = hex_trial(configuration, 0, &[]);
    let mut second = trial.frames[0].clone();
    second.sequence = 12;
    second.counts[5] = i16::MIN;
    trial.frames.push(second);
    trial.tips = weights as u8;
    (trial.depth_mm, trial.target, trial.reached) = (None, None, None);
    trial.scalars = TrialScalars::default();
    trial.placed_by = Some("Ada".into());
    trial.flags = vec![Flag::Unsettled, Flag::SaturatedChannels];
    trial.placed = (0..weights)
        .map(|i| PlacedContact { x_mm: 100.0 + i as f64, y_mm: 55.0, force_n: 4.905 })
        .collect();
    trial
}
