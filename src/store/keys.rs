//! Keys of the API: made from random bytes that are handed in, kept only as hashes, revocable.
//! Uses: sha2, `store::writer`. Never: a key's text in a table, a log or a `Debug`.
//!
//! A key is found by its sha256, so that what is compared does not depend on how much of a guess
//! was right; 32 random bytes need no slow hash.

use jiff::{Span, Timestamp};
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;
use utoipa::ToSchema;

use super::columns::{Columns, hex, sha256_hex, time_text};
use super::{Store, StoreError};

/// What a key's text begins with.
const PREFIX: &str = "palpate_";

/// Uses of a key within this time are noted once.
const USE_GRAIN_S: i64 = 60;

/// What the holder of a key may do; each may do what the ones before may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Look, and stop.
    Viewer,
    /// Run and move.
    Operator,
    /// Manage keys, break the lock.
    Admin,
}

impl Role {
    fn as_str(self) -> &'static str {
        match self {
            Role::Viewer => "viewer",
            Role::Operator => "operator",
            Role::Admin => "admin",
        }
    }
}

/// A key without its text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct KeyRow {
    /// Its number.
    pub id: i64,
    /// Whose, or what for.
    pub name: String,
    /// What its holder may do.
    pub role: Role,
    /// When it was made.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// When it was last used, to the minute.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub last_used_at: Option<Timestamp>,
    /// When it was revoked.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub revoked_at: Option<Timestamp>,
}

impl KeyRow {
    fn read(row: &SqliteRow, operation: &'static str) -> Result<Self, StoreError> {
        let c = Columns::of(row, operation);
        Ok(Self {
            id: c.get("id")?,
            name: c.get("name")?,
            role: c.word("role")?,
            created_at: c.time("created_at")?,
            last_used_at: c.time_or_none("last_used_at")?,
            revoked_at: c.time_or_none("revoked_at")?,
        })
    }
}

impl Store {
    /// Makes a key of 32 random bytes. Its text is returned here and never again.
    pub async fn create_key(
        &self,
        name: &str,
        role: Role,
        random: [u8; 32],
    ) -> Result<(KeyRow, String), StoreError> {
        const OPERATION: &str = "creating a key";
        let secret = format!("{PREFIX}{}", hex(&random));
        let (name, hash, now) = (name.to_owned(), sha256_hex(&secret), self.now_text());
        let row = self
            .inner
            .writer
            .run(OPERATION, async move |connection| {
                let row = sqlx::query(
                    "INSERT INTO api_keys (name, sha256, role, created_at)
                     VALUES (?1, ?2, ?3, ?4) RETURNING *",
                )
                .bind(name)
                .bind(hash)
                .bind(role.as_str())
                .bind(now)
                .fetch_one(connection)
                .await
                .map_err(StoreError::sql(OPERATION))?;
                KeyRow::read(&row, OPERATION)
            })
            .await?;
        Ok((row, secret))
    }

    /// The key with this text, unless it is revoked or there is none.
    pub async fn key_by_secret(&self, secret: &str) -> Result<Option<KeyRow>, StoreError> {
        const OPERATION: &str = "looking a key up";
        sqlx::query("SELECT * FROM api_keys WHERE sha256 = ?1 AND revoked_at IS NULL")
            .bind(sha256_hex(secret))
            .fetch_optional(&self.inner.readers)
            .await
            .map_err(StoreError::sql(OPERATION))?
            .map(|row| KeyRow::read(&row, OPERATION))
            .transpose()
    }

    /// Notes that a key was used, at most once a minute, so that reads through the API do not
    /// become writes.
    pub async fn note_key_use(&self, key: &KeyRow) -> Result<(), StoreError> {
        const OPERATION: &str = "noting a key's use";
        let now = self.inner.clock.timestamp();
        let due = now.checked_sub(Span::new().seconds(USE_GRAIN_S)).unwrap_or(now);
        if key.last_used_at.is_some_and(|used| used > due) {
            return Ok(());
        }
        let (id, now, due) = (key.id, time_text(now), time_text(due));
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "UPDATE api_keys SET last_used_at = ?2
                     WHERE id = ?1 AND (last_used_at IS NULL OR last_used_at <= ?3)",
                )
                .bind(id)
                .bind(now)
                .bind(due)
                .execute(connection)
                .await
                .map_err(StoreError::sql(OPERATION))?;
                Ok(())
            })
            .await
    }

    /// Revokes a key. False when there is none of this number, or it was revoked before.
    pub async fn revoke_key(&self, id: i64) -> Result<bool, StoreError> {
        const OPERATION: &str = "revoking a key";
        let now = self.now_text();
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                let done = sqlx::query(
                    "UPDATE api_keys SET revoked_at = ?2 WHERE id = ?1 AND revoked_at IS NULL",
                )
                .bind(id)
                .bind(now)
                .execute(connection)
                .await
                .map_err(StoreError::sql(OPERATION))?;
                Ok(done.rows_affected() > 0)
            })
            .await
    }

    /// All keys, also revoked ones, oldest first.
    pub async fn keys(&self) -> Result<Vec<KeyRow>, StoreError> {
        const OPERATION: &str = "listing keys";
        let rows = sqlx::query("SELECT * FROM api_keys ORDER BY id")
            .fetch_all(&self.inner.readers)
            .await
            .map_err(StoreError::sql(OPERATION))?;
        rows.iter().map(|row| KeyRow::read(row, OPERATION)).collect()
    }
}
