//! Datasets and exports: what was made from what, and which wishes are open.
//! Uses: `store::writer`. Never: the files themselves, what a definition means.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;

use crate::core::columns::{Columns, time_text};
use crate::core::{During, Store, StoreError};
use crate::ids::RunUid;

/// A dataset; its rows are in a file of its id's name.
#[derive(Debug, Clone, PartialEq)]
pub struct DatasetRow {
    /// `ds-` and the start of a sha256 over its contents.
    pub id: String,
    /// Its definition's name.
    pub name: String,
    /// Its definition.
    pub definition: Value,
    /// Rows.
    pub rows: u64,
    /// Length of its Parquet file.
    pub bytes: u64,
    /// sha256 of its Parquet file.
    pub sha256: String,
    /// Parts, what was left out and why, columns.
    pub report: Value,
    /// Runs, models, calibrations, shards, code.
    pub lineage: Value,
    /// When it was made.
    pub created_at: Timestamp,
}

impl DatasetRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        Ok(Self {
            id: c.get("id")?,
            name: c.get("name")?,
            definition: c.json("definition")?,
            rows: c.whole("rows")?,
            bytes: c.whole("bytes")?,
            sha256: c.get("sha256")?,
            report: c.json("report")?,
            lineage: c.json("lineage")?,
            created_at: c.time("created_at")?,
        })
    }
}

/// What the rows of a run depend on: it changes whenever they may have.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RunExtent {
    /// Stored trials.
    pub trials: i64,
    /// The last one's id.
    pub last: i64,
    /// Trials that were taken back.
    pub taken_back: i64,
    /// Twins.
    pub twins: i64,
    /// The newest model among them: a later one has a larger number.
    pub newest: Option<i64>,
    /// Its hash.
    pub model: Option<String>,
}

impl Store {
    /// What the rows of a run depend on.
    pub async fn run_extent(&self, run: RunUid) -> Result<RunExtent, StoreError> {
        const OPERATION: &str = "looking at a run's extent";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let row = sqlx::query(
            "SELECT e.*, m.hash AS model,
                 (SELECT count(*) FROM attempts WHERE run = ?1 AND trial IS NOT NULL) AS taken_back
             FROM (SELECT count(DISTINCT t.id) AS trials, coalesce(max(t.id), 0) AS last,
                       count(w.trial) AS twins, max(w.model) AS newest
                   FROM trials t INDEXED BY trials_in_order
                   LEFT JOIN twins w ON w.trial = t.id WHERE t.run = ?1) e
             LEFT JOIN twin_models m ON m.id = e.newest",
        )
        .bind(scan_id)
        .fetch_one(&self.inner.readers)
        .await
        .during(OPERATION)?;
        let c = Columns::of(&row, OPERATION);
        Ok(RunExtent {
            trials: c.get("trials")?,
            last: c.get("last")?,
            taken_back: c.get("taken_back")?,
            twins: c.get("twins")?,
            newest: c.get("newest")?,
            model: c.get("model")?,
        })
    }

    /// Stores a dataset, whose file is there, under the state of its inputs. One that is stored
    /// already stays as it is. Returns what is stored.
    pub async fn insert_dataset(
        &self,
        new: DatasetRow,
        inputs: &str,
    ) -> Result<DatasetRow, StoreError> {
        const OPERATION: &str = "storing a dataset";
        let inputs = inputs.to_owned();
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "INSERT INTO datasets (id, name, definition, rows, bytes, sha256, report,
                         lineage, created_at)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9) ON CONFLICT (id) DO NOTHING",
                )
                .bind(&new.id)
                .bind(&new.name)
                .bind(new.definition.to_string())
                .bind(new.rows.cast_signed())
                .bind(new.bytes.cast_signed())
                .bind(&new.sha256)
                .bind(new.report.to_string())
                .bind(new.lineage.to_string())
                .bind(time_text(new.created_at))
                .execute(&mut *connection)
                .await
                .during(OPERATION)?;
                sqlx::query(
                    "INSERT INTO dataset_inputs (inputs, dataset) VALUES (?1, ?2)
                     ON CONFLICT (inputs) DO UPDATE SET dataset = ?2",
                )
                .bind(inputs)
                .bind(&new.id)
                .execute(&mut *connection)
                .await
                .during(OPERATION)?;
                let row = sqlx::query("SELECT * FROM datasets WHERE id = ?1")
                    .bind(&new.id)
                    .fetch_one(connection)
                    .await
                    .during(OPERATION)?;
                DatasetRow::read(&row, OPERATION)
            })
            .await
    }

    /// The dataset of this id.
    pub async fn dataset(&self, id: &str) -> Result<Option<DatasetRow>, StoreError> {
        self.one_dataset("SELECT * FROM datasets WHERE id = ?1", id).await
    }

    /// The dataset that was made from inputs in this state.
    pub async fn dataset_of_inputs(&self, inputs: &str) -> Result<Option<DatasetRow>, StoreError> {
        self.one_dataset(
            "SELECT d.* FROM dataset_inputs i JOIN datasets d ON d.id = i.dataset
             WHERE i.inputs = ?1",
            inputs,
        )
        .await
    }

    /// The dataset of this name that was made last.
    pub async fn newest_dataset(&self, name: &str) -> Result<Option<DatasetRow>, StoreError> {
        self.one_dataset(
            "SELECT * FROM datasets WHERE name = ?1 ORDER BY created_at DESC, rowid DESC LIMIT 1",
            name,
        )
        .await
    }

    async fn one_dataset(
        &self,
        sql: &'static str,
        value: &str,
    ) -> Result<Option<DatasetRow>, StoreError> {
        const OPERATION: &str = "reading a dataset";
        sqlx::query(sql)
            .bind(value)
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?
            .map(|row| DatasetRow::read(&row, OPERATION))
            .transpose()
    }

    /// All datasets, newest first.
    pub async fn datasets(&self) -> Result<Vec<DatasetRow>, StoreError> {
        const OPERATION: &str = "listing datasets";
        let rows = sqlx::query("SELECT * FROM datasets ORDER BY created_at DESC, rowid DESC")
            .fetch_all(&self.inner.readers)
            .await
            .during(OPERATION)?;
        rows.iter().map(|row| DatasetRow::read(row, OPERATION)).collect()
    }
}
