//! Storing trials: a trial is one transaction, and its key is stored once.
//! Uses: `record`, `core::writer`, `table::checksum`. Never: a decision whether a trial is accepted
//! (`campaign` makes it).

use sqlx::query_builder::Separated;
use sqlx::sqlite::SqliteConnection;
use sqlx::{QueryBuilder, Sqlite};

use crate::core::columns::{counts_blob, volts_blob};
use crate::core::facts::{RunFacts, RunKind};
use crate::core::{During, Store, StoreError, StoreResult};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::record::{ArmReading, CONTACTS_MAX, FrameRecord, TrialRecord};
use crate::table::checksum::{self, Numbers};
use crate::table::trial_row::Contact;

/// Largest number of rows of one statement.
const ROWS_AT_ONCE: usize = 100;

const STORING_TRIAL: &str = "storing a trial";

impl Store {
    /// Stores a trial and returns its id. A stored key is not changed.
    ///
    /// # Errors
    /// `Refused` if the record is invalid; `NoSuchRun` if the run is not stored; `NotStored` if the
    /// commit failed and the trial is absent; `Sql` or `Closed` if the outcome is unknown.
    pub(crate) async fn insert_trial(
        &self,
        run: RunUid,
        trial: &TrialRecord,
    ) -> StoreResult<TrialId> {
        let facts = self.facts_to_write(run, STORING_TRIAL).await?;
        check(trial)?;
        let contacts = contact_count(facts, trial)?;
        let forces = trial.arms.iter().map(|a| a.force_n);
        let max_force_n = forces.chain(trial.placed.iter().map(|p| p.force_n)).reduce(f64::max);
        let placed: Vec<Contact> = trial.placed.iter().map(Contact::from).collect();
        let (record, mean_v) = (trial.clone(), trial.mean_voltages_v());
        let (scan_id, key) = (facts.scan_id, trial.key);
        self.inner
            .writer
            .patient()
            .run_and_settle(
                STORING_TRIAL,
                async move |connection| {
                    let numbers = Numbers::of_record(&record, &placed, contacts, max_force_n);
                    let (mean_v, raw) = (&mean_v, &record.frames);
                    let new = insert(connection, scan_id, &numbers, mean_v, raw, STORING_TRIAL);
                    if let Some(id) = new.await? {
                        return Ok(id);
                    }
                    let stored = id_of_key(connection, scan_id, key, STORING_TRIAL).await?;
                    stored.ok_or_else(|| refused("its key", "is neither new nor stored"))
                },
                async move |connection| id_of_key(connection, scan_id, key, STORING_TRIAL).await,
            )
            .await
    }
}

fn refused(field: &'static str, limit: &'static str) -> StoreError {
    StoreError::Refused { operation: STORING_TRIAL, field, limit }
}

/// Checks the frames and numbers of a trial: SQLite would store NaN as NULL, and frames of different
/// lengths have no mean.
///
/// # Errors
/// `Refused` with the invalid field.
fn check(record: &TrialRecord) -> StoreResult<()> {
    let Some(first) = record.frames.first() else {
        return Err(refused("frames", "must hold at least one"));
    };
    if record.frames.iter().any(|f| f.counts.len() != first.counts.len()) {
        return Err(refused("frames", "must have the same length"));
    }
    let poses = [record.target, record.reached].into_iter().flatten();
    let numbers = [Some(record.settle_ms), record.depth_mm, record.quality.injection_sum_v]
        .into_iter()
        .chain(record.scalars.columns().map(|(_, value)| value))
        .flatten()
        .chain(poses.flat_map(|p| [p.x_mm, p.y_mm, p.z_mm, p.radius_mm]))
        .chain(record.arms.iter().flat_map(|a| [a.x_mm, a.y_mm, a.force_n, a.cell_v, a.tare_v]))
        .chain(record.placed.iter().flat_map(|p| [p.x_mm, p.y_mm, p.force_n]))
        .chain(record.frames.iter().map(|f| f64::from(f.volts_per_count)));
    for number in numbers {
        if !number.is_finite() {
            return Err(refused("every number", "must be finite"));
        }
    }
    Ok(())
}

/// Returns the number of contacts of a trial.
///
/// # Errors
/// `Refused` if there are more than six.
fn contact_count(facts: RunFacts, record: &TrialRecord) -> StoreResult<u8> {
    let contacts = match facts.kind {
        RunKind::RealHex => record.arms.iter().filter(|a| a.force_n >= facts.deadband_n).count(),
        RunKind::RealRandom | RunKind::Imported => record.placed.len(),
    };
    u8::try_from(contacts)
        .ok()
        .filter(|n| usize::from(*n) <= CONTACTS_MAX)
        .ok_or_else(|| refused("the number of contacts", "must be at most 6"))
}

/// Returns the id of the trial with this key; `None` if it is not stored.
pub(crate) async fn id_of_key(
    connection: &mut SqliteConnection,
    scan_id: i64,
    key: TrialKey,
    operation: &'static str,
) -> StoreResult<Option<TrialId>> {
    let id: Option<i64> = sqlx::query_scalar(
        "SELECT id FROM trials WHERE run = ?1 AND configuration = ?2 AND depth_index = ?3",
    )
    .bind(scan_id)
    .bind(key.configuration)
    .bind(key.depth_index)
    .fetch_optional(connection)
    .await
    .during(operation)?;
    Ok(id.map(TrialId))
}

/// Inserts a trial of a run, measured or imported, with its tips, placed contacts and frames: their mean, V,
/// injection-major, and the raw ones. Returns its id; `None` if its key is stored, and then inserts nothing.
pub(crate) async fn insert(
    connection: &mut SqliteConnection,
    scan_id: i64,
    numbers: &Numbers<'_>,
    mean_v: &[f32],
    frames: &[FrameRecord],
    operation: &'static str,
) -> StoreResult<Option<TrialId>> {
    let Some(id) = insert_row(connection, scan_id, numbers, operation).await? else {
        return Ok(None);
    };
    insert_mean(connection, id, mean_v, operation).await?;
    let tips = "INSERT INTO trial_tips (trial, arm, x_mm, y_mm, force_n, cell_v, tare_v) ";
    insert_tips(connection, tips, id, numbers.arms, operation).await?;
    let placed = "INSERT INTO placed_contacts (trial, n, x_mm, y_mm, force_n, diameter_mm) ";
    insert_many(connection, placed, numbers.placed, operation, |mut row, n, p| {
        row.push_bind(id)
            .push_bind(n)
            .push_bind(p.x_mm)
            .push_bind(p.y_mm)
            .push_bind(p.force_n)
            .push_bind(p.diameter_mm);
    })
    .await?;
    let raw =
        "INSERT INTO frames (trial, n, sequence, device_time_us, volts_per_count, counts, crc32) ";
    insert_many(connection, raw, frames, operation, |mut row, n, f| {
        row.push_bind(id)
            .push_bind(n)
            .push_bind(f.sequence)
            // A counter of microseconds; the sign bit is reached after 292,000 years.
            .push_bind(f.device_time_us.cast_signed())
            .push_bind(f.volts_per_count)
            .push_bind(counts_blob(&f.counts))
            .push_bind(checksum::of_frame(f));
    })
    .await?;
    Ok(Some(TrialId(id)))
}

/// Inserts the row of a trial. Returns its id; `None` if its key is stored.
async fn insert_row(
    connection: &mut SqliteConnection,
    scan_id: i64,
    numbers: &Numbers<'_>,
    operation: &'static str,
) -> StoreResult<Option<i64>> {
    let limit = "must be words that JSON can represent";
    let flags = serde_json::to_string(numbers.flags).map_err(|_| StoreError::Refused {
        operation,
        field: "flags",
        limit,
    })?;
    let mut row = QueryBuilder::<Sqlite>::new(
        "INSERT INTO trials (run, configuration, depth_index, attempt, tips, depth_mm,
             target_x_mm, target_y_mm, target_z_mm, target_radius_mm,
             reached_x_mm, reached_y_mm, reached_z_mm, reached_radius_mm,
             placed_by, flags, settle_ms, contact_count, max_force_n, frame_count,
             started_at, measured_at, saturated_channels, stuck_channels, missing_channels,
             injection_sum_v, dropped_packets, imported_split, imported_tag, crc32",
    );
    for (name, _) in numbers.scalars.columns() {
        row.push(", ").push(name);
    }
    let mut values = row.push(") VALUES (").separated(", ");
    values
        .push_bind(scan_id)
        .push_bind(numbers.key.configuration)
        .push_bind(numbers.key.depth_index)
        .push_bind(numbers.attempt)
        .push_bind(numbers.tips)
        .push_bind(numbers.depth_mm);
    for pose in numbers.poses {
        values
            .push_bind(pose.map(|p| p.x_mm))
            .push_bind(pose.map(|p| p.y_mm))
            .push_bind(pose.map(|p| p.z_mm))
            .push_bind(pose.map(|p| p.radius_mm));
    }
    values
        .push_bind(numbers.placed_by)
        .push_bind(flags)
        .push_bind(numbers.settle_ms)
        .push_bind(numbers.contact_count)
        .push_bind(numbers.max_force_n)
        .push_bind(numbers.frame_count);
    for time in &numbers.times {
        values.push_bind(time.as_deref());
    }
    values
        .push_bind(numbers.quality.saturated_channels)
        .push_bind(numbers.quality.stuck_channels)
        .push_bind(numbers.quality.missing_channels)
        .push_bind(numbers.quality.injection_sum_v)
        .push_bind(numbers.quality.dropped_packets)
        .push_bind(numbers.imported_split)
        .push_bind(numbers.imported_tag)
        .push_bind(numbers.crc32());
    for (_, value) in numbers.scalars.columns() {
        values.push_bind(value);
    }
    row.push(
        ") ON CONFLICT (run, configuration, depth_index) DO NOTHING
         RETURNING id",
    );
    row.build_query_scalar().fetch_optional(connection).await.during(operation)
}

/// Inserts the mean of the frames of a trial, V, injection-major.
async fn insert_mean(
    connection: &mut SqliteConnection,
    trial: i64,
    mean_v: &[f32],
    operation: &'static str,
) -> StoreResult<()> {
    let volts = volts_blob(mean_v);
    sqlx::query("INSERT INTO trial_voltages (trial, voltages_v, crc32) VALUES (?1, ?2, ?3)")
        .bind(trial)
        .bind(&volts)
        .bind(checksum::of_volts(&volts))
        .execute(connection)
        .await
        .during(operation)?;
    Ok(())
}

/// Inserts the readings of the tips of a trial or a reference press. `into` names the table, and its columns: `owner`,
/// then those of a reading.
pub(super) async fn insert_tips(
    connection: &mut SqliteConnection,
    into: &'static str,
    owner: i64,
    arms: &[ArmReading],
    operation: &'static str,
) -> StoreResult<()> {
    insert_many(connection, into, arms, operation, |mut row, _, a| {
        row.push_bind(owner)
            .push_bind(a.arm)
            .push_bind(a.x_mm)
            .push_bind(a.y_mm)
            .push_bind(a.force_n)
            .push_bind(a.cell_v)
            .push_bind(a.tare_v);
    })
    .await
}

/// Inserts rows with few statements: each statement switches to the thread of sqlx and back. `bind`
/// receives the index of the row.
pub(super) async fn insert_many<T>(
    connection: &mut SqliteConnection,
    into: &'static str,
    rows: &[T],
    operation: &'static str,
    mut bind: impl FnMut(Separated<'_, Sqlite, &'static str>, i64, &T),
) -> StoreResult<()> {
    // SQLite allows 32,766 parameters per statement.
    for (chunk, rows) in rows.chunks(ROWS_AT_ONCE).enumerate() {
        let first = (chunk * ROWS_AT_ONCE) as i64;
        QueryBuilder::<Sqlite>::new(into)
            .push_values(rows.iter().zip(first..), |row, (value, n)| bind(row, n, value))
            .build()
            .execute(&mut *connection)
            .await
            .during(operation)?;
    }
    Ok(())
}
