//! Simulated twins: the trials without a twin of a model, and the fit of the model to the others.
//! Uses: `core`, `table`. Never: a row for a pending twin; a twin is pending while it is absent
//! (`docs/decisions/0008`).

use rusqlite::Connection;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteConnection;
use utoipa::ToSchema;

use crate::core::bulk::Statement;
use crate::core::columns::{Columns, row, volts_blob};
use crate::core::{During, Store, StoreResult};
use crate::ids::{CalibrationId, RunUid, TrialId};
use crate::table::assemble::rows_of_ids;
use crate::table::checksum;
use crate::table::pages::id;
use crate::table::query::SELECT_WITH_VOLTAGES;
use crate::table::trial_row::TrialRow;

/// Number of a stored model of twins; a model that is stored later has a larger number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TwinModelId(i64);

impl TwinModelId {
    /// A number that no model has.
    pub const NONE: Self = Self(0);
}

/// A model of twins: what determines its frames.
#[derive(Debug, Clone, PartialEq)]
pub struct NewTwinModel {
    /// Simulation id: `sim-` and the first digits of a sha256 of everything that determines its frames.
    pub hash: String,
    /// sha256 of the text of the sensor file.
    pub sensor_sha256: String,
    /// Id of its calibration; absent for the nominal model.
    pub calibration_id: Option<CalibrationId>,
    /// Version of the program.
    pub version: String,
    /// Commit of the program; absent if unknown.
    pub git_commit: Option<String>,
}

/// The twin of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// Id of the trial.
    pub trial: TrialId,
    /// Result of the simulation.
    pub outcome: TwinOutcome,
}

/// Result of the simulation of a trial.
#[derive(Debug, Clone, PartialEq)]
pub enum TwinOutcome {
    /// A simulated frame.
    Frame {
        /// Voltages, V, injection-major.
        voltages_v: Vec<f32>,
        /// RMSE against the measured frame, V.
        rmse_v: f64,
        /// FVU (paper, Eq. 2); absent if the measured frame is constant.
        fvu: Option<f64>,
    },
    /// The model cannot simulate the trial; the text is the cause.
    Failure(String),
}

/// Progress of the twins of a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct TwinCount {
    /// Number of stored trials.
    pub trials: u64,
    /// Number of trials with a twin.
    pub twins: u64,
    /// Number of trials that the model cannot simulate.
    pub failures: u64,
}

impl TwinCount {
    /// Returns the number of trials without a twin or a failure.
    pub fn pending(&self) -> u64 {
        self.trials.saturating_sub(self.twins + self.failures)
    }
}

/// Fit of the newest model to a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Id of the trial.
    pub trial: TrialId,
    /// Number of attached tips.
    pub tips: u8,
    /// Number of contacts at or above the deadband of the run.
    pub contact_count: u8,
    /// Largest raw force, N; absent if no force was measured.
    pub max_force_n: Option<f64>,
    /// x and y of the tip, skin coordinates, mm, for a trial with one tip; absent otherwise.
    pub single_tip_mm: Option<[f64; 2]>,
    /// Whether the trial has a flag.
    pub flagged: bool,
    /// RMSE of the frame against its twin, V.
    pub rmse_v: f64,
    /// FVU (paper, Eq. 2); absent if the measured frame is constant.
    pub fvu: Option<f64>,
}

const STORING_TWINS: &str = "storing twins";

impl Store {
    /// Returns the number of a model, after storing it if it is new.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn twin_model(&self, new: NewTwinModel) -> StoreResult<TwinModelId> {
        let query = sqlx::query(
            "INSERT INTO twin_models
                 (hash, sensor_sha256, calibration_id, version, git_commit, created_at)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6)
             ON CONFLICT (hash) DO UPDATE SET hash = excluded.hash RETURNING id",
        )
        .bind(new.hash)
        .bind(new.sensor_sha256)
        .bind(new.calibration_id.as_ref().map(CalibrationId::as_str))
        .bind(new.version)
        .bind(new.git_commit)
        .bind(self.now_text());
        let id = self.inner.writer.returned("storing a model", query, |c| c.get("id")).await?;
        Ok(TwinModelId(id))
    }

    /// Returns the model with this simulation id; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn twin_model_of(&self, hash: &str) -> StoreResult<Option<NewTwinModel>> {
        let query = sqlx::query("SELECT * FROM twin_models WHERE hash = ?1").bind(hash);
        let read = |c: &Columns<'_>| {
            Ok(row!(c, NewTwinModel {},
                get: hash, sensor_sha256, version, git_commit; word_or_none: calibration_id))
        };
        self.row("reading a model", query, read).await
    }

    /// Returns at most `limit` trials of a run without a twin of this model, with their voltages, in
    /// the order of storing, with ids above `after`.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Damaged` if a trial differs from its checksum;
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn pending_twins(
        &self,
        run: RunUid,
        model: TwinModelId,
        after: TrialId,
        limit: u32,
    ) -> StoreResult<Vec<TrialRow>> {
        const OPERATION: &str = "reading pending twins";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut ids = Statement::new("SELECT t.id FROM trials t WHERE t.run = ");
        ids.bind(scan_id).push(" AND t.id > ").bind(after.0);
        ids.push(" AND NOT EXISTS (SELECT 1 FROM twins o WHERE o.trial = t.id AND o.model = ");
        ids.bind(model.0).push(") ORDER BY t.id LIMIT ").bind(limit);
        let read = move |c: &Connection| {
            let ids = ids.rows(c, OPERATION, id)?;
            rows_of_ids(c, SELECT_WITH_VOLTAGES, &ids, OPERATION)
        };
        self.inner.bulk.read(OPERATION, read).await
    }

    /// Stores twins of one model in one transaction. A stored twin is not changed. A twin of a trial
    /// that was discarded meanwhile is not stored.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn insert_twins(&self, model: TwinModelId, twins: Vec<Twin>) -> StoreResult<()> {
        let now = self.now_text();
        let trials: Vec<i64> = twins.iter().map(|twin| twin.trial.0).collect();
        let runs: Vec<i64> = self
            .write(STORING_TWINS, async move |connection| {
                for twin in twins {
                    insert(connection, model, twin, &now).await?;
                }
                let runs = "SELECT DISTINCT run FROM trials \
                            WHERE id IN (SELECT value FROM json_each(?1))";
                let runs = sqlx::query_scalar(runs).bind(format!("{trials:?}"));
                runs.fetch_all(connection).await.during(STORING_TWINS)
            })
            .await?;
        runs.into_iter().for_each(|run| self.count_change(run));
        Ok(())
    }

    /// Returns the stored twins of these trials by this model, in ascending order of the trials.
    ///
    /// # Errors
    /// `Damaged` if a frame differs from its checksum; `Sql` or `Unreadable` if the read fails.
    pub async fn twins_of(&self, model: TwinModelId, trials: &[TrialId]) -> StoreResult<Vec<Twin>> {
        let trials: Vec<i64> = trials.iter().map(|trial| trial.0).collect();
        let query = sqlx::query(
            "SELECT w.trial, w.rmse_v, w.fvu, w.failure, s.voltages_v, s.crc32
             FROM twins w LEFT JOIN twin_voltages s ON s.trial = w.trial AND s.model = w.model
             WHERE w.model = ?1 AND w.trial IN (SELECT value FROM json_each(?2)) ORDER BY w.trial",
        )
        .bind(model.0)
        .bind(format!("{trials:?}"));
        let read = |c: &Columns<'_>| {
            let trial = TrialId(c.get("trial")?);
            let of = || format!("the twin of trial {}", trial.0);
            let outcome = match checksum::volts(c, "voltages_v", "crc32", of)? {
                Some(voltages_v) => {
                    TwinOutcome::Frame { voltages_v, rmse_v: c.get("rmse_v")?, fvu: c.get("fvu")? }
                }
                None => {
                    TwinOutcome::Failure(c.get::<Option<String>>("failure")?.unwrap_or_default())
                }
            };
            Ok(Twin { trial, outcome })
        };
        self.rows("reading twins", query, read).await
    }

    /// Returns the progress of the twins of a run with this model.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn twin_count(&self, run: RunUid, model: TwinModelId) -> StoreResult<TwinCount> {
        const OPERATION: &str = "counting twins";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT count(*) AS trials, count(w.failure) AS failures,
                 count(w.trial) - count(w.failure) AS twins
             FROM trials t INDEXED BY trials_in_order
             LEFT JOIN twins w ON w.trial = t.id AND w.model = ?2 WHERE t.run = ?1",
        )
        .bind(scan_id)
        .bind(model.0);
        let count = |c: &Columns<'_>| Ok(row!(c, TwinCount {}, whole: trials, twins, failures));
        self.one(OPERATION, query, count).await
    }

    /// Returns the ids of the runs with trials, newest first, except of incomplete imports.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn runs_with_trials(&self) -> StoreResult<Vec<RunUid>> {
        let query = sqlx::query(
            // The state is behind the long texts of a run: it is read of imports only.
            "SELECT uid FROM runs r WHERE (kind <> 'imported' OR state <> 'removed')
                 AND EXISTS (SELECT 1 FROM trials t WHERE t.run = r.scan_id)
             ORDER BY scan_id DESC",
        );
        self.rows("reading the runs with trials", query, |c| c.word("uid")).await
    }

    /// Returns the fit of each trial of a run by the newest model with a twin of it, in the order of
    /// storing. Trials without a simulated frame are omitted.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn fits(&self, run: RunUid) -> StoreResult<Vec<Fit>> {
        const OPERATION: &str = "reading the fits of a run";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT t.id, t.tips, t.contact_count, t.max_force_n, t.flags <> '[]' AS flagged,
                    w.rmse_v, w.fvu, p.x_mm, p.y_mm
             FROM trials t
             JOIN twins w ON w.trial = t.id
                 AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
             LEFT JOIN trial_tips p ON p.trial = t.id AND t.tips = 1
             WHERE t.run = ?1 AND w.rmse_v IS NOT NULL ORDER BY t.id",
        )
        .bind(scan_id);
        let read = |c: &Columns<'_>| {
            let (x_mm, y_mm): (Option<f64>, Option<f64>) = (c.get("x_mm")?, c.get("y_mm")?);
            let single_tip_mm = x_mm.zip(y_mm).map(|(x, y)| [x, y]);
            Ok(row!(c, Fit { trial: id(c)?, single_tip_mm },
                whole: tips, contact_count; get: max_force_n, flagged, rmse_v, fvu))
        };
        self.rows(OPERATION, query, read).await
    }
}

/// Inserts a twin, unless it is stored or its trial is not; `now` is its time of simulation.
pub(crate) async fn insert(
    connection: &mut SqliteConnection,
    model: TwinModelId,
    twin: Twin,
    now: &str,
) -> StoreResult<()> {
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
    .during(STORING_TWINS)?;
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
        .during(STORING_TWINS)?;
    }
    Ok(())
}
