//! Storing trials: a trial is one transaction, and its key is stored once.
//! Uses: `record`, `core::writer`, `table::checksum`. Never: a decision whether a trial is accepted
//! (`campaign` makes it).

use sqlx::query_builder::Separated;
use sqlx::sqlite::SqliteConnection;
use sqlx::{QueryBuilder, Sqlite};

use crate::core::columns::{counts_blob, time_text, volts_blob};
use crate::core::facts::{RunFacts, RunKind};
use crate::core::{During, Store, StoreError, StoreResult};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::record::{ArmReading, CONTACTS_MAX, FrameRecord, PlacedContact, TrialRecord};
use crate::table::checksum::{self, Numbers};
use crate::table::trial_row::Contact;

/// Largest number of rows of one statement.
const ROWS_AT_ONCE: usize = 100;

const STORING_TRIAL: &str = "storing a trial";

/// A checked trial with the values of its columns.
struct Entry {
    scan_id: i64,
    record: TrialRecord,
    voltages_v: Vec<f32>,
    flags: String,
    contact_count: u8,
    max_force_n: Option<f64>,
    crc32: u32,
}

impl Entry {
    /// Checks a trial and computes its columns.
    ///
    /// # Errors
    /// `Refused` if it has no frames, frames of different lengths, a number that is not finite, or more
    /// than six contacts.
    fn new(facts: RunFacts, record: TrialRecord) -> StoreResult<Self> {
        check(&record)?;
        let forces = record.arms.iter().map(|a| a.force_n);
        let contacts = match facts.kind {
            RunKind::RealHex => forces.clone().filter(|f| *f >= facts.deadband_n).count(),
            RunKind::RealRandom | RunKind::Imported => record.placed.len(),
        };
        let largest = forces.chain(record.placed.iter().map(|p| p.force_n)).reduce(f64::max);
        let contact_count = u8::try_from(contacts)
            .ok()
            .filter(|n| usize::from(*n) <= CONTACTS_MAX)
            .ok_or_else(|| refused("the number of contacts", "must be at most 6"))?;
        let flags = serde_json::to_string(&record.flags)
            .map_err(|_| refused("flags", "must be words that JSON can represent"))?;
        let placed: Vec<Contact> = record.placed.iter().map(Contact::from).collect();
        let crc32 = Numbers::of_record(&record, &placed, contact_count, largest).crc32();
        Ok(Self {
            scan_id: facts.scan_id,
            voltages_v: record.mean_voltages_v(),
            record,
            flags,
            contact_count,
            max_force_n: largest,
            crc32,
        })
    }

    /// Inserts the trial with its tips, contacts and frames, unless its key is stored. Returns the id
    /// of the stored trial.
    async fn insert(&self, connection: &mut SqliteConnection) -> StoreResult<TrialId> {
        let Some(id) = self.insert_row(connection).await? else {
            let stored =
                id_of_key(connection, self.scan_id, self.record.key, STORING_TRIAL).await?;
            return stored.ok_or_else(|| refused("its key", "is neither new nor stored"));
        };
        insert_voltages(connection, id, &self.voltages_v, STORING_TRIAL).await?;
        insert_tips(connection, id, &self.record.arms).await?;
        insert_placed(connection, id, &self.record.placed).await?;
        insert_frames(connection, id, &self.record.frames).await?;
        Ok(id)
    }

    /// Inserts the row of the trial. Returns its id; `None` if its key is stored.
    async fn insert_row(&self, connection: &mut SqliteConnection) -> StoreResult<Option<TrialId>> {
        let r = &self.record;
        let mut insert = QueryBuilder::<Sqlite>::new(
            "INSERT INTO trials (run, configuration, depth_index, attempt, tips, depth_mm,
                 target_x_mm, target_y_mm, target_z_mm, target_radius_mm,
                 reached_x_mm, reached_y_mm, reached_z_mm, reached_radius_mm,
                 placed_by, flags, settle_ms, contact_count, max_force_n, frame_count,
                 started_at, measured_at, saturated_channels, stuck_channels, missing_channels,
                 injection_sum_v, dropped_packets, crc32",
        );
        for (name, _) in r.scalars.columns() {
            insert.push(", ").push(name);
        }
        let mut values = insert.push(") VALUES (").separated(", ");
        values
            .push_bind(self.scan_id)
            .push_bind(r.key.configuration)
            .push_bind(r.key.depth_index)
            .push_bind(r.attempt)
            .push_bind(r.tips)
            .push_bind(r.depth_mm);
        for pose in [r.target, r.reached] {
            values
                .push_bind(pose.map(|p| p.x_mm))
                .push_bind(pose.map(|p| p.y_mm))
                .push_bind(pose.map(|p| p.z_mm))
                .push_bind(pose.map(|p| p.radius_mm));
        }
        values
            .push_bind(r.placed_by.as_deref())
            .push_bind(self.flags.as_str())
            .push_bind(r.settle_ms)
            .push_bind(self.contact_count)
            .push_bind(self.max_force_n)
            .push_bind(r.frames.len() as i64)
            .push_bind(time_text(r.started_at))
            .push_bind(time_text(r.measured_at))
            .push_bind(r.quality.saturated_channels)
            .push_bind(r.quality.stuck_channels)
            .push_bind(r.quality.missing_channels)
            .push_bind(r.quality.injection_sum_v)
            .push_bind(r.quality.dropped_packets)
            .push_bind(self.crc32);
        for (_, value) in r.scalars.columns() {
            values.push_bind(value);
        }
        insert.push(
            ") ON CONFLICT (run, configuration, depth_index) DO NOTHING
             RETURNING id",
        );
        let id: Option<i64> =
            insert.build_query_scalar().fetch_optional(connection).await.during(STORING_TRIAL)?;
        Ok(id.map(TrialId))
    }
}

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
        let entry = Entry::new(facts, trial.clone())?;
        let key = trial.key;
        self.inner
            .writer
            .patient()
            .run_and_settle(
                STORING_TRIAL,
                async move |connection| entry.insert(connection).await,
                async move |connection| {
                    id_of_key(connection, facts.scan_id, key, STORING_TRIAL).await
                },
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

/// Inserts the mean of the frames of a trial, V, injection-major.
pub(crate) async fn insert_voltages(
    connection: &mut SqliteConnection,
    trial: TrialId,
    voltages_v: &[f32],
    operation: &'static str,
) -> StoreResult<()> {
    let volts = volts_blob(voltages_v);
    sqlx::query("INSERT INTO trial_voltages (trial, voltages_v, crc32) VALUES (?1, ?2, ?3)")
        .bind(trial.0)
        .bind(&volts)
        .bind(checksum::of_volts(&volts))
        .execute(connection)
        .await
        .during(operation)?;
    Ok(())
}

async fn insert_tips(
    connection: &mut SqliteConnection,
    trial: TrialId,
    arms: &[ArmReading],
) -> StoreResult<()> {
    let into = "INSERT INTO trial_tips (trial, arm, x_mm, y_mm, force_n, cell_v, tare_v) ";
    insert_many(connection, into, arms, |mut row, _, a| {
        row.push_bind(trial.0)
            .push_bind(a.arm)
            .push_bind(a.x_mm)
            .push_bind(a.y_mm)
            .push_bind(a.force_n)
            .push_bind(a.cell_v)
            .push_bind(a.tare_v);
    })
    .await
}

async fn insert_placed(
    connection: &mut SqliteConnection,
    trial: TrialId,
    placed: &[PlacedContact],
) -> StoreResult<()> {
    let into = "INSERT INTO placed_contacts (trial, n, x_mm, y_mm, force_n) ";
    insert_many(connection, into, placed, |mut row, n, p| {
        row.push_bind(trial.0)
            .push_bind(n)
            .push_bind(p.x_mm)
            .push_bind(p.y_mm)
            .push_bind(p.force_n);
    })
    .await
}

/// Inserts the raw frames of a trial.
pub(crate) async fn insert_frames(
    connection: &mut SqliteConnection,
    trial: TrialId,
    frames: &[FrameRecord],
) -> StoreResult<()> {
    let into =
        "INSERT INTO frames (trial, n, sequence, device_time_us, volts_per_count, counts, crc32) ";
    insert_many(connection, into, frames, |mut row, n, f| {
        row.push_bind(trial.0)
            .push_bind(n)
            .push_bind(f.sequence)
            // A counter of microseconds; the sign bit is reached after 292,000 years.
            .push_bind(f.device_time_us.cast_signed())
            .push_bind(f.volts_per_count)
            .push_bind(counts_blob(&f.counts))
            .push_bind(checksum::of_frame(f));
    })
    .await
}

/// Inserts rows with few statements: each statement switches to the thread of sqlx and back. `bind`
/// receives the index of the row.
async fn insert_many<T>(
    connection: &mut SqliteConnection,
    into: &'static str,
    rows: &[T],
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
            .during(STORING_TRIAL)?;
    }
    Ok(())
}
