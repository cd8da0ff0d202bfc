//! Damage is found: when the file opens, when it is examined, or when a damaged value is read.
//! Uses: `store`. Never: damage that is not drawn from a stated seed.

use std::collections::{BTreeMap, BTreeSet};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::Connection;

use super::{Folder, execute, findings, hex_trial, new_run, now, open, with_run};
use crate::clock::Clock;
use crate::core::store::PAGE_BYTES;
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::{Journal, error_chain};
use crate::record::{ArmReading, FrameRecord, Pose, ReferenceRecord, TrialScalars};
use crate::state::{StateChange, StoredState};
use crate::{RunKind, Soundness, Store, StoreError, StoreResult, TrialQuery};

/// Number of trials in the file that is damaged.
const TRIALS: u32 = 66;
/// Size of a page of the file, bytes.
const PAGE_LEN: usize = PAGE_BYTES as usize;

/// Creates and closes a database with trials, reference presses and events. Returns its run.
async fn filled(folder: &Folder) -> RunUid {
    let store = open(&folder.file()).await;
    let run = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    store.run_state(run, StateChange::to(StoredState::Running), now()).await.unwrap();
    for n in 0..TRIALS {
        let mut trial = hex_trial(n / 11, n % 11, &[f64::from(n), 7.5]);
        trial.frames.push(FrameRecord { sequence: n, ..trial.frames[0].clone() });
        store.trial(run, &trial).await.unwrap();
        store.append_event(Some(run), "trial", serde_json::json!({ "n": n })).await.unwrap();
    }
    let press = reference();
    store.reference(run, &press).await.unwrap();
    store.close().await;
    run
}

/// Such a database, opened again, with its folder and its run.
async fn opened() -> (Folder, Store, RunUid) {
    let folder = Folder::new();
    let run = filled(&folder).await;
    let store = open(&folder.file()).await;
    (folder, store, run)
}

fn reference() -> ReferenceRecord {
    let like = hex_trial(1, 0, &[9.0]);
    let (arms, frame) = (like.arms, like.frames[0].clone());
    let reached = like.reached.unwrap();
    ReferenceRecord { before_configuration: 0, reached, depth_mm: 3.0, arms, frame, at: now() }
}

/// The measured values of a trial, bit for bit.
type Measured = (TrialKey, Vec<ArmReading>, Option<Pose>, Vec<u32>, Vec<FrameRecord>);

async fn measured(store: &Store, run: RunUid) -> StoreResult<Vec<Measured>> {
    let query =
        TrialQuery { run: Some(run), limit: 1000, with_voltages: true, ..Default::default() };
    let mut all = Vec::new();
    for trial in store.trials(&query).await? {
        let (configuration, depth_index) = (trial.configuration, trial.depth_index);
        let volts = trial.voltages_v.unwrap_or_default().iter().map(|v| v.to_bits()).collect();
        let frames = store.frames(trial.trial_id).await?;
        let key = TrialKey { configuration, depth_index };
        all.push((key, trial.arms, trial.reached, volts, frames));
    }
    Ok(all)
}

/// Number of single bits that are flipped, each in a separate file.
const FLIPS: usize = 100;

/// A kind of damage, with its name.
type Damage = (&'static str, fn(&mut Vec<u8>, &mut ChaCha8Rng));

const WAYS: [Damage; 14] = [
    ("emptied", |bytes, _| bytes.clear()),
    ("no database at all", |bytes, rng| rng.fill(&mut bytes[..])),
    ("another file's text", |bytes, _| *bytes = b"not a database\n".repeat(2000)),
    ("header zeroed", |bytes, _| bytes[..100].fill(0)),
    ("first page zeroed", |bytes, _| bytes[..PAGE_LEN].fill(0)),
    ("another page size", |bytes, _| bytes[16..18].copy_from_slice(&4096u16.to_be_bytes())),
    ("a format of the future", |bytes, _| bytes[18..20].fill(9)),
    ("cut at a page", |bytes, rng| {
        let pages = bytes.len() / PAGE_LEN;
        bytes.truncate(PAGE_LEN * rng.random_range(1..pages));
    }),
    ("cut anywhere", |bytes, rng| bytes.truncate(rng.random_range(1..bytes.len()))),
    ("a page zeroed", |bytes, rng| page(bytes, rng).fill(0)),
    ("a page of ones", |bytes, rng| page(bytes, rng).fill(0xFF)),
    ("a page of noise", |bytes, rng| {
        let mut noise = [0; PAGE_LEN];
        rng.fill(&mut noise[..]);
        page(bytes, rng).copy_from_slice(&noise);
    }),
    ("a page twice", |bytes, rng| {
        let from = page(bytes, rng).to_vec();
        page(bytes, rng).copy_from_slice(&from);
    }),
    ("a sector zeroed", |bytes, rng| {
        let at = 512 * rng.random_range(0..bytes.len() / 512);
        bytes[at..at + 512].fill(0);
    }),
];

/// Draws a page other than the first.
fn page<'b>(bytes: &'b mut [u8], rng: &mut ChaCha8Rng) -> &'b mut [u8] {
    let n = rng.random_range(1..bytes.len() / PAGE_LEN);
    &mut bytes[PAGE_LEN * n..PAGE_LEN * (n + 1)]
}

#[expect(clippy::ptr_arg, reason = "every way to damage has this type; some shorten the file")]
fn flip(bytes: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    let at = rng.random_range(0..bytes.len());
    bytes[at] ^= 1 << rng.random_range(0..8);
}

/// A sound file and its contents.
struct Original {
    bytes: Vec<u8>,
    run: RunUid,
    measured: Vec<Measured>,
    stored: BTreeSet<TrialKey>,
    /// Offset of the index of the trials' keys, which `progress` reads instead of the table.
    keys_at: usize,
}

impl Original {
    async fn new() -> Self {
        let folder = Folder::new();
        let run = filled(&folder).await;
        let bytes = std::fs::read(folder.file()).unwrap();
        let store = open(&folder.file()).await;
        assert_eq!(store.examine(2000).await.unwrap(), Soundness::Sound);
        let measured = measured(&store, run).await.unwrap();
        let stored = store.progress(run).await.unwrap().stored;
        assert_eq!((measured.len(), stored.len()), (TRIALS as usize, TRIALS as usize));
        let keys = "SELECT rootpage FROM sqlite_schema WHERE name = 'sqlite_autoindex_trials_1'";
        let keys: i64 = sqlx::query_scalar(keys).fetch_one(&store.inner.readers).await.unwrap();
        Self { bytes, run, measured, stored, keys_at: PAGE_LEN * (keys as usize - 1) }
    }

    /// Returns whether the damaged file is `refused`, `found` to be damaged, or `harmless`. It never
    /// returns other trials.
    async fn verdict(&self, damaged: &[u8], what: &str) -> &'static str {
        let folder = Folder::new();
        std::fs::write(folder.file(), damaged).unwrap();
        let Ok(store) = Store::open(&folder.file(), Clock::new(1.0)).await else {
            return "refused";
        };
        match store.examine(2000).await.unwrap() {
            Soundness::Damaged(findings) => {
                assert!(!findings.is_empty(), "{what}");
                "found"
            }
            Soundness::Sound => {
                let again = measured(&store, self.run).await;
                assert!(again.is_ok_and(|again| again == self.measured), "{what}");
                let stored = store.progress(self.run).await.map(|progress| progress.stored);
                assert!(stored.is_ok_and(|stored| stored == self.stored), "{what}: keys");
                "harmless"
            }
            Soundness::Unchecked => panic!("{what}: it was not looked at"),
        }
    }
}

#[tokio::test]
async fn no_damage_passes_for_a_measurement() {
    let original = Original::new().await;
    let few_bits: Damage = ("a bit flipped", flip);
    let ways = (0..6).flat_map(|_| WAYS).chain((0..FLIPS).map(|_| few_bits));
    let mut verdicts: BTreeMap<&str, u32> = BTreeMap::new();
    for (seed, (way, damage)) in ways.enumerate() {
        let mut bytes = original.bytes.clone();
        damage(&mut bytes, &mut ChaCha8Rng::seed_from_u64(seed as u64));
        let verdict = original.verdict(&bytes, &format!("{way}, seed {seed}")).await;
        *verdicts.entry(verdict).or_default() += 1;
    }
    assert!(verdicts["refused"] > 20 && verdicts["found"] > 20, "{verdicts:?}");
}

/// The remaining steps of a plan are read from an index: an index that differs from its table is damage.
#[tokio::test]
async fn a_key_that_changed_in_its_index_alone_is_found() {
    let original = Original::new().await;
    let mut found = 0;
    for seed in 0..40 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut bytes = original.bytes.clone();
        // The records of a page are at its end.
        let at = original.keys_at + PAGE_LEN - 1 - rng.random_range(0..500);
        bytes[at] ^= 1 << rng.random_range(0..8);
        let verdict = original.verdict(&bytes, &format!("index, seed {seed}")).await;
        found += u32::from(verdict == "found");
    }
    assert!(found > 30, "{found} of 40");
}

/// Changes one count of the first frame of the trial, outside the store.
async fn change_count(folder: &Folder, trial: TrialId) {
    let mut behind = folder.behind().await;
    let counts: Vec<u8> = sqlx::query_scalar("SELECT counts FROM frames WHERE trial = ?1")
        .bind(trial.0)
        .fetch_one(&mut behind)
        .await
        .unwrap();
    let mut changed = counts.clone();
    changed[77] ^= 0x10;
    sqlx::query("UPDATE frames SET counts = ?2 WHERE trial = ?1 AND n = 0")
        .bind(trial.0)
        .bind(changed)
        .execute(&mut behind)
        .await
        .unwrap();
    behind.close().await.unwrap();
}

#[tokio::test]
async fn a_frame_that_changed_is_named_by_its_trial() {
    let (folder, store, run) = opened().await;
    assert_eq!(store.soundness(), Soundness::Unchecked);
    change_count(&folder, TrialId(60)).await;
    // Older than the examined trials.
    assert_eq!(store.examine(3).await.unwrap(), Soundness::Sound);
    assert_eq!(store.soundness(), Soundness::Sound);
    let findings = findings(&store).await;
    let [finding] = &findings[..] else { panic!("{findings:?}") };
    assert!(finding.contains("trial 60"), "{finding}");
    assert_eq!(store.soundness(), Soundness::Damaged(findings));
    let error = store.frames(TrialId(60)).await.unwrap_err();
    assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
    assert!(error.to_string().contains("trial 60"), "{error}");
    assert_eq!(store.frames(TrialId(59)).await.unwrap().len(), 2);
    assert_eq!(store.references(run).await.unwrap().len(), 1);
}

#[tokio::test]
async fn whatever_of_a_trial_changes_is_found_where_it_is_read() {
    let changes = [
        "UPDATE trials SET reached_z_mm = reached_z_mm + 0.001 WHERE id = 9",
        "UPDATE trials SET depth_index = 100 WHERE id = 9",
        "UPDATE trial_tips SET force_n = -force_n WHERE trial = 9 AND arm = 2",
        "DELETE FROM trial_tips WHERE trial = 9 AND arm = 2",
        "UPDATE trial_voltages SET voltages_v = zeroblob(3136) WHERE trial = 9",
        "DELETE FROM trial_voltages WHERE trial = 9",
        "DELETE FROM frames WHERE trial = 9 AND n = 1",
        "UPDATE frames SET sequence = sequence + 1 WHERE trial = 9 AND n = 0",
        "UPDATE frames SET volts_per_count = 0.5 WHERE trial = 9 AND n = 0",
    ];
    for change in changes {
        let (_folder, store, _) = opened().await;
        execute(&store, change).await;
        let findings = findings(&store).await;
        assert!(findings.len() == 1 && findings[0].contains("trial 9"), "{change}: {findings:?}");
    }
}

#[tokio::test]
async fn a_damaged_trial_stays_and_the_diary_does_not_wait_for_its_discard() {
    let (_folder, store, run) = opened().await;
    execute(&store, "UPDATE trial_tips SET force_n = -force_n WHERE trial = 9 AND arm = 2").await;
    let key = TrialKey { configuration: 0, depth_index: 8 };
    let refused = store.discard(run, key, "a hand slipped").await.unwrap_err();
    assert!(refused.refused, "a repetition fails, too: {}", error_chain(&refused));
    assert!(store.progress(run).await.unwrap().stored.contains(&key));
}

#[tokio::test]
async fn whatever_column_of_the_trials_table_changes_is_found() {
    let (_folder, store, _) = opened().await;
    let change = async |sql: String| {
        let changing = async move |c: &mut sqlx::SqliteConnection| {
            sqlx::raw_sql(sqlx::AssertSqlSafe(sql)).execute(c).await.unwrap();
            Ok(())
        };
        store.write("damaging", changing).await.unwrap();
    };
    // The id and the run are references: the structure of the file covers them.
    let columns: Vec<(String, String)> = sqlx::query_as(
        "SELECT name, type FROM pragma_table_info('trials') WHERE name NOT IN ('id', 'run')",
    )
    .fetch_all(&store.inner.readers)
    .await
    .unwrap();
    assert!(columns.len() > 20, "{columns:?}");
    change("CREATE TEMP TABLE original AS SELECT * FROM trials WHERE id = 9".into()).await;
    for (name, kind) in columns {
        let other = match (&*name, &*kind) {
            ("flags", _) => "'[\"unsettled\"]'".to_owned(),
            // One of three words, by a CHECK of its column.
            ("imported_split", _) => "'train'".to_owned(),
            (_, "TEXT") => "'2026-01-01T00:00:00.000Z'".to_owned(),
            // Still a number of contacts, of a key that is not stored.
            _ => format!("coalesce({name}, 0) + 100"),
        };
        change(format!("UPDATE trials SET {name} = {other} WHERE id = 9")).await;
        let findings = findings(&store).await;
        assert!(findings.len() == 1 && findings[0].contains("trial 9"), "{name}: {findings:?}");
        let original = format!("(SELECT {name} FROM original)");
        change(format!("UPDATE trials SET {name} = {original} WHERE id = 9")).await;
    }
    assert_eq!(store.examine(2000).await.unwrap(), Soundness::Sound);
}

#[tokio::test]
async fn a_reference_press_that_changed_is_found_where_it_is_read() {
    let (_folder, store, run) = opened().await;
    execute(&store, "UPDATE reference_presses SET device_time_us = 1").await;
    let error = store.references(run).await.unwrap_err();
    assert!(error.to_string().contains("reference press 1"), "{error}");
}

#[tokio::test]
async fn trials_of_before_the_checksums_are_read_as_they_are() {
    let (_folder, store, run) = opened().await;
    execute(
        &store,
        "UPDATE trials SET crc32 = NULL; UPDATE trial_voltages SET crc32 = NULL;
         UPDATE frames SET crc32 = NULL; UPDATE reference_presses SET crc32 = NULL",
    )
    .await;
    assert_eq!(store.examine(2000).await.unwrap(), Soundness::Sound);
    assert_eq!(measured(&store, run).await.unwrap().len(), TRIALS as usize);
}

#[tokio::test]
async fn a_negative_zero_and_what_is_absent_are_no_damage() {
    let (_folder, store, run) = with_run(RunKind::RealHex).await;
    let mut trial = hex_trial(0, 0, &[-0.0, 5.0]);
    (trial.target, trial.scalars) = (None, TrialScalars::all(-0.0));
    trial.quality.injection_sum_v = None;
    let id = store.trial(run, &trial).await.unwrap();
    assert_eq!(store.trial_by_id(id).await.unwrap().unwrap().target, None);
    assert_eq!(store.examine(1).await.unwrap(), Soundness::Sound);
}

/// The database of a process that was killed: its file and its log, which holds every trial.
async fn killed(folder: &Folder) -> (Vec<u8>, Vec<u8>) {
    let store = open(&folder.file()).await;
    let run = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    for n in 0..22 {
        store.trial(run, &hex_trial(n / 11, n % 11, &[f64::from(n), 7.5])).await.unwrap();
    }
    let log = std::fs::read(folder.0.path().join("palpate.sqlite-wal")).unwrap();
    (std::fs::read(folder.file()).unwrap(), log)
}

#[tokio::test]
async fn a_damaged_log_is_refused_and_one_that_a_crash_tore_is_not() {
    let folder = Folder::new();
    let (file, log) = killed(&folder).await;
    let all = TrialQuery { limit: 1000, ..Default::default() };
    let reopened = async |log: &[u8]| {
        let folder = Folder::new();
        std::fs::write(folder.file(), &file).unwrap();
        std::fs::write(folder.0.path().join("palpate.sqlite-wal"), log).unwrap();
        let opened = Store::open(&folder.file(), Clock::new(1.0)).await;
        if opened.is_err() {
            let kept = std::fs::read(folder.0.path().join("palpate.sqlite-wal")).unwrap();
            assert_eq!(kept, log, "a damaged log is not changed");
        }
        match opened {
            Ok(store) => Ok(store.trials(&all).await.unwrap().len()),
            Err(error) => Err(error.to_string()),
        }
    };
    assert_eq!(reopened(&log).await, Ok(22));
    // Torn: the end is missing, or differs from what was to be written.
    let frame = 24 + PAGE_LEN;
    assert_eq!(reopened(&log[..log.len() - 5]).await, Ok(21));
    let mut torn = log.clone();
    torn[log.len() - 9000..].fill(0);
    assert_eq!(reopened(&torn).await, Ok(21));
    // Cut at any frame: whole transactions are kept.
    for frames in [1, 2, 5, 20] {
        assert!(reopened(&log[..32 + frame * frames]).await.is_ok());
    }
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    // Damage in the last transaction cannot be distinguished from a torn end. A frame that commits
    // holds the size of the database.
    let commits = |n: &usize| log[32 + frame * n..][4..8] != [0; 4];
    let mut ends = (0..(log.len() - 32) / frame).filter(commits);
    let before_the_last = 32 + frame * (1 + ends.nth_back(1).unwrap());
    for _ in 0..60 {
        let mut damaged = log.clone();
        let at = rng.random_range(0..before_the_last);
        damaged[at] ^= 1 << rng.random_range(0..8);
        let refused = reopened(&damaged).await.unwrap_err();
        assert!(refused.contains("is damaged at byte"), "byte {at}: {refused}");
    }
    // A log that was restarted over an older one.
    let mut rewound = log.clone();
    rewound[32 + 8 * frame..][8..16].fill(0x55);
    for later in rewound[32..].chunks_exact_mut(frame).skip(8) {
        later[8..16].fill(0x55);
    }
    assert!(reopened(&rewound).await.is_ok());
}

/// Neither an empty file nor the log of a missing one is taken for a new database.
#[tokio::test]
async fn a_lost_database_is_not_begun_anew() {
    let lost = async |folder: &Folder| {
        let opened = Store::open(&folder.file(), Clock::new(1.0)).await;
        assert!(matches!(opened, Err(StoreError::Lost { .. })));
    };
    let folder = Folder::new();
    std::fs::write(folder.file(), "").unwrap();
    lost(&folder).await;
    std::fs::rename(folder.file(), folder.0.path().join("palpate.sqlite-wal")).unwrap();
    lost(&folder).await;
    assert!(!folder.file().exists());
    std::fs::remove_file(folder.0.path().join("palpate.sqlite-wal")).unwrap();
    // A process that was killed while it created a new database.
    std::fs::write(folder.0.path().join("palpate.sqlite.new"), "half").unwrap();
    open(&folder.file()).await.set_lock("Ada", "kept").await.unwrap();
    assert!(!folder.0.path().join("palpate.sqlite.new").exists());
}

#[tokio::test]
async fn tables_that_another_hand_changed_are_refused_with_the_cause() {
    let refusal = async |sql: &'static str| {
        let folder = Folder::new();
        filled(&folder).await;
        let mut behind = folder.behind().await;
        sqlx::raw_sql(sql).execute(&mut behind).await.unwrap();
        behind.close().await.unwrap();
        match Store::open(&folder.file(), Clock::new(1.0)).await {
            Ok(_) => panic!("{sql}: it opened"),
            Err(error) => error_chain(&error),
        }
    };
    let words = refusal("DROP VIEW trials_flat; DROP VIEW trial_bounds; DROP TRIGGER trials_in_blocks; ALTER TABLE trials DROP COLUMN settle_ms").await;
    assert!(words.contains("column trials.settle_ms is missing"), "{words}");
    let words = refusal("DELETE FROM _sqlx_migrations").await;
    assert!(words.contains("table runs already exists"), "{words}");
    assert_eq!(words.matches("already exists").count(), 1, "each cause appears once: {words}");
    let words = refusal("UPDATE _sqlx_migrations SET checksum = x'00' WHERE version = 2").await;
    assert!(words.contains("migration 2 was previously applied but has been modified"), "{words}");
}
