//! Jobs (trainings and evaluations): their requests, states and results.
//! Uses: `core::writer`. Never: the meaning of a request.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;

use crate::core::columns::Columns;
use crate::core::{During, Store, StoreError};

/// Kind of a job.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum JobKind {
    /// Training of a net.
    Training,
    /// Evaluation of methods or nets on a dataset.
    Evaluation,
}

/// State of a job.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum JobState {
    /// It waits for earlier jobs.
    Waiting,
    /// It runs; after a restart it resumes.
    Running,
    /// It completed with a result.
    Done,
    /// A person stopped it.
    Stopped,
    /// It failed.
    Failed,
}

impl JobState {
    /// Whether the job has ended, with or without a result.
    pub fn has_ended(self) -> bool {
        !matches!(self, Self::Waiting | Self::Running)
    }
}

/// A stored job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRow {
    /// Id: `job-` and a UUIDv7.
    pub id: String,
    /// Kind of the job.
    pub kind: JobKind,
    /// The request, as JSON.
    pub request: Value,
    /// State of the job.
    pub state: JobState,
    /// Id of the dataset; absent until it is known.
    pub dataset: Option<crate::ids::DatasetId>,
    /// The result, as JSON; absent unless it is done.
    pub result: Option<Value>,
    /// Cause of the failure; absent unless it failed.
    pub error: Option<String>,
    /// Person or key that requested it.
    pub asked_by: String,
    /// Wall time of the request.
    pub created_at: Timestamp,
    /// Wall time at which it first started; absent before.
    pub started_at: Option<Timestamp>,
    /// Wall time at which it ended; absent before.
    pub finished_at: Option<Timestamp>,
}

impl JobRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        let result: Option<&str> = c.get("result")?;
        Ok(Self {
            id: c.get("id")?,
            kind: c.word("kind")?,
            request: c.json("request")?,
            state: c.word("state")?,
            dataset: c.id_or_none("dataset")?,
            result: result.map(|_| c.json("result")).transpose()?,
            error: c.get("error")?,
            asked_by: c.get("asked_by")?,
            created_at: c.time("created_at")?,
            started_at: c.time_or_none("started_at")?,
            finished_at: c.time_or_none("finished_at")?,
        })
    }
}

/// Result of a job.
#[derive(Debug, Clone, PartialEq)]
pub enum JobEnd {
    /// It completed with this result, as JSON.
    Done(Value),
    /// A person stopped it.
    Stopped,
    /// It failed; the text is the cause.
    Failed(String),
}

impl Store {
    /// Stores a request for a job, in the state `waiting`.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn create_job(
        &self,
        id: String,
        kind: JobKind,
        request: Value,
        asked_by: &str,
    ) -> Result<JobRow, StoreError> {
        const OPERATION: &str = "storing a job";
        let (asked_by, now) = (asked_by.to_owned(), self.now_text());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                let kind = match kind {
                    JobKind::Training => "training",
                    JobKind::Evaluation => "evaluation",
                };
                let row = sqlx::query(
                    "INSERT INTO jobs (id, kind, request, state, asked_by, created_at)
                     VALUES (?1, ?2, ?3, 'waiting', ?4, ?5) RETURNING *",
                )
                .bind(id)
                .bind(kind)
                .bind(request.to_string())
                .bind(asked_by)
                .bind(now)
                .fetch_one(connection)
                .await
                .during(OPERATION)?;
                JobRow::read(&row, OPERATION)
            })
            .await
    }

    /// Marks a job as running, with the id of its dataset if it is known. A job that has ended is not
    /// changed.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn begin_job(&self, id: &str, dataset: Option<&str>) -> Result<(), StoreError> {
        const OPERATION: &str = "beginning a job";
        let (id, dataset, now) = (id.to_owned(), dataset.map(str::to_owned), self.now_text());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "UPDATE jobs SET state = 'running', dataset = coalesce(?2, dataset),
                         started_at = coalesce(started_at, ?3)
                     WHERE id = ?1 AND state IN ('waiting', 'running')",
                )
                .bind(id)
                .bind(dataset)
                .bind(now)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    /// Stores the result of a job. Returns false, and changes nothing, if it has already ended.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn end_job(&self, id: &str, end: JobEnd) -> Result<bool, StoreError> {
        const OPERATION: &str = "ending a job";
        let (id, now) = (id.to_owned(), self.now_text());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                let (state, result, error) = match end {
                    JobEnd::Done(result) => ("done", Some(result.to_string()), None),
                    JobEnd::Stopped => ("stopped", None, None),
                    JobEnd::Failed(why) => ("failed", None, Some(why)),
                };
                let ended = sqlx::query(
                    "UPDATE jobs SET state = ?2, result = ?3, error = ?4, finished_at = ?5
                     WHERE id = ?1 AND state IN ('waiting', 'running')",
                )
                .bind(id)
                .bind(state)
                .bind(result)
                .bind(error)
                .bind(now)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(ended.rows_affected() > 0)
            })
            .await
    }

    /// Returns a job; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn job(&self, id: &str) -> Result<Option<JobRow>, StoreError> {
        const OPERATION: &str = "reading a job";
        sqlx::query("SELECT * FROM jobs WHERE id = ?1")
            .bind(id)
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?
            .map(|row| JobRow::read(&row, OPERATION))
            .transpose()
    }

    /// Returns at most `limit` jobs, newest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn jobs(&self, limit: u32) -> Result<Vec<JobRow>, StoreError> {
        self.read_jobs("SELECT * FROM jobs ORDER BY id DESC LIMIT ?1", limit).await
    }

    /// Returns at most `limit` jobs that have not ended, oldest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn open_jobs(&self, limit: u32) -> Result<Vec<JobRow>, StoreError> {
        self.read_jobs(
            "SELECT * FROM jobs WHERE state IN ('waiting', 'running') ORDER BY id LIMIT ?1",
            limit,
        )
        .await
    }

    async fn read_jobs(&self, sql: &'static str, limit: u32) -> Result<Vec<JobRow>, StoreError> {
        const OPERATION: &str = "listing jobs";
        let rows =
            sqlx::query(sql).bind(limit).fetch_all(&self.inner.readers).await.during(OPERATION)?;
        rows.iter().map(|row| JobRow::read(row, OPERATION)).collect()
    }

    /// Returns the completed evaluations that scored this model, newest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn evaluations_of(
        &self,
        model: &crate::ids::ModelId,
    ) -> Result<Vec<JobRow>, StoreError> {
        const OPERATION: &str = "reading a model's evaluations";
        let rows = sqlx::query(
            "SELECT * FROM jobs WHERE kind = 'evaluation' AND state = 'done'
                 AND EXISTS (SELECT 1 FROM json_each(result, '$.models') WHERE value = ?1)
             ORDER BY id DESC",
        )
        .bind(model.as_str())
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        rows.iter().map(|row| JobRow::read(row, OPERATION)).collect()
    }
}
