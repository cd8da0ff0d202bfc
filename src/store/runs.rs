//! Runs: their provenance, their states and their ends.
//! Uses: `store`, `journal`. Never: what a state means (`campaign` does).

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use utoipa::ToSchema;

use super::columns::{Columns, sha256_hex, time_text};
use super::{During, Store, StoreError};
use crate::ids::RunUid;
use crate::journal::ExitStatus;

/// Where trials come from: the two measured experiments of Table I, or elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RunKind {
    /// The multi-point indenter's; contacts under the deadband are removed from the labels.
    RealHex,
    /// Weights placed by hand; nominal contacts are all kept, also under the deadband.
    RealRandom,
    /// Trials measured elsewhere, with contacts as they were handed in.
    Imported,
}

impl RunKind {
    /// The kind as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        match self {
            RunKind::RealHex => "real-hex",
            RunKind::RealRandom => "real-random",
            RunKind::Imported => "imported",
        }
    }
}

/// Whether a skin was touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Label {
    /// On a real rig.
    Measured,
    /// On the virtual rig.
    Virtual,
    /// Nowhere: computed by somebody's model, and imported.
    Simulated,
}

impl Label {
    /// The label as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        match self {
            Label::Measured => "measured",
            Label::Virtual => "virtual",
            Label::Simulated => "simulated",
        }
    }
}

/// A run to be: what it is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct NewRun {
    /// Its id.
    pub uid: RunUid,
    /// Name of the experiment.
    pub experiment: String,
    /// Which experiment of Table I.
    pub kind: RunKind,
    /// Text of the experiment file.
    pub definition: String,
    /// Seed of everything drawn; at most 2^63 - 1, the largest of TOML. Absent for an import.
    pub seed: Option<u64>,
    /// Text of the rig file; absent for an import.
    pub rig: Option<String>,
    /// Text of the sensor file.
    pub sensor: String,
    /// The calibration in force, if there is one.
    pub calibration_id: Option<String>,
    /// Whether a skin will be touched.
    pub label: Label,
    /// Version of the program.
    pub version: String,
    /// Commit of the program, where it is known.
    pub git_commit: Option<String>,
    /// Contacts under this are removed from the labels, N.
    pub deadband_n: f64,
    /// Diameter of a contact, mm, where the sensor file says it.
    pub tip_diameter_mm: Option<f64>,
    /// Trials in its plan.
    pub trials_planned: u64,
    /// It may go on by itself after a restart.
    pub auto_resume: bool,
    /// Who asked for it.
    pub submitted_by: String,
}

/// A run as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunRow {
    /// Its id.
    pub uid: RunUid,
    /// Its number for people, from 1.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Which experiment of Table I.
    pub kind: RunKind,
    /// Text of the experiment file.
    pub definition: String,
    /// Its sha256.
    pub definition_sha256: String,
    /// Seed of everything drawn; absent for an import.
    pub seed: Option<u64>,
    /// Text of the rig file; absent for an import.
    pub rig: Option<String>,
    /// Its sha256.
    pub rig_sha256: Option<String>,
    /// Text of the sensor file.
    pub sensor: String,
    /// Its sha256.
    pub sensor_sha256: String,
    /// The calibration in force, if there was one.
    pub calibration_id: Option<String>,
    /// Whether a skin was touched.
    pub label: Label,
    /// Version of the program.
    pub version: String,
    /// Commit of the program, where it is known.
    pub git_commit: Option<String>,
    /// Contacts under this are removed from the labels, N.
    pub deadband_n: f64,
    /// Diameter of a contact, mm, where it is known.
    pub tip_diameter_mm: Option<f64>,
    /// Trials in its plan.
    pub trials_planned: u64,
    /// It may go on by itself after a restart.
    pub auto_resume: bool,
    /// `queued`, a state of the engine, `interrupted`, `ended` or `removed`.
    pub state: String,
    /// The state that was asked for, where it is not reached yet.
    pub requested_state: Option<String>,
    /// Why it is paused, when it is.
    pub paused_why: Option<String>,
    /// How it ended.
    pub exit_status: Option<ExitStatus>,
    /// Why it ended so.
    pub reason: Option<String>,
    /// Its place in the queue, from 1, while it waits there.
    pub queue_position: Option<u32>,
    /// Armed and started, it waits since then for the run under way to end.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub waiting_since: Option<Timestamp>,
    /// When it was created.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// When it first left the queue.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// When it ended, or was removed.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub ended_at: Option<Timestamp>,
    /// Who asked for it.
    pub submitted_by: String,
}

/// A page of runs, newest first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunPage {
    /// The runs.
    pub runs: Vec<RunRow>,
    /// Hand this in as `before` for the page that follows; absent on the last.
    pub next: Option<i64>,
}

impl RunRow {
    pub(super) fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        let exit_status = match c.get::<Option<&str>>("exit_status")? {
            None => None,
            Some(_) => Some(c.word("exit_status")?),
        };
        Ok(Self {
            uid: c.uid("uid")?,
            scan_id: c.get("scan_id")?,
            experiment: c.get("experiment")?,
            kind: c.word("kind")?,
            definition: c.get("definition")?,
            definition_sha256: c.get("definition_sha256")?,
            seed: c.whole_or_none("seed")?,
            rig: c.get("rig")?,
            rig_sha256: c.get("rig_sha256")?,
            sensor: c.get("sensor")?,
            sensor_sha256: c.get("sensor_sha256")?,
            calibration_id: c.get("calibration_id")?,
            label: c.word("label")?,
            version: c.get("version")?,
            git_commit: c.get("git_commit")?,
            deadband_n: c.get("deadband_n")?,
            tip_diameter_mm: c.get("tip_diameter_mm")?,
            trials_planned: c.whole("trials_planned")?,
            auto_resume: c.get("auto_resume")?,
            state: c.get("state")?,
            requested_state: c.get("requested_state")?,
            paused_why: c.get("paused_why")?,
            exit_status,
            reason: c.get("reason")?,
            queue_position: c.whole_or_none("queue_position")?,
            waiting_since: c.time_or_none("waiting_since")?,
            created_at: c.time("created_at")?,
            started_at: c.time_or_none("started_at")?,
            ended_at: c.time_or_none("ended_at")?,
            submitted_by: c.get("submitted_by")?,
        })
    }
}

/// Inserts a run; at the end of the queue when `queued`. Returns its row.
pub(super) async fn insert(
    connection: &mut SqliteConnection,
    new: NewRun,
    queued: bool,
    now: String,
    operation: &'static str,
) -> Result<RunRow, StoreError> {
    let refused = |field, limit| StoreError::Refused { operation, field, limit };
    let seed = new.seed.map(i64::try_from).transpose();
    let seed = seed.map_err(|_| refused("seed", "must be under 2^63"))?;
    let planned = i64::try_from(new.trials_planned)
        .map_err(|_| refused("trials_planned", "must be under 2^63"))?;
    if !new.deadband_n.is_finite() {
        return Err(refused("deadband_n", "must be a number"));
    }
    let row = sqlx::query(
        "INSERT INTO runs (uid, experiment, kind, definition, definition_sha256, seed, rig,
             rig_sha256, sensor, sensor_sha256, calibration_id, label, version, git_commit,
             deadband_n, tip_diameter_mm, trials_planned, auto_resume, state, queue_position,
             created_at, submitted_by)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18,
             ?19, CASE WHEN ?19 = 'queued'
                  THEN (SELECT coalesce(max(queue_position), 0) + 1 FROM runs) END,
             ?20, ?21)
         RETURNING *",
    )
    .bind(new.uid.to_string())
    .bind(&new.experiment)
    .bind(new.kind.as_str())
    .bind(&new.definition)
    .bind(sha256_hex(&new.definition))
    .bind(seed)
    .bind(&new.rig)
    .bind(new.rig.as_deref().map(sha256_hex))
    .bind(&new.sensor)
    .bind(sha256_hex(&new.sensor))
    .bind(&new.calibration_id)
    .bind(new.label.as_str())
    .bind(&new.version)
    .bind(&new.git_commit)
    .bind(new.deadband_n)
    .bind(new.tip_diameter_mm)
    .bind(planned)
    .bind(new.auto_resume)
    .bind(if queued { "queued" } else { "idle" })
    .bind(now)
    .bind(&new.submitted_by)
    .fetch_one(connection)
    .await
    .during(operation)?;
    RunRow::read(&row, operation)
}

impl Store {
    /// Stores a new run in the state `idle` and gives it its number.
    pub async fn create_run(&self, new: NewRun) -> Result<RunRow, StoreError> {
        const OPERATION: &str = "creating a run";
        let now = self.now_text();
        let insert =
            async move |c: &mut SqliteConnection| insert(c, new, false, now, OPERATION).await;
        Ok(self.keep_facts(self.inner.writer.run(OPERATION, insert).await?))
    }

    /// One run.
    pub async fn run(&self, run: RunUid) -> Result<Option<RunRow>, StoreError> {
        const OPERATION: &str = "reading a run";
        sqlx::query("SELECT * FROM runs WHERE uid = ?1")
            .bind(run.to_string())
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?
            .map(|row| RunRow::read(&row, OPERATION))
            .transpose()
    }

    /// One run by its number.
    pub async fn run_by_scan_id(&self, scan_id: i64) -> Result<Option<RunRow>, StoreError> {
        const OPERATION: &str = "reading a run";
        sqlx::query("SELECT * FROM runs WHERE scan_id = ?1")
            .bind(scan_id)
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?
            .map(|row| RunRow::read(&row, OPERATION))
            .transpose()
    }

    /// Up to `limit` runs, newest first, older than the one numbered `before`.
    pub async fn runs(&self, limit: u32, before: Option<i64>) -> Result<RunPage, StoreError> {
        const OPERATION: &str = "listing runs";
        let rows =
            sqlx::query("SELECT * FROM runs WHERE scan_id < ?1 ORDER BY scan_id DESC LIMIT ?2")
                .bind(before.unwrap_or(i64::MAX))
                .bind(i64::from(limit) + 1)
                .fetch_all(&self.inner.readers)
                .await
                .during(OPERATION)?;
        let mut runs = read_all(&rows, OPERATION)?;
        let more = runs.len() > limit as usize;
        runs.truncate(limit as usize);
        let next = if more { runs.last().map(|r| r.scan_id) } else { None };
        Ok(RunPage { runs, next })
    }

    /// Runs in a state of the engine, oldest first. At the start, before any engine runs: those that
    /// a process left open.
    pub async fn open_runs(&self) -> Result<Vec<RunRow>, StoreError> {
        const OPERATION: &str = "reading open runs";
        let rows = sqlx::query(
            "SELECT * FROM runs WHERE state NOT IN ('queued', 'interrupted', 'ended', 'removed')
             ORDER BY scan_id",
        )
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        read_all(&rows, OPERATION)
    }

    /// Marks the runs that a process left open as `interrupted`, all but one if one is named. For
    /// the start, before any engine runs.
    pub async fn interrupt_open_runs(&self, but: Option<RunUid>) -> Result<(), StoreError> {
        const OPERATION: &str = "marking interrupted runs";
        let but = but.map(|run| run.to_string());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "UPDATE runs
                     SET state = 'interrupted', requested_state = NULL, paused_why = 'restart'
                     WHERE state NOT IN ('queued', 'interrupted', 'ended', 'removed')
                         AND uid IS NOT ?1",
                )
                .bind(but)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    pub(super) async fn set_run_state(
        &self,
        run: RunUid,
        state: &str,
        requested: Option<&str>,
        why: Option<&str>,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        const OPERATION: &str = "storing a run's state";
        const OWN: [&str; 3] = ["queued", "ended", "removed"];
        if OWN.contains(&state) {
            let limit = "must be a state of the engine (the store sets queued, ended and removed)";
            return Err(StoreError::Refused { operation: OPERATION, field: "state", limit });
        }
        let (state, requested, why) =
            (state.to_owned(), requested.map(str::to_owned), why.map(str::to_owned));
        let at = time_text(at);
        self.inner
            .writer
            .patient()
            .run(OPERATION, async move |connection| {
                let changed = sqlx::query(
                    "UPDATE runs SET state = ?2, requested_state = ?3, paused_why = ?4,
                         queue_position = NULL, waiting_since = NULL,
                         started_at = coalesce(started_at, ?5)
                     WHERE uid = ?1 AND state NOT IN ('ended', 'removed')",
                )
                .bind(run.to_string())
                .bind(state)
                .bind(requested)
                .bind(why)
                .bind(at)
                .execute(&mut *connection)
                .await
                .during(OPERATION)?;
                changed_or_ended(connection, run, changed.rows_affected(), OPERATION).await
            })
            .await
    }

    pub(super) async fn finish_run(
        &self,
        run: RunUid,
        status: ExitStatus,
        reason: &str,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        const OPERATION: &str = "ending a run";
        let (reason, at) = (reason.to_owned(), time_text(at));
        self.inner
            .writer
            .patient()
            .run(OPERATION, async move |connection| {
                // Ending a run as it has ended is no change: the caller may have to ask twice.
                let changed = sqlx::query(
                    "UPDATE runs SET state = 'ended', requested_state = NULL, paused_why = NULL,
                         queue_position = NULL, waiting_since = NULL, exit_status = ?2,
                         reason = CASE WHEN state = 'ended' THEN reason ELSE ?3 END,
                         ended_at = coalesce(ended_at, ?4)
                     WHERE uid = ?1 AND state <> 'removed'
                       AND (exit_status IS NULL OR exit_status = ?2)",
                )
                .bind(run.to_string())
                .bind(status.as_str())
                .bind(reason)
                .bind(at)
                .execute(&mut *connection)
                .await
                .during(OPERATION)?;
                changed_or_ended(connection, run, changed.rows_affected(), OPERATION).await
            })
            .await
    }
}

pub(super) fn read_all(
    rows: &[SqliteRow],
    operation: &'static str,
) -> Result<Vec<RunRow>, StoreError> {
    rows.iter().map(|row| RunRow::read(row, operation)).collect()
}

/// Explains why a change of a run's state changed nothing.
async fn changed_or_ended(
    connection: &mut SqliteConnection,
    run: RunUid,
    changed: u64,
    operation: &'static str,
) -> Result<(), StoreError> {
    if changed > 0 {
        return Ok(());
    }
    let known: Option<i64> = sqlx::query_scalar("SELECT scan_id FROM runs WHERE uid = ?1")
        .bind(run.to_string())
        .fetch_optional(connection)
        .await
        .during(operation)?;
    Err(if known.is_some() { StoreError::RunEnded(run) } else { StoreError::NoSuchRun(run) })
}
