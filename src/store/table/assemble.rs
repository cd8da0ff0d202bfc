//! Rows of the database joined to trials, each compared with its checksum.
//! Uses: `core::{bulk, columns}`, `checksum`, `trial_row`. Never: a query per row, a value that differs from its
//! checksum.

use std::iter::Peekable;

use rusqlite::Connection;

use super::checksum::{self, Numbers};
use super::trial_row::{Contact, TipsAsContacts, TrialRow};
use crate::core::bulk::Statement;
use crate::core::columns::{Columns, row};
use crate::core::facts::{Label, RunKind};
use crate::core::{StoreError, StoreResult};
use crate::ids::{RunUid, TrialId};
use crate::record::{ARMS, ArmReading, FrameQuality, Pose, TrialScalars};

/// Returns the reading of an attached tip from its columns.
pub(crate) fn arm(c: &Columns<'_>) -> StoreResult<ArmReading> {
    Ok(row!(c, ArmReading {}, whole: arm; get: x_mm, y_mm, force_n, cell_v, tare_v))
}

/// Returns trials by their ids, in ascending order of the ids, with the columns of `select`. Missing
/// trials are omitted.
///
/// # Errors
/// `Read` or `Unreadable` if a read fails; `Damaged` if a trial differs from its checksum.
pub(crate) fn rows_of_ids(
    connection: &Connection,
    select: &str,
    ids: &[TrialId],
    operation: &'static str,
) -> StoreResult<Vec<TrialRow>> {
    let mut wanted: Vec<i64> = ids.iter().map(|id| id.0).collect();
    wanted.sort_unstable();
    wanted.dedup();
    let wanted = format!("{wanted:?}");
    let mut tips = Belonging::read(connection, "trial_tips", &wanted, operation, arm)?;
    let mut placed = Belonging::read(connection, "placed_contacts", &wanted, operation, |c| {
        Ok(row!(c, Contact {}, get: x_mm, y_mm, force_n, diameter_mm))
    })?;
    let mut query = Statement::new(select);
    query.push(" WHERE t.id IN (SELECT value FROM json_each(").bind(wanted);
    query.push(")) ORDER BY t.id");
    // The run of the trial before; a page is mostly of one.
    let mut last: Option<OfRun> = None;
    query.rows(connection, operation, |c| {
        let (trial, scan_id): (i64, i64) = (c.get("id")?, c.get("run")?);
        let run = match last.take().filter(|run| run.scan_id == scan_id) {
            Some(run) => run,
            None => OfRun::read(connection, scan_id, operation)?,
        };
        let row = trial_row(c, TrialId(trial), &run, tips.take(trial), placed.take(trial));
        last = Some(run);
        row
    })
}

/// What the trials of a run have from it.
struct OfRun {
    scan_id: i64,
    uid: RunUid,
    experiment: String,
    kind: RunKind,
    label: Label,
    deadband_n: f64,
    tip_diameter_mm: Option<f64>,
}

impl OfRun {
    fn read(connection: &Connection, scan_id: i64, operation: &'static str) -> StoreResult<Self> {
        let mut query = Statement::new(
            "SELECT uid, experiment, kind, label, deadband_n, tip_diameter_mm FROM runs
             WHERE scan_id = ",
        );
        query.bind(scan_id);
        let mut found = query.rows(connection, operation, |c| {
            Ok(row!(c, Self { scan_id },
                word: uid, kind, label; get: experiment, deadband_n, tip_diameter_mm))
        })?;
        let missing = || StoreError::damaged(format!("run {scan_id} has trials and no row"));
        found.pop().ok_or_else(missing)
    }
}

/// Rows of a child table in ascending order of their trials.
struct Belonging<T>(Peekable<std::vec::IntoIter<(i64, T)>>);

impl<T> Belonging<T> {
    /// Reads the rows of these trials, a JSON array, in the order of the primary key.
    fn read(
        connection: &Connection,
        table: &str,
        wanted: &str,
        operation: &'static str,
        read: impl Fn(&Columns<'_>) -> StoreResult<T>,
    ) -> StoreResult<Self> {
        let mut query = Statement::new("SELECT p.* FROM json_each(");
        query.bind(wanted.to_owned()).push(") wanted CROSS JOIN ").push(table);
        query.push(" p ON p.trial = wanted.value");
        let rows = query.rows(connection, operation, |c| Ok((c.get("trial")?, read(c)?)))?;
        Ok(Self(rows.into_iter().peekable()))
    }

    /// Removes and returns the rows of this trial, and removes those of trials before it.
    fn take(&mut self, trial: i64) -> Vec<T> {
        while self.0.next_if(|(of, _)| *of < trial).is_some() {}
        std::iter::from_fn(|| self.0.next_if(|(of, _)| *of == trial)).map(|(_, row)| row).collect()
    }
}

/// Returns a trial of `run` from its columns; `placed` are its placed contacts as they are stored.
fn trial_row(
    c: &Columns<'_>,
    trial_id: TrialId,
    run: &OfRun,
    arms: Vec<ArmReading>,
    placed: Vec<Contact>,
) -> StoreResult<TrialRow> {
    let contacts = match run.kind {
        RunKind::RealHex => {
            let (deadband_n, diameter_mm) = (run.deadband_n, run.tip_diameter_mm);
            TipsAsContacts { deadband_n, diameter_mm }.of(&arms)
        }
        RunKind::RealRandom | RunKind::Imported => placed
            .iter()
            .map(|p| Contact { diameter_mm: p.diameter_mm.or(run.tip_diameter_mm), ..*p })
            .collect(),
    };
    let mut forces_n = [None; ARMS];
    for a in &arms {
        if let Some(force) = usize::from(a.arm).checked_sub(1).and_then(|i| forces_n.get_mut(i)) {
            *force = Some(a.force_n);
        }
    }
    let (started, measured) = (c.time_and_text("started_at")?, c.time_and_text("measured_at")?);
    let of = || format!("trial {}", trial_id.0);
    let volts = |column: &'static str, sum: &'static str| match c.has(column) {
        true => checksum::volts(c, column, sum, of),
        false => Ok(None),
    };
    let quality = row!(c, FrameQuality {},
        whole_or_none: saturated_channels, stuck_channels, missing_channels, dropped_packets;
        get: injection_sum_v);
    let row = row!(c, TrialRow {
            trial_id,
            run: run.uid,
            scan_id: run.scan_id,
            experiment: run.experiment.clone(),
            kind: run.kind,
            label: run.label,
            contacts,
            forces_n,
            arms,
            target: pose(c, ["target_x_mm", "target_y_mm", "target_z_mm", "target_radius_mm"])?,
            reached: pose(c, ["reached_x_mm", "reached_y_mm", "reached_z_mm", "reached_radius_mm"])?,
            flags: match c.get("flags")? {
                "[]" => Vec::new(),
                _ => c.json("flags")?,
            },
            quality,
            scalars: TrialScalars::of_columns(|name| c.get(name))?,
            started_at: started.map(|(at, _)| at),
            measured_at: measured.map(|(at, _)| at),
            voltages_v: volts("voltages_v", "volts_crc32")?,
            sim_voltages_v: volts("sim_voltages_v", "sim_volts_crc32")?,
        },
        whole: configuration, depth_index, attempt, tips, contact_count, frame_count;
        get: depth_mm, max_force_n, placed_by, settle_ms, imported_split, imported_tag, sim_model,
            rmse_v, fvu);
    let times = [started, measured].map(|at| at.map(|(_, text)| text));
    let found = Numbers::of_row(&row, &placed, times).crc32();
    checksum::compare(c.whole_or_none("crc32")?, found, || format!("the row of {}", of()))?;
    Ok(row)
}

/// Returns a pose from its four columns: x, y, z and radius, mm; `None` if one of them is NULL.
fn pose(c: &Columns<'_>, columns: [&'static str; 4]) -> StoreResult<Option<Pose>> {
    let [x, y, z, radius] = columns.map(|column| c.get::<Option<f64>>(column));
    let all = x?.zip(y?).zip(z?.zip(radius?));
    Ok(all.map(|((x_mm, y_mm), (z_mm, radius_mm))| Pose { x_mm, y_mm, z_mm, radius_mm }))
}
