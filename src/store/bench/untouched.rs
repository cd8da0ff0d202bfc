//! Frames of the untouched skin, and the one that was measured last before a trial.
//! Uses: `record`, `core::{bulk, writer}`, `table::checksum`. Never: a trial's frames.

use std::collections::HashMap;
use std::sync::Arc;

use jiff::Timestamp;
use rusqlite::Connection;

use crate::core::bulk::Statement;
use crate::core::columns::{time_text, volts_blob};
use crate::core::{Store, StoreError, StoreResult};
use crate::ids::{RunUid, TrialId};
use crate::record::Untouched;
use crate::table::checksum;

/// Number of trials that are looked up at once.
const AT_ONCE: usize = 1000;

/// The untouched skin before a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct BeforeTrial {
    /// Its frame; trials of one configuration share it.
    pub skin: Arc<Untouched>,
    /// Wall time at which the trial started.
    pub trial_started_at: Timestamp,
}

impl Store {
    /// Stores a frame of the untouched skin. A repetition after a failure does not store it twice.
    ///
    /// # Errors
    /// `Refused` without a voltage; `NoSuchRun` if the run is not stored; `Sql` or `Closed` if the write
    /// fails.
    pub(crate) async fn insert_untouched(&self, run: RunUid, skin: &Untouched) -> StoreResult<()> {
        const OPERATION: &str = "storing the untouched skin";
        if skin.voltages_v.is_empty() || skin.voltages_v.iter().any(|v| !v.is_finite()) {
            let (field, limit) = ("voltages_v", "must be finite numbers");
            return Err(StoreError::Refused { operation: OPERATION, field, limit });
        }
        let scan_id = self.facts_to_write(run, OPERATION).await?.scan_id;
        let volts = volts_blob(&skin.voltages_v);
        let query = sqlx::query(
            "INSERT INTO untouched_frames
                 (run, at, frame_count, voltages_v, crc32, stream_since, after_trial)
             SELECT ?1, ?2, ?3, ?4, ?5, ?6, (SELECT coalesce(max(id), 0) FROM trials WHERE run = ?1)
             WHERE NOT EXISTS (
               SELECT 1 FROM untouched_frames
               WHERE run = ?1 AND at = ?2 AND frame_count = ?3 AND crc32 = ?5
                 AND after_trial = (SELECT coalesce(max(id), 0) FROM trials WHERE run = ?1))",
        )
        .bind(scan_id)
        .bind(time_text(skin.at))
        .bind(skin.frames as i64)
        .bind(&volts)
        .bind(checksum::of_volts(&volts))
        .bind(skin.stream_since.map(time_text));
        self.inner.writer.patient().execute(OPERATION, query).await.map(drop)
    }

    /// Returns, for each of these trials, the frame of the untouched skin that was measured last in its run
    /// before it; a trial without one is absent. The order of storing decides, not the times: the clock may have
    /// been set back.
    ///
    /// # Errors
    /// `Damaged` if a frame differs from its checksum; `Read` or `Unreadable` if the read fails.
    pub async fn untouched_before(
        &self,
        trials: &[TrialId],
    ) -> StoreResult<HashMap<TrialId, BeforeTrial>> {
        const OPERATION: &str = "reading the untouched skin";
        let trials = trials.to_vec();
        let read = move |connection: &Connection| {
            let mut skins: HashMap<i64, Arc<Untouched>> = HashMap::new();
            let mut before = HashMap::new();
            for trials in trials.chunks(AT_ONCE) {
                for (trial, skin, trial_started_at) in last_before(connection, trials, OPERATION)? {
                    let known = skins.get(&skin).cloned().map_or_else(
                        || frame(connection, skin, OPERATION).map(Arc::new),
                        Ok::<_, StoreError>,
                    )?;
                    skins.insert(skin, known.clone());
                    before.insert(trial, BeforeTrial { skin: known, trial_started_at });
                }
            }
            Ok(before)
        };
        self.inner.bulk.read(OPERATION, read).await
    }

    /// Returns the first `most` frames of the untouched skin of a run, oldest first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Damaged` if a frame differs from its checksum; `Read` or
    /// `Unreadable` if the read fails.
    pub async fn untouched_frames(&self, run: RunUid, most: u32) -> StoreResult<Vec<Untouched>> {
        const OPERATION: &str = "reading the frames of the untouched skin";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let read = move |connection: &Connection| {
            let mut ids = Statement::new("SELECT id FROM untouched_frames WHERE run = ");
            ids.bind(scan_id).push(" ORDER BY after_trial, id LIMIT ").bind(most);
            let ids: Vec<i64> = ids.rows(connection, OPERATION, |c| c.get("id"))?;
            ids.into_iter().map(|id| frame(connection, id, OPERATION)).collect()
        };
        self.inner.bulk.read(OPERATION, read).await
    }
}

/// Trials, each with the row of the untouched skin before it, and the time at which it started.
fn last_before(
    connection: &Connection,
    trials: &[TrialId],
    operation: &'static str,
) -> StoreResult<Vec<(TrialId, i64, Timestamp)>> {
    let wanted: Vec<i64> = trials.iter().map(|id| id.0).collect();
    let mut last = Statement::new(
        "SELECT t.id AS trial, t.started_at AS started_at,
             (SELECT u.id FROM untouched_frames u WHERE u.run = t.run AND u.after_trial < t.id
              ORDER BY u.after_trial DESC, u.id DESC LIMIT 1) AS skin
         FROM json_each(",
    );
    last.bind(format!("{wanted:?}"));
    last.push(") wanted CROSS JOIN trials t ON t.id = wanted.value");
    let all = last.rows(connection, operation, |c| {
        let (trial, skin): (i64, Option<i64>) = (c.get("trial")?, c.get("skin")?);
        // An imported trial may state no time.
        Ok((TrialId(trial), skin, c.time_or_none("started_at")?))
    })?;
    Ok(all.into_iter().filter_map(|(trial, skin, at)| Some((trial, skin?, at?))).collect())
}

/// The frame of a row.
fn frame(connection: &Connection, id: i64, operation: &'static str) -> StoreResult<Untouched> {
    let mut row = Statement::new(
        "SELECT u.voltages_v, u.crc32, u.at, u.frame_count, u.stream_since, r.uid
         FROM untouched_frames u JOIN runs r ON r.scan_id = u.run WHERE u.id = ",
    );
    row.bind(id);
    let of = || format!("the untouched skin {id}");
    let rows = row.rows(connection, operation, |c| {
        Ok(Untouched {
            voltages_v: checksum::volts(c, "voltages_v", "crc32", of)?.unwrap_or_default(),
            at: c.time("at")?,
            frames: c.whole("frame_count")?,
            run: Some(c.word("uid")?),
            stream_since: c.time_or_none("stream_since")?,
        })
    })?;
    rows.into_iter().next().ok_or_else(|| StoreError::damaged(format!("{} is missing", of())))
}
