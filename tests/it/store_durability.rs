//! What is acknowledged is kept: kill -9 at random instants, a disk that refuses, a torn log.
//! Uses: the store's public face; this binary runs itself again as the process that is killed.
//! Never: a sleep that a result depends on (instants are drawn; every outcome must hold).

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use palpate::clock::Clock;
use palpate::ids::{RunUid, TrialId, TrialKey};
use palpate::journal::Journal;
use palpate::record::{ArmReading, FrameQuality, FrameRecord, TrialRecord, TrialScalars};
use palpate::store::{
    MAX_PAGE, NewRun, RunKind, Soundness, Store, StoreError, TrialQuery, TrialRow,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::datasets::filled::new_run;
use crate::support::Folder;

/// Names the database to the process that is killed.
const CHILD: &str = "PALPATE_STORE_CHILD";
/// Name of the test that is that process.
const TEST: &str = "store_durability::child";

const DEPTHS: u32 = 11;

/// The run of every test here.
fn run_uid() -> RunUid {
    "0198a3c0-0000-7000-8000-000000000001".parse().unwrap()
}

/// The trial that belongs at the n-th place: everything follows from n.
fn trial(n: u32) -> TrialRecord {
    let key = TrialKey { configuration: n / DEPTHS, depth_index: n % DEPTHS };
    let tips = (n % 6) as u8 + 1;
    let arm = |arm: u8| ArmReading {
        arm,
        x_mm: f64::from(n) * 0.01,
        y_mm: f64::from(arm) / 3.0,
        force_n: f64::from((n * u32::from(arm)) % 50),
        cell_v: 0.5,
        tare_v: 0.5,
    };
    let frame = |sequence: u32| FrameRecord {
        sequence,
        device_time_us: u64::from(sequence) * 33_333,
        volts_per_count: 0.000_366,
        counts: (0..784u32).map(|i| (i * 7 + n * 13 + sequence) as i16).collect(),
    };
    let at = "2026-11-20T18:00:00Z".parse().unwrap();
    TrialRecord {
        key,
        attempt: 1,
        tips,
        depth_mm: Some(f64::from(key.depth_index) * 0.5),
        target: None,
        reached: None,
        arms: (1..=tips).map(arm).collect(),
        placed: vec![],
        placed_by: None,
        frames: (0..=n % 3).map(|k| frame(4 * n + k)).collect(),
        quality: FrameQuality::default(),
        flags: vec![],
        settle_ms: f64::from(n),
        scalars: TrialScalars::default(),
        started_at: at,
        measured_at: at,
    }
}

/// The place of a key, as `trial` counts.
fn place(configuration: u32, depth_index: u32) -> u32 {
    configuration * DEPTHS + depth_index
}

/// A folder for one test or one case.
fn own_folder(name: &str) -> Folder {
    Folder::new(&format!("durability-{name}"))
}

fn file(folder: &Folder) -> PathBuf {
    folder.join("palpate.sqlite")
}

async fn open(path: &Path) -> Store {
    Store::open(path, Clock::new(1.0)).await.unwrap()
}

async fn open_with_run(path: &Path) -> Store {
    let store = open(path).await;
    let new = new_run(RunKind::RealHex, "durability");
    let new = NewRun { uid: run_uid(), sensor: String::new(), auto_resume: true, ..new };
    if store.run(run_uid()).await.unwrap().is_none() {
        store.create_run(new).await.unwrap();
    }
    store
}

/// Not a test by itself: the process that the others start, kill, and starve. It resumes where the
/// run stopped, as a campaign does, and prints what was acknowledged.
#[tokio::test]
async fn child() {
    let Ok(path) = std::env::var(CHILD) else { return };
    let store = open_with_run(Path::new(&path)).await;
    let stored = store.progress(run_uid()).await.unwrap().stored;
    let mut out = std::io::stdout();
    for n in (0..).filter(|n| !stored.contains(&trial(*n).key)) {
        match store.trial(run_uid(), &trial(n)).await {
            Ok(id) => writeln!(out, "ack {n} {}", id.0).unwrap(),
            Err(error) => {
                writeln!(out, "failed {n} {error}").unwrap();
                return;
            }
        }
    }
}

/// The child as a process; `limit` stands before it on a shell's command line.
fn start(path: &Path, limit: &str) -> Child {
    let me = std::env::current_exe().unwrap();
    Command::new("sh")
        .arg("-c")
        .arg(format!("{limit} exec \"$0\" --exact {TEST} --nocapture --test-threads=1"))
        .arg(me)
        .env(CHILD, path)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// What a child printed until its end: ids by place, and the place that failed.
fn listen(child: &mut Child) -> (BTreeMap<u32, i64>, Option<u32>) {
    let mut acknowledged = BTreeMap::new();
    let mut failed = None;
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        // The harness's own words may stand before the first of ours.
        let words: Vec<_> =
            line.split(' ').skip_while(|w| !["ack", "failed"].contains(w)).collect();
        match words[..] {
            ["ack", n, id] => {
                acknowledged.insert(n.parse().unwrap(), id.parse().unwrap());
            }
            ["failed", n, ..] => failed = Some(n.parse().unwrap()),
            _ => {}
        }
    }
    (acknowledged, failed)
}

async fn all(store: &Store) -> Vec<TrialRow> {
    let mut query = TrialQuery { limit: MAX_PAGE, run: Some(run_uid()), ..Default::default() };
    let mut rows = Vec::new();
    loop {
        let page = store.trials(&query).await.unwrap();
        let Some(last) = page.last() else { return rows };
        query.after = Some(last.trial_id);
        rows.extend(page);
    }
}

/// Every row is what `trial` says at its place, whole, once; the places have no gap, and those that were acknowledged
/// have their ids.
async fn check_whole(store: &Store, acknowledged: &BTreeMap<u32, i64>) -> BTreeMap<u32, i64> {
    assert_eq!(store.examine(0).await.unwrap(), Soundness::Sound);
    let rows = all(store).await;
    let mut stored = BTreeMap::new();
    for row in rows {
        let n = place(row.configuration, row.depth_index);
        let expected = trial(n);
        assert_eq!((row.arms, row.settle_ms), (expected.arms.clone(), Some(expected.settle_ms)));
        assert_eq!(store.frames(row.trial_id).await.unwrap(), expected.frames);
        let mean = store.trial_voltages(row.trial_id).await.unwrap().unwrap();
        assert_eq!(mean, expected.mean_voltages_v());
        assert_eq!(stored.insert(n, row.trial_id.0), None, "place {n} is there twice");
    }
    assert!(stored.keys().copied().eq(0..stored.len() as u32), "a place is missing");
    for (n, id) in acknowledged {
        assert_eq!(stored.get(n), Some(id), "place {n} was acknowledged");
    }
    stored
}

#[tokio::test]
async fn kill_9_at_30_instants_loses_doubles_and_invents_nothing() {
    const SEED: u64 = 20_261_120;
    let mut chance = ChaCha8Rng::seed_from_u64(SEED);
    let (folder, other) = (own_folder("kill"), own_folder("kill-first"));
    // A busy machine reaches its first trial late.
    let began = Instant::now();
    let mut first = start(&file(&other), "");
    let lines = BufReader::new(first.stdout.take().unwrap()).lines();
    assert!(lines.map(Result::unwrap).any(|line| line.contains("ack ")));
    let longest_ms = (2 * began.elapsed().as_millis() as u64).max(200);
    first.kill().unwrap();
    first.wait().unwrap();
    let mut acknowledged = BTreeMap::new();
    let mut unacknowledged = 0;
    for kill in 1..=30u64 {
        let mut child = start(&file(&folder), "");
        // From the creation of the file and its tables to the middle of a run.
        std::thread::sleep(Duration::from_millis(chance.random_range(0..longest_ms)));
        child.kill().unwrap();
        let (said, failed) = listen(&mut child);
        assert!(!child.wait().unwrap().success(), "the child ended before kill {kill}");
        assert_eq!(failed, None);
        acknowledged.extend(said);
        unacknowledged = acknowledged.len();
    }
    let store = open_with_run(&file(&folder)).await;
    let stored = check_whole(&store, &acknowledged).await;
    unacknowledged = stored.len() - unacknowledged;
    println!(
        "30 kills, {} trials, {unacknowledged} of them stored but not acknowledged",
        stored.len()
    );
    assert!(acknowledged.len() >= 100, "too few trials to say anything: {}", stored.len());
    assert!(unacknowledged <= 30, "at most one commit is under way at a kill");
}

#[tokio::test]
async fn a_disk_that_refuses_costs_no_acknowledged_trial() {
    let folder = own_folder("refusal");
    open_with_run(&file(&folder)).await.close().await;
    let mut acknowledged = BTreeMap::new();
    // Files may grow to 2, 4, .. MiB (blocks of 512 bytes); beyond, writes fail.
    for mib in [2, 4, 6] {
        let limit = format!("trap '' XFSZ; ulimit -f {};", mib * 2048);
        let mut child = start(&file(&folder), &limit);
        let (said, failed) = listen(&mut child);
        child.wait().unwrap();
        assert!(failed.is_some(), "the limit of {mib} MiB did not hold");
        acknowledged.extend(said);
        let store = open_with_run(&file(&folder)).await;
        check_whole(&store, &acknowledged).await;
        store.close().await;
    }
    assert!(acknowledged.len() >= 20, "{}", acknowledged.len());
}

#[tokio::test]
async fn a_torn_log_leaves_a_prefix_and_a_changed_one_is_refused() {
    const SEED: u64 = 7;
    let mut chance = ChaCha8Rng::seed_from_u64(SEED);
    let folder = own_folder("torn");
    let store = open_with_run(&file(&folder)).await;
    for n in 0..60 {
        store.trial(run_uid(), &trial(n)).await.unwrap();
    }
    let log = |path: &Path| PathBuf::from(format!("{}-wal", path.display()));
    // As they lie on the disk at a power cut: the store is still open.
    let [start, whole] =
        [file(&folder), log(&file(&folder))].map(|path| std::fs::read(path).unwrap());
    let mut shorter = 0;
    for case in 0..20 {
        let cut = own_folder(&format!("torn-{case}"));
        let mut torn = whole.clone();
        let at = chance.random_range(0..torn.len());
        match case % 3 {
            0 => torn.truncate(at),
            1 => torn[at] ^= 1 << chance.random_range(0..8u32),
            _ => torn[at..].fill(0),
        }
        std::fs::write(file(&cut), &start).unwrap();
        std::fs::write(log(&file(&cut)), torn).unwrap();
        if case % 3 == 1 {
            // A crash does not do that: what follows the changed bit was stored.
            let refused = Store::open(&file(&cut), Clock::new(1.0)).await.err().unwrap();
            assert!(matches!(refused, StoreError::DamagedLog { .. }), "{refused}");
            continue;
        }
        let again = open_with_run(&file(&cut)).await;
        let kept = check_whole(&again, &BTreeMap::new()).await.len() as u32;
        shorter += u32::from(kept < 60);
        // It resumes at the right place.
        let next = again.trial(run_uid(), &trial(kept)).await.unwrap();
        assert!(next > TrialId(i64::from(kept)) || kept == 0);
        again.close().await;
    }
    assert!(shorter > 0, "no case lost anything: the log was not torn");
}
