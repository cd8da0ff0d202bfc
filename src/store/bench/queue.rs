//! The queue: runs in the state `queued`, in the order of their positions, from 1; and the started runs
//! that wait for their turn.
//! Uses: `core::writer`, `run_row`. Never: starting a run (the conductor does).

use sqlx::sqlite::SqliteConnection;

use super::run_row::{self, NewRun, RunRow};
use crate::core::columns::Columns;
use crate::core::{During, Store, StoreError, StoreResult};
use crate::ids::RunUid;
use crate::state::StoredState;

impl Store {
    /// Stores a new run at the end of the queue.
    ///
    /// # Errors
    /// `Refused` if the seed or the number of trials is too large or the deadband is not finite;
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn enqueue(&self, new: NewRun) -> StoreResult<RunRow> {
        const OPERATION: &str = "queueing a run";
        let now = self.now_text();
        let insert = async move |c: &mut SqliteConnection| {
            run_row::insert(c, new, StoredState::Queued, now, OPERATION).await
        };
        self.write(OPERATION, insert).await
    }

    /// Replaces the inputs of the queued run with the uid of `new`. It keeps its number, its place, its
    /// creation and its submitter, and must be armed and started again.
    ///
    /// # Errors
    /// `NotQueued` if the run is not in the queue; others as [`Self::enqueue`].
    pub async fn replace_queued(&self, new: NewRun) -> StoreResult<RunRow> {
        const OPERATION: &str = "editing a queued run";
        let now = self.now_text();
        let replace =
            async move |c: &mut SqliteConnection| run_row::replace(c, new, now, OPERATION).await;
        self.write(OPERATION, replace).await
    }

    /// Returns the queued runs, the next one first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn queue(&self) -> StoreResult<Vec<RunRow>> {
        let query =
            sqlx::query("SELECT * FROM runs WHERE state = 'queued' ORDER BY queue_position");
        self.rows("reading the queue", query, RunRow::read).await
    }

    /// Moves a run to a position, from 1; a larger position than the last means the end. Returns the
    /// queue.
    ///
    /// # Errors
    /// `NotQueued` if the run is not in the queue;
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn move_item(&self, run: RunUid, position: u32) -> StoreResult<Vec<RunRow>> {
        const OPERATION: &str = "moving a run in the queue";
        self.write(OPERATION, async move |connection| {
            let mut order = order(connection, OPERATION).await?;
            let text = run.to_string();
            let from = order.iter().position(|uid| *uid == text);
            let moved = order.remove(from.ok_or(StoreError::NotQueued(run))?);
            let to = (position.max(1) as usize - 1).min(order.len());
            order.insert(to, moved);
            number(connection, &order, OPERATION).await
        })
        .await?;
        self.queue().await
    }

    /// Removes a run from the queue permanently. Its row remains, in the state `removed`.
    ///
    /// # Errors
    /// `NotQueued` if the run is not in the queue;
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn remove(&self, run: RunUid) -> StoreResult<RunRow> {
        const OPERATION: &str = "removing a run from the queue";
        let now = self.now_text();
        self.write(OPERATION, async move |connection| {
            let row = sqlx::query(
                "UPDATE runs SET state = 'removed', queue_position = NULL, waiting_since = NULL,
                     ended_at = ?2
                 WHERE uid = ?1 AND state = 'queued' RETURNING *",
            )
            .bind(run.to_string())
            .bind(now)
            .fetch_optional(&mut *connection)
            .await
            .during(OPERATION)?
            .ok_or(StoreError::NotQueued(run))?;
            let order = order(connection, OPERATION).await?;
            number(connection, &order, OPERATION).await?;
            RunRow::read(&Columns::of(&row, OPERATION))
        })
        .await
    }

    /// Marks a queued or interrupted run as started: it waits for the active run to end. The mark
    /// survives a crash. It is removed when the run begins or is removed.
    ///
    /// # Errors
    /// `NotQueued` if the run is neither queued nor interrupted;
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn set_waiting(&self, run: RunUid) -> StoreResult<()> {
        let query = sqlx::query(
            "UPDATE runs SET waiting_since = coalesce(waiting_since, ?2)
             WHERE uid = ?1 AND (state IN ('queued', 'interrupted')
                 OR (state = 'ended' AND exit_status <> 'success' AND kind <> 'imported'))",
        )
        .bind(run.to_string())
        .bind(self.now_text());
        match self.inner.writer.execute("marking a run as waiting for its turn", query).await? {
            0 => Err(StoreError::NotQueued(run)),
            _ => Ok(()),
        }
    }

    /// Removes the mark of a waiting run, which must be started again.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn clear_waiting(&self, run: RunUid) -> StoreResult<()> {
        let query = sqlx::query("UPDATE runs SET waiting_since = NULL WHERE uid = ?1")
            .bind(run.to_string());
        self.inner.writer.execute("removing the mark of a waiting run", query).await.map(drop)
    }

    /// Returns the started runs that wait for their turn, the next one first: interrupted runs, then
    /// queued runs by position.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn waiting_runs(&self) -> StoreResult<Vec<RunRow>> {
        let query = sqlx::query(
            "SELECT * FROM runs
             WHERE waiting_since IS NOT NULL AND state IN ('queued', 'interrupted', 'ended')
             ORDER BY coalesce(queue_position, 0), waiting_since, scan_id",
        );
        self.rows("reading the waiting runs", query, RunRow::read).await
    }
}

/// Returns the ids of the queued runs, the next one first.
async fn order(
    connection: &mut SqliteConnection,
    operation: &'static str,
) -> StoreResult<Vec<String>> {
    sqlx::query_scalar("SELECT uid FROM runs WHERE state = 'queued' ORDER BY queue_position")
        .fetch_all(connection)
        .await
        .during(operation)
}

/// Assigns the positions 1, 2, .. in this order.
async fn number(
    connection: &mut SqliteConnection,
    order: &[String],
    operation: &'static str,
) -> StoreResult<()> {
    for (i, uid) in order.iter().enumerate() {
        sqlx::query("UPDATE runs SET queue_position = ?2 WHERE uid = ?1")
            .bind(uid)
            .bind(i as i64 + 1)
            .execute(&mut *connection)
            .await
            .during(operation)?;
    }
    Ok(())
}
