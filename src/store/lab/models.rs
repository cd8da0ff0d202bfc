//! Models and what serves: rows beside the models' own files.
//! Uses: `store::writer`. Never: the files, what a manifest means.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;

use crate::core::columns::{Columns, time_text};
use crate::core::{During, Store, StoreError};

/// A model; its files are in a folder of its id's name.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelRow {
    /// `mdl-` and the start of a sha256 over its contents.
    pub id: String,
    /// Its recipe's name, or its file's.
    pub name: String,
    /// What it does.
    pub task: String,
    /// Its manifest, TOML.
    pub manifest: String,
    /// When it came.
    pub created_at: Timestamp,
}

impl ModelRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        Ok(Self {
            id: c.get("id")?,
            name: c.get("name")?,
            task: c.get("task")?,
            manifest: c.get("manifest")?,
            created_at: c.time("created_at")?,
        })
    }
}

/// What serves in a slot from when on.
#[derive(Debug, Clone, PartialEq)]
pub struct PromotionRow {
    /// `transfer`, `map`, `points` or `skin`.
    pub slot: String,
    /// A model's or a calibration's id; nothing serves without.
    pub what: Option<String>,
    /// Who promoted it.
    pub who: String,
    /// Why, in their words.
    pub why: Option<String>,
    /// When.
    pub at: Timestamp,
    /// Whether it had served before and was gone back to.
    pub rolled_back: bool,
}

impl PromotionRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        Ok(Self {
            slot: c.get("slot")?,
            what: c.get("what")?,
            who: c.get("who")?,
            why: c.get("why")?,
            at: c.time("at")?,
            rolled_back: c.get("rolled_back")?,
        })
    }
}

impl Store {
    /// Stores a model, whose files are there. One that is stored already stays as it is.
    pub async fn insert_model(&self, new: ModelRow) -> Result<(), StoreError> {
        const OPERATION: &str = "storing a model";
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "INSERT INTO models (id, name, task, manifest, created_at)
                     VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT (id) DO NOTHING",
                )
                .bind(&new.id)
                .bind(&new.name)
                .bind(&new.task)
                .bind(&new.manifest)
                .bind(time_text(new.created_at))
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    /// The model of this id, or else the newest of this name.
    pub async fn model(&self, id_or_name: &str) -> Result<Option<ModelRow>, StoreError> {
        const OPERATION: &str = "reading a model";
        sqlx::query(
            "SELECT * FROM models WHERE id = ?1 OR name = ?1
             ORDER BY id = ?1 DESC, created_at DESC, rowid DESC LIMIT 1",
        )
        .bind(id_or_name)
        .fetch_optional(&self.inner.readers)
        .await
        .during(OPERATION)?
        .map(|row| ModelRow::read(&row, OPERATION))
        .transpose()
    }

    /// All models, newest first.
    pub async fn models(&self) -> Result<Vec<ModelRow>, StoreError> {
        const OPERATION: &str = "listing models";
        let rows = sqlx::query("SELECT * FROM models ORDER BY created_at DESC, rowid DESC")
            .fetch_all(&self.inner.readers)
            .await
            .during(OPERATION)?;
        rows.iter().map(|row| ModelRow::read(row, OPERATION)).collect()
    }

    /// From now on this serves in a slot, promoted or gone back to.
    pub async fn promote(
        &self,
        slot: &str,
        (what, rolled_back): (Option<&str>, bool),
        who: &str,
        why: Option<&str>,
    ) -> Result<(), StoreError> {
        const OPERATION: &str = "promoting";
        let (slot, what) = (slot.to_owned(), what.map(str::to_owned));
        let (who, why, now) = (who.to_owned(), why.map(str::to_owned), self.now_text());
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "INSERT INTO promotions (slot, what, who, why, at, rolled_back)
                     VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                )
                .bind(slot)
                .bind(what)
                .bind(who)
                .bind(why)
                .bind(now)
                .bind(rolled_back)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    /// All promotions, newest first.
    pub async fn promotions(&self) -> Result<Vec<PromotionRow>, StoreError> {
        const OPERATION: &str = "reading promotions";
        let rows = sqlx::query("SELECT * FROM promotions ORDER BY id DESC")
            .fetch_all(&self.inner.readers)
            .await
            .during(OPERATION)?;
        rows.iter().map(|row| PromotionRow::read(row, OPERATION)).collect()
    }
}
