//! The log of actions: who asked for what, when, why, and whether it was allowed.
//! Uses: `store::writer`. Never: a secret (callers name the key, not its text).

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::columns::{Columns, time_text};
use crate::core::{During, Store, StoreError};
use crate::ids::RunUid;

/// An action to be logged.
#[derive(Debug, Clone, PartialEq)]
pub struct NewAction {
    /// When it was asked for.
    pub at: Timestamp,
    /// The run it was meant for, if any.
    pub run: Option<RunUid>,
    /// One word: `start`, `pause`, `estop`, `jog`, ...
    pub action: String,
    /// The name of the key, or `local`.
    pub who: String,
    /// The reason that was given.
    pub why: Option<String>,
    /// It was done, not refused.
    pub accepted: bool,
    /// Why it was refused, or what it was done with.
    pub detail: Option<String>,
}

/// An action as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ActionRow {
    /// Its number.
    pub id: i64,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// The run it was meant for, if any.
    pub run: Option<RunUid>,
    /// One word: `start`, `pause`, `estop`, `jog`, ...
    pub action: String,
    /// The name of the key, or `local`.
    pub who: String,
    /// The reason that was given.
    pub why: Option<String>,
    /// It was done, not refused.
    pub accepted: bool,
    /// Why it was refused, or what it was done with.
    pub detail: Option<String>,
}

impl Store {
    /// Logs an action. Logging it again, after a failure, does not double it.
    ///
    /// # Errors
    /// When it is unknown whether the action is stored, and when its run does not exist.
    pub async fn log_action(&self, action: NewAction) -> Result<(), StoreError> {
        const OPERATION: &str = "logging an action";
        let scan_id = match action.run {
            Some(run) => Some(self.facts(run, OPERATION).await?.scan_id),
            None => None,
        };
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "INSERT INTO actions (at, run, action, who, why, accepted, detail)
                     SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7 WHERE NOT EXISTS (
                       SELECT 1 FROM actions
                       WHERE id > (SELECT max(id) - 1000 FROM actions) AND at = ?1
                         AND run IS ?2 AND action = ?3 AND who = ?4 AND why IS ?5
                         AND accepted = ?6 AND detail IS ?7)",
                )
                .bind(time_text(action.at))
                .bind(scan_id)
                .bind(action.action)
                .bind(action.who)
                .bind(action.why)
                .bind(action.accepted)
                .bind(action.detail)
                .execute(connection)
                .await
                .map(drop)
                .during(OPERATION)
            })
            .await
    }

    /// Up to `limit` actions, newest first, older than the one numbered `before`; of one run, or
    /// of all.
    pub async fn actions(
        &self,
        run: Option<RunUid>,
        limit: u32,
        before: Option<i64>,
    ) -> Result<Vec<ActionRow>, StoreError> {
        const OPERATION: &str = "reading actions";
        let before = before.unwrap_or(i64::MAX);
        let statement = match run {
            Some(run) => {
                let scan_id = self.facts(run, OPERATION).await?.scan_id;
                sqlx::query(
                    "SELECT a.*, r.uid FROM actions a JOIN runs r ON r.scan_id = a.run
                     WHERE a.id < ?1 AND a.run = ?3 ORDER BY a.id DESC LIMIT ?2",
                )
                .bind(before)
                .bind(limit)
                .bind(scan_id)
            }
            None => sqlx::query(
                "SELECT a.*, r.uid FROM actions a LEFT JOIN runs r ON r.scan_id = a.run
                 WHERE a.id < ?1 ORDER BY a.id DESC LIMIT ?2",
            )
            .bind(before)
            .bind(limit),
        };
        let rows = statement.fetch_all(&self.inner.readers).await.during(OPERATION)?;
        rows.iter()
            .map(|row| {
                let c = Columns::of(row, OPERATION);
                Ok(ActionRow {
                    id: c.get("id")?,
                    at: c.time("at")?,
                    run: c.uid_or_none("uid")?,
                    action: c.get("action")?,
                    who: c.get("who")?,
                    why: c.get("why")?,
                    accepted: c.get("accepted")?,
                    detail: c.get("detail")?,
                })
            })
            .collect()
    }
}
