//! Keys of the API: made from random bytes that are handed in, kept only as hashes, revocable.
//! Uses: sha2, `store::writer`. Never: a key's text in a table, a log or a `Debug`; a wait of who
//! asks for the store.
//!
//! A key is found by its sha256, so that what is compared does not depend on how much of a guess
//! was right; 32 random bytes need no slow hash.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use jiff::Timestamp;
use parking_lot::{RwLock, RwLockReadGuard, RwLockWriteGuard};
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;
use utoipa::ToSchema;

use super::columns::{Columns, sha256_hex, time_text};
use super::{During, Store, StoreError};

/// What a key's text begins with.
const PREFIX: &str = "palpate_";

/// Uses of a key within this time are noted once.
const USE_GRAIN_S: i64 = 60;

/// Longest name of a key.
const NAME_MAX_CHARS: usize = 100;

/// Who asks without a key and gives no name.
pub const KEYLESS: &str = "local";

/// What follows the name of somebody who asks without a key; no key's name ends in it.
pub const KEYLESS_SUFFIX: &str = " (local)";

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

/// A valid key as it is known in memory. Clones share the time of its last noted use.
#[derive(Debug, Clone)]
pub struct Key {
    /// Its number.
    pub id: i64,
    /// Whose, or what for.
    pub name: String,
    /// What its holder may do.
    pub role: Role,
    noted_s: Arc<AtomicI64>,
}

impl Key {
    fn of(row: &KeyRow) -> Self {
        let noted_s = row.last_used_at.map_or(i64::MIN, Timestamp::as_second);
        let noted_s = Arc::new(AtomicI64::new(noted_s));
        Self { id: row.id, name: row.name.clone(), role: row.role, noted_s }
    }

    /// True once in `USE_GRAIN_S`, s, and when the clock was set back.
    fn note_is_due(&self, now_s: i64) -> bool {
        let noted_s = self.noted_s.load(Ordering::Relaxed);
        let due = now_s < noted_s || now_s.saturating_sub(noted_s) >= USE_GRAIN_S;
        let taken =
            || self.noted_s.compare_exchange(noted_s, now_s, Ordering::Relaxed, Ordering::Relaxed);
        due && taken().is_ok()
    }
}

/// Every valid key, in memory, by its hash: who asks is known without a read of the store. Keys are
/// made and revoked through it alone while the service runs. Clones share it.
#[derive(Clone)]
pub struct KeyRing {
    store: Store,
    valid: Arc<RwLock<HashMap<String, Key>>>,
}

impl KeyRing {
    /// Reads the valid keys.
    pub async fn load(store: Store) -> Result<Self, StoreError> {
        const OPERATION: &str = "reading the valid keys";
        let rows = sqlx::query("SELECT * FROM api_keys WHERE revoked_at IS NULL")
            .fetch_all(&store.inner.readers)
            .await
            .during(OPERATION)?;
        let entry = |row: &SqliteRow| {
            let hash = Columns::of(row, OPERATION).get("sha256")?;
            Ok((hash, Key::of(&KeyRow::read(row, OPERATION)?)))
        };
        let valid = rows.iter().map(entry).collect::<Result<_, StoreError>>()?;
        Ok(Self { store, valid: Arc::new(RwLock::new(valid)) })
    }

    /// Whether there is no valid key.
    pub fn is_empty(&self) -> bool {
        self.valid().is_empty()
    }

    /// The key with this text, unless it is revoked or there is none. Waits for nothing.
    pub fn find(&self, secret: &str) -> Option<Key> {
        self.valid().get(&sha256_hex(secret)).cloned()
    }

    /// Notes in the background that a key was used, at most once a minute. Needs a tokio runtime. A
    /// note that fails is only logged.
    pub fn note_use(&self, key: &Key) {
        let now = self.store.inner.clock.timestamp();
        if !key.note_is_due(now.as_second()) {
            return;
        }
        let (store, id) = (self.store.clone(), key.id);
        tokio::spawn(async move {
            if let Err(error) = store.note_key_use(id, now).await {
                tracing::warn!(%error, key = id, "a key's use was not noted");
            }
        });
    }

    /// Makes a key of 32 random bytes. Its text is returned here and never again. Refuses a name
    /// that is empty, longer than 100 characters, taken by a valid key, or that reads like somebody
    /// without a key: names tell who holds the operator lock.
    pub async fn create(
        &self,
        name: &str,
        role: Role,
        random: [u8; 32],
    ) -> Result<(KeyRow, String), StoreError> {
        self.check_name(name)?;
        let secret = format!("{PREFIX}{}", hex::encode(random));
        let hash = sha256_hex(&secret);
        let row = self.store.insert_key(name, role, hash.clone()).await?;
        self.change().insert(hash, Key::of(&row));
        Ok((row, secret))
    }

    fn check_name(&self, name: &str) -> Result<(), StoreError> {
        let refused =
            |limit| StoreError::Refused { operation: "creating a key", field: "name", limit };
        if name.trim().is_empty() || name.chars().count() > NAME_MAX_CHARS {
            return Err(refused("must have 1 to 100 characters"));
        }
        if name == KEYLESS || name.ends_with(KEYLESS_SUFFIX) {
            return Err(refused(
                "must not be `local` or end in `(local)`: so is called who has no key",
            ));
        }
        if self.valid().values().any(|key| key.name == name) {
            return Err(refused("must not be the name of another valid key"));
        }
        Ok(())
    }

    /// Revokes a key. False when there is none of this number, or it was revoked before. It opens
    /// nothing from here on, even if the store fails, until the service starts again.
    pub async fn revoke(&self, id: i64) -> Result<bool, StoreError> {
        self.change().retain(|_, key| key.id != id);
        self.store.revoke_key(id).await
    }

    fn valid(&self) -> RwLockReadGuard<'_, HashMap<String, Key>> {
        self.valid.read()
    }

    fn change(&self) -> RwLockWriteGuard<'_, HashMap<String, Key>> {
        self.valid.write()
    }
}

impl Store {
    async fn insert_key(&self, name: &str, role: Role, hash: String) -> Result<KeyRow, StoreError> {
        const OPERATION: &str = "creating a key";
        let (name, now) = (name.to_owned(), self.now_text());
        self.inner
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
                .during(OPERATION)?;
                KeyRow::read(&row, OPERATION)
            })
            .await
    }

    async fn note_key_use(&self, id: i64, at: Timestamp) -> Result<(), StoreError> {
        const OPERATION: &str = "noting a key's use";
        let at = time_text(at);
        self.inner
            .writer
            .run(OPERATION, async move |connection| {
                sqlx::query("UPDATE api_keys SET last_used_at = ?2 WHERE id = ?1")
                    .bind(id)
                    .bind(at)
                    .execute(connection)
                    .await
                    .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    async fn revoke_key(&self, id: i64) -> Result<bool, StoreError> {
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
                .during(OPERATION)?;
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
            .during(OPERATION)?;
        rows.iter().map(|row| KeyRow::read(row, OPERATION)).collect()
    }
}
