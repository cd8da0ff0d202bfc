//! Tasks (exports, trainings, evaluations): their requests, states and results.
//! Uses: `core::writer`. Never: the meaning of a request or of a result.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use strum::{Display, VariantArray};
use utoipa::ToSchema;

use crate::core::columns::{Columns, row};
use crate::core::{Store, StoreResult};
use crate::ids::{DatasetId, ModelId, TaskId};

/// Kind of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, Display)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum TaskKind {
    /// Writing of a dataset in a requested format.
    Export,
    /// Training of a net.
    Training,
    /// Evaluation of methods or nets on a dataset.
    Evaluation,
}

impl TaskKind {
    /// The kinds of jobs.
    pub const JOBS: &'static [Self] = &[Self::Training, Self::Evaluation];
    /// The kinds of exports.
    pub const EXPORTS: &'static [Self] = &[Self::Export];

    fn new_id(self) -> TaskId {
        match self {
            Self::Export => TaskId::new_export(),
            Self::Training | Self::Evaluation => TaskId::new_job(),
        }
    }
}

/// State of a task.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, Display, VariantArray,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum TaskState {
    /// It waits for earlier tasks of its queue.
    Waiting,
    /// It runs; after a restart it resumes.
    Running,
    /// It completed with a result.
    Done,
    /// A person stopped it.
    Stopped,
    /// It ended with an error, which is stored.
    Failed,
}

/// A stored task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TaskRow {
    /// Id of the task.
    #[schema(value_type = String)]
    pub id: TaskId,
    /// Kind of the task.
    pub kind: TaskKind,
    /// The request: of a job `{"recipe": text}` or an EvaluationRequest.
    #[schema(value_type = Object)]
    pub request: Value,
    /// State of the task.
    pub state: TaskState,
    /// Id of the dataset; absent until it is known.
    pub dataset: Option<DatasetId>,
    /// The result: `{"model": id, "name": ..}` of a training, with `"warnings": [..]` if there were any, an
    /// EvaluationReport of an evaluation. Absent until it is done.
    #[schema(value_type = Option<Object>)]
    pub result: Option<Value>,
    /// Cause of the failure; absent unless it failed.
    pub error: Option<String>,
    /// Name of the person or key that requested it.
    pub asked_by: String,
    /// Time of the request.
    pub created_at: Timestamp,
    /// Time of the first start; absent before it.
    pub started_at: Option<Timestamp>,
    /// Time of the end; absent before it.
    pub finished_at: Option<Timestamp>,
}

impl TaskRow {
    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        let result: Option<&str> = c.get("result")?;
        let result = result.map(|_| c.json("result")).transpose()?;
        Ok(row!(c, Self { result },
            get: error, asked_by;
            json: request;
            word: id, kind, state;
            word_or_none: dataset;
            time: created_at;
            time_or_none: started_at, finished_at))
    }
}

/// End of a task.
#[derive(Debug, Clone, PartialEq)]
pub enum TaskEnd {
    /// It completed with this result, as JSON.
    Done(Value),
    /// A person stopped it.
    Stopped,
    /// It failed; the text is the cause.
    Failed(String),
}

impl TaskEnd {
    /// State of a task with this end.
    pub fn state(&self) -> TaskState {
        match self {
            Self::Done(_) => TaskState::Done,
            Self::Stopped => TaskState::Stopped,
            Self::Failed(_) => TaskState::Failed,
        }
    }
}

/// Kinds as a JSON array, the parameter of a statement.
fn names(kinds: &[TaskKind]) -> String {
    kinds.iter().map(ToString::to_string).collect::<Value>().to_string()
}

impl Store {
    /// Stores a request for a task under a new id, in the state `waiting`.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn create_task(
        &self,
        kind: TaskKind,
        request: Value,
        asked_by: &str,
    ) -> StoreResult<TaskRow> {
        let query = sqlx::query(
            "INSERT INTO tasks (id, kind, request, state, asked_by, created_at)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6) RETURNING *",
        )
        .bind(kind.new_id().to_string())
        .bind(kind.to_string())
        .bind(request.to_string())
        .bind(TaskState::Waiting.to_string())
        .bind(asked_by)
        .bind(self.now_text());
        self.inner.writer.returned("storing a task", query, TaskRow::read).await
    }

    /// Marks a task as running, with the id of its dataset if it is known. Returns false, and changes
    /// nothing, if it has already ended.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn begin_task(&self, id: TaskId, dataset: Option<&DatasetId>) -> StoreResult<bool> {
        let query = sqlx::query(
            "UPDATE tasks SET state = 'running', dataset = coalesce(?2, dataset),
                 started_at = coalesce(started_at, ?3)
             WHERE id = ?1 AND state IN ('waiting', 'running')",
        )
        .bind(id.to_string())
        .bind(dataset.map(DatasetId::as_str))
        .bind(self.now_text());
        Ok(self.inner.writer.execute("beginning a task", query).await? > 0)
    }

    /// Stores the end of a task. Returns false, and changes nothing, if it has already ended.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn end_task(&self, id: TaskId, end: TaskEnd) -> StoreResult<bool> {
        let state = end.state();
        let (result, error) = match end {
            TaskEnd::Done(result) => (Some(result.to_string()), None),
            TaskEnd::Stopped => (None, None),
            TaskEnd::Failed(cause) => (None, Some(cause)),
        };
        let query = sqlx::query(
            "UPDATE tasks SET state = ?2, result = ?3, error = ?4, finished_at = ?5
             WHERE id = ?1 AND state IN ('waiting', 'running')",
        )
        .bind(id.to_string())
        .bind(state.to_string())
        .bind(result)
        .bind(error)
        .bind(self.now_text());
        Ok(self.inner.writer.execute("ending a task", query).await? > 0)
    }

    /// Returns a task; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn task(&self, id: TaskId) -> StoreResult<Option<TaskRow>> {
        let query = sqlx::query("SELECT * FROM tasks WHERE id = ?1").bind(id.to_string());
        self.row("reading a task", query, TaskRow::read).await
    }

    /// Returns at most `limit` tasks of these kinds that were requested before the task `before`, newest
    /// first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn tasks(
        &self,
        kinds: &[TaskKind],
        limit: u32,
        before: Option<TaskId>,
    ) -> StoreResult<Vec<TaskRow>> {
        let sql = "SELECT * FROM tasks WHERE kind IN (SELECT value FROM json_each(?1))
                 AND (?3 IS NULL OR id < ?3)
             ORDER BY id DESC LIMIT ?2";
        self.read_tasks(sql, kinds, limit, before).await
    }

    /// Returns at most `limit` tasks of these kinds that have not ended, oldest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn open_tasks(&self, kinds: &[TaskKind], limit: u32) -> StoreResult<Vec<TaskRow>> {
        let sql = "SELECT * FROM tasks WHERE state IN ('waiting', 'running')
                 AND kind IN (SELECT value FROM json_each(?1))
             ORDER BY id LIMIT ?2";
        self.read_tasks(sql, kinds, limit, None).await
    }

    async fn read_tasks(
        &self,
        sql: &'static str,
        kinds: &[TaskKind],
        limit: u32,
        before: Option<TaskId>,
    ) -> StoreResult<Vec<TaskRow>> {
        let before = before.map(|id| id.to_string());
        let reading = sqlx::query(sql).bind(names(kinds)).bind(limit).bind(before);
        self.rows("listing tasks", reading, TaskRow::read).await
    }

    /// Returns the completed evaluations that scored this model, newest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn evaluations_of(&self, model: &ModelId) -> StoreResult<Vec<TaskRow>> {
        let query = sqlx::query(
            "SELECT * FROM tasks WHERE kind = 'evaluation' AND state = 'done'
                 AND EXISTS (SELECT 1 FROM json_each(result, '$.models') WHERE value = ?1)
             ORDER BY id DESC",
        )
        .bind(model.as_str());
        self.rows("reading a model's evaluations", query, TaskRow::read).await
    }

    /// Returns the newest completed training of this model; `None` if it was added, or trained elsewhere.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn training_of(&self, model: &ModelId) -> StoreResult<Option<TaskRow>> {
        let query = sqlx::query(
            "SELECT * FROM tasks WHERE kind = 'training' AND state = 'done'
                 AND json_extract(result, '$.model') = ?1
             ORDER BY id DESC LIMIT 1",
        )
        .bind(model.as_str());
        self.row("reading a model's training", query, TaskRow::read).await
    }
}
