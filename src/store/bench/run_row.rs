//! The row of a run: its inputs, its state and its end; inserting, replacing and decoding it.
//! Uses: `core`, `plans`, `journal`, `state`. Never: a change of a state (`run_state`).

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::AssertSqlSafe;
use sqlx::sqlite::SqliteConnection;
use utoipa::ToSchema;

use super::plans;
use crate::core::columns::{Columns, row, time_text};
use crate::core::facts::{Label, RunKind};
use crate::core::{During, StoreError, StoreResult};
use crate::digest::sha256_hex;
use crate::ids::{CalibrationId, RunUid};
use crate::journal::ExitStatus;
use crate::state::{PausedWhy, StoredState};

/// Inputs of a run that is to be stored.
#[derive(Debug, Clone, PartialEq)]
pub struct NewRun {
    /// Id of the run.
    pub uid: RunUid,
    /// Name of the experiment.
    pub experiment: String,
    /// Origin of its trials.
    pub kind: RunKind,
    /// Text of the experiment file.
    pub definition: String,
    /// Seed of all random choices, at most 2^63 - 1 (the limit of TOML); absent for an import.
    pub seed: Option<u64>,
    /// Text of the rig file; absent for an import.
    pub rig: Option<String>,
    /// Text of the sensor file.
    pub sensor: String,
    /// Id of the serving calibration; absent without one.
    pub calibration_id: Option<CalibrationId>,
    /// Origin of the data: measured, virtual or simulated.
    pub label: Label,
    /// Version of the program.
    pub version: String,
    /// Commit of the program; absent if unknown.
    pub git_commit: Option<String>,
    /// Force below which contacts are removed from the labels, N.
    pub deadband_n: f64,
    /// Diameter of a tip, mm; absent if the sensor file does not state it.
    pub tip_diameter_mm: Option<f64>,
    /// Its plan as JSON; absent for an import.
    pub plan: Option<String>,
    /// Number of trials of its plan.
    pub trials_planned: u64,
    /// Whether it may resume automatically after a restart.
    pub auto_resume: bool,
    /// Earliest start, wall time; absent if it may start at any time.
    pub not_before: Option<Timestamp>,
    /// Person or key that submitted it.
    pub submitted_by: String,
}

/// A run as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunRow {
    /// Id of the run.
    pub uid: RunUid,
    /// Number of the run, from 1.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Origin of its trials.
    pub kind: RunKind,
    /// Text of the experiment file.
    pub definition: String,
    /// sha256 of the experiment file.
    pub definition_sha256: String,
    /// Seed of all random choices; absent for an import.
    pub seed: Option<u64>,
    /// Text of the rig file; absent for an import.
    pub rig: Option<String>,
    /// sha256 of the rig file; absent for an import.
    pub rig_sha256: Option<String>,
    /// Text of the sensor file.
    pub sensor: String,
    /// sha256 of the sensor file.
    pub sensor_sha256: String,
    /// Id of the calibration that served when it was submitted; absent without one.
    pub calibration_id: Option<CalibrationId>,
    /// Origin of the data: measured, virtual or simulated.
    pub label: Label,
    /// Version of the program.
    pub version: String,
    /// Commit of the program; absent if unknown.
    pub git_commit: Option<String>,
    /// Force below which contacts are removed from the labels, N.
    pub deadband_n: f64,
    /// Diameter of a tip, mm; absent if unknown.
    pub tip_diameter_mm: Option<f64>,
    /// Number of trials of its plan.
    pub trials_planned: u64,
    /// Whether it may resume automatically after a restart.
    pub auto_resume: bool,
    /// Earliest start, wall time; absent if it may start at any time.
    pub not_before: Option<Timestamp>,
    /// sha256 of its plan; absent for an import, and for a run of an older version that has not been
    /// armed since.
    pub plan_sha256: Option<String>,
    /// State of the run.
    pub state: StoredState,
    /// Requested state that is not reached yet; absent without a request.
    pub requested_state: Option<StoredState>,
    /// Cause of the pause; absent unless it is paused or interrupted.
    pub paused_why: Option<PausedWhy>,
    /// Exit status; absent until it ends, and again after it was resumed.
    pub exit_status: Option<ExitStatus>,
    /// Reason of the exit status; absent until it ends.
    pub reason: Option<String>,
    /// Position in the queue, from 1; absent unless it is queued.
    pub queue_position: Option<u32>,
    /// Wall time since which it is started and waits for the active run to end; absent otherwise.
    pub waiting_since: Option<Timestamp>,
    /// Whether it can be resumed: nothing drives it and its plan has trials left, since it was interrupted or
    /// ended short of its plan.
    pub is_resumable: bool,
    /// Wall time at which it was submitted.
    pub created_at: Timestamp,
    /// Wall time at which it first left the queue; absent before.
    pub started_at: Option<Timestamp>,
    /// Wall time at which it ended or was removed from the queue; absent before.
    pub ended_at: Option<Timestamp>,
    /// Person or key that submitted it.
    pub submitted_by: String,
}

/// Page of runs, newest first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunPage {
    /// Runs of the page.
    pub runs: Vec<RunRow>,
    /// Value of `before` for the next page; absent on the last page.
    pub next: Option<i64>,
}

impl RunRow {
    /// Whether it has begun and has not ended, driven or not.
    pub fn is_open(&self) -> bool {
        !matches!(self.state, StoredState::Queued | StoredState::Ended | StoredState::Removed)
    }

    /// Whether it is driven, now or again after a restart: trials of it may be stored at any time.
    pub fn is_driven(&self) -> bool {
        self.is_open() && self.state != StoredState::Interrupted
    }

    /// The row as it is once the runs that an earlier process left open are marked as interrupted.
    pub(crate) fn interrupted(self) -> Self {
        if !self.is_driven() {
            return self;
        }
        let (state, paused_why) = (StoredState::Interrupted, Some(PausedWhy::Restart));
        let is_resumable = is_resumable(self.kind, state, self.exit_status);
        Self { state, requested_state: None, paused_why, is_resumable, ..self }
    }

    pub(crate) fn read(c: &Columns<'_>) -> StoreResult<Self> {
        let (kind, state) = (c.word("kind")?, c.word("state")?);
        let exit_status = c.word_or_none("exit_status")?;
        let is_resumable = is_resumable(kind, state, exit_status);
        Ok(row!(c, Self { kind, state, exit_status, is_resumable },
            get: scan_id, experiment, definition, definition_sha256, rig, rig_sha256, sensor,
                sensor_sha256, version, git_commit, deadband_n, tip_diameter_mm, auto_resume,
                plan_sha256, reason, submitted_by;
            whole: trials_planned;
            whole_or_none: seed, queue_position;
            word: uid, label;
            word_or_none: calibration_id, requested_state, paused_why;
            time: created_at;
            time_or_none: not_before, waiting_since, started_at, ended_at))
    }
}

/// Whether nothing drives a run and its plan has trials left.
fn is_resumable(kind: RunKind, state: StoredState, exit_status: Option<ExitStatus>) -> bool {
    match state {
        StoredState::Interrupted => true,
        StoredState::Ended => kind != RunKind::Imported && exit_status != Some(ExitStatus::Success),
        StoredState::Queued
        | StoredState::Idle
        | StoredState::Running
        | StoredState::Pausing
        | StoredState::Paused
        | StoredState::Stopping
        | StoredState::Aborting
        | StoredState::Suspending
        | StoredState::Panicked
        | StoredState::Removed => false,
    }
}

/// Columns of the inputs of a run, in the order of their parameters, from the fifth on.
const INPUTS: &str = "experiment, kind, definition, definition_sha256, seed, rig, rig_sha256, \
     sensor, sensor_sha256, calibration_id, label, version, git_commit, deadband_n, \
     tip_diameter_mm, trials_planned, auto_resume, plan_sha256, not_before";

/// Inserts a run, `Queued` at the end of the queue or `Idle`, and returns its row. `now` is its time of
/// creation.
///
/// # Errors
/// `Refused` if the seed or the number of trials is too large or the deadband is not finite; `Sql` if
/// the statement fails.
pub(crate) async fn insert(
    connection: &mut SqliteConnection,
    new: NewRun,
    state: StoredState,
    now: String,
    operation: &'static str,
) -> StoreResult<RunRow> {
    write(connection, "", new, state, now, operation).await
}

/// Replaces the inputs of the queued run with the uid of `new`, and returns its row; number, place,
/// creation and submitter stay. It is no longer started: what was armed was the earlier run.
///
/// # Errors
/// `NotQueued` if the run is not in the queue; others as [`insert`].
pub(crate) async fn replace(
    connection: &mut SqliteConnection,
    new: NewRun,
    now: String,
    operation: &'static str,
) -> StoreResult<RunRow> {
    let uid = new.uid;
    let queued: Option<Option<String>> =
        sqlx::query_scalar("SELECT plan_sha256 FROM runs WHERE uid = ?1 AND state = 'queued'")
            .bind(uid.to_string())
            .fetch_optional(&mut *connection)
            .await
            .during(operation)?;
    let earlier_plan = queued.ok_or(StoreError::NotQueued(uid))?;
    let inputs: Vec<String> =
        INPUTS.split(", ").map(|column| format!("{column} = excluded.{column}")).collect();
    let inputs = inputs.join(", ");
    let replacing = format!("ON CONFLICT (uid) DO UPDATE SET {inputs}, waiting_since = NULL");
    let row = write(&mut *connection, &replacing, new, StoredState::Queued, now, operation).await?;
    if let Some(sha256) = earlier_plan {
        plans::discard(connection, &sha256, operation).await?;
    }
    Ok(row)
}

/// Inserts a run; `on_conflict` is what the statement does if its uid is stored.
async fn write(
    connection: &mut SqliteConnection,
    on_conflict: &str,
    new: NewRun,
    state: StoredState,
    now: String,
    operation: &'static str,
) -> StoreResult<RunRow> {
    let refused = |field, limit| StoreError::Refused { operation, field, limit };
    let seed = new.seed.map(i64::try_from).transpose();
    let seed = seed.map_err(|_| refused("seed", "must be under 2^63"))?;
    let planned = i64::try_from(new.trials_planned)
        .map_err(|_| refused("trials_planned", "must be under 2^63"))?;
    if !new.deadband_n.is_finite() {
        return Err(refused("deadband_n", "must be finite"));
    }
    let plan_sha256 = match &new.plan {
        Some(plan) => Some(plans::keep(&mut *connection, plan, operation).await?),
        None => None,
    };
    let values: Vec<String> = (5..).zip(INPUTS.split(", ")).map(|(n, _)| format!("?{n}")).collect();
    let statement = format!(
        "INSERT INTO runs (uid, state, queue_position, created_at, submitted_by, {INPUTS})
         VALUES (?1, ?2, CASE WHEN ?2 = 'queued'
                 THEN (SELECT coalesce(max(queue_position), 0) + 1 FROM runs) END,
             ?3, ?4, {})
         {on_conflict} RETURNING *",
        values.join(", ")
    );
    let row = sqlx::query(AssertSqlSafe(statement))
        .bind(new.uid.to_string())
        .bind(state.as_str())
        .bind(now)
        .bind(&new.submitted_by)
        .bind(&new.experiment)
        .bind(new.kind.as_str())
        .bind(&new.definition)
        .bind(sha256_hex(&new.definition))
        .bind(seed)
        .bind(&new.rig)
        .bind(new.rig.as_deref().map(sha256_hex))
        .bind(&new.sensor)
        .bind(sha256_hex(&new.sensor))
        .bind(new.calibration_id.as_ref().map(CalibrationId::as_str))
        .bind(new.label.as_str())
        .bind(&new.version)
        .bind(&new.git_commit)
        .bind(new.deadband_n)
        .bind(new.tip_diameter_mm)
        .bind(planned)
        .bind(new.auto_resume)
        .bind(plan_sha256)
        .bind(new.not_before.map(time_text))
        .fetch_one(connection)
        .await
        .during(operation)?;
    RunRow::read(&Columns::of(&row, operation))
}
