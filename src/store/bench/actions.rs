//! The log of actions: who requested what, when and why, and whether it was accepted.
//! Uses: `core::writer`. Never: the text of an API key (callers state its name).

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::columns::{Columns, row, time_text};
use crate::core::{Store, StoreResult};
use crate::ids::RunUid;

/// An action that is to be logged.
#[derive(Debug, Clone, PartialEq)]
pub struct NewAction {
    /// Wall time of the request.
    pub at: Timestamp,
    /// Run that it concerns; absent if it concerns none.
    pub run: Option<RunUid>,
    /// Name of the action, one word: `start`, `pause`, `estop`, `jog`, ...
    pub action: String,
    /// Name of the API key, or of a caller without a key (`local`).
    pub who: String,
    /// Number of the API key; absent without one.
    pub key_id: Option<i64>,
    /// Reason that the person entered; absent without one.
    pub why: Option<String>,
    /// Whether it was accepted (true) or refused (false).
    pub accepted: bool,
    /// Cause of the refusal, or values of the action; absent without them.
    pub detail: Option<String>,
}

/// A logged action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ActionRow {
    /// Number of the action, in the order of storing.
    pub id: i64,
    /// Wall time of the request.
    pub at: Timestamp,
    /// Run that it concerns; absent if it concerns none.
    pub run: Option<RunUid>,
    /// Name of the action, one word: `start`, `pause`, `estop`, `jog`, ...
    pub action: String,
    /// Name of the API key, or of a caller without a key (`local`).
    pub who: String,
    /// Number of the API key, which is unique, unlike the name of a revoked key; absent without one, and
    /// for actions that an older version logged.
    pub key_id: Option<i64>,
    /// Reason that the person entered; absent without one.
    pub why: Option<String>,
    /// Whether it was accepted (true) or refused (false).
    pub accepted: bool,
    /// Cause of the refusal, or values of the action; absent without them.
    pub detail: Option<String>,
}

impl Store {
    /// Logs an action. A repetition after a failure does not store it twice.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql`, `Late` or `Closed` if it is unknown
    /// whether the action is stored.
    pub async fn log_action(&self, action: NewAction) -> StoreResult<()> {
        const OPERATION: &str = "logging an action";
        let scan_id = match action.run {
            Some(run) => Some(self.facts(run, OPERATION).await?.scan_id),
            None => None,
        };
        let query = sqlx::query(
            "INSERT INTO actions (at, run, action, who, why, accepted, detail, key_id)
             SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8 WHERE NOT EXISTS (
               SELECT 1 FROM actions
               WHERE id > (SELECT max(id) - 1000 FROM actions) AND at = ?1
                 AND run IS ?2 AND action = ?3 AND who = ?4 AND why IS ?5
                 AND accepted = ?6 AND detail IS ?7 AND key_id IS ?8)",
        )
        .bind(time_text(action.at))
        .bind(scan_id)
        .bind(action.action)
        .bind(action.who)
        .bind(action.why)
        .bind(action.accepted)
        .bind(action.detail)
        .bind(action.key_id);
        self.inner.writer.execute(OPERATION, query).await.map(drop)
    }

    /// Returns at most `limit` actions with numbers below `before`, newest first, of one run or of all.
    ///
    /// # Errors
    /// `NoSuchRun` if a given run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn actions(
        &self,
        run: Option<RunUid>,
        limit: u32,
        before: Option<i64>,
    ) -> StoreResult<Vec<ActionRow>> {
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
        let read = |c: &Columns<'_>| {
            Ok(row!(c, ActionRow { run: c.word_or_none("uid")? },
                get: id, action, who, key_id, why, accepted, detail;
                time: at))
        };
        self.rows(OPERATION, statement, read).await
    }

    /// Returns the time of the last accepted action with one of these names; `None` without one.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn last_accepted(&self, actions: &[&str]) -> StoreResult<Option<Timestamp>> {
        let query = sqlx::query(
            "SELECT at FROM actions
             WHERE accepted = 1 AND action IN (SELECT value FROM json_each(?1))
             ORDER BY id DESC LIMIT 1",
        )
        .bind(serde_json::json!(actions).to_string());
        self.row("reading the last action of a kind", query, |c| c.time("at")).await
    }

    /// Returns the time of the newest action with one of the names `operations`, accepted or refused, unless an
    /// accepted one of `handovers` is newer; `None` without one.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn last_operated(
        &self,
        operations: &[&str],
        handovers: &[&str],
    ) -> StoreResult<Option<Timestamp>> {
        let query = sqlx::query(
            "SELECT at, action IN (SELECT value FROM json_each(?1)) AS is_operation FROM actions
             WHERE action IN (SELECT value FROM json_each(?1))
                OR (accepted = 1 AND action IN (SELECT value FROM json_each(?2)))
             ORDER BY id DESC LIMIT 1",
        )
        .bind(serde_json::json!(operations).to_string())
        .bind(serde_json::json!(handovers).to_string());
        let read = |c: &Columns<'_>| Ok((c.time("at")?, c.whole::<i64>("is_operation")? == 1));
        let newest = self.row("reading the last action on the rig", query, read).await?;
        Ok(newest.filter(|(_, is_operation)| *is_operation).map(|(at, _)| at))
    }

    /// Returns the number of accepted actions on a run with this name.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` if the read fails.
    pub async fn accepted_on(&self, run: RunUid, action: &str) -> StoreResult<u64> {
        const OPERATION: &str = "counting actions on a run";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT count(*) AS n FROM actions WHERE run = ?1 AND accepted = 1 AND action = ?2",
        )
        .bind(scan_id)
        .bind(action);
        self.one(OPERATION, query, |c| c.whole("n")).await
    }
}
