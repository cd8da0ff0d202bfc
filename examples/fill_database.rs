//! Fills a data folder with trials like Real-Hex's, for measuring what is built on them:
//! `cargo run --example fill_database -- --data DIR [--trials 93674] [--seed 1] [--copies 0] [--measured-copies]`.
//! Uses: the store's public face, sim-core. Never: a rig; a folder that has a database already.
//!
//! One ended run, labelled virtual. A configuration has 1 to 6 tips on points of the default skin and
//! 11 depths; forces grow with depth, the first tip's from 5 N on, so that every trial has a contact.
//! The twin is the simulated frame, the measured one the same times 1 + 2 % of error that is smooth
//! over the channels, plus 1.2 mV of noise, in counts. Each trial is a separate commit, as in a run.
//! A copy is a further run with the same trials and twins, without raw frames, in one transaction: 35
//! copies make 3.4 million trials in a few minutes, 24 GB; without the frames of their twins 13 GB. The examination of
//! such a file reports the missing frames as damage, so that no run is armed on it.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Parser;
use jiff::Timestamp;
use palpate::clock::Clock;
use palpate::ids::{RunUid, TrialKey};
use palpate::journal::{ExitStatus, Journal};
use palpate::record::{ArmReading, FrameQuality, FrameRecord, Pose, TrialRecord, TrialScalars};
use palpate::simulate::compare::Compared;
use palpate::simulate::model::load_or_build;
use palpate::store::{Label, NewRun, NewTwinModel, RunKind, Store, Twin, TwinOutcome};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::batch::{BatchModel, BatchWork, Kernel};
use sim_core::forward::Contact;
use sim_core::sensor::{Point, Sensor};
use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

type Failure = Box<dyn std::error::Error>;

const EXPERIMENT: &str = include_str!("../experiments/real-hex.toml");
const RIG: &str = include_str!("../experiments/rigs/virtual.toml");
const SENSOR: &str = include_str!("../experiments/sensors/ert-28.toml");

/// Trials of a depth series; with `SERIES` of them, of a step and of a transaction of twins.
const DEPTHS: u32 = 11;
const SERIES: u32 = 60;
/// What a tip presses with at its deepest, N, and all of them together.
const FORCE_N: std::ops::Range<f64> = 15.0..60.0;
const LOAD_MAX_N: f64 = 240.0;
/// What every trial's first tip presses with at least, N.
const FIRST_MIN_N: f64 = 5.0;
const MODEL_ERROR: f64 = 0.02;
const NOISE_V: f64 = 1.2e-3;
const VOLTS_PER_COUNT: f32 = 12.0 / 32_768.0;
/// Between two trials, and how much of that the motion takes.
const TRIAL: Duration = Duration::from_millis(2700);
const MOTION: Duration = Duration::from_millis(900);

#[derive(Parser)]
struct Arguments {
    #[arg(long)]
    data: PathBuf,
    /// Trials; as many as the paper's Real-Hex has with contact.
    #[arg(long, default_value_t = 93_674)]
    trials: u32,
    /// Seed of places, forces and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Further runs with the same trials.
    #[arg(long, default_value_t = 0)]
    copies: i64,
    /// The copies have no frames of their twins.
    #[arg(long)]
    measured_copies: bool,
}

/// One trial before it was measured.
struct Press {
    key: TrialKey,
    contacts: Vec<Contact>,
}

/// The next configuration, all its depths.
fn series(configuration: u32, points: &[Point], rng: &mut ChaCha8Rng) -> Vec<Press> {
    let tips = rng.random_range(1..=6);
    let places = rand::seq::index::sample(rng, points.len(), tips).into_vec();
    let most_n = FORCE_N.end.min(LOAD_MAX_N / tips as f64);
    let deepest: Vec<f64> =
        places.iter().map(|_| rng.random_range(FORCE_N.start..most_n)).collect();
    let press = |depth_index: u32| {
        let share = f64::from(depth_index + 1) / f64::from(DEPTHS);
        let contact = |(tip, (&place, &deepest_n)): (usize, (&usize, &f64))| {
            let least_n = if tip == 0 { FIRST_MIN_N } else { 0.5 };
            let Point { x_mm, y_mm, .. } = points[place];
            Contact { x_mm, y_mm, force_n: least_n + (deepest_n - least_n) * share.powf(1.5) }
        };
        let contacts = places.iter().zip(&deepest).enumerate().map(contact).collect();
        Press { key: TrialKey { configuration, depth_index }, contacts }
    };
    (0..DEPTHS).map(press).collect()
}

/// A draw from the standard normal distribution (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (TAU * rng.random::<f64>()).cos()
}

/// Reading of the converter for this voltage of the model.
fn measured(simulated_v: &[f32], electrodes: usize, rng: &mut ChaCha8Rng) -> Vec<i16> {
    let read = |(channel, &volts): (usize, &f32)| {
        let (k, j) = ((channel / electrodes) as f64, (channel % electrodes) as f64);
        let error = MODEL_ERROR * 2.0_f64.sqrt() * (TAU * (k + 2.0 * j) / electrodes as f64).sin();
        let volts = f64::from(volts) * (1.0 + error) + NOISE_V * normal(rng);
        (volts / f64::from(VOLTS_PER_COUNT)).round() as i16
    };
    simulated_v.iter().enumerate().map(read).collect()
}

fn record(n: u32, press: &Press, counts: Vec<i16>, electrodes: usize) -> TrialRecord {
    let key = press.key;
    let depth_mm = 0.5 + f64::from(key.depth_index) * 0.25;
    let pose = |z_mm| Pose { x_mm: 270.0, y_mm: 280.0, z_mm, radius_mm: 60.0 };
    let arm = |(arm, contact): (u8, &Contact)| ArmReading {
        arm,
        x_mm: contact.x_mm,
        y_mm: contact.y_mm,
        force_n: contact.force_n,
        cell_v: 0.5 + contact.force_n / 100.0,
        tare_v: 0.5,
    };
    let sums = counts.chunks(electrodes).map(|injection| {
        injection.iter().map(|&c| f64::from(c) * f64::from(VOLTS_PER_COUNT)).sum::<f64>().abs()
    });
    let started_at = Timestamp::constant(1_767_225_600, 0) + n * TRIAL;
    TrialRecord {
        key,
        attempt: 1,
        tips: press.contacts.len() as u8,
        depth_mm: Some(depth_mm),
        target: Some(pose(40.0 + depth_mm)),
        reached: Some(pose(40.004 + depth_mm)),
        arms: (1..).zip(&press.contacts).map(arm).collect(),
        placed: vec![],
        placed_by: None,
        quality: FrameQuality {
            saturated_channels: Some(0),
            stuck_channels: Some(0),
            missing_channels: Some(0),
            injection_sum_v: sums.reduce(f64::max),
            dropped_packets: Some(0),
        },
        frames: vec![FrameRecord {
            sequence: n,
            device_time_us: u64::from(n) * 2_700_000,
            volts_per_count: VOLTS_PER_COUNT,
            counts,
        }],
        flags: vec![],
        settle_ms: 1500.0,
        scalars: TrialScalars::all(0.2),
        started_at,
        measured_at: started_at + (TRIAL - MOTION),
    }
}

fn new_run(seed: u64, trials: u32, sensor: &Sensor) -> NewRun {
    NewRun {
        uid: RunUid::new(),
        experiment: "fill-database".into(),
        kind: RunKind::RealHex,
        definition: EXPERIMENT.into(),
        seed: Some(seed),
        rig: Some(RIG.into()),
        sensor: SENSOR.into(),
        calibration_id: None,
        plan: None,
        label: Label::Virtual,
        version: env!("CARGO_PKG_VERSION").into(),
        git_commit: None,
        deadband_n: 5.0,
        tip_diameter_mm: Some(sensor.file.tip_diameter_mm),
        trials_planned: u64::from(trials),
        auto_resume: false,
        not_before: None,
        submitted_by: "fill_database".into(),
    }
}

/// Copies run 1, its trials, contacts, voltages and twins, `copies` times; the frames of the twins with `twin_frames`.
async fn copy(path: &Path, copies: i64, twin_frames: bool) -> Result<(), Failure> {
    let options = SqliteConnectOptions::new().filename(path).foreign_keys(false);
    let mut database = SqliteConnection::connect_with(&options).await?;
    let last: i64 =
        sqlx::query_scalar("SELECT max(id) FROM trials").fetch_one(&mut database).await?;
    for run in 2..2 + copies {
        let shift = (run - 1) * last;
        let mut view = database.begin().await?;
        for (table, changed) in [
            ("runs", vec![("scan_id", run.to_string()), ("uid", format!("'{}'", RunUid::new()))]),
            ("trials", vec![("id", format!("id + {shift}")), ("run", run.to_string())]),
            ("trial_tips", vec![("trial", format!("trial + {shift}"))]),
            ("trial_voltages", vec![("trial", format!("trial + {shift}"))]),
            ("twins", vec![("trial", format!("trial + {shift}"))]),
            ("twin_voltages", vec![("trial", format!("trial + {shift}"))]),
        ] {
            if table == "twin_voltages" && !twin_frames {
                continue;
            }
            let names: Vec<String> = sqlx::query_scalar("SELECT name FROM pragma_table_info(?1)")
                .bind(table)
                .fetch_all(&mut *view)
                .await?;
            let value = |name: &String| {
                let other = changed.iter().find(|(column, _)| column == name);
                other.map_or_else(|| name.clone(), |(_, value)| value.clone())
            };
            let values: Vec<String> = names.iter().map(value).collect();
            let only = match table {
                "runs" => "scan_id = 1".to_owned(),
                "trials" => "run = 1".to_owned(),
                _ => format!("trial <= {last}"),
            };
            let sql = format!(
                "INSERT INTO {table} ({}) SELECT {} FROM {table} WHERE {only}",
                names.join(", "),
                values.join(", ")
            );
            sqlx::raw_sql(sqlx::AssertSqlSafe(sql)).execute(&mut *view).await?;
        }
        view.commit().await?;
    }
    Ok(database.close().await?)
}

#[tokio::main]
async fn main() -> Result<(), Failure> {
    let Arguments { data, trials, seed, copies, measured_copies } = Arguments::parse();
    let path = data.join("palpate.db");
    if path.exists() {
        return Err(format!("{}: is there already", path.display()).into());
    }
    std::fs::create_dir_all(&data)?;
    let sensor = Sensor::from_toml(SENSOR)?;
    let forward = load_or_build(&sensor, &data.join("cache"))?;
    let batch = BatchModel::new(&forward, Kernel::detect());
    let electrodes = forward.circuit().electrodes.len();

    let store = Store::open(&path, Clock::new(1.0)).await?;
    let run = store.create_run(new_run(seed, trials, &sensor)).await?;
    let model = NewTwinModel {
        hash: forward.model_hash().into(),
        sensor_sha256: run.sensor_sha256,
        calibration_id: None,
        version: run.version,
        git_commit: None,
    };
    let model = store.twin_model(model).await?;

    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut work, mut frames) = (BatchWork::default(), Vec::new());
    let (started, mut stored) = (Instant::now(), 0);
    for first in (0..trials.div_ceil(DEPTHS)).step_by(SERIES as usize) {
        let configurations = first..first + SERIES;
        let mut presses: Vec<Press> =
            configurations.flat_map(|c| series(c, sensor.points(), &mut rng)).collect();
        presses.truncate((trials - stored) as usize);
        let contacts: Vec<&[Contact]> = presses.iter().map(|p| p.contacts.as_slice()).collect();
        frames.resize(presses.len() * batch.frame_len(), 0.0);
        batch.voltages(&contacts, &mut frames, &mut work)?;

        let mut twins = Vec::with_capacity(presses.len());
        for (press, simulated) in presses.iter().zip(frames.chunks(batch.frame_len())) {
            let counts = measured(simulated, electrodes, &mut rng);
            let trial = record(stored, press, counts, electrodes);
            let measured_v = &trial.mean_voltages_v();
            let apart = Compared { measured_v, simulated_v: simulated }.difference();
            let outcome = TwinOutcome::Frame {
                voltages_v: simulated.to_vec(),
                rmse_v: apart.rmse_v,
                fvu: apart.fvu,
            };
            twins.push(Twin { trial: store.trial(run.uid, &trial).await?, outcome });
            stored += 1;
        }
        store.insert_twins(model, twins).await?;
    }
    store.end_run(run.uid, ExitStatus::Success, "filled", Timestamp::now()).await?;
    store.close().await;
    copy(&path, copies, !measured_copies).await?;
    let bytes = std::fs::metadata(&path)?.len();
    let (stored, wall_s) = (i64::from(stored) * (1 + copies), started.elapsed().as_secs_f64());
    println!(
        "{stored} trials in {wall_s:.1} s ({:.0}/s), {} bytes each",
        stored as f64 / wall_s,
        bytes / stored.max(1).unsigned_abs()
    );
    Ok(())
}
