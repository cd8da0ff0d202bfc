//! Simulated twins: which trials have none of a model yet, and how well the model fits the others.
//! Uses: `store`. Never: a job row; a twin is pending while it is absent (`docs/decisions/0008`).

use serde::{Deserialize, Serialize};
use sqlx::QueryBuilder;
use sqlx::sqlite::SqliteConnection;
use utoipa::ToSchema;

use crate::core::columns::{Columns, volts_blob};
use crate::core::{During, Store, StoreError};
use crate::ids::{RunUid, TrialId};
use crate::table::assemble::assemble;
use crate::table::checksum;
use crate::table::query::SELECT_WITH_VOLTAGES;
use crate::table::trial_row::TrialRow;

/// A stored model; a larger one was stored later.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TwinModelId(i64);

impl TwinModelId {
    /// A model that no twin is of.
    pub const NONE: Self = Self(0);
}

/// What a model is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct NewTwinModel {
    /// `sim-` and the start of a sha256 over all that its frames depend on.
    pub hash: String,
    /// sha256 of the sensor file's text.
    pub sensor_sha256: String,
    /// The calibration in it, if there is one.
    pub calibration_id: Option<String>,
    /// Version of the program.
    pub version: String,
    /// Commit of the program, where it is known.
    pub git_commit: Option<String>,
}

/// The twin of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// The trial.
    pub trial: TrialId,
    /// What the model said.
    pub outcome: TwinOutcome,
}

/// What a model said to a trial.
#[derive(Debug, Clone, PartialEq)]
pub enum TwinOutcome {
    /// A frame.
    Frame {
        /// V, injection-major.
        voltages_v: Vec<f32>,
        /// Root of the mean squared difference, V.
        rmse_v: f64,
        /// Fraction of variance unexplained (paper, Eq. 2); absent for a constant measured frame.
        fvu: Option<f64>,
    },
    /// The model cannot take such a trial.
    Failure(String),
}

/// How far the twins of a run are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct TwinCount {
    /// Stored trials.
    pub trials: u64,
    /// Those with a twin.
    pub twins: u64,
    /// Those that the model could not take.
    pub failures: u64,
}

impl TwinCount {
    /// Trials that wait for their twin.
    pub fn pending(&self) -> u64 {
        self.trials.saturating_sub(self.twins + self.failures)
    }
}

/// How well the newest model fits a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The trial.
    pub trial: TrialId,
    /// Attached tips.
    pub tips: u8,
    /// Contacts at or above the run's deadband.
    pub contact_count: u8,
    /// Largest raw force, N.
    pub max_force_n: Option<f64>,
    /// Where the only tip stood, mm, with a single tip.
    pub single_tip_mm: Option<[f64; 2]>,
    /// Something may be wrong with the trial.
    pub flagged: bool,
    /// Root of the mean squared difference, V.
    pub rmse_v: f64,
    /// Fraction of variance unexplained.
    pub fvu: Option<f64>,
}

const STORING: &str = "storing twins";

impl Store {
    /// The id of a model, stored if it is new.
    pub async fn twin_model(&self, new: NewTwinModel) -> Result<TwinModelId, StoreError> {
        const OPERATION: &str = "storing a model";
        let now = self.now_text();
        let id = self
            .inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query_scalar(
                    "INSERT INTO twin_models
                         (hash, sensor_sha256, calibration_id, version, git_commit, created_at)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6)
                     ON CONFLICT (hash) DO UPDATE SET hash = excluded.hash RETURNING id",
                )
                .bind(new.hash)
                .bind(new.sensor_sha256)
                .bind(new.calibration_id)
                .bind(new.version)
                .bind(new.git_commit)
                .bind(now)
                .fetch_one(connection)
                .await
                .during(OPERATION)
            })
            .await?;
        Ok(TwinModelId(id))
    }

    /// What the model of this hash is made of.
    pub async fn twin_model_of(&self, hash: &str) -> Result<Option<NewTwinModel>, StoreError> {
        const OPERATION: &str = "reading a model";
        let row = sqlx::query("SELECT * FROM twin_models WHERE hash = ?1")
            .bind(hash)
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?;
        row.map(|row| {
            let c = Columns::of(&row, OPERATION);
            Ok(NewTwinModel {
                hash: c.get("hash")?,
                sensor_sha256: c.get("sensor_sha256")?,
                calibration_id: c.get("calibration_id")?,
                version: c.get("version")?,
                git_commit: c.get("git_commit")?,
            })
        })
        .transpose()
    }

    /// Up to `limit` trials of a run that have no twin of this model, with their mean voltages, in
    /// the order in which they were stored, from the one `after` this.
    pub async fn pending_twins(
        &self,
        run: RunUid,
        model: TwinModelId,
        after: TrialId,
        limit: u32,
    ) -> Result<Vec<TrialRow>, StoreError> {
        const OPERATION: &str = "looking for pending twins";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let mut query = QueryBuilder::new(SELECT_WITH_VOLTAGES);
        query.push(" WHERE t.run = ").push_bind(scan_id);
        query.push(" AND t.id > ").push_bind(after.0);
        query.push(" AND NOT EXISTS (SELECT 1 FROM twins o WHERE o.trial = t.id AND o.model = ");
        query.push_bind(model.0).push(") ORDER BY t.id LIMIT ").push_bind(limit);
        let rows = query.build().fetch_all(&mut *view).await.during(OPERATION)?;
        assemble(&mut view, rows, OPERATION).await
    }

    /// Stores twins of one model in one transaction. A twin that is there stays as it is; a trial
    /// that was taken back meanwhile gets none.
    pub async fn insert_twins(
        &self,
        model: TwinModelId,
        twins: Vec<Twin>,
    ) -> Result<(), StoreError> {
        let now = self.now_text();
        self.inner
            .writer
            .run(STORING, async move |connection| {
                for twin in twins {
                    insert(connection, model, twin, &now).await?;
                }
                Ok(())
            })
            .await
    }

    /// How far the twins of a run are.
    pub async fn twin_count(
        &self,
        run: RunUid,
        model: TwinModelId,
    ) -> Result<TwinCount, StoreError> {
        const OPERATION: &str = "counting twins";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let (trials, rows, failures): (i64, i64, i64) = sqlx::query_as(
            "SELECT count(*), count(w.trial), count(w.failure)
             FROM trials t INDEXED BY trials_in_order
             LEFT JOIN twins w ON w.trial = t.id AND w.model = ?2 WHERE t.run = ?1",
        )
        .bind(scan_id)
        .bind(model.0)
        .fetch_one(&self.inner.readers)
        .await
        .during(OPERATION)?;
        Ok(TwinCount {
            trials: trials.unsigned_abs(),
            twins: (rows - failures).unsigned_abs(),
            failures: failures.unsigned_abs(),
        })
    }

    /// Runs with trials, newest first.
    pub async fn runs_with_trials(&self) -> Result<Vec<RunUid>, StoreError> {
        const OPERATION: &str = "looking for runs with trials";
        let rows = sqlx::query(
            "SELECT uid FROM runs r WHERE EXISTS (SELECT 1 FROM trials t WHERE t.run = r.scan_id)
             ORDER BY scan_id DESC",
        )
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        rows.iter().map(|row| Columns::of(row, OPERATION).uid("uid")).collect()
    }

    /// How well a run's trials are fitted by the newest model that has looked at each.
    pub async fn fits(&self, run: RunUid) -> Result<Vec<Fit>, StoreError> {
        const OPERATION: &str = "reading how well a run is fitted";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let rows = sqlx::query(
            "SELECT t.id, t.tips, t.contact_count, t.max_force_n, t.flags <> '[]' AS flagged,
                    w.rmse_v, w.fvu, p.x_mm, p.y_mm
             FROM trials t
             JOIN twins w ON w.trial = t.id
                 AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
             LEFT JOIN trial_tips p ON p.trial = t.id AND t.tips = 1
             WHERE t.run = ?1 AND w.rmse_v IS NOT NULL ORDER BY t.id",
        )
        .bind(scan_id)
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        rows.iter()
            .map(|row| {
                let c = Columns::of(row, OPERATION);
                let (x_mm, y_mm): (Option<f64>, Option<f64>) = (c.get("x_mm")?, c.get("y_mm")?);
                Ok(Fit {
                    trial: TrialId(c.get("id")?),
                    tips: c.whole("tips")?,
                    contact_count: c.whole("contact_count")?,
                    max_force_n: c.get("max_force_n")?,
                    single_tip_mm: x_mm.zip(y_mm).map(|(x, y)| [x, y]),
                    flagged: c.get("flagged")?,
                    rmse_v: c.get("rmse_v")?,
                    fvu: c.get("fvu")?,
                })
            })
            .collect()
    }
}

pub(crate) async fn insert(
    connection: &mut SqliteConnection,
    model: TwinModelId,
    twin: Twin,
    now: &str,
) -> Result<(), StoreError> {
    let (voltages_v, rmse_v, fvu, failure) = match twin.outcome {
        TwinOutcome::Frame { voltages_v, rmse_v, fvu } => {
            (Some(voltages_v), Some(rmse_v), fvu, None)
        }
        TwinOutcome::Failure(why) => (None, None, None, Some(why)),
    };
    let inserted = sqlx::query(
        "INSERT INTO twins (trial, model, rmse_v, fvu, failure, computed_at)
         SELECT ?1, ?2, ?3, ?4, ?5, ?6 WHERE EXISTS (SELECT 1 FROM trials WHERE id = ?1)
         ON CONFLICT (trial, model) DO NOTHING",
    )
    .bind(twin.trial.0)
    .bind(model.0)
    .bind(rmse_v)
    .bind(fvu)
    .bind(failure)
    .bind(now)
    .execute(&mut *connection)
    .await
    .during(STORING)?;
    if let Some(voltages_v) = voltages_v.filter(|_| inserted.rows_affected() == 1) {
        let volts = volts_blob(&voltages_v);
        sqlx::query(
            "INSERT INTO twin_voltages (trial, model, voltages_v, crc32) VALUES (?1, ?2, ?3, ?4)",
        )
        .bind(twin.trial.0)
        .bind(model.0)
        .bind(&volts)
        .bind(checksum::of_volts(&volts))
        .execute(connection)
        .await
        .during(STORING)?;
    }
    Ok(())
}
