//! Auxiliary measurements of a run: tares, reference presses and touch-offs.
//! Uses: `record`, `core::writer`, `table::checksum`, the inserts of `trials`. Never: a trial.

use super::trials::{insert_many, insert_tips};
use crate::core::columns::{Columns, counts_blob, row, time_text};
use crate::core::{During, Store, StoreError, StoreResult};
use crate::ids::RunUid;
use crate::record::{Pose, ReferenceRecord, TareRecord, TouchOffRecord};
use crate::table::assemble::arm;
use crate::table::checksum;

impl Store {
    /// Stores a tare. A repetition after a failure does not store it twice.
    pub(crate) async fn insert_tare(&self, run: RunUid, tare: &TareRecord) -> StoreResult<()> {
        const OPERATION: &str = "storing a tare";
        let scan_id = self.facts_to_write(run, OPERATION).await?.scan_id;
        let tare = tare.clone();
        self.inner
            .writer
            .patient()
            .run(OPERATION, async move |connection| {
                let id: Option<i64> = sqlx::query_scalar(
                    "INSERT INTO tares (run, configuration, samples, at)
                     SELECT ?1, ?2, ?3, ?4 WHERE NOT EXISTS (
                       SELECT 1 FROM tares
                       WHERE id > (SELECT max(id) - 1000 FROM tares) AND run = ?1
                         AND configuration = ?2 AND samples = ?3 AND at = ?4)
                     RETURNING id",
                )
                .bind(scan_id)
                .bind(tare.configuration)
                .bind(tare.samples)
                .bind(time_text(tare.at))
                .fetch_optional(&mut *connection)
                .await
                .during(OPERATION)?;
                let Some(id) = id else { return Ok(()) };
                let into = "INSERT INTO tare_arms (tare, arm, cell_v) ";
                insert_many(connection, into, &tare.volts, OPERATION, |mut row, _, (arm, volts)| {
                    row.push_bind(id).push_bind(*arm).push_bind(*volts);
                })
                .await
            })
            .await
    }

    /// Stores a reference press with its frame and tips. A repetition after a failure does not store it twice.
    pub(crate) async fn insert_reference(
        &self,
        run: RunUid,
        press: &ReferenceRecord,
    ) -> StoreResult<()> {
        const OPERATION: &str = "storing a reference press";
        let scan_id = self.facts_to_write(run, OPERATION).await?.scan_id;
        let press = press.clone();
        self.inner
            .writer
            .patient()
            .run(OPERATION, async move |connection| {
                let id: Option<i64> = sqlx::query_scalar(
                    "INSERT INTO reference_presses (run, before_configuration, reached_x_mm,
                         reached_y_mm, reached_z_mm, reached_radius_mm, depth_mm, sequence,
                         device_time_us, volts_per_count, counts, at, crc32)
                     SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13
                     WHERE NOT EXISTS (
                       SELECT 1 FROM reference_presses
                       WHERE id > (SELECT max(id) - 1000 FROM reference_presses) AND run = ?1
                         AND before_configuration = ?2 AND at = ?12 AND crc32 = ?13)
                     RETURNING id",
                )
                .bind(scan_id)
                .bind(press.before_configuration)
                .bind(press.reached.x_mm)
                .bind(press.reached.y_mm)
                .bind(press.reached.z_mm)
                .bind(press.reached.radius_mm)
                .bind(press.depth_mm)
                .bind(press.frame.sequence)
                .bind(press.frame.device_time_us.cast_signed())
                .bind(press.frame.volts_per_count)
                .bind(counts_blob(&press.frame.counts))
                .bind(time_text(press.at))
                .bind(checksum::of_frame(&press.frame))
                .fetch_optional(&mut *connection)
                .await
                .during(OPERATION)?;
                let Some(id) = id else { return Ok(()) };
                let into = "INSERT INTO reference_tips
                     (press, arm, x_mm, y_mm, force_n, cell_v, tare_v) ";
                insert_tips(connection, into, id, &press.arms, OPERATION).await
            })
            .await
    }

    /// Stores a touch-off. A repetition after a failure does not store it twice.
    ///
    /// # Errors
    /// `Refused` if JSON cannot represent its numbers; `NoSuchRun` if the run is not stored; `Sql` or
    /// `Closed` if the write fails.
    pub(crate) async fn insert_touch_off(
        &self,
        run: RunUid,
        found: &TouchOffRecord,
    ) -> StoreResult<()> {
        const OPERATION: &str = "storing a touch-off";
        let scan_id = self.facts_to_write(run, OPERATION).await?.scan_id;
        let json = |value: serde_json::Result<String>| {
            let limit = "must be numbers that JSON can represent";
            let field = "touches";
            value.map_err(|_| StoreError::Refused { operation: OPERATION, field, limit })
        };
        let offsets = json(serde_json::to_string(&found.tip_offset_mm))?;
        let touches = json(serde_json::to_string(&found.touches))?;
        let query = sqlx::query(
            "INSERT INTO touch_offs
                 (run, tips, surface_z_mm, tip_offsets_mm, touches_mm, at)
             SELECT ?1, ?2, ?3, ?4, ?5, ?6 WHERE NOT EXISTS (
               SELECT 1 FROM touch_offs
               WHERE id > (SELECT max(id) - 1000 FROM touch_offs) AND run = ?1 AND tips = ?2
                 AND surface_z_mm = ?3 AND tip_offsets_mm = ?4 AND touches_mm = ?5 AND at = ?6)",
        )
        .bind(scan_id)
        .bind(found.tips)
        .bind(found.surface_z_mm)
        .bind(offsets)
        .bind(touches)
        .bind(time_text(found.at));
        self.inner.writer.patient().execute(OPERATION, query).await.map(drop)
    }

    /// Returns the tares of a run, oldest first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn tares(&self, run: RunUid) -> StoreResult<Vec<TareRecord>> {
        const OPERATION: &str = "reading tares";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let rows = sqlx::query(
            "SELECT t.id, t.configuration, t.samples, t.at, a.arm, a.cell_v
             FROM tares t LEFT JOIN tare_arms a ON a.tare = t.id
             WHERE t.run = ?1 ORDER BY t.id, a.arm",
        )
        .bind(scan_id)
        .fetch_all(&self.inner.readers)
        .await
        .during(OPERATION)?;
        let mut tares: Vec<(i64, TareRecord)> = Vec::new();
        for row in &rows {
            let c = Columns::of(row, OPERATION);
            let id = c.get("id")?;
            if tares.last().is_none_or(|(last, _)| *last != id) {
                let (configuration, samples) = (c.whole("configuration")?, c.whole("samples")?);
                let volts = Vec::new();
                tares.push((id, TareRecord { configuration, volts, samples, at: c.time("at")? }));
            }
            if let (Some((_, tare)), Some(arm)) = (tares.last_mut(), c.whole_or_none("arm")?) {
                tare.volts.push((arm, c.get("cell_v")?));
            }
        }
        Ok(tares.into_iter().map(|(_, tare)| tare).collect())
    }

    /// Returns the reference presses of a run, oldest first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Damaged` if a frame differs from its checksum;
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn references(&self, run: RunUid) -> StoreResult<Vec<ReferenceRecord>> {
        const OPERATION: &str = "reading reference presses";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let mut view = self.read(OPERATION).await?;
        let rows = sqlx::query("SELECT * FROM reference_presses WHERE run = ?1 ORDER BY id")
            .bind(scan_id)
            .fetch_all(&mut *view)
            .await
            .during(OPERATION)?;
        let tips = sqlx::query(
            "SELECT t.* FROM reference_presses p JOIN reference_tips t ON t.press = p.id
             WHERE p.run = ?1 ORDER BY p.id, t.arm",
        )
        .bind(scan_id)
        .fetch_all(&mut *view)
        .await
        .during(OPERATION)?;
        let mut arms: std::collections::HashMap<i64, Vec<_>> = std::collections::HashMap::new();
        for row in &tips {
            let c = Columns::of(row, OPERATION);
            arms.entry(c.get("press")?).or_default().push(arm(&c)?);
        }
        rows.iter()
            .map(|row| {
                let c = Columns::of(row, OPERATION);
                let id: i64 = c.get("id")?;
                Ok(ReferenceRecord {
                    before_configuration: c.whole("before_configuration")?,
                    reached: Pose {
                        x_mm: c.get("reached_x_mm")?,
                        y_mm: c.get("reached_y_mm")?,
                        z_mm: c.get("reached_z_mm")?,
                        radius_mm: c.get("reached_radius_mm")?,
                    },
                    depth_mm: c.get("depth_mm")?,
                    arms: arms.remove(&id).unwrap_or_default(),
                    frame: checksum::frame(&c, || format!("reference press {id}"))?,
                    at: c.time("at")?,
                })
            })
            .collect()
    }

    /// Returns the touch-offs of a run, oldest first.
    ///
    /// # Errors
    /// `NoSuchRun` if the run is not stored; `Sql` or `Unreadable` if the read fails.
    pub async fn touch_offs(&self, run: RunUid) -> StoreResult<Vec<TouchOffRecord>> {
        const OPERATION: &str = "reading touch-offs";
        let scan_id = self.facts(run, OPERATION).await?.scan_id;
        let query =
            sqlx::query("SELECT * FROM touch_offs WHERE run = ?1 ORDER BY id").bind(scan_id);
        let read = |c: &Columns<'_>| {
            let (tip_offset_mm, touches) = (c.json("tip_offsets_mm")?, c.json("touches_mm")?);
            Ok(row!(c, TouchOffRecord { tip_offset_mm, touches },
                whole: tips; get: surface_z_mm; time: at))
        };
        self.rows(OPERATION, query, read).await
    }
}
