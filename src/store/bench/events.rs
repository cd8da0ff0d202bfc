//! Events: appended with a number, and read from a number on.
//! Uses: `journal` (`Event`), `core::writer`. Never: the clients that receive them.

use jiff::Timestamp;

use crate::core::columns::{Columns, row, time_text};
use crate::core::writer::Writer;
use crate::core::{Store, StoreError, StoreResult};
use crate::ids::RunUid;
use crate::journal::Event;

/// Appends an event.
const APPEND: &str =
    "INSERT INTO events (run, at, kind, data) VALUES (?1, ?2, ?3, ?4) RETURNING seq";

/// Appends an event, unless it is stored. Also then returns its number.
const APPEND_ONCE: &str = "INSERT INTO events (seq, run, at, kind, data)
    SELECT (SELECT seq FROM events WHERE run IS ?1 AND at = ?2 AND kind = ?3 AND data = ?4),
        ?1, ?2, ?3, ?4
    WHERE true ON CONFLICT (seq) DO UPDATE SET kind = excluded.kind RETURNING seq";

/// The first `?2` events after `?1` of the kinds `?3`, from those of each kind: a rare kind may be far away, and a scan
/// by number would read all events in between.
const OF_KINDS: &str = "SELECT e.*, r.uid FROM events e LEFT JOIN runs r ON r.scan_id = e.run
    WHERE e.seq IN (
        SELECT f.seq FROM (SELECT DISTINCT value AS kind FROM json_each(?3)) k
        CROSS JOIN events f ON f.seq IN (
            SELECT seq FROM events WHERE kind = k.kind AND seq > ?1 ORDER BY seq LIMIT ?2)
        ORDER BY f.seq LIMIT ?2)
    ORDER BY e.seq";

/// The number of the last event but `?1 - 1` of the kinds `?2`, from the newest of each kind.
const NEWEST_OF_KINDS: &str = "SELECT f.seq
    FROM (SELECT DISTINCT value AS kind FROM json_each(?2)) k
    CROSS JOIN events f ON f.seq IN (
        SELECT seq FROM events WHERE kind = k.kind ORDER BY seq DESC LIMIT ?1)
    ORDER BY f.seq DESC LIMIT 1 OFFSET ?1 - 1";

impl Store {
    /// Appends an event with the current wall time, and returns it with its number.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql`, `Late` or `Closed` if the write fails.
    pub async fn append_event(
        &self,
        run: Option<RunUid>,
        kind: &str,
        data: serde_json::Value,
    ) -> StoreResult<Event> {
        let at = self.inner.clock.timestamp();
        self.insert_event(self.inner.writer.clone(), APPEND, run, kind, data, at).await
    }

    /// Appends an event with this wall time, and returns it with its number. A repetition after a failure does not
    /// store it twice.
    pub(crate) async fn append_event_once(
        &self,
        run: Option<RunUid>,
        kind: &str,
        data: serde_json::Value,
        at: Timestamp,
    ) -> StoreResult<Event> {
        self.insert_event(self.inner.writer.patient(), APPEND_ONCE, run, kind, data, at).await
    }

    async fn insert_event(
        &self,
        writer: Writer,
        append: &'static str,
        run: Option<RunUid>,
        kind: &str,
        data: serde_json::Value,
        at: Timestamp,
    ) -> StoreResult<Event> {
        const OPERATION: &str = "storing an event";
        let scan_id = match run {
            Some(run) => Some(self.facts_by(&writer, run, OPERATION).await?.scan_id),
            None => None,
        };
        // Truncated to ms as stored, so that the returned event equals the one that is read later.
        let now = time_text(at);
        let at = now.parse().map_err(|_| StoreError::Unreadable {
            operation: OPERATION,
            column: "at",
            value: now.clone(),
        })?;
        let query = sqlx::query(append).bind(scan_id).bind(now).bind(kind).bind(data.to_string());
        let seq = writer.returned(OPERATION, query, |c| c.get("seq")).await?;
        Ok(Event { seq, run, at, kind: kind.to_owned(), data })
    }

    /// Returns at most `limit` events with numbers above `seq`, in ascending order, of one run or of
    /// all, and of these kinds or, without `kinds`, of all.
    ///
    /// # Errors
    /// `NoSuchRun` if a given run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn events_since(
        &self,
        seq: i64,
        limit: u32,
        run: Option<RunUid>,
        kinds: &[String],
    ) -> StoreResult<Vec<Event>> {
        const OPERATION: &str = "reading events";
        let kinds = (!kinds.is_empty()).then(|| serde_json::json!(kinds).to_string());
        let statement = match run {
            Some(run) => {
                let scan_id = self.facts(run, OPERATION).await?.scan_id;
                sqlx::query(
                    "SELECT e.*, r.uid FROM events e JOIN runs r ON r.scan_id = e.run
                     WHERE e.seq > ?1 AND e.run = ?4
                         AND (?3 IS NULL OR e.kind IN (SELECT value FROM json_each(?3)))
                     ORDER BY e.seq LIMIT ?2",
                )
                .bind(seq)
                .bind(limit)
                .bind(kinds)
                .bind(scan_id)
            }
            None if kinds.is_some() => sqlx::query(OF_KINDS).bind(seq).bind(limit).bind(kinds),
            None => sqlx::query(
                "SELECT e.*, r.uid FROM events e LEFT JOIN runs r ON r.scan_id = e.run
                 WHERE e.seq > ?1 ORDER BY e.seq LIMIT ?2",
            )
            .bind(seq)
            .bind(limit),
        };
        self.rows(OPERATION, statement, event).await
    }

    /// Returns the newest events of these kinds of a run, at most `limit`, in ascending order.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn events_of_kinds(
        &self,
        run: RunUid,
        kinds: &[&str],
        limit: u32,
    ) -> StoreResult<Vec<Event>> {
        const OPERATION: &str = "reading events of some kinds";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query = sqlx::query(
            "SELECT *, ?4 AS uid FROM events
             WHERE run = ?1 AND kind IN (SELECT value FROM json_each(?2)) ORDER BY seq DESC LIMIT ?3",
        )
        .bind(scan_id)
        .bind(serde_json::json!(kinds).to_string())
        .bind(limit)
        .bind(run.to_string());
        let mut events = self.rows(OPERATION, query, event).await?;
        events.reverse();
        Ok(events)
    }

    /// Returns the number after which the `newest` last events of a selection begin, as `events_since` selects them: one
    /// run or all, these kinds or, without `kinds`, all. 0 if there are not that many.
    ///
    /// # Errors
    /// `NoSuchRun` if a given run is not stored; `Sql` if the read fails.
    pub async fn seq_before_newest(
        &self,
        newest: u64,
        run: Option<RunUid>,
        kinds: &[String],
    ) -> StoreResult<i64> {
        const OPERATION: &str = "finding the newest events";
        let kinds = (!kinds.is_empty()).then(|| serde_json::json!(kinds).to_string());
        let newest = i64::try_from(newest.max(1)).unwrap_or(i64::MAX);
        let statement = match run {
            Some(run) => {
                let scan_id = self.facts(run, OPERATION).await?.scan_id;
                sqlx::query(
                    "SELECT seq FROM events
                     WHERE run = ?3 AND (?2 IS NULL OR kind IN (SELECT value FROM json_each(?2)))
                     ORDER BY seq DESC LIMIT 1 OFFSET ?1 - 1",
                )
                .bind(newest)
                .bind(kinds)
                .bind(scan_id)
            }
            None if kinds.is_some() => sqlx::query(NEWEST_OF_KINDS).bind(newest).bind(kinds),
            None => sqlx::query("SELECT seq FROM events ORDER BY seq DESC LIMIT 1 OFFSET ?1 - 1")
                .bind(newest),
        };
        let first = self.row(OPERATION, statement, |c| c.get::<i64>("seq")).await?;
        Ok(first.map_or(0, |seq| seq - 1))
    }

    /// Returns the number of the last event; 0 before the first.
    ///
    /// # Errors
    /// `Sql` if the read fails.
    pub async fn last_event_seq(&self) -> StoreResult<i64> {
        let query = sqlx::query("SELECT coalesce(max(seq), 0) AS seq FROM events");
        self.one("reading the number of the last event", query, |c| c.get("seq")).await
    }
}

/// Reads an event; `uid` is that of its run.
fn event(c: &Columns<'_>) -> StoreResult<Event> {
    Ok(row!(c, Event { run: c.word_or_none("uid")? }, get: seq, kind; time: at; json: data))
}
