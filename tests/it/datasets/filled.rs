//! A data folder with trials, as campaigns would leave it, and a service on it. Frames are made up:
//! nothing here is about physics.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use jiff::Timestamp;
use palpate::api::{ServeOptions, Service};
use palpate::clock::Clock;
use palpate::ids::{CalibrationId, RunUid, TrialKey};
use palpate::journal::{ExitStatus, Journal};
use palpate::record::{
    ArmReading, Flag, FrameQuality, FrameRecord, PlacedContact, Pose, TrialRecord, TrialScalars,
};
use palpate::store::{
    Label, NewRun, NewTwinModel, RunKind, Store, TrialQuery, Twin, TwinModelId, TwinOutcome,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tokio::sync::OnceCell;

use crate::support::{
    SENSOR, VIRTUAL_RIG, answered, copy_folder, http, is_refused, sensor, serve_options, until,
    with_responses,
};

/// Configurations of the Real-Hex run; each third is one that was drawn before.
pub const CONFIGURATIONS: u32 = 30;
const DEPTHS: u32 = 11;
/// Longest wait for anything.
const LIMIT: Duration = Duration::from_secs(60);

/// A folder with a Real-Hex run of 330 trials with twins, and a Real-Random run of 12.
pub struct Filled {
    pub data: PathBuf,
    pub service: Service,
    pub http: reqwest::Client,
}

/// An empty folder of a test's own.
pub fn folder(name: &str) -> PathBuf {
    let data = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("datasets-{name}"));
    std::fs::remove_dir_all(&data).ok();
    std::fs::create_dir_all(&data).unwrap();
    data
}

pub async fn store(data: &Path) -> Store {
    Store::open(&data.join("palpate.db"), Clock::new(1.0)).await.unwrap()
}

pub fn new_run(kind: RunKind, experiment: &str) -> NewRun {
    NewRun {
        uid: RunUid::new(),
        experiment: experiment.into(),
        kind,
        definition: format!("name = \"{experiment}\"\n"),
        seed: Some(7),
        rig: Some("name = \"made up\"\n".into()),
        sensor: SENSOR.into(),
        calibration_id: None,
        plan: None,
        label: Label::Virtual,
        version: "0.1.0".into(),
        git_commit: None,
        deadband_n: 5.0,
        tip_diameter_mm: Some(20.0),
        trials_planned: 1,
        auto_resume: false,
        not_before: None,
        submitted_by: "test".into(),
    }
}

fn frame(chance: &mut ChaCha8Rng) -> FrameRecord {
    let counts = (0..784).map(|_| (chance.next_u32() % 20_000) as i16 - 10_000).collect();
    FrameRecord { sequence: 1, device_time_us: 2, volts_per_count: 12.0 / 32_768.0, counts }
}

fn trial(key: TrialKey, chance: &mut ChaCha8Rng) -> TrialRecord {
    let at: jiff::Timestamp = "2026-11-20T18:00:00.123Z".parse().unwrap();
    let started_at =
        at + Duration::from_secs(u64::from(key.configuration * DEPTHS + key.depth_index));
    TrialRecord {
        key,
        attempt: 1,
        tips: 0,
        depth_mm: None,
        target: None,
        reached: None,
        arms: Vec::new(),
        placed: Vec::new(),
        placed_by: None,
        frames: vec![frame(chance)],
        quality: FrameQuality {
            saturated_channels: Some(0),
            stuck_channels: Some(key.depth_index),
            missing_channels: Some(0),
            injection_sum_v: Some(1e-3),
            dropped_packets: Some(0),
        },
        flags: Vec::new(),
        settle_ms: 1800.5,
        scalars: TrialScalars::all(0.25),
        started_at,
        measured_at: started_at + Duration::from_millis(800),
    }
}

/// Presses with tips on as many points, harder with each depth: the first depths make no contact.
pub fn press(key: TrialKey, tips: u8, points: &[[f64; 2]], chance: &mut ChaCha8Rng) -> TrialRecord {
    let draw = key.configuration - key.configuration % 3 / 2;
    let place = |n: u32| points[(draw * 37 + n * 101) as usize % points.len()];
    let z_mm = 0.5 * f64::from(key.depth_index);
    let pose = |z_mm| Pose { x_mm: place(0)[0], y_mm: place(0)[1], z_mm, radius_mm: 34.641 };
    let arms = (0..u32::from(tips)).map(|n| {
        let [x_mm, y_mm] = place(n);
        let force_n = 1.7 * f64::from(key.depth_index) + 0.3 * f64::from(n) - 0.1;
        ArmReading { arm: n as u8 + 1, x_mm, y_mm, force_n, cell_v: 1.0, tare_v: 0.5 }
    });
    let flags = if key.configuration == 4 && key.depth_index > 5 {
        vec![Flag::Unsettled, Flag::DepthMissed]
    } else {
        Vec::new()
    };
    TrialRecord {
        tips,
        depth_mm: Some(z_mm),
        target: Some(pose(z_mm)),
        reached: Some(pose(z_mm + 0.004)),
        arms: arms.collect(),
        flags,
        ..trial(key, chance)
    }
}

pub fn placed(key: TrialKey, points: &[[f64; 2]], chance: &mut ChaCha8Rng) -> TrialRecord {
    let weights = 2 + key.configuration % 3;
    let contact = |n: u32| {
        let [x_mm, y_mm] = points[(key.configuration * 53 + n * 17) as usize % points.len()];
        PlacedContact { x_mm, y_mm, force_n: 4.905 }
    };
    TrialRecord {
        tips: weights as u8,
        placed: (0..weights).map(contact).collect(),
        placed_by: Some("Ada".into()),
        ..trial(key, chance)
    }
}

/// Points of the sensor, mm.
pub fn points() -> Vec<[f64; 2]> {
    sensor().points().iter().map(|p| [p.x_mm, p.y_mm]).collect()
}

/// Stores a run of presses that has ended; returns its uid.
pub async fn press_run(
    store: &Store,
    new: NewRun,
    tips: u8,
    configurations: u32,
    depths: Range<u32>,
    chance: &mut ChaCha8Rng,
) -> RunUid {
    let points = points();
    let run = store.create_run(new).await.unwrap().uid;
    for configuration in 0..configurations {
        for depth_index in depths.clone() {
            let key = TrialKey { configuration, depth_index };
            store.trial(run, &press(key, tips, &points, chance)).await.unwrap();
        }
    }
    end(store, run).await;
    run
}

/// Ends a run, whose trials are all stored.
pub async fn end(store: &Store, run: RunUid) {
    store.end_run(run, ExitStatus::Success, "made up", jiff::Timestamp::now()).await.unwrap();
}

/// Fills a folder: run 1 is Real-Hex, run 2 is Real-Random.
pub async fn fill(data: &Path) {
    let store = store(data).await;
    let mut chance = ChaCha8Rng::seed_from_u64(5);
    let new = new_run(RunKind::RealHex, "made-up-hex");
    let hex = press_run(&store, new, 2, CONFIGURATIONS, 0..DEPTHS, &mut chance).await;
    twins(&store, hex, "sim-0000000000000001", &mut chance).await;
    let random =
        store.create_run(new_run(RunKind::RealRandom, "made-up-random")).await.unwrap().uid;
    let points = points();
    for configuration in 0..12 {
        let key = TrialKey { configuration, depth_index: 0 };
        store.trial(random, &placed(key, &points, &mut chance)).await.unwrap();
    }
    end(&store, random).await;
    store.close().await;
}

/// Fills a folder with a copy of what `fill` leaves in one that stays: each trial waits for the disk, a copy does not.
/// Runs have the same uid in all copies.
pub async fn copied(
    data: &Path,
    kept: &OnceCell<PathBuf>,
    name: &str,
    fill: impl AsyncFnOnce(&Path),
) {
    let make = || async move {
        let kept = folder(name);
        fill(kept.as_path()).await;
        kept
    };
    copy_folder(&kept.get_or_init(make).await.join("."), data);
}

/// As [`fill`], by a copy.
pub async fn copy_filled(data: &Path) {
    static FILLED: OnceCell<PathBuf> = OnceCell::const_new();
    copied(data, &FILLED, "filled", fill).await;
}

/// A rig whose lock no other process has.
pub fn rig() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let (process, n) = (std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    let own = format!("127.{}.{}.{}:", process >> 8 & 0x7F, process & 0xFF, n + 1);
    VIRTUAL_RIG.replace("127.0.0.1:", &own)
}

pub fn twin_model(hash: &str) -> NewTwinModel {
    NewTwinModel {
        hash: hash.into(),
        sensor_sha256: "s".into(),
        calibration_id: None,
        version: "0.1.0".into(),
        git_commit: None,
    }
}

/// Twins of all trials of a run but the last three.
pub async fn twins(store: &Store, run: RunUid, model: &str, chance: &mut ChaCha8Rng) {
    twins_but(3, store, run, model, chance).await;
}

/// Twins of all trials of a run but the last ones.
pub async fn twins_but(
    last: usize,
    store: &Store,
    run: RunUid,
    model: &str,
    chance: &mut ChaCha8Rng,
) {
    let new = NewTwinModel {
        calibration_id: Some(CalibrationId::unchecked("cal-1")),
        git_commit: Some("c".into()),
        ..twin_model(model)
    };
    let model: TwinModelId = store.twin_model(new).await.unwrap();
    let query = TrialQuery { run: Some(run), limit: 10_000, ..TrialQuery::default() };
    let trials = store.trials(&query).await.unwrap();
    let twins = trials[..trials.len() - last].iter().map(|trial| {
        let voltages_v = (0..784).map(|_| chance.random_range(-1.0..1.0)).collect();
        let outcome = TwinOutcome::Frame { voltages_v, rmse_v: 0.125, fvu: Some(0.5) };
        Twin { trial: trial.trial_id, outcome }
    });
    store.insert_twins(model, twins.collect()).await.unwrap();
}

impl Filled {
    /// A filled folder of this test's own, and a service on it.
    pub async fn open(name: &str) -> Self {
        let data = folder(name);
        copy_filled(&data).await;
        Self::serve(data).await
    }

    /// A service on a folder.
    pub async fn serve(data: PathBuf) -> Self {
        Self::serve_with(data, true).await
    }

    /// A service on a folder; `local_admin`: without a key one may make keys.
    pub async fn serve_with(data: PathBuf, local_admin: bool) -> Self {
        Self::serve_as(data, |options| options.local_admin = local_admin).await
    }

    /// A service on a folder whose requests need a key.
    pub async fn serve_keys(data: PathBuf) -> Self {
        let change = |options: &mut ServeOptions| {
            (options.local_admin, options.require_key) = (false, true);
        };
        Self::serve_as(data, change).await
    }

    /// A service on a folder, with other options.
    pub async fn serve_as(data: PathBuf, change: impl FnOnce(&mut ServeOptions)) -> Self {
        let mut options = serve_options(&data, rig());
        change(&mut options);
        with_responses(&data);
        let service = Service::start(options).await.unwrap();
        Self { data, service, http: http() }
    }

    pub fn url(&self, path: &str) -> String {
        format!("{}{path}", self.service.url())
    }

    pub async fn answer(&self, path: &str) -> reqwest::Response {
        self.http.get(self.url(path)).send().await.unwrap()
    }

    /// The entity tag of what is at an address.
    pub async fn tag(&self, path: &str) -> String {
        self.answer(path).await.headers()["etag"].to_str().unwrap().to_owned()
    }

    /// Makes a dataset of the trials stored now, by its name.
    pub async fn make(&self, name: &str) -> Value {
        self.posted("/api/v1/datasets", json!({ "name": name }), 200).await
    }

    /// Makes a dataset of a definition.
    pub async fn defined(&self, definition: Value) -> Value {
        self.posted("/api/v1/datasets", json!({ "definition": definition }), 200).await
    }

    /// A GET that must succeed.
    pub async fn get(&self, path: &str) -> Value {
        let answer = self.answer(path).await;
        let status = answer.status();
        let text = answer.text().await.unwrap();
        assert!(status.is_success(), "{path}: {status} {text}");
        serde_json::from_str(&text).unwrap()
    }

    /// The items of a page.
    pub async fn items(&self, path: &str) -> Vec<Value> {
        self.get(path).await["items"].as_array().unwrap().clone()
    }

    /// Wall time of the last use of the dataset or the export at this path.
    pub async fn used_at(&self, path: &str) -> Timestamp {
        self.get(path).await["last_used_at"].as_str().unwrap().parse().unwrap()
    }

    /// A GET that must not: its status and the problem's words.
    pub async fn refused(&self, path: &str) -> (u16, String) {
        let answer = self.answer(path).await;
        let status = answer.status().as_u16();
        let body: Value = answer.json().await.unwrap();
        (status, body["detail"].as_str().unwrap_or_default().to_owned())
    }

    /// A GET that must be refused with this status and these words.
    pub async fn refuses_get(&self, path: &str, expected: u16, words: &str) {
        let (status, found) = self.refused(path).await;
        assert!(status == expected && found.contains(words), "{path:.200}: {status} {found:.300}");
    }

    /// A POST: its status and its body.
    pub async fn post(&self, path: &str, body: Value) -> (u16, Value) {
        answered(self.http.post(self.url(path)).json(&body)).await
    }

    /// A POST that must have this status: its body.
    pub async fn posted(&self, path: &str, body: Value, expected: u16) -> Value {
        let (status, answer) = self.post(path, body.clone()).await;
        assert_eq!(status, expected, "{path} {body}: {answer}");
        answer
    }

    /// A POST that must be refused with this status and these words.
    pub async fn refuses(&self, path: &str, body: Value, expected: u16, words: &str) {
        is_refused(self.post(path, body).await, expected, words);
    }

    /// Makes a key: its number, and its secret.
    pub async fn key(&self, name: &str, role: &str) -> (i64, String) {
        let made = self.posted("/api/v1/keys", json!({ "name": name, "role": role }), 201).await;
        (made["key"]["id"].as_i64().unwrap(), made["secret"].as_str().unwrap().to_owned())
    }

    /// Waits for what stands at a path to satisfy this; returns it.
    pub async fn until(&self, path: &str, limit: Duration, done: impl Fn(&Value) -> bool) -> Value {
        until(path, limit, async || self.get(path).await, done).await
    }

    pub async fn over(&self, export: &str) -> Value {
        let is_over = |row: &Value| row["state"] == "done" || row["state"] == "failed";
        self.until(&format!("/api/v1/exports/{export}"), LIMIT, is_over).await
    }

    /// The service ends; the folder stays.
    pub async fn end(self) -> PathBuf {
        self.service.shutdown().await;
        self.data
    }

    /// Everything goes.
    pub async fn close(self) {
        let data = self.end().await;
        std::fs::remove_dir_all(data).ok();
    }
}
