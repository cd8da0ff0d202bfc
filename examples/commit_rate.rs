//! How fast trials are stored and read back: `cargo run --example commit_rate -- [TRIALS] [FOLDER]`.
//! Uses: the store's public face. Never: anything but its own file `commit_rate.sqlite`.
//!
//! Each trial has six tips and one frame of 784 values and is one commit with synchronous=FULL,
//! as in a campaign. Prints one line of JSON.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use palpate::clock::Clock;
use palpate::ids::{RunUid, TrialKey};
use palpate::journal::Journal;
use palpate::record::{ArmReading, FrameQuality, FrameRecord, Pose, TrialRecord, TrialScalars};
use palpate::store::{Condition, Label, NewRun, RunKind, Store, TrialQuery};

type Failure = Box<dyn std::error::Error>;

fn trial(n: u32) -> TrialRecord {
    let pose = Pose { x_mm: 270.0, y_mm: 280.0, z_mm: 41.5, radius_mm: 34.641 };
    let arm = |arm: u8| ArmReading {
        arm,
        x_mm: 270.0 + f64::from(arm),
        y_mm: 280.0,
        force_n: f64::from((n.wrapping_mul(2_654_435_761) >> arm) % 4000) / 100.0,
        cell_v: 0.731,
        tare_v: 0.501,
    };
    // Bytes that do not repeat, as noise does not.
    let counts = (0..784u32).map(|i| (n * 784 + i).wrapping_mul(2_654_435_761) as i16);
    let frame = FrameRecord {
        sequence: n,
        device_time_us: u64::from(n) * 33_333,
        volts_per_count: 12.0 / 32_768.0,
        counts: counts.collect(),
    };
    let now = jiff::Timestamp::UNIX_EPOCH;
    TrialRecord {
        key: TrialKey { configuration: n / 11, depth_index: n % 11 },
        attempt: 1,
        tips: 6,
        depth_mm: Some(f64::from(n % 11) * 0.5),
        target: Some(pose),
        reached: Some(pose),
        arms: (1..=6).map(arm).collect(),
        placed: vec![],
        placed_by: None,
        frames: vec![frame],
        quality: FrameQuality::default(),
        flags: vec![],
        settle_ms: 1800.0,
        scalars: TrialScalars::all(0.1),
        started_at: now,
        measured_at: now,
    }
}

fn new_run(trials: u32) -> NewRun {
    NewRun {
        uid: RunUid::new(),
        experiment: "commit_rate".into(),
        kind: RunKind::RealHex,
        definition: String::new(),
        seed: Some(1),
        rig: Some(String::new()),
        sensor: String::new(),
        calibration_id: None,
        plan: None,
        label: Label::Virtual,
        version: env!("CARGO_PKG_VERSION").into(),
        git_commit: None,
        deadband_n: 5.0,
        tip_diameter_mm: Some(20.0),
        trials_planned: u64::from(trials),
        auto_resume: false,
        not_before: None,
        submitted_by: "commit_rate".into(),
    }
}

fn remove(path: &Path) {
    for end in ["", "-wal", "-shm"] {
        // What is not there need not be removed.
        let _ = std::fs::remove_file(format!("{}{end}", path.display()));
    }
}

fn at(sorted: &[Duration], share: f64) -> f64 {
    let i = (share * (sorted.len() - 1) as f64).round() as usize;
    sorted[i].as_secs_f64() * 1e3
}

/// Reads all trials in pages of 1000; returns how many and how long.
async fn read_all(store: &Store, query: TrialQuery) -> Result<(usize, f64), Failure> {
    let started = Instant::now();
    let mut query = TrialQuery { limit: 1000, ..query };
    let mut read = 0;
    loop {
        let page = store.trials(&query).await?;
        let Some(last) = page.last() else { break };
        query.after = Some(last.trial_id);
        read += page.len();
    }
    Ok((read, started.elapsed().as_secs_f64()))
}

#[tokio::main]
async fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let trials: u32 = arguments.next().map_or(Ok(5000), |text| text.parse())?;
    let folder = arguments.next().map_or_else(std::env::temp_dir, PathBuf::from);
    let path = folder.join("commit_rate.sqlite");
    remove(&path);
    let store = Store::open(&path, Clock::new(1.0)).await?;
    let run = store.create_run(new_run(trials)).await?.uid;
    let started = Instant::now();
    let mut commits = Vec::with_capacity(trials as usize);
    for n in 0..trials {
        let record = trial(n);
        let begun = Instant::now();
        store.trial(run, &record).await?;
        commits.push(begun.elapsed());
    }
    let wall_s = started.elapsed().as_secs_f64();
    commits.sort();

    let (rows, rows_s) =
        read_all(&store, TrialQuery { run: Some(run), ..Default::default() }).await?;
    let with_voltages = TrialQuery { run: Some(run), with_voltages: true, ..Default::default() };
    let (_, with_voltages_s) = read_all(&store, with_voltages).await?;
    let that = |text| Condition::parse(text).map_err(std::io::Error::other);
    let filters = vec![that("contact_count=5")?, that("max_force_n__gt=35")?];
    let (hits, hits_s) = read_all(&store, TrialQuery { filters, ..Default::default() }).await?;
    let begun = Instant::now();
    let counts = store.contact_counts(run).await?;
    let counts_s = begun.elapsed().as_secs_f64();
    store.close().await;
    let bytes = std::fs::metadata(&path)?.len();
    remove(&path);
    let answer = serde_json::json!({
        "trials": trials,
        "trials_per_s": f64::from(trials) / wall_s,
        "commit_ms": {
            "p50": at(&commits, 0.5), "p99": at(&commits, 0.99), "max": at(&commits, 1.0),
        },
        "bytes_per_trial": bytes / u64::from(trials),
        "read_rows_per_s": rows as f64 / rows_s,
        "read_rows_with_voltages_per_s": rows as f64 / with_voltages_s,
        "filter": { "hits": hits, "ms": hits_s * 1e3 },
        "contact_counts": { "counts": counts, "ms": counts_s * 1e3 },
    });
    println!("{answer}");
    Ok(())
}
