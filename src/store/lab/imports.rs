//! Trials measured elsewhere: a run that is over before it is stored, and its trials in bulk.
//! Uses: `store::{runs, writer}`. Never: a judgement on what was measured, a value of its own.
//!
//! A batch is a transaction. The run is `ended` only with the last one, so that a kill leaves an
//! import which nothing takes for whole; the next start removes it.

use jiff::Timestamp;
use sqlx::sqlite::SqliteConnection;

use super::twins::{self, Twin, TwinModelId, TwinOutcome};
use crate::bench::run_row::{self, NewRun, RunRow};
use crate::bench::trials::insert_voltages;
use crate::core::columns::time_text;
use crate::core::{During, Store, StoreError};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::ExitStatus;
use crate::record::FrameQuality;
use crate::table::checksum::Numbers;
use crate::table::trial_row::Contact;

/// Version of a model whose frames came with an import.
pub const IMPORTED_MODEL: &str = "imported";
/// The most contacts of an imported trial.
pub const IMPORTED_CONTACTS_MAX: usize = 64;

const STORING: &str = "storing an import";

/// A trial measured elsewhere. What is not known of it is absent.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImportedTrial {
    /// Its place in its file where it has no place in a plan.
    pub configuration: u32,
    /// Depth step.
    pub depth_index: u32,
    /// Depth, mm.
    pub depth_mm: Option<f64>,
    /// Tips, where the file says them; else its contacts are counted.
    pub tips: Option<u8>,
    /// What touched the skin.
    pub contacts: Vec<Contact>,
    /// The measured frame, V; NaN where a channel is missing.
    pub voltages_v: Vec<f32>,
    /// Somebody's simulated frame of the same touch, V.
    pub sim_voltages_v: Option<Vec<f32>>,
    /// How far the two are apart: RMSE (V) and FVU.
    pub fit: Option<(f64, Option<f64>)>,
    /// Words about what may be wrong with it; must be those of `Flag`.
    pub flags: Vec<crate::record::Flag>,
    /// How good its frame is.
    pub quality: FrameQuality,
    /// When it was measured.
    pub started_at: Option<Timestamp>,
}

impl Store {
    /// Stores a run that was measured elsewhere, not ended yet.
    pub async fn begin_import(&self, new: NewRun) -> Result<RunRow, StoreError> {
        let now = self.now_text();
        self.inner
            .writer
            .run(STORING, async move |connection| {
                let row = run_row::insert(connection, new, false, now, STORING).await?;
                sqlx::query("UPDATE runs SET state = 'removed' WHERE scan_id = ?1")
                    .bind(row.scan_id)
                    .execute(connection)
                    .await
                    .during(STORING)?;
                Ok(row)
            })
            .await
    }

    /// Stores some trials of an import in one transaction.
    pub async fn import_trials(
        &self,
        run: RunUid,
        model: Option<TwinModelId>,
        trials: Vec<ImportedTrial>,
    ) -> Result<(), StoreError> {
        let scan_id = self.facts(run, STORING).await?.scan_id;
        let now = self.now_text();
        self.inner
            .writer
            .run(STORING, async move |connection| {
                for trial in &trials {
                    insert(connection, scan_id, model, trial, &now).await?;
                }
                Ok(())
            })
            .await
    }

    /// Ends an import: from now on it is a run like any other. Returns its row.
    pub async fn end_import(&self, run: RunUid) -> Result<RunRow, StoreError> {
        let now = self.now_text();
        self.inner
            .writer
            .run(STORING, async move |connection| {
                let row = sqlx::query(
                    "UPDATE runs SET state = 'ended', exit_status = ?2, reason = 'imported',
                         ended_at = ?3
                     WHERE uid = ?1 AND kind = 'imported' RETURNING *",
                )
                .bind(run.to_string())
                .bind(ExitStatus::Success.as_str())
                .bind(now)
                .fetch_one(connection)
                .await
                .during(STORING)?;
                RunRow::read(&row, STORING)
            })
            .await
    }

    /// Removes the trials of imports that did not come to their end. For the start.
    pub async fn sweep_imports(&self) -> Result<u64, StoreError> {
        const OPERATION: &str = "removing half an import";
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                let gone = sqlx::query(
                    "DELETE FROM trials WHERE run IN
                         (SELECT scan_id FROM runs WHERE kind = 'imported' AND state = 'removed')",
                )
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(gone.rows_affected())
            })
            .await
    }
}

async fn insert(
    connection: &mut SqliteConnection,
    scan_id: i64,
    model: Option<TwinModelId>,
    trial: &ImportedTrial,
    now: &str,
) -> Result<(), StoreError> {
    let refused = |field, limit| StoreError::Refused { operation: STORING, field, limit };
    if trial.contacts.len() > IMPORTED_CONTACTS_MAX {
        return Err(refused("contacts", "must be at most 64"));
    }
    let contacts = trial.contacts.len() as u8;
    let largest = trial.contacts.iter().filter_map(|c| c.force_n).reduce(f64::max);
    let flags = serde_json::to_string(&trial.flags)
        .map_err(|_| refused("flags", "must be words that JSON can hold"))?;
    let at = trial.started_at.map(time_text);
    let (configuration, depth_index) = (trial.configuration, trial.depth_index);
    let numbers = Numbers {
        key: TrialKey { configuration, depth_index },
        attempt: 1,
        tips: trial.tips.unwrap_or(contacts),
        depth_mm: trial.depth_mm,
        poses: [None, None],
        arms: &[],
        placed: &trial.contacts,
        placed_by: None,
        flags: &trial.flags,
        quality: trial.quality,
        settle_ms: None,
        overshoot_n: None,
        contact_count: contacts,
        max_force_n: largest,
        frame_count: 0,
        times: [trial.started_at, None],
    };
    let id: i64 = sqlx::query_scalar(
        "INSERT INTO trials (run, configuration, depth_index, attempt, tips, depth_mm, flags,
             contact_count, max_force_n, frame_count, started_at, measured_at, saturated_channels,
             stuck_channels, missing_channels, injection_sum_v, dropped_packets, crc32)
         VALUES (?1, ?2, ?3, 1, ?4, ?5, ?6, ?7, ?8, 0, ?9, NULL, ?10, ?11, ?12, ?13, ?14, ?15)
         RETURNING id",
    )
    .bind(scan_id)
    .bind(trial.configuration)
    .bind(trial.depth_index)
    .bind(numbers.tips)
    .bind(trial.depth_mm)
    .bind(flags)
    .bind(contacts)
    .bind(largest)
    .bind(at)
    .bind(trial.quality.saturated_channels)
    .bind(trial.quality.stuck_channels)
    .bind(trial.quality.missing_channels)
    .bind(trial.quality.injection_sum_v)
    .bind(trial.quality.dropped_packets)
    .bind(numbers.crc32())
    .fetch_one(&mut *connection)
    .await
    .during(STORING)?;
    insert_voltages(connection, TrialId(id), &trial.voltages_v, STORING).await?;
    for (n, contact) in trial.contacts.iter().enumerate() {
        sqlx::query(
            "INSERT INTO placed_contacts (trial, n, x_mm, y_mm, force_n, diameter_mm)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
        )
        .bind(id)
        .bind(n as i64)
        .bind(contact.x_mm)
        .bind(contact.y_mm)
        .bind(contact.force_n)
        .bind(contact.diameter_mm)
        .execute(&mut *connection)
        .await
        .during(STORING)?;
    }
    let (Some(model), Some(frame), Some((rmse_v, fvu))) = (model, &trial.sim_voltages_v, trial.fit)
    else {
        return Ok(());
    };
    let outcome = TwinOutcome::Frame { voltages_v: frame.clone(), rmse_v, fvu };
    let twin = Twin { trial: TrialId(id), outcome };
    twins::insert(connection, model, twin, now).await
}
