//! Rows of the database joined to trials, each compared with its checksum.
//! Uses: `core::columns`, `checksum`, `trial_row`. Never: a query per row, a value that differs from its
//! checksum.

use sqlx::QueryBuilder;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::checksum::{self, Numbers};
use super::query::SELECT_WITH_VOLTAGES;
use super::trial_row::{Contact, TrialRow, tips_as_contacts};
use crate::core::columns::Columns;
use crate::core::facts::RunKind;
use crate::core::{During, StoreError};
use crate::ids::{TrialId, TrialKey};
use crate::record::{ArmReading, FrameQuality, Pose, TrialScalars};

/// Returns the reading of an attached tip from its columns.
pub(crate) fn arm(c: &Columns<'_>) -> Result<ArmReading, StoreError> {
    Ok(ArmReading {
        arm: c.whole("arm")?,
        x_mm: c.get("x_mm")?,
        y_mm: c.get("y_mm")?,
        force_n: c.get("force_n")?,
        cell_v: c.get("cell_v")?,
        tare_v: c.get("tare_v")?,
    })
}

/// Returns a trial by its key, as a transaction of the writer reads it; `None` if it is not stored.
pub(crate) async fn row_of_key(
    connection: &mut SqliteConnection,
    scan_id: i64,
    key: TrialKey,
    operation: &'static str,
) -> Result<Option<TrialRow>, StoreError> {
    let mut query = QueryBuilder::new(SELECT_WITH_VOLTAGES);
    query.push(" WHERE t.run = ").push_bind(scan_id);
    query.push(" AND t.configuration = ").push_bind(key.configuration);
    query.push(" AND t.depth_index = ").push_bind(key.depth_index);
    let rows = query.build().fetch_all(&mut *connection).await.during(operation)?;
    Ok(assemble(connection, rows, operation).await?.pop())
}

/// Returns trials by their ids, in the order of the ids, with the columns of `select`. Missing trials
/// are omitted.
pub(crate) async fn rows_of_ids(
    connection: &mut SqliteConnection,
    select: &'static str,
    ids: &[TrialId],
    operation: &'static str,
) -> Result<Vec<TrialRow>, StoreError> {
    let wanted: Vec<i64> = ids.iter().map(|id| id.0).collect();
    let mut query = QueryBuilder::new(select);
    query.push(" WHERE t.id IN (SELECT value FROM json_each(");
    query.push_bind(format!("{wanted:?}")).push(")) ORDER BY t.id");
    let rows = query.build().fetch_all(&mut *connection).await.during(operation)?;
    assemble(connection, rows, operation).await
}

/// Joins a page of trials with their tips and placed contacts: two queries for the whole page.
///
/// # Errors
/// `Sql` or `Unreadable` if a read fails; `Damaged` if a trial differs from its checksum.
pub(crate) async fn assemble(
    connection: &mut SqliteConnection,
    rows: Vec<SqliteRow>,
    operation: &'static str,
) -> Result<Vec<TrialRow>, StoreError> {
    let ids = rows
        .iter()
        .map(|row| Columns::of(row, operation).get::<i64>("id"))
        .collect::<Result<Vec<_>, _>>()?;
    let wanted = format!("{ids:?}");
    let tips = sqlx::query(
        "SELECT p.* FROM json_each(?1) wanted CROSS JOIN trial_tips p ON p.trial = wanted.value
         ORDER BY wanted.key, p.arm",
    )
    .bind(&wanted)
    .fetch_all(&mut *connection)
    .await
    .during(operation)?;
    let placed = sqlx::query(
        "SELECT p.* FROM json_each(?1) wanted CROSS JOIN placed_contacts p
         ON p.trial = wanted.value ORDER BY wanted.key, p.n",
    )
    .bind(&wanted)
    .fetch_all(&mut *connection)
    .await
    .during(operation)?;
    let mut tips = Belonging::of(&tips, operation);
    let mut placed = Belonging::of(&placed, operation);
    ids.iter()
        .zip(&rows)
        .map(|(id, row)| {
            let arms = tips.take(*id, arm)?;
            let placed = placed.take(*id, |c| {
                let (x_mm, y_mm) = (c.get("x_mm")?, c.get("y_mm")?);
                let (force_n, diameter_mm) = (c.get("force_n")?, c.get("diameter_mm")?);
                Ok(Contact { x_mm, y_mm, force_n, diameter_mm })
            })?;
            trial_row(&Columns::of(row, operation), arms, placed)
        })
        .collect()
}

/// Rows of a child table in the order of their parents.
struct Belonging<'r> {
    rows: &'r [SqliteRow],
    operation: &'static str,
}

impl<'r> Belonging<'r> {
    fn of(rows: &'r [SqliteRow], operation: &'static str) -> Self {
        Self { rows, operation }
    }

    /// Removes and returns the first rows that belong to this trial.
    fn take<T>(
        &mut self,
        trial: i64,
        read: impl Fn(&Columns<'_>) -> Result<T, StoreError>,
    ) -> Result<Vec<T>, StoreError> {
        let mut taken = Vec::new();
        while let Some((first, rest)) = self.rows.split_first() {
            let columns = Columns::of(first, self.operation);
            if columns.get::<i64>("trial")? != trial {
                break;
            }
            taken.push(read(&columns)?);
            self.rows = rest;
        }
        Ok(taken)
    }
}

/// Returns a trial from its columns; `placed` are its placed contacts as they are stored.
fn trial_row(
    c: &Columns<'_>,
    arms: Vec<ArmReading>,
    placed: Vec<Contact>,
) -> Result<TrialRow, StoreError> {
    let (deadband_n, diameter_mm): (f64, Option<f64>) =
        (c.get("deadband_n")?, c.get("tip_diameter_mm")?);
    let kind = c.word::<RunKind>("kind")?;
    let contacts = match kind {
        RunKind::RealHex => tips_as_contacts(&arms, deadband_n, diameter_mm),
        RunKind::RealRandom | RunKind::Imported => placed
            .iter()
            .map(|p| Contact { diameter_mm: p.diameter_mm.or(diameter_mm), ..*p })
            .collect(),
    };
    let mut forces_n = [None; 6];
    for a in &arms {
        if let Some(force) = usize::from(a.arm).checked_sub(1).and_then(|i| forces_n.get_mut(i)) {
            *force = Some(a.force_n);
        }
    }
    let trial_id = TrialId(c.get("id")?);
    let of = || format!("trial {}", trial_id.0);
    let row = TrialRow {
        trial_id,
        run: c.uid("uid")?,
        scan_id: c.get("run")?,
        experiment: c.get("experiment")?,
        kind,
        label: c.word("label")?,
        configuration: c.whole("configuration")?,
        depth_index: c.whole("depth_index")?,
        attempt: c.whole("attempt")?,
        depth_mm: c.get("depth_mm")?,
        tips: c.whole("tips")?,
        contact_count: c.whole("contact_count")?,
        max_force_n: c.get("max_force_n")?,
        contacts,
        forces_n,
        arms,
        target: pose([
            c.get("target_x_mm")?,
            c.get("target_y_mm")?,
            c.get("target_z_mm")?,
            c.get("target_radius_mm")?,
        ]),
        reached: pose([
            c.get("reached_x_mm")?,
            c.get("reached_y_mm")?,
            c.get("reached_z_mm")?,
            c.get("reached_radius_mm")?,
        ]),
        placed_by: c.get("placed_by")?,
        flags: match c.get("flags")? {
            "[]" => Vec::new(),
            _ => c.json("flags")?,
        },
        quality: FrameQuality {
            saturated_channels: c.whole_or_none("saturated_channels")?,
            stuck_channels: c.whole_or_none("stuck_channels")?,
            missing_channels: c.whole_or_none("missing_channels")?,
            injection_sum_v: c.get("injection_sum_v")?,
            dropped_packets: c.whole_or_none("dropped_packets")?,
        },
        settle_ms: c.get("settle_ms")?,
        scalars: TrialScalars::of_columns(|name| c.get(name))?,
        frame_count: c.whole("frame_count")?,
        started_at: c.time_or_none("started_at")?,
        measured_at: c.time_or_none("measured_at")?,
        voltages_v: match c.has("voltages_v") {
            true => checksum::volts(c, "voltages_v", "volts_crc32", of)?,
            false => None,
        },
        sim_voltages_v: match c.has("sim_voltages_v") {
            true => checksum::volts(c, "sim_voltages_v", "sim_volts_crc32", of)?,
            false => None,
        },
        sim_model: c.get("sim_model")?,
        rmse_v: c.get("rmse_v")?,
        fvu: c.get("fvu")?,
    };
    checksum::compare(c.whole_or_none("crc32")?, Numbers::of_row(&row, &placed).crc32(), || {
        format!("the row of {}", of())
    })?;
    Ok(row)
}

/// Returns a pose from its four columns: x, y, z and radius, mm; `None` if one of them is NULL.
pub(crate) fn pose(parts: [Option<f64>; 4]) -> Option<Pose> {
    let [x_mm, y_mm, z_mm, radius_mm] = parts;
    Some(Pose { x_mm: x_mm?, y_mm: y_mm?, z_mm: z_mm?, radius_mm: radius_mm? })
}
