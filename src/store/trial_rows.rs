//! Trials coming out: single rows, pages that follow an index, voltages and raw frames.
//! Uses: `store::{trial_query, checksum}`, `record`. Never: a write, a query per row, a value
//! that differs from its checksum.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::QueryBuilder;
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use utoipa::ToSchema;

use super::checksum::{self, Numbers};
use super::columns::Columns;
use super::runs::{Label, RunKind};
use super::trial_query::{SELECT, SELECT_IDS, SELECT_WITH_VOLTAGES, TrialQuery};
use super::trials::pose;
use super::{During, Store, StoreError};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::record::{ArmReading, Flag, FrameQuality, FrameRecord, PlacedContact, Pose};

const READING: &str = "reading trials";

/// A place on the skin that was pressed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Contact {
    /// Centre on the skin, mm, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<f64>,
    /// Centre on the skin, mm, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<f64>,
    /// Force, N, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Diameter, mm, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter_mm: Option<f64>,
}

impl From<&PlacedContact> for Contact {
    fn from(p: &PlacedContact) -> Self {
        let (x_mm, y_mm, force_n) = (Some(p.x_mm), Some(p.y_mm), Some(p.force_n));
        Self { x_mm, y_mm, force_n, diameter_mm: None }
    }
}

impl Contact {
    /// Place and force (mm, mm, N), where all of them are known.
    pub fn pressed(&self) -> Option<[f64; 3]> {
        Some([self.x_mm?, self.y_mm?, self.force_n?])
    }
}

/// A stored trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TrialRow {
    /// Its id.
    pub trial_id: TrialId,
    /// Its run.
    pub run: RunUid,
    /// Its run's number for people.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Where it comes from.
    pub kind: RunKind,
    /// Whether a skin was touched.
    pub label: Label,
    /// Position of the configuration in the plan.
    pub configuration: u32,
    /// Position of the depth in the configuration.
    pub depth_index: u32,
    /// Which try it was, from 1.
    pub attempt: u32,
    /// Depth, mm; absent when weights were placed by hand.
    pub depth_mm: Option<f64>,
    /// Attached tips, or placed contacts.
    pub tips: u8,
    /// Number of `contacts`.
    pub contact_count: u8,
    /// Largest raw force, N, also when it lies under the deadband.
    pub max_force_n: Option<f64>,
    /// Real-Hex: the tips at or above the run's deadband. Real-Random: the placed weights.
    pub contacts: Vec<Contact>,
    /// Raw forces of arms 1 to 6, N; absent where no tip is attached.
    #[schema(value_type = Vec<Option<f64>>, min_items = 6, max_items = 6)]
    pub forces_n: [Option<f64>; 6],
    /// Every attached tip as it was read.
    pub arms: Vec<ArmReading>,
    /// Where the stage was sent.
    pub target: Option<Pose>,
    /// Where it measured itself to be.
    pub reached: Option<Pose>,
    /// Who placed the weights.
    pub placed_by: Option<String>,
    /// What may be wrong with it.
    pub flags: Vec<Flag>,
    /// How good its frames are.
    #[serde(flatten)]
    pub quality: FrameQuality,
    /// Time between the end of motion and the measurement, process ms.
    pub settle_ms: Option<f64>,
    /// Largest force while approaching and settling over the measured one, N.
    pub overshoot_n: Option<f64>,
    /// Raw frames kept.
    pub frame_count: u32,
    /// Start of its motion.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// Its last frame.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub measured_at: Option<Timestamp>,
    /// Mean of its frames, V, injection-major, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltages_v: Option<Vec<f32>>,
    /// Its newest twin's frame, V, injection-major, where it was asked for and is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sim_voltages_v: Option<Vec<f32>>,
    /// Model of its newest twin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sim_model: Option<String>,
    /// Root of the mean squared difference to its newest twin, V.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rmse_v: Option<f64>,
    /// Fraction of variance unexplained by its newest twin (paper, Eq. 2).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fvu: Option<f64>,
}

impl TrialRow {
    /// How far z was off its target, mm; absent for weights placed manually.
    pub fn depth_error_mm(&self) -> Option<f64> {
        Some(self.reached?.z_mm - self.target?.z_mm)
    }
}

impl Store {
    /// A page of trials. The next one starts `after` its last id.
    pub async fn trials(&self, query: &TrialQuery) -> Result<Vec<TrialRow>, StoreError> {
        let scan_id = match query.run {
            Some(run) => Some(self.facts(run, READING).await?.scan_id),
            None => None,
        };
        let mut view = self.read(READING).await?;
        let rows = query.build(scan_id).build().fetch_all(&mut *view).await.during(READING)?;
        assemble(&mut view, rows, READING).await
    }

    /// The ids of a page of trials, for whoever reads the trials in smaller pieces.
    pub async fn trial_ids(&self, query: &TrialQuery) -> Result<Vec<TrialId>, StoreError> {
        let scan_id = match query.run {
            Some(run) => Some(self.facts(run, READING).await?.scan_id),
            None => None,
        };
        let ids: Vec<i64> = query
            .select(SELECT_IDS, scan_id)
            .build_query_scalar()
            .fetch_all(&self.inner.readers)
            .await
            .during(READING)?;
        Ok(ids.into_iter().map(TrialId).collect())
    }

    /// One trial, with its mean voltages.
    pub async fn trial_by_id(&self, trial: TrialId) -> Result<Option<TrialRow>, StoreError> {
        let mut view = self.read(READING).await?;
        let mut query = QueryBuilder::new(SELECT_WITH_VOLTAGES);
        let rows = query
            .push(" WHERE t.id = ")
            .push_bind(trial.0)
            .build()
            .fetch_all(&mut *view)
            .await
            .during(READING)?;
        Ok(assemble(&mut view, rows, READING).await?.pop())
    }

    /// These trials with their voltages, by id; those that are not there are left out.
    pub async fn trials_with_voltages(&self, ids: &[TrialId]) -> Result<Vec<TrialRow>, StoreError> {
        self.trials_by(SELECT_WITH_VOLTAGES, ids).await
    }

    /// The same without their voltages.
    pub async fn trials_of(&self, ids: &[TrialId]) -> Result<Vec<TrialRow>, StoreError> {
        self.trials_by(SELECT, ids).await
    }

    async fn trials_by(
        &self,
        select: &'static str,
        ids: &[TrialId],
    ) -> Result<Vec<TrialRow>, StoreError> {
        rows_of_ids(&mut *self.read(READING).await?, select, ids, READING).await
    }

    /// The different lengths of these trials' frames, in voltages.
    pub async fn frame_lengths(&self, ids: &[TrialId]) -> Result<Vec<u32>, StoreError> {
        let wanted: Vec<i64> = ids.iter().map(|id| id.0).collect();
        sqlx::query_scalar(
            "SELECT DISTINCT length(v.voltages_v) / 4 FROM json_each(?1) wanted
             CROSS JOIN trial_voltages v ON v.trial = wanted.value ORDER BY 1",
        )
        .bind(format!("{wanted:?}"))
        .fetch_all(&self.inner.readers)
        .await
        .during(READING)
    }

    /// The mean of a trial's frames, V, injection-major.
    pub async fn trial_voltages(&self, trial: TrialId) -> Result<Option<Vec<f32>>, StoreError> {
        const OPERATION: &str = "reading a trial's voltages";
        let row = sqlx::query("SELECT voltages_v, crc32 FROM trial_voltages WHERE trial = ?1")
            .bind(trial.0)
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?;
        let Some(row) = row else { return Ok(None) };
        let of = || format!("trial {}", trial.0);
        checksum::volts(&Columns::of(&row, OPERATION), "voltages_v", "crc32", of)
    }

    /// The raw frames of a trial, in the order in which they were taken.
    pub async fn frames(&self, trial: TrialId) -> Result<Vec<FrameRecord>, StoreError> {
        const OPERATION: &str = "reading a trial's frames";
        let rows = sqlx::query("SELECT * FROM frames WHERE trial = ?1 ORDER BY n")
            .bind(trial.0)
            .fetch_all(&self.inner.readers)
            .await
            .during(OPERATION)?;
        let of = || format!("trial {}", trial.0);
        rows.iter().map(|row| checksum::frame(&Columns::of(row, OPERATION), of)).collect()
    }

    /// How SQLite would find a page: its plan, a line per step.
    #[cfg(test)]
    pub(super) async fn explain(&self, query: &TrialQuery) -> Result<Vec<String>, StoreError> {
        let scan_id = match query.run {
            Some(run) => Some(self.facts(run, READING).await?.scan_id),
            None => None,
        };
        let sql = format!("EXPLAIN QUERY PLAN {}", query.build(scan_id).sql().as_str());
        let mut statement = sqlx::query(sqlx::AssertSqlSafe(sql));
        for _ in 0..query.filters.len() + query.flags.len() + 3 {
            statement = statement.bind(1);
        }
        let rows = statement.fetch_all(&self.inner.readers).await.during("explaining a query")?;
        rows.iter().map(|row| Columns::of(row, "explaining a query").get("detail")).collect()
    }
}

/// An attached tip from its columns.
pub(super) fn arm(c: &Columns<'_>) -> Result<ArmReading, StoreError> {
    Ok(ArmReading {
        arm: c.whole("arm")?,
        x_mm: c.get("x_mm")?,
        y_mm: c.get("y_mm")?,
        force_n: c.get("force_n")?,
        cell_v: c.get("cell_v")?,
        tare_v: c.get("tare_v")?,
    })
}

/// A trial by its key, as a transaction of the writer sees it.
pub(super) async fn row_of_key(
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

/// Trials by their ids, as `select` brings them; those that are not there are left out.
pub(super) async fn rows_of_ids(
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
pub(super) async fn assemble(
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

    /// The rows at the front that belong to this trial.
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

/// The tips that press with at least the deadband: what Real-Hex calls contacts (paper IV-A).
pub fn tips_as_contacts(
    arms: &[ArmReading],
    deadband_n: f64,
    diameter_mm: Option<f64>,
) -> Vec<Contact> {
    let pressing = arms.iter().filter(|a| a.force_n >= deadband_n);
    let contact = |a: &ArmReading| Contact {
        x_mm: Some(a.x_mm),
        y_mm: Some(a.y_mm),
        force_n: Some(a.force_n),
        diameter_mm,
    };
    pressing.map(contact).collect()
}

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
        overshoot_n: c.get("overshoot_n")?,
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
