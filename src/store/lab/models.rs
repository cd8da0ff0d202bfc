//! Models and promotions: rows that describe the model files.
//! Uses: `core::writer`. Never: the files themselves, the meaning of a manifest.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::columns::{Columns, row, time_text};
use crate::core::{Store, StoreResult};
use crate::ids::{DatasetId, ModelId, PromotedId};

/// A stored model. Its files are in a folder that is named by its id.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelRow {
    /// Id: `mdl-` and the first digits of the sha256 of its contents.
    pub id: ModelId,
    /// Name of its recipe, or of its file if it was imported.
    pub name: String,
    /// Task of the net.
    pub task: String,
    /// Text of its manifest, TOML.
    pub manifest: String,
    /// Wall time at which it was stored.
    pub created_at: Timestamp,
}

impl ModelRow {
    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        Ok(row!(c, Self {}, word: id; get: name, task, manifest; time: created_at))
    }
}

/// A change of what a slot serves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PromotionRow {
    /// Name of the slot.
    pub slot: String,
    /// Name of the sensor whose frames it answers; null in promotions from before sensors were stored: the rig's.
    pub sensor: Option<String>,
    /// Id of the promoted model or calibration; null if the slot was emptied.
    #[schema(value_type = Option<String>)]
    pub what: Option<PromotedId>,
    /// Name of the person or key.
    pub who: String,
    /// Reason; null if none was entered.
    pub why: Option<String>,
    /// Time of the promotion.
    pub at: Timestamp,
    /// True if this restored an earlier promotion.
    pub rolled_back: bool,
}

/// A promotion that is to be stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NewPromotion<'a> {
    /// Name of the slot: `transfer`, `map`, `points` or `skin`.
    pub slot: &'a str,
    /// Name of the sensor whose frames it answers.
    pub sensor: &'a str,
    /// What it puts into the slot; if absent, nothing serves in the slot.
    pub what: Option<&'a PromotedId>,
    /// Whether it restores an earlier promotion.
    pub rolled_back: bool,
    /// Person or key that promotes it.
    pub who: &'a str,
    /// Reason that the person entered; absent without one.
    pub why: Option<&'a str>,
}

impl PromotionRow {
    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        Ok(row!(c, Self {},
            get: slot, sensor, who, why, rolled_back; word_or_none: what; time: at))
    }
}

impl Store {
    /// Stores a model whose files exist. A stored model is not changed.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn insert_model(&self, new: ModelRow) -> StoreResult<()> {
        let query = sqlx::query(
            "INSERT INTO models (id, name, task, manifest, created_at)
             VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT (id) DO NOTHING",
        )
        .bind(new.id.as_str())
        .bind(&new.name)
        .bind(&new.task)
        .bind(&new.manifest)
        .bind(time_text(new.created_at));
        self.inner.writer.execute("storing a model", query).await.map(drop)
    }

    /// Returns the model with this id, or else the newest with this name, the one that was stored last; `None` if there
    /// is none.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn model(&self, id_or_name: &str) -> StoreResult<Option<ModelRow>> {
        let query = sqlx::query(
            "SELECT * FROM models WHERE id = ?1 OR name = ?1
             ORDER BY id = ?1 DESC, rowid DESC LIMIT 1",
        )
        .bind(id_or_name);
        self.row("reading a model", query, ModelRow::read).await
    }

    /// Returns all models, newest first: in the order of storing, since the clock may have been set back.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn models(&self) -> StoreResult<Vec<ModelRow>> {
        let query = sqlx::query("SELECT * FROM models ORDER BY rowid DESC");
        self.rows("listing models", query, ModelRow::read).await
    }

    /// Returns the models whose manifests name a dataset, newest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn models_of(&self, dataset: &DatasetId) -> StoreResult<Vec<ModelRow>> {
        let query =
            sqlx::query("SELECT * FROM models WHERE instr(manifest, ?1) > 0 ORDER BY rowid DESC")
                .bind(dataset.as_str());
        self.rows("listing the models of a dataset", query, ModelRow::read).await
    }

    /// Stores a promotion with the current wall time.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn promote(&self, new: NewPromotion<'_>) -> StoreResult<()> {
        let query = sqlx::query(
            "INSERT INTO promotions (slot, sensor, what, who, why, at, rolled_back)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        )
        .bind(new.slot)
        .bind(new.sensor)
        .bind(new.what.map(ToString::to_string))
        .bind(new.who)
        .bind(new.why)
        .bind(self.now_text())
        .bind(new.rolled_back);
        self.inner.writer.execute("storing a promotion", query).await.map(drop)
    }

    /// Returns what is promoted in the slot of a sensor; `None` if the slot is empty, or no promotion states the sensor.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn promoted(&self, slot: &str, sensor: &str) -> StoreResult<Option<PromotedId>> {
        let query = sqlx::query(
            "SELECT * FROM promotions WHERE slot = ?1 AND sensor = ?2 ORDER BY id DESC LIMIT 1",
        )
        .bind(slot)
        .bind(sensor);
        Ok(self
            .row("reading a promotion", query, PromotionRow::read)
            .await?
            .and_then(|row| row.what))
    }

    /// Returns all promotions, newest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn promotions(&self) -> StoreResult<Vec<PromotionRow>> {
        let query = sqlx::query("SELECT * FROM promotions ORDER BY id DESC");
        self.rows("reading promotions", query, PromotionRow::read).await
    }
}
