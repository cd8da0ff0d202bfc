//! Examination of the file for damage: its structure, the texts of its runs, the checksums of its last
//! trials, the bounds of its blocks.
//! Uses: `table::{checksum, assemble, column}`. Never: a repair, a connection that other callers wait for.

use std::collections::HashMap;
use std::time::Duration;

use futures::TryStreamExt;
use rusqlite::Connection;
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnection;

use crate::core::bulk::Statement;
use crate::core::columns::Columns;
use crate::core::facts::RunKind;
use crate::core::store::Soundness;
use crate::core::{During, Store, StoreError, StoreResult};
use crate::digest::sha256_hex;
use crate::ids::TrialId;
use crate::table::assemble::rows_of_ids;
use crate::table::pages::id;
use crate::table::query::SELECT_WITH_VOLTAGES;
use crate::table::{Column, TABLE, checksum};

const OPERATION: &str = "examining the database";

/// Longest wall time of an examination: a file of 10 GB on a slow disk.
const EXAMINE_DEADLINE: Duration = Duration::from_secs(600);

/// Number of trials that are read at once.
const EXAMINED_AT_ONCE: usize = 100;

/// Largest number of reported findings.
const FINDINGS_MAX: usize = 20;

impl Store {
    /// Returns the result of the last examination; `Unchecked` before its end. Does not wait.
    pub fn soundness(&self) -> Soundness {
        self.inner.soundness.lock().clone()
    }

    /// Checks the structure of the whole file and the texts of its runs, compares the newest `last` trials
    /// and their frames with their checksums, and all trials with the bounds of their blocks. It reads the
    /// whole file, on a separate connection, so that no other caller waits. Damage is a result, not an
    /// error.
    ///
    /// # Errors
    /// `Sql` or `Read` if the file cannot be examined; `Late` after 600 s.
    pub async fn examine(&self, last: u32) -> StoreResult<Soundness> {
        let examined = tokio::time::timeout(EXAMINE_DEADLINE, async {
            let options = self.inner.readers.connect_options();
            let mut own = options.connect().await.during(OPERATION)?;
            let mut findings = of_file(&mut own).await?;
            let room = FINDINGS_MAX.saturating_sub(findings.len());
            let trials = move |c: &Connection| match of_trials(c, last, room)? {
                // A value that changed is outside its bounds, too.
                sound if sound.is_empty() => of_blocks(c),
                findings => Ok(findings),
            };
            match self.inner.bulk.read_apart(OPERATION, trials).await {
                Ok(of_trials) => findings.extend(of_trials),
                Err(error) => match error.into_findings() {
                    Ok(damage) => findings.extend(damage),
                    // What was found before counts.
                    Err(error) if findings.is_empty() => return Err(error),
                    Err(_) => {}
                },
            }
            Ok(findings)
        });
        let late =
            || StoreError::Late { operation: OPERATION, limit_s: EXAMINE_DEADLINE.as_secs() };
        let mut findings = examined.await.unwrap_or_else(|_| Err(late()))?;
        findings.truncate(FINDINGS_MAX);
        let soundness = match findings.is_empty() {
            true => Soundness::Sound,
            false => Soundness::Damaged(findings),
        };
        *self.inner.soundness.lock() = soundness.clone();
        Ok(soundness)
    }
}

/// Returns the findings about the structure of the file and the texts of its runs.
async fn of_file(connection: &mut SqliteConnection) -> StoreResult<Vec<String>> {
    let mut findings = structure(connection).await.or_else(StoreError::into_findings)?;
    match changed_texts(connection).await {
        Ok(changed) => findings.extend(changed),
        Err(error) => findings.extend(error.into_findings()?),
    }
    Ok(findings)
}

/// Returns the findings about the newest `last` trials, which are checked until there are `room`.
fn of_trials(connection: &Connection, last: u32, room: usize) -> StoreResult<Vec<String>> {
    let mut newest = Statement::new("SELECT id FROM trials ORDER BY id DESC LIMIT ");
    newest.bind(last);
    let ids = match newest.rows(connection, OPERATION, id) {
        Ok(ids) => ids,
        Err(error) => return error.into_findings(),
    };
    let mut findings = Vec::new();
    for ids in ids.chunks(EXAMINED_AT_ONCE) {
        if findings.len() >= room {
            break;
        }
        if let Err(error) = check_trials(connection, ids) {
            error.into_findings()?;
            findings.extend(one_by_one(connection, ids)?);
        }
    }
    Ok(findings)
}

/// Returns the findings about the bounds of blocks: conditions would miss a trial that is outside them. For a
/// million trials it takes about 2 s.
fn of_blocks(connection: &Connection) -> StoreResult<Vec<String>> {
    let mut outside = Statement::new(
        "SELECT DISTINCT t.id >> 10 AS block FROM trials t
             LEFT JOIN trial_blocks b ON b.block = t.id >> 10
             LEFT JOIN twins w ON w.trial = t.id
         WHERE NOT (coalesce(t.flags BETWEEN b.flags_least AND b.flags_most, FALSE)",
    );
    for Column { name, sql, .. } in TABLE.iter().filter(|column| column.has_bounds()) {
        outside.push(&format!(
            " AND coalesce({sql} BETWEEN b.{name}_least AND b.{name}_most, {sql} IS NULL)"
        ));
    }
    outside.push(") LIMIT ").bind(FINDINGS_MAX as i64);
    let blocks = outside.rows(connection, OPERATION, |c| c.get::<i64>("block"));
    let finding = |block: i64| {
        let (first, last) = (block << 10, (block << 10) + 1023);
        format!("a value of the trials {first} to {last} is outside the bounds of their block")
    };
    blocks.map(|all| all.into_iter().map(finding).collect()).or_else(StoreError::into_findings)
}

/// Returns the damage that SQLite reports. Unlike SQLite's quick check, this one compares the indexes
/// with their tables: the remaining steps of a plan are read from an index only. For 60,000 trials (328
/// MB, in memory) it takes 0.19 s, the quick check 0.15 s.
async fn structure(connection: &mut SqliteConnection) -> StoreResult<Vec<String>> {
    let lines: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check")
        .fetch_all(&mut *connection)
        .await
        .during(OPERATION)?;
    // One answer may hold several lines.
    let lines = lines.iter().flat_map(|answer| answer.lines());
    let mut findings: Vec<String> = lines.filter(|line| *line != "ok").map(str::to_owned).collect();
    let orphans = sqlx::query("PRAGMA foreign_key_check").fetch_all(connection).await;
    match orphans.during(OPERATION)?.len() {
        0 => {}
        n => findings.push(format!("{n} rows refer to missing rows")),
    }
    Ok(findings)
}

/// Returns the runs whose stored files differ from their sha256, so that a resume would compute another
/// plan, and the plans that differ from theirs.
async fn changed_texts(connection: &mut SqliteConnection) -> StoreResult<Vec<String>> {
    const TEXTS: [(&str, &str); 3] =
        [("definition", "definition_sha256"), ("rig", "rig_sha256"), ("sensor", "sensor_sha256")];
    let rows =
        sqlx::query("SELECT * FROM runs").fetch_all(&mut *connection).await.during(OPERATION)?;
    let mut findings = Vec::new();
    for row in &rows {
        let c = Columns::of(row, OPERATION);
        let run: i64 = c.get("scan_id")?;
        for (text, sum) in TEXTS {
            let (kept, stored) = (c.get::<Option<&str>>(text)?, c.get::<Option<&str>>(sum)?);
            if kept.map(sha256_hex).as_deref() != stored {
                findings
                    .push(format!("the {text} file of run {run} was changed after it was stored"));
            }
        }
    }
    // One by one: a plan has megabytes.
    let mut plans = sqlx::query_as("SELECT sha256, plan FROM plans").fetch(connection);
    while let Some((sha256, plan)) = plans.try_next().await.during(OPERATION)? {
        let (sha256, plan): (String, String) = (sha256, plan);
        if sha256_hex(plan) != sha256 {
            findings.push(format!("the plan {sha256} was changed after it was stored"));
        }
    }
    Ok(findings)
}

/// Checks trials one by one and returns their findings, each with the id of its trial.
fn one_by_one(connection: &Connection, ids: &[TrialId]) -> StoreResult<Vec<String>> {
    let mut findings = Vec::new();
    for id in ids {
        if let Err(error) = check_trials(connection, &[*id]) {
            let words = error.into_findings()?;
            findings.extend(words.into_iter().map(|word| format!("trial {}: {word}", id.0)));
        }
    }
    Ok(findings)
}

/// Reads trials completely: row, tips, contacts, voltages, twins, frames. Every checksum is compared.
///
/// # Errors
/// `Damaged` if a trial differs from its checksums or lacks voltages or frames.
fn check_trials(connection: &Connection, ids: &[TrialId]) -> StoreResult<()> {
    let trials = rows_of_ids(connection, SELECT_WITH_VOLTAGES, ids, OPERATION)?;
    let wanted: Vec<i64> = ids.iter().map(|id| id.0).collect();
    let mut of_ids = Statement::new("SELECT f.* FROM json_each(");
    of_ids
        .bind(format!("{wanted:?}"))
        .push(") wanted CROSS JOIN frames f ON f.trial = wanted.value");
    let mut frames: HashMap<i64, u32> = HashMap::new();
    of_ids.rows(connection, OPERATION, |c| {
        let trial: i64 = c.get("trial")?;
        checksum::frame(c, || format!("trial {trial}"))?;
        *frames.entry(trial).or_default() += 1;
        Ok(())
    })?;
    if trials.len() != ids.len() {
        let (there, all) = (trials.len(), ids.len());
        return Err(StoreError::damaged(format!("{there} of {all} rows have their voltages")));
    }
    for trial in trials {
        let (id, planned) = (trial.trial_id.0, trial.frame_count);
        let there = frames.get(&id).copied().unwrap_or(0);
        // An import may have the mean of its frames only.
        let is_mean = trial.kind == RunKind::Imported && there == 0;
        if there != planned && !is_mean {
            return Err(StoreError::damaged(format!(
                "trial {id} has {there} of its {planned} frames"
            )));
        }
    }
    Ok(())
}
