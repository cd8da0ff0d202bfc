//! Datasets: their rows, and from which inputs each was made.
//! Uses: `core::writer`. Never: the files themselves, the meaning of a definition.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde_json::Value;

use crate::core::columns::{Columns, row, time_text};
use crate::core::{During, Store, StoreResult};
use crate::ids::{DatasetId, RunUid};

/// A stored dataset. Its trials are in a Parquet file that is named by its id.
#[derive(Debug, Clone, PartialEq)]
pub struct DatasetRow {
    /// Id: `ds-` and the first digits of the sha256 of its contents.
    pub id: DatasetId,
    /// Name of its definition.
    pub name: String,
    /// Its definition, as JSON.
    pub definition: Value,
    /// Number of rows.
    pub rows: u64,
    /// Length of its Parquet file, bytes.
    pub bytes: u64,
    /// sha256 of its Parquet file.
    pub sha256: String,
    /// Report of the build, as JSON: parts, excluded trials with reasons, columns.
    pub report: Value,
    /// Lineage, as JSON: runs, models, calibrations, shards, code.
    pub lineage: Value,
    /// Wall time of its creation.
    pub created_at: Timestamp,
}

impl DatasetRow {
    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        Ok(row!(c, Self {},
            word: id;
            get: name, sha256;
            json: definition, report, lineage;
            whole: rows, bytes;
            time: created_at))
    }
}

/// State of the trials and twins of a run: it changes whenever rows of a dataset of the run may change.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RunExtent {
    /// Number of stored trials.
    pub trials: i64,
    /// Id of the last stored trial; 0 without trials.
    pub last: i64,
    /// Number of discarded trials.
    pub taken_back: i64,
    /// Number of twins, failures included.
    pub twins: i64,
    /// Number of the newest model of the twins; a model that is stored later has a larger number. Absent
    /// without twins.
    pub newest: Option<i64>,
    /// Simulation id of this model.
    pub model: Option<String>,
}

impl Store {
    /// Returns the state of the trials and twins of a run.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn run_extent(&self, run: RunUid) -> StoreResult<RunExtent> {
        const OPERATION: &str = "reading the extent of a run";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT e.*, m.hash AS model,
                 (SELECT count(*) FROM attempts WHERE run = ?1 AND trial IS NOT NULL) AS taken_back
             FROM (SELECT count(DISTINCT t.id) AS trials, coalesce(max(t.id), 0) AS last,
                       count(w.trial) AS twins, max(w.model) AS newest
                   FROM trials t INDEXED BY trials_in_order
                   LEFT JOIN twins w ON w.trial = t.id WHERE t.run = ?1) e
             LEFT JOIN twin_models m ON m.id = e.newest",
        )
        .bind(scan_id);
        let read = |c: &Columns<'_>| {
            Ok(row!(c, RunExtent {}, get: trials, last, taken_back, twins, newest, model))
        };
        self.one(OPERATION, query, read).await
    }

    /// Stores a dataset whose file exists, under the state of its inputs. If it is stored already, its
    /// file was written again: length, sha256 and lineage are those of the new file. Returns the stored
    /// dataset.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn insert_dataset(&self, new: DatasetRow, inputs: &str) -> StoreResult<DatasetRow> {
        const OPERATION: &str = "storing a dataset";
        let inputs = inputs.to_owned();
        self.write(OPERATION, async move |connection| {
            let row = sqlx::query(
                "INSERT INTO datasets (id, name, definition, rows, bytes, sha256, report,
                     lineage, created_at)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)
                 ON CONFLICT (id) DO UPDATE SET bytes = excluded.bytes,
                     sha256 = excluded.sha256, lineage = excluded.lineage
                 RETURNING *",
            )
            .bind(new.id.as_str())
            .bind(&new.name)
            .bind(new.definition.to_string())
            .bind(new.rows.cast_signed())
            .bind(new.bytes.cast_signed())
            .bind(&new.sha256)
            .bind(new.report.to_string())
            .bind(new.lineage.to_string())
            .bind(time_text(new.created_at))
            .fetch_one(&mut *connection)
            .await
            .during(OPERATION)?;
            sqlx::query(
                "INSERT INTO dataset_inputs (inputs, dataset) VALUES (?1, ?2)
                 ON CONFLICT (inputs) DO UPDATE SET dataset = ?2",
            )
            .bind(inputs)
            .bind(new.id.as_str())
            .execute(connection)
            .await
            .during(OPERATION)?;
            DatasetRow::read(&Columns::of(&row, OPERATION))
        })
        .await
    }

    /// Returns the dataset with this id; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn dataset(&self, id: &DatasetId) -> StoreResult<Option<DatasetRow>> {
        self.one_dataset("SELECT * FROM datasets WHERE id = ?1", id.as_str()).await
    }

    /// Returns the dataset that was made from inputs in this state; `None` if none was.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn dataset_of_inputs(&self, inputs: &str) -> StoreResult<Option<DatasetRow>> {
        self.one_dataset(
            "SELECT d.* FROM dataset_inputs i JOIN datasets d ON d.id = i.dataset
             WHERE i.inputs = ?1",
            inputs,
        )
        .await
    }

    /// Returns the newest dataset with this name, the one that was stored last; `None` if none is stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn newest_dataset(&self, name: &str) -> StoreResult<Option<DatasetRow>> {
        self.one_dataset("SELECT * FROM datasets WHERE name = ?1 ORDER BY rowid DESC LIMIT 1", name)
            .await
    }

    async fn one_dataset(&self, sql: &'static str, value: &str) -> StoreResult<Option<DatasetRow>> {
        let query = sqlx::query(sql).bind(value);
        self.row("reading a dataset", query, DatasetRow::read).await
    }

    /// Returns all datasets, newest first: in the order of storing, since the clock may have been set back.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn datasets(&self) -> StoreResult<Vec<DatasetRow>> {
        let query = sqlx::query("SELECT * FROM datasets ORDER BY rowid DESC");
        self.rows("listing datasets", query, DatasetRow::read).await
    }

    /// Returns what refers to datasets: models that were made of them, jobs that read them, and exports and jobs
    /// that have not ended, whose dataset may still be known by their request alone; as text, by dataset.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn dataset_users(&self) -> StoreResult<BTreeMap<DatasetId, String>> {
        let users: Vec<(String, String)> = sqlx::query_as(
            "SELECT d.id, 'model ' || m.id FROM datasets d JOIN models m ON instr(m.manifest, d.id) > 0
             UNION ALL
             SELECT dataset, kind || ' ' || id FROM tasks WHERE dataset IS NOT NULL
                 AND (kind <> 'export' OR state IN ('waiting', 'running'))
             UNION ALL
             SELECT d.id, t.kind || ' ' || t.id FROM datasets d JOIN tasks t ON instr(t.request, d.id) > 0
                 WHERE t.state IN ('waiting', 'running')",
        )
        .fetch_all(&self.inner.readers)
        .await
        .during("reading what refers to datasets")?;
        Ok(users.into_iter().map(|(id, user)| (DatasetId::unchecked(id), user)).collect())
    }

    /// Removes datasets to which nothing refers but exports that have ended.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails; a dataset that is referred to fails all.
    pub async fn remove_datasets(&self, ids: Vec<DatasetId>) -> StoreResult<()> {
        const OPERATION: &str = "removing datasets";
        self.write(OPERATION, async move |connection| {
            let statements = [
                "UPDATE tasks SET dataset = NULL WHERE dataset = ?1 AND kind = 'export'
                     AND state NOT IN ('waiting', 'running')",
                "DELETE FROM dataset_inputs WHERE dataset = ?1",
                "DELETE FROM datasets WHERE id = ?1",
            ];
            for id in &ids {
                for sql in statements {
                    let removed = sqlx::query(sql).bind(id.as_str());
                    removed.execute(&mut *connection).await.during(OPERATION)?;
                }
            }
            Ok(())
        })
        .await
    }
}
