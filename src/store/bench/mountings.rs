//! The number of mounted tips, as confirmed by the person who mounts them.
//! Uses: `core::writer`. Never: a check of this number (the campaign checks it by measurements).

use jiff::Timestamp;

use crate::core::columns::{Columns, row, time_text};
use crate::core::{Store, StoreResult};
use crate::journal::Mounting;

impl Store {
    /// Stores the confirmed number of tips. A repetition after a failure does not store it twice.
    pub(crate) async fn insert_mounting(
        &self,
        mounting: &Mounting,
        at: Timestamp,
    ) -> StoreResult<()> {
        let query = sqlx::query(
            "INSERT INTO mountings (tips, live_cells, who, at)
             SELECT ?1, ?2, ?3, ?4 WHERE NOT EXISTS (
               SELECT 1 FROM mountings
               WHERE id = (SELECT max(id) FROM mountings) AND tips = ?1 AND live_cells = ?2
                 AND who = ?3 AND at = ?4)",
        )
        .bind(mounting.tips)
        .bind(mounting.live_cells)
        .bind(&mounting.who)
        .bind(time_text(at));
        let writer = self.inner.writer.patient();
        writer.execute("storing the number of mounted tips", query).await.map(drop)
    }

    /// Returns the last confirmed number of tips; `None` before the first, and after a manual run, during which
    /// tips may be removed.
    pub(crate) async fn read_last_mounted(&self) -> StoreResult<Option<Mounting>> {
        // The order of the events holds although the clock was set back.
        let query = sqlx::query(
            "SELECT * FROM (SELECT * FROM mountings ORDER BY id DESC LIMIT 1) AS last
             WHERE NOT EXISTS (
                 SELECT 1 FROM runs WHERE kind = 'real-random'
                     AND (started_at > last.at OR ended_at > last.at
                         OR (started_at IS NOT NULL AND state NOT IN ('ended', 'removed'))))
                 AND NOT EXISTS (
                     SELECT 1 FROM events e JOIN runs r ON r.scan_id = e.run
                     WHERE e.kind = 'state' AND r.kind = 'real-random'
                         AND e.seq > (SELECT max(seq) FROM events WHERE kind = 'tips'))",
        );
        let read = |c: &Columns<'_>| Ok(row!(c, Mounting {}, whole: tips, live_cells; get: who));
        self.row("reading the number of mounted tips", query, read).await
    }
}
