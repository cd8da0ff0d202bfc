//! Imports: a run that was measured elsewhere, and its trials in batches.
//! Uses: `core::writer`, `bench::{run_row, trials}`, `twins`. Never: a value that the imported file does not
//! state.
//!
//! A batch is a transaction. The run becomes `ended` after the last one. A killed import therefore never
//! looks complete, and the next start removes its trials. Of two equal imports at once the first one ends.

use jiff::Timestamp;
use sqlx::sqlite::SqliteConnection;

use super::twins::{self, Twin, TwinModelId, TwinOutcome};
use crate::bench::run_row::{self, NewRun, RunRow};
use crate::bench::trials;
use crate::core::columns::{Columns, time_text};
use crate::core::facts::RunKind;
use crate::core::{During, Store, StoreError, StoreResult};
use crate::ids::{RunUid, TrialKey};
use crate::journal::ExitStatus;
use crate::record::{Flag, FrameQuality, FrameRecord, TrialScalars};
use crate::state::StoredState;
use crate::table::checksum::Numbers;
use crate::table::trial_row::Contact;

/// Version of a model whose simulated frames are part of an import.
pub const IMPORTED_MODEL: &str = "imported";

/// Largest number of contacts of an imported trial.
pub const IMPORTED_CONTACTS_MAX: usize = 64;

/// Largest number of raw frames of an imported trial.
pub const IMPORTED_FRAMES_MAX: usize = 300;

/// Largest count of a stored raw frame.
const LARGEST_COUNT: f32 = 32_767.0;

/// Largest number of characters of the tag of an imported trial.
pub const TAG_MAX_CHARS: usize = 100;

const STORING_IMPORT: &str = "storing an import";

/// Number of trials of incomplete imports that one transaction removes: a trial's commit must not wait for all, and a
/// start of the service not end because all of them take longer than one write may.
const REMOVED_AT_ONCE: i64 = 500;

/// A trial measured elsewhere. Unknown values are absent.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImportedTrial {
    /// Position of the configuration in its plan; position of the trial in its file if it has no plan.
    pub configuration: u32,
    /// Position of the depth in the configuration.
    pub depth_index: u32,
    /// Depth, mm; absent if unknown.
    pub depth_mm: Option<f64>,
    /// Number of tips; if absent, the number of contacts is stored.
    pub tips: Option<u8>,
    /// Contacts, at most [`IMPORTED_CONTACTS_MAX`].
    pub contacts: Vec<Contact>,
    /// Measured frame, V, injection-major; NaN for a missing channel.
    pub voltages_v: Vec<f32>,
    /// Simulated frame of the same contacts, V, injection-major; absent without one.
    pub sim_voltages_v: Option<Vec<f32>>,
    /// RMSE (V) and FVU between the two frames; without them the simulated frame is not stored.
    pub fit: Option<(f64, Option<f64>)>,
    /// Marks of possible faults.
    pub flags: Vec<Flag>,
    /// Quality of its frame.
    pub quality: FrameQuality,
    /// Wall time of the measurement; absent if unknown.
    pub started_at: Option<Timestamp>,
    /// Number of frames that the measured frame is the mean of; 0 if unknown.
    pub frame_count: u32,
    /// Its raw frames, V, injection-major, each with all channels: `frame_count` of them, or none. They are
    /// stored as 16-bit counts, as those of a rig.
    pub frames_v: Vec<Vec<f32>>,
    /// Part that the file states: `train`, `validation` or `test`.
    pub split: Option<String>,
    /// Tag that the file states, 1 to [`TAG_MAX_CHARS`] characters.
    pub tag: Option<String>,
}

/// State of an import until it is complete: lists of runs show no removed run, and a database that earlier
/// versions open has no other state that they hide.
const INCOMPLETE: StoredState = StoredState::Removed;

impl Store {
    /// Stores a run that was measured elsewhere; lists show it after [`Store::end_import`].
    ///
    /// # Errors
    /// `Refused` if the number of trials is too large or the deadband is not finite;
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn begin_import(&self, new: NewRun) -> StoreResult<RunRow> {
        let now = self.now_text();
        self.write(STORING_IMPORT, async move |connection| {
            let state = StoredState::Idle;
            let row = run_row::insert(connection, new, state, now, STORING_IMPORT).await?;
            sqlx::query("UPDATE runs SET state = ?2 WHERE scan_id = ?1")
                .bind(row.scan_id)
                .bind(INCOMPLETE.as_str())
                .execute(connection)
                .await
                .during(STORING_IMPORT)?;
            Ok(row)
        })
        .await
    }

    /// Returns the number of the ended run that an import of this file, as hashed in `new`, made with the
    /// same name, label and sensor, whatever the file was called.
    ///
    /// # Errors
    /// `Sql` if the read fails.
    pub async fn imported_as(&self, new: &NewRun) -> StoreResult<Option<i64>> {
        let query = sqlx::query(
            "SELECT scan_id FROM runs WHERE kind = ?1 AND state = 'ended'
                 AND experiment = ?2 AND label = ?3 AND sensor = ?4
                 AND CASE WHEN json_valid(definition) THEN json_remove(definition, '$.imported')
                     ELSE definition END
                   = CASE WHEN json_valid(?5) THEN json_remove(?5, '$.imported') ELSE ?5 END",
        )
        .bind(new.kind.as_str())
        .bind(&new.experiment)
        .bind(new.label.as_str())
        .bind(&new.sensor)
        .bind(&new.definition);
        self.row(STORING_IMPORT, query, |c| c.get("scan_id")).await
    }

    /// Stores a batch of trials of an import in one transaction. `model` is the model of their simulated
    /// frames.
    ///
    /// # Errors
    /// `Refused` if a trial has too many contacts, invalid frames, or the key of a stored one; `NoSuchRun` if the run
    /// is not stored; `Sql`, `Late` or `Closed` if the write fails.
    pub async fn import_trials(
        &self,
        run: RunUid,
        model: Option<TwinModelId>,
        trials: Vec<ImportedTrial>,
    ) -> StoreResult<()> {
        let scan_id = self.facts(run, STORING_IMPORT).await?.scan_id;
        let now = self.now_text();
        self.write(STORING_IMPORT, async move |connection| {
            for trial in &trials {
                insert(connection, scan_id, model, trial, &now).await?;
            }
            Ok(())
        })
        .await
    }

    /// Ends an import: it is then an ended run like any other. Returns its row; that of an equal import, as
    /// [`Store::imported_as`] compares them, if that one has ended meanwhile: then this one stays incomplete.
    ///
    /// # Errors
    /// `Sql` if the run is not an import; `Sql`, `Late` or `Closed` if the write fails.
    pub async fn end_import(&self, run: RunUid) -> StoreResult<RunRow> {
        let (run, now) = (run.to_string(), self.now_text());
        self.write(STORING_IMPORT, async move |connection| {
            let equal = sqlx::query(
                "SELECT e.* FROM runs own JOIN runs e ON e.kind = own.kind AND e.experiment = own.experiment
                     AND e.label = own.label AND e.sensor = own.sensor
                     AND CASE WHEN json_valid(e.definition) THEN json_remove(e.definition, '$.imported')
                         ELSE e.definition END
                       = CASE WHEN json_valid(own.definition) THEN json_remove(own.definition, '$.imported')
                         ELSE own.definition END
                 WHERE own.uid = ?1 AND own.kind = 'imported' AND e.uid <> ?1 AND e.state = 'ended' LIMIT 1",
            )
            .bind(&run)
            .fetch_optional(&mut *connection)
            .await
            .during(STORING_IMPORT)?;
            let row = match equal {
                Some(row) => row,
                None => sqlx::query(
                    "UPDATE runs SET state = 'ended', exit_status = ?2, reason = 'imported', ended_at = ?3
                     WHERE uid = ?1 AND kind = 'imported' RETURNING *",
                )
                .bind(&run)
                .bind(ExitStatus::Success.as_str())
                .bind(now)
                .fetch_one(connection)
                .await
                .during(STORING_IMPORT)?,
            };
            RunRow::read(&Columns::of(&row, STORING_IMPORT))
        })
        .await
    }

    /// Removes the trials of an import that does not become complete. An ended one stays as it is.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql`, `Late` or `Closed` if a write fails: then the next start removes
    /// the rest.
    pub async fn discard_import(&self, run: RunUid) -> StoreResult<()> {
        const OPERATION: &str = "removing a failed import";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        self.remove_incomplete(Some(scan_id), OPERATION).await.map(drop)
    }

    /// Removes the trials of incomplete imports, and returns their number. Call it at the start.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if a write fails: then the next start removes the rest.
    pub async fn sweep_imports(&self) -> StoreResult<u64> {
        self.remove_incomplete(None, "removing an incomplete import").await
    }

    /// Removes the trials of incomplete imports, of one run or of all, and returns their number. However many they are,
    /// no transaction is late.
    async fn remove_incomplete(
        &self,
        scan_id: Option<i64>,
        operation: &'static str,
    ) -> StoreResult<u64> {
        let mut removed = 0;
        loop {
            // The few runs first: not each stored trial.
            let query = sqlx::query(
                "DELETE FROM trials WHERE id IN
                     (SELECT t.id FROM runs r CROSS JOIN trials t ON t.run = r.scan_id
                      WHERE r.kind = ?1 AND r.state = ?2 AND r.scan_id = coalesce(?3, r.scan_id)
                      LIMIT ?4)",
            )
            .bind(RunKind::Imported.as_str())
            .bind(INCOMPLETE.as_str())
            .bind(scan_id)
            .bind(REMOVED_AT_ONCE);
            match self.inner.writer.execute(operation, query).await? {
                0 => return Ok(removed),
                trials => removed += trials,
            }
        }
    }
}

/// Inserts a trial with its contacts, frames and simulated frame; `now` is the time of the import.
async fn insert(
    connection: &mut SqliteConnection,
    scan_id: i64,
    model: Option<TwinModelId>,
    trial: &ImportedTrial,
    now: &str,
) -> StoreResult<()> {
    let refused = |field, limit| StoreError::Refused { operation: STORING_IMPORT, field, limit };
    if trial.contacts.len() > IMPORTED_CONTACTS_MAX {
        return Err(refused("contacts", "must be at most 64"));
    }
    if !trial.frames_v.is_empty() {
        if trial.frames_v.len() != trial.frame_count as usize {
            return Err(refused("frames_v", "must be as many as frame_count, or none"));
        }
        let channels = trial.voltages_v.len();
        let is_whole = |f: &Vec<f32>| f.len() == channels && f.iter().all(|v| v.is_finite());
        if !trial.frames_v.iter().all(is_whole) {
            return Err(refused("frames_v", "must have a finite value for each channel"));
        }
    }
    let contacts = trial.contacts.len() as u8;
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
        scalars: TrialScalars::default(),
        contact_count: contacts,
        max_force_n: trial.contacts.iter().filter_map(|c| c.force_n).reduce(f64::max),
        frame_count: trial.frame_count,
        times: [at.as_deref().map(Into::into), None],
        imported_split: trial.split.as_deref(),
        imported_tag: trial.tag.as_deref(),
    };
    let raw = as_counts(&trial.frames_v);
    let mean_v = &trial.voltages_v;
    let id = trials::insert(connection, scan_id, &numbers, mean_v, &raw, STORING_IMPORT)
        .await?
        .ok_or_else(|| refused("its key", "must be new"))?;
    let (Some(model), Some(frame), Some((rmse_v, fvu))) = (model, &trial.sim_voltages_v, trial.fit)
    else {
        return Ok(());
    };
    let outcome = TwinOutcome::Frame { voltages_v: frame.clone(), rmse_v, fvu };
    let twin = Twin { trial: id, outcome };
    twins::insert(connection, model, twin, now).await
}

/// Raw frames as counts: the largest magnitude of a trial is the largest count, so that a voltage changes by at
/// most 1/65534 of it. Their sequence is their order; a device time is not known, and not read from an import.
fn as_counts(frames_v: &[Vec<f32>]) -> Vec<FrameRecord> {
    let largest_v = frames_v.iter().flatten().fold(0.0_f32, |most, v| most.max(v.abs()));
    let volts_per_count = (largest_v / LARGEST_COUNT).max(f32::MIN_POSITIVE);
    let count = |v: &f32| (v / volts_per_count).round() as i16;
    let record = |(frame_v, sequence): (&Vec<f32>, u32)| FrameRecord {
        sequence,
        device_time_us: 0,
        volts_per_count,
        counts: frame_v.iter().map(count).collect(),
    };
    frames_v.iter().zip(0..).map(record).collect()
}
