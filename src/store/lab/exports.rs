//! Exports: their requests, states and results.
//! Uses: `core::writer`. Never: the files themselves, the meaning of a request.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;

use crate::core::columns::Columns;
use crate::core::{During, Store, StoreError};

/// State of an export.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum ExportState {
    /// It waits for earlier exports.
    Waiting,
    /// Its file is being written.
    Running,
    /// Its file is complete.
    Done,
    /// It failed.
    Failed,
}

/// A stored export.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportRow {
    /// Id: `ex-` and a UUIDv7.
    pub id: String,
    /// The request, as JSON.
    pub request: Value,
    /// State of the export.
    pub state: ExportState,
    /// Id of the dataset; absent until it is known.
    pub dataset: Option<crate::ids::DatasetId>,
    /// Name of its file; absent until it is complete.
    pub file: Option<String>,
    /// Length of the file, bytes; absent until it is complete.
    pub bytes: Option<u64>,
    /// sha256 of the file; absent until it is complete.
    pub sha256: Option<String>,
    /// Cause of the failure; absent unless it failed.
    pub error: Option<String>,
    /// Person or key that requested it.
    pub asked_by: String,
    /// Wall time of the request.
    pub created_at: Timestamp,
    /// Wall time at which it completed or failed; absent before.
    pub finished_at: Option<Timestamp>,
}

impl ExportRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        Ok(Self {
            id: c.get("id")?,
            request: c.json("request")?,
            state: c.word("state")?,
            dataset: c.id_or_none("dataset")?,
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

/// Result of an export.
#[derive(Debug, Clone, PartialEq)]
pub enum ExportEnd {
    /// Its file is complete.
    Done {
        /// Name of the file.
        file: String,
        /// Length of the file, bytes.
        bytes: u64,
        /// sha256 of the file.
        sha256: String,
    },
    /// It failed; the text is the cause.
    Failed(String),
}

impl Store {
    /// Stores a request for an export, in the state `waiting`.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
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

    /// Marks an export as running, with the id of its dataset if it is known. An export that has ended
    /// is not changed.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
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

    /// Stores the result of an export.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
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

    /// Returns an export; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
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

    /// Returns at most `limit` exports, newest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn exports(&self, limit: u32) -> Result<Vec<ExportRow>, StoreError> {
        self.read_exports("SELECT * FROM exports ORDER BY id DESC LIMIT ?1", limit).await
    }

    /// Returns at most `limit` exports that wait or run, oldest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
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
