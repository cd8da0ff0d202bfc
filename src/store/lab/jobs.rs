//! Long computations: what was asked for, how far it is, what came of it.
//! Uses: `store::writer`. Never: what a request means.

use jiff::Timestamp;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;

use crate::core::columns::Columns;
use crate::core::{During, Store, StoreError};

/// What is computed.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum JobKind {
    /// A net is trained.
    Training,
    /// A method is scored on a dataset.
    Evaluation,
}

/// How far a job is.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum JobState {
    /// Others come first.
    Waiting,
    /// It is under way; after a restart it goes on.
    Running,
    /// Its result is there.
    Done,
    /// Somebody ended it.
    Stopped,
    /// It gave no result.
    Failed,
}

impl JobState {
    /// Whether nothing more will happen.
    pub fn has_ended(self) -> bool {
        !matches!(self, Self::Waiting | Self::Running)
    }
}

/// A job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRow {
    /// `job-` and a UUIDv7.
    pub id: String,
    /// What is computed.
    pub kind: JobKind,
    /// What was asked for.
    pub request: Value,
    /// How far it is.
    pub state: JobState,
    /// The dataset, once it is known.
    pub dataset: Option<String>,
    /// What came of it, once it is done.
    pub result: Option<Value>,
    /// Why it failed.
    pub error: Option<String>,
    /// Who asked.
    pub asked_by: String,
    /// When.
    pub created_at: Timestamp,
    /// When it first began.
    pub started_at: Option<Timestamp>,
    /// When it ended.
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
            dataset: c.get("dataset")?,
            result: result.map(|_| c.json("result")).transpose()?,
            error: c.get("error")?,
            asked_by: c.get("asked_by")?,
            created_at: c.time("created_at")?,
            started_at: c.time_or_none("started_at")?,
            finished_at: c.time_or_none("finished_at")?,
        })
    }
}

/// What became of a job.
#[derive(Debug, Clone, PartialEq)]
pub enum JobEnd {
    /// Its result.
    Done(Value),
    /// Somebody ended it.
    Stopped,
    /// It gave no result.
    Failed(String),
}

impl Store {
    /// Stores a wish for a job.
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

    /// Marks a job as begun, on this dataset once it is known. One that has ended stays so.
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

    /// Stores what became of a job. False when it had ended before: that stays.
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

    /// One job.
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

    /// The last jobs, newest first.
    pub async fn jobs(&self, limit: u32) -> Result<Vec<JobRow>, StoreError> {
        self.read_jobs("SELECT * FROM jobs ORDER BY id DESC LIMIT ?1", limit).await
    }

    /// Jobs that have not ended, oldest first.
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

    /// Evaluations that are done and name this model among those that they scored, newest first.
    pub async fn evaluations_of(&self, model: &str) -> Result<Vec<JobRow>, StoreError> {
        const OPERATION: &str = "reading a model's evaluations";
        let rows = sqlx::query(
            "SELECT * FROM jobs WHERE kind = 'evaluation' AND state = 'done'
                 AND EXISTS (SELECT 1 FROM json_each(result, '$.models') WHERE value = ?1)
             ORDER BY id DESC",
        )
        .bind(model)
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        rows.iter().map(|row| JobRow::read(row, OPERATION)).collect()
    }
}
