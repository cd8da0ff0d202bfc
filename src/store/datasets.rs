//! Datasets and exports: what was made from what, and which wishes are open.
//! Uses: `store::writer`. Never: the files themselves, what a definition means.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;

use super::columns::{Columns, time_text};
use super::{During, Store, StoreError};
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

/// How far an export is.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum ExportState {
    /// Others come first.
    Waiting,
    /// It is being written.
    Running,
    /// Its file is there.
    Done,
    /// It cannot be made.
    Failed,
}

/// A wish for rows in some format.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportRow {
    /// `ex-` and a UUIDv7.
    pub id: String,
    /// What was asked for.
    pub request: Value,
    /// How far it is.
    pub state: ExportState,
    /// The dataset, once it is known.
    pub dataset: Option<String>,
    /// Name of its file, once it is there.
    pub file: Option<String>,
    /// Length of the file.
    pub bytes: Option<u64>,
    /// sha256 of the file.
    pub sha256: Option<String>,
    /// Why it cannot be made.
    pub error: Option<String>,
    /// Who asked.
    pub asked_by: String,
    /// When.
    pub created_at: Timestamp,
    /// When it was done, or failed.
    pub finished_at: Option<Timestamp>,
}

impl ExportRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        Ok(Self {
            id: c.get("id")?,
            request: c.json("request")?,
            state: c.word("state")?,
            dataset: c.get("dataset")?,
            file: c.get("file")?,
            bytes: c.whole_or_none("bytes")?,
            sha256: c.get("sha256")?,
            error: c.get("error")?,
            asked_by: c.get("asked_by")?,
            created_at: c.time("created_at")?,
            finished_at: c.time_or_none("finished_at")?,
        })
    }
}

/// What became of an export.
#[derive(Debug, Clone, PartialEq)]
pub enum ExportEnd {
    /// Its file is there.
    Done {
        /// Name of the file.
        file: String,
        /// Its length.
        bytes: u64,
        /// Its sha256.
        sha256: String,
    },
    /// It cannot be made.
    Failed(String),
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

    /// Stores a request for an export.
    pub async fn create_export(
        &self,
        id: String,
        request: Value,
        asked_by: &str,
    ) -> Result<ExportRow, StoreError> {
        const OPERATION: &str = "storing an export";
        let (asked_by, now) = (asked_by.to_owned(), self.now_text());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                let row = sqlx::query(
                    "INSERT INTO exports (id, request, state, asked_by, created_at)
                     VALUES (?1, ?2, 'waiting', ?3, ?4) RETURNING *",
                )
                .bind(id)
                .bind(request.to_string())
                .bind(asked_by)
                .bind(now)
                .fetch_one(connection)
                .await
                .during(OPERATION)?;
                ExportRow::read(&row, OPERATION)
            })
            .await
    }

    /// Marks an export as begun, on this dataset once it is known.
    pub async fn begin_export(&self, id: &str, dataset: Option<&str>) -> Result<(), StoreError> {
        const OPERATION: &str = "beginning an export";
        let (id, dataset) = (id.to_owned(), dataset.map(str::to_owned));
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "UPDATE exports SET state = 'running', dataset = coalesce(?2, dataset)
                     WHERE id = ?1 AND state IN ('waiting', 'running')",
                )
                .bind(id)
                .bind(dataset)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    /// Stores what became of an export.
    pub async fn end_export(&self, id: &str, end: ExportEnd) -> Result<(), StoreError> {
        const OPERATION: &str = "ending an export";
        let (id, now) = (id.to_owned(), self.now_text());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                let (state, file, bytes, sha256, error) = match end {
                    ExportEnd::Done { file, bytes, sha256 } => {
                        ("done", Some(file), Some(bytes.cast_signed()), Some(sha256), None)
                    }
                    ExportEnd::Failed(why) => ("failed", None, None, None, Some(why)),
                };
                sqlx::query(
                    "UPDATE exports SET state = ?2, file = ?3, bytes = ?4, sha256 = ?5, error = ?6,
                         finished_at = ?7
                     WHERE id = ?1",
                )
                .bind(id)
                .bind(state)
                .bind(file)
                .bind(bytes)
                .bind(sha256)
                .bind(error)
                .bind(now)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    /// One export.
    pub async fn export(&self, id: &str) -> Result<Option<ExportRow>, StoreError> {
        const OPERATION: &str = "reading an export";
        sqlx::query("SELECT * FROM exports WHERE id = ?1")
            .bind(id)
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?
            .map(|row| ExportRow::read(&row, OPERATION))
            .transpose()
    }

    /// The last exports, newest first.
    pub async fn exports(&self, limit: u32) -> Result<Vec<ExportRow>, StoreError> {
        self.read_exports("SELECT * FROM exports ORDER BY id DESC LIMIT ?1", limit).await
    }

    /// Exports that are neither done nor failed, oldest first.
    pub async fn open_exports(&self, limit: u32) -> Result<Vec<ExportRow>, StoreError> {
        self.read_exports(
            "SELECT * FROM exports WHERE state IN ('waiting', 'running') ORDER BY id LIMIT ?1",
            limit,
        )
        .await
    }

    async fn read_exports(
        &self,
        sql: &'static str,
        limit: u32,
    ) -> Result<Vec<ExportRow>, StoreError> {
        const OPERATION: &str = "listing exports";
        let rows =
            sqlx::query(sql).bind(limit).fetch_all(&self.inner.readers).await.during(OPERATION)?;
        rows.iter().map(|row| ExportRow::read(row, OPERATION)).collect()
    }
}
