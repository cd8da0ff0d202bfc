//! Runs: storing, listing and reading them.
//! Uses: `core`, `table` (conditions), `run_row`. Never: a change of a state (`run_state`).

use std::sync::atomic::Ordering;

use jiff::Timestamp;
use rusqlite::Connection;
use sqlx::sqlite::SqliteConnection;

use super::run_row::{self, NewRun, RunPage, RunRow};
use crate::core::bulk::Statement;
use crate::core::columns::time_text;
use crate::core::facts::{Label, RunFacts, RunKind};
use crate::core::{Store, StoreResult};
use crate::ids::RunUid;
use crate::state::StoredState;
use crate::table::condition::Condition;

impl Store {
    /// From now on, runs that an earlier process left open are read as interrupted: nothing drives them. They stay as
    /// they are stored, so that the next process finds what it would have found without this one, unless a person stops
    /// something meanwhile ([`Store::interrupt_open_runs`]): then it must drive none of them.
    pub fn leave_open_runs(&self) {
        self.inner.leaves_open.store(true, Ordering::SeqCst);
    }

    /// Whether runs that an earlier process left open stay as they are stored ([`Store::leave_open_runs`]).
    fn leaves_open_runs(&self) -> bool {
        self.inner.leaves_open.load(Ordering::SeqCst)
    }

    /// A run as it is read.
    fn as_read(&self, run: RunRow) -> RunRow {
        if self.leaves_open_runs() { run.interrupted() } else { run }
    }

    /// Stores a new run in the state `idle`. Returns its row, which holds its number.
    ///
    /// # Errors
    /// `Refused` if the seed or the number of trials is too large or the deadband is not finite;
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn create_run(&self, new: NewRun) -> StoreResult<RunRow> {
        const OPERATION: &str = "creating a run";
        let now = self.now_text();
        let insert = async move |c: &mut SqliteConnection| {
            run_row::insert(c, new, StoredState::Idle, now, OPERATION).await
        };
        let row = self.write(OPERATION, insert).await?;
        let (scan_id, kind, deadband_n) = (row.scan_id, row.kind, row.deadband_n);
        self.keep(row.uid, RunFacts { scan_id, kind, deadband_n });
        Ok(row)
    }

    /// Returns a run by its id; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn run(&self, run: RunUid) -> StoreResult<Option<RunRow>> {
        let query = sqlx::query("SELECT * FROM runs WHERE uid = ?1").bind(run.to_string());
        Ok(self.row("reading a run", query, RunRow::read).await?.map(|run| self.as_read(run)))
    }

    /// Returns a run by its number; `None` if it is not stored.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn run_by_scan_id(&self, scan_id: i64) -> StoreResult<Option<RunRow>> {
        let query = sqlx::query("SELECT * FROM runs WHERE scan_id = ?1").bind(scan_id);
        Ok(self.row("reading a run", query, RunRow::read).await?.map(|run| self.as_read(run)))
    }

    /// Returns at most `limit` runs that meet all conditions, newest first, with numbers below `before`.
    ///
    /// # Errors
    /// `Read` or `Unreadable` if the read fails.
    pub async fn runs(
        &self,
        conditions: &[Condition],
        limit: u32,
        before: Option<i64>,
    ) -> StoreResult<RunPage> {
        const OPERATION: &str = "listing runs";
        // A condition compares the state as it is read.
        let mut query = Statement::new("SELECT r.* FROM (SELECT *, iif(");
        query.bind(self.leaves_open_runs()).push(
            " AND state NOT IN ('queued', 'interrupted', 'ended', 'removed'), 'interrupted', state)
              AS state_read FROM runs) r WHERE r.scan_id < ",
        );
        query.bind(before.unwrap_or(i64::MAX));
        conditions.iter().for_each(|condition| condition.push_onto(&mut query));
        query.push(" ORDER BY r.scan_id DESC LIMIT ").bind(i64::from(limit) + 1);
        let read = move |c: &Connection| query.rows(c, OPERATION, RunRow::read);
        let runs = self.inner.bulk.read(OPERATION, read).await?;
        let mut runs: Vec<RunRow> = runs.into_iter().map(|run| self.as_read(run)).collect();
        let more = runs.len() > limit as usize;
        runs.truncate(limit as usize);
        let next = if more { runs.last().map(|r| r.scan_id) } else { None };
        Ok(RunPage { runs, next })
    }

    /// Returns the `limit` runs that ended last by their times, and the `limit` newest ones of those that have ended, whose
    /// times are earlier if the clock was set back. The last one to end comes first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn ended_runs(&self, limit: u32) -> StoreResult<Vec<RunRow>> {
        let query = sqlx::query(
            "SELECT * FROM runs WHERE scan_id IN (
                 SELECT * FROM (SELECT scan_id FROM runs WHERE state = 'ended'
                     ORDER BY ended_at DESC, scan_id DESC LIMIT ?1)
                 UNION SELECT * FROM (SELECT scan_id FROM runs WHERE state = 'ended'
                     ORDER BY scan_id DESC LIMIT ?1))
             ORDER BY ended_at DESC, scan_id DESC",
        )
        .bind(i64::from(limit));
        self.rows("reading ended runs", query, RunRow::read).await
    }

    /// Returns the newest run that began before a time and pressed a skin, by the digest of its sensor file;
    /// `None` if no such run has a stored force.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn pressed_before(
        &self,
        sensor_sha256: &str,
        label: Label,
        before: Timestamp,
    ) -> StoreResult<Option<RunRow>> {
        let query = sqlx::query(
            "SELECT * FROM runs WHERE kind = ?1 AND sensor_sha256 = ?2 AND label = ?3 AND started_at < ?4
                 AND EXISTS (SELECT 1 FROM trials WHERE run = scan_id AND max_force_n IS NOT NULL)
             ORDER BY started_at DESC LIMIT 1",
        )
        .bind(RunKind::RealHex.as_str())
        .bind(sensor_sha256.to_owned())
        .bind(label.as_str())
        .bind(time_text(before));
        let run = self.row("looking for an earlier run", query, RunRow::read).await?;
        Ok(run.map(|run| self.as_read(run)))
    }

    /// Returns all runs except the removed ones, oldest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn all_runs(&self) -> StoreResult<Vec<RunRow>> {
        let query = sqlx::query("SELECT * FROM runs WHERE state <> 'removed' ORDER BY scan_id");
        let runs = self.rows("reading all runs", query, RunRow::read).await?;
        Ok(runs.into_iter().map(|run| self.as_read(run)).collect())
    }

    /// Returns the runs in a state of the engine, oldest first. Before an engine starts, these are the
    /// runs that an earlier process did not end; none after [`Store::leave_open_runs`].
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn open_runs(&self) -> StoreResult<Vec<RunRow>> {
        if self.leaves_open_runs() {
            return Ok(Vec::new());
        }
        let query = sqlx::query(
            "SELECT * FROM runs WHERE state NOT IN ('queued', 'interrupted', 'ended', 'removed')
             ORDER BY scan_id",
        );
        self.rows("reading open runs", query, RunRow::read).await
    }
}
