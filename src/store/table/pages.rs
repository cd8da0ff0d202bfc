//! Reads of trials: single trials, pages that follow an index, voltages and raw frames.
//! Uses: `query`, `assemble`, `checksum`. Never: a write, a value that differs from its checksum.

use rusqlite::Connection;

use super::assemble::rows_of_ids;
use super::checksum;
use super::query::{Order, SELECT, SELECT_WITH_VOLTAGES, TrialQuery};
use super::trial_row::TrialRow;
use crate::core::bulk::Statement;
use crate::core::columns::Columns;
use crate::core::{Store, StoreResult};
use crate::ids::{RunUid, TrialId};
use crate::record::FrameRecord;

const READING: &str = "reading trials";

/// The imports that are in progress, or whose trials are not removed yet (`lab/imports.rs`).
const INCOMPLETE_IMPORTS: &str =
    "SELECT scan_id FROM runs r WHERE kind = 'imported' AND state = 'removed'
     AND EXISTS (SELECT 1 FROM trials t WHERE t.run = r.scan_id)";

/// The lengths of the frames of some trials, whose ids follow.
const LENGTHS_OF: &str = "SELECT DISTINCT length(v.voltages_v) / 4 AS channels
     FROM trial_voltages v WHERE v.trial IN (";

impl Store {
    /// Returns a page of trials, in the order of the query; those of incomplete imports are not among all runs. Set
    /// `after` to its last id for the next page.
    ///
    /// # Errors
    /// `NoSuchRun` if the run of the query is not stored; `Damaged` if a trial differs from its
    /// checksum; `Read` or `Unreadable` if the read fails.
    pub async fn trials(&self, query: &TrialQuery) -> StoreResult<Vec<TrialRow>> {
        let select = if query.with_voltages { SELECT_WITH_VOLTAGES } else { SELECT };
        let (scan_id, query) = (self.scan_id_of(query).await?, query.clone());
        let read = move |c: &Connection| {
            let ids = ids_of(&query, scan_id, c)?;
            let mut trials = rows_of_ids(c, select, &ids, READING)?;
            if query.order == Order::NewestFirst {
                trials.reverse();
            }
            Ok(trials)
        };
        self.inner.bulk.read(READING, read).await
    }

    /// Returns the ids of a page of trials, as [`Store::trials`] selects them, for a caller that reads the trials in
    /// smaller pieces.
    ///
    /// # Errors
    /// `NoSuchRun` if the run of the query is not stored; `Read` if the read fails.
    pub async fn trial_ids(&self, query: &TrialQuery) -> StoreResult<Vec<TrialId>> {
        let (scan_id, query) = (self.scan_id_of(query).await?, query.clone());
        self.inner.bulk.read(READING, move |c| ids_of(&query, scan_id, c)).await
    }

    async fn scan_id_of(&self, query: &TrialQuery) -> StoreResult<Option<i64>> {
        match query.run {
            Some(run) => Ok(Some(self.facts(run, READING).await?.scan_id)),
            None => Ok(None),
        }
    }

    /// Returns a trial with its voltages; `None` if it is not stored.
    ///
    /// # Errors
    /// `Damaged` if it differs from its checksum; `Read` or `Unreadable` if the read fails.
    pub async fn trial_by_id(&self, trial: TrialId) -> StoreResult<Option<TrialRow>> {
        Ok(self.trials_with_voltages(&[trial]).await?.pop())
    }

    /// Returns these trials with their voltages, in ascending order of the ids. Missing trials are
    /// omitted.
    ///
    /// # Errors
    /// `Damaged` if a trial differs from its checksum; `Read` or `Unreadable` if the read fails.
    pub async fn trials_with_voltages(&self, ids: &[TrialId]) -> StoreResult<Vec<TrialRow>> {
        self.trials_by(SELECT_WITH_VOLTAGES, ids).await
    }

    /// Returns these trials without their voltages, in ascending order of the ids. Missing trials are
    /// omitted.
    ///
    /// # Errors
    /// `Damaged` if a trial differs from its checksum; `Read` or `Unreadable` if the read fails.
    pub async fn trials_of(&self, ids: &[TrialId]) -> StoreResult<Vec<TrialRow>> {
        self.trials_by(SELECT, ids).await
    }

    async fn trials_by(&self, select: &'static str, ids: &[TrialId]) -> StoreResult<Vec<TrialRow>> {
        let ids = ids.to_vec();
        self.inner.bulk.read(READING, move |c| rows_of_ids(c, select, &ids, READING)).await
    }

    /// Returns the ids of up to `limit` trials of a run in the order of storing, from the first one after
    /// `after`, each with the number of the model of its newest twin; 0 without a twin.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Read` if the read fails.
    pub async fn newest_twins(
        &self,
        run: RunUid,
        after: TrialId,
        limit: u32,
    ) -> StoreResult<Vec<(TrialId, i64)>> {
        let scan_id = self.facts(run, READING).await?.scan_id;
        let read = move |c: &Connection| {
            let mut newest = Statement::new(
                "SELECT t.id AS id, coalesce((SELECT max(model) FROM twins w WHERE w.trial = t.id), 0) AS model
                 FROM trials t INDEXED BY trials_in_order WHERE t.run = ",
            );
            newest.bind(scan_id).push(" AND t.id > ").bind(after.0);
            newest.push(" ORDER BY t.id LIMIT ").bind(i64::from(limit));
            newest.rows(c, READING, |c| Ok((TrialId(c.get("id")?), c.get("model")?)))
        };
        self.inner.bulk.read(READING, read).await
    }

    /// Returns the distinct numbers of channels of the frames of these trials, in ascending order. All
    /// frames of a run have the same.
    ///
    /// # Errors
    /// `Read` if the read fails.
    pub async fn frame_lengths(&self, ids: &[TrialId]) -> StoreResult<Vec<u32>> {
        let (Some(&first), Some(&last)) = (ids.iter().min(), ids.iter().max()) else {
            return Ok(Vec::new());
        };
        let ids: Vec<i64> = ids.iter().map(|id| id.0).collect();
        let read = move |c: &Connection| {
            // Runs are few: mostly those from the first to the last trial have one length.
            let mut between = Statement::new(LENGTHS_OF);
            between.push("SELECT (SELECT t.id FROM trials t WHERE t.run = r.scan_id AND t.id >= ");
            between
                .bind(first.0)
                .push(" ORDER BY t.id LIMIT 1) AS id FROM runs r) AND v.trial <= ");
            between.bind(last.0).push(" ORDER BY 1");
            let lengths = between.rows(c, READING, |c| c.whole("channels"))?;
            if lengths.len() <= 1 {
                return Ok(lengths);
            }
            let mut exact = Statement::new(LENGTHS_OF);
            exact.push(
                "SELECT min(t.id) AS id FROM trials t
                 WHERE t.id IN (SELECT value FROM json_each(",
            );
            exact.bind(format!("{ids:?}")).push(")) GROUP BY t.run) ORDER BY 1");
            exact.rows(c, READING, |c| c.whole("channels"))
        };
        self.inner.bulk.read(READING, read).await
    }

    /// Returns the mean of the frames of a trial, V, injection-major; `None` if it is not stored.
    ///
    /// # Errors
    /// `Damaged` if it differs from its checksum; `Sql` or `Unreadable` if the read fails.
    pub async fn trial_voltages(&self, trial: TrialId) -> StoreResult<Option<Vec<f32>>> {
        let query = sqlx::query("SELECT voltages_v, crc32 FROM trial_voltages WHERE trial = ?1")
            .bind(trial.0);
        let of = || format!("trial {}", trial.0);
        let read = |c: &Columns<'_>| checksum::volts(c, "voltages_v", "crc32", of);
        Ok(self.row("reading a trial's voltages", query, read).await?.flatten())
    }

    /// Returns the raw frames of a trial, in the order of measurement; empty if the trial is not stored.
    ///
    /// # Errors
    /// `Damaged` if a frame differs from its checksum; `Sql` or `Unreadable` if the read fails.
    pub async fn frames(&self, trial: TrialId) -> StoreResult<Vec<FrameRecord>> {
        let query = sqlx::query("SELECT * FROM frames WHERE trial = ?1 ORDER BY n").bind(trial.0);
        let of = || format!("trial {}", trial.0);
        self.rows("reading a trial's frames", query, |c| checksum::frame(c, of)).await
    }

    /// Returns the query plan of SQLite for the ids of a page, one line per step.
    #[cfg(test)]
    pub(crate) async fn explain(&self, query: &TrialQuery) -> StoreResult<Vec<String>> {
        let ids = query.ids(self.scan_id_of(query).await?, &[]);
        self.inner.bulk.read(READING, move |c| ids.explain(c)).await
    }
}

/// The ids of a page; `scan_id` is the number of its run.
fn ids_of(
    query: &TrialQuery,
    scan_id: Option<i64>,
    connection: &Connection,
) -> StoreResult<Vec<TrialId>> {
    let incomplete = match scan_id {
        Some(_) => Vec::new(),
        None => Statement::new(INCOMPLETE_IMPORTS)
            .rows(connection, READING, |c| c.get::<i64>("scan_id"))?,
    };
    query.ids(scan_id, &incomplete).rows(connection, READING, id)
}

/// The id of a row of [`TrialQuery::ids`].
pub(crate) fn id(c: &Columns<'_>) -> StoreResult<TrialId> {
    c.get("id").map(TrialId)
}
