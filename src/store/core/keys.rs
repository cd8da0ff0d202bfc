//! API keys: created from random bytes of the caller, stored as hashes, revocable.
//! Uses: `digest`, `core::{once, writer}`. Never: the text of a key in a table, a log or a `Debug`; a read of the
//! store per request.
//!
//! A key is found by its sha256, so that the time of a comparison reveals nothing about a guess. A key
//! of 32 random bytes needs no slow hash.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use jiff::Timestamp;
use parking_lot::RwLock;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteConnection;
use strum::IntoStaticStr;
use tokio::sync::watch;
use tracing::Instrument;
use utoipa::ToSchema;

use super::columns::{Columns, row, time_text};
use super::{During, Store, StoreError, StoreResult, once};
use crate::digest::sha256_hex;
use crate::journal::error_chain;
use crate::plain::violated;

/// Start of the text of every key.
const PREFIX: &str = "palpate_";

/// Interval in which the use of a key is stored at most once, s.
const USE_GRAIN_S: i64 = 60;

/// Longest name of a key, characters.
const KEY_NAME_MAX_CHARS: usize = 100;

const CREATING_KEY: &str = "creating a key";
const REVOKING_KEY: &str = "revoking a key";

/// Name of a caller without a key and without a name.
pub const KEYLESS: &str = "local";

/// End of the name of a caller without a key; no name of a key ends in it.
pub const KEYLESS_SUFFIX: &str = " (local)";

/// Rights of an API key; each role includes the rights of the previous ones.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Serialize, Deserialize, ToSchema, IntoStaticStr,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Role {
    /// Read, and stop the rig.
    Viewer,
    /// Start runs and move the rig.
    Operator,
    /// Manage keys, and remove the operator lock of another person.
    Admin,
}

impl Role {
    /// All roles, each with the rights of the previous ones.
    pub const ALL: [Self; 3] = [Self::Viewer, Self::Operator, Self::Admin];

    /// Rights of its holder, in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Viewer => {
                "reads and exports everything; pauses, stops and aborts runs; may stop the rig"
            }
            Self::Operator => "also queues and starts runs, moves the rig, trains and promotes",
            Self::Admin => "also makes and revokes keys, and removes the operator lock of others",
        }
    }

    /// Name of the role, as in requests and in the database.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// An API key without its text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct KeyRow {
    /// Number of the key.
    pub id: i64,
    /// Name of the key: its holder or purpose.
    pub name: String,
    /// Rights of its holder.
    pub role: Role,
    /// Wall time of its creation.
    pub created_at: Timestamp,
    /// Wall time of its last use, to the minute; absent if it was never used.
    pub last_used_at: Option<Timestamp>,
    /// Wall time of its revocation; absent while it is valid.
    pub revoked_at: Option<Timestamp>,
}

impl KeyRow {
    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        Ok(row!(c, Self {},
            get: id, name; word: role; time: created_at; time_or_none: last_used_at, revoked_at))
    }
}

/// A valid key in memory. Clones share the time of its last stored use.
#[derive(Debug, Clone)]
pub struct Key {
    /// Number of the key.
    pub id: i64,
    /// Name of the key: its holder or purpose.
    pub name: String,
    /// Rights of its holder.
    pub role: Role,
    noted_s: Arc<AtomicI64>,
}

impl Key {
    fn of(row: &KeyRow) -> Self {
        let noted_s = row.last_used_at.map_or(i64::MIN, Timestamp::as_second);
        let noted_s = Arc::new(AtomicI64::new(noted_s));
        Self { id: row.id, name: row.name.clone(), role: row.role, noted_s }
    }

    /// Whether the use at this time, s, is to be stored: once per `USE_GRAIN_S`, and after the clock
    /// was set back.
    fn note_is_due(&self, now_s: i64) -> bool {
        let noted_s = self.noted_s.load(Ordering::Relaxed);
        let due = now_s < noted_s || now_s.saturating_sub(noted_s) >= USE_GRAIN_S;
        let taken =
            || self.noted_s.compare_exchange(noted_s, now_s, Ordering::Relaxed, Ordering::Relaxed);
        due && taken().is_ok()
    }
}

/// All valid keys in memory, by their hashes, so that a request is authorised without a read of the
/// store. While the service runs, keys are created and revoked only through it. Clones share it.
#[derive(Clone)]
pub struct KeyRing {
    store: Store,
    valid: Arc<RwLock<HashMap<String, Key>>>,
    /// Changes when a key is revoked.
    revocations: watch::Sender<()>,
}

impl KeyRing {
    /// Reads the valid keys.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn load(store: Store) -> StoreResult<Self> {
        let query = sqlx::query("SELECT * FROM api_keys WHERE revoked_at IS NULL");
        let entry = |c: &Columns<'_>| Ok((c.get::<String>("sha256")?, Key::of(&KeyRow::read(c)?)));
        let valid = store.rows("reading the valid keys", query, entry).await?.into_iter().collect();
        let (revocations, _) = watch::channel(());
        Ok(Self { store, valid: Arc::new(RwLock::new(valid)), revocations })
    }

    /// Whether no key is valid.
    pub fn is_empty(&self) -> bool {
        self.valid.read().is_empty()
    }

    /// Returns the valid key with this text. Does not wait for the store.
    pub fn find(&self, secret: &str) -> Option<Key> {
        self.valid.read().get(&sha256_hex(secret)).cloned()
    }

    /// Stores in the background that a key was used, at most once per minute. A failure is logged.
    ///
    /// # Panics
    /// If it is called outside of a tokio runtime.
    pub fn note_use(&self, key: &Key) {
        let now = self.store.inner.clock.timestamp();
        if !key.note_is_due(now.as_second()) {
            return;
        }
        let (store, id) = (self.store.clone(), key.id);
        let query = sqlx::query("UPDATE api_keys SET last_used_at = ?2 WHERE id = ?1")
            .bind(id)
            .bind(time_text(now));
        let noting = async move {
            let noted = store.inner.writer.execute("storing the use of a key", query).await;
            if let Err(error) = noted {
                let error = error_chain(&error);
                tracing::warn!(error, key = id, "the use of a key was not stored");
            }
        };
        tokio::spawn(noting.in_current_span());
    }

    /// Creates a key from 32 random bytes. Returns its row and its text, which is not stored.
    ///
    /// # Errors
    /// `Refused` if the name is empty, longer than 100 characters, has control characters, is the name of another valid key, or
    /// that of a caller without a key (names identify the holder of the operator lock); `Sql`, `Late` or
    /// `Closed` if the write fails.
    pub async fn create(
        &self,
        name: &str,
        role: Role,
        random: [u8; 32],
    ) -> StoreResult<(KeyRow, String)> {
        check_name(name)?;
        let secret = format!("{PREFIX}{}", hex::encode(random));
        let hash = sha256_hex(&secret);
        let query = sqlx::query(
            "INSERT INTO api_keys (name, sha256, role, created_at)
             SELECT ?1, ?2, ?3, ?4 WHERE NOT EXISTS
             (SELECT 1 FROM api_keys WHERE name = ?1 AND revoked_at IS NULL) RETURNING *",
        )
        .bind(name)
        .bind(&hash)
        .bind(role.as_str())
        .bind(self.store.now_text());
        let insert = async move |connection: &mut SqliteConnection| {
            let row = query.fetch_optional(connection).await.during(CREATING_KEY)?;
            let row = row.ok_or_else(|| refused("must not be the name of another valid key"))?;
            KeyRow::read(&Columns::of(&row, CREATING_KEY))
        };
        let row = self.store.write(CREATING_KEY, insert).await?;
        self.valid.write().insert(hash, Key::of(&row));
        Ok((row, secret))
    }

    /// Revokes a key, and removes its requests that were carried out once. Returns false if no key has this
    /// number, or it is already revoked. The key is refused from now on; if the write fails, until the service
    /// starts again.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn revoke(&self, id: i64) -> StoreResult<bool> {
        self.valid.write().retain(|_, key| key.id != id);
        self.revocations.send_replace(());
        let query =
            sqlx::query("UPDATE api_keys SET revoked_at = ?2 WHERE id = ?1 AND revoked_at IS NULL")
                .bind(id)
                .bind(self.store.now_text());
        let write = self.store.write(REVOKING_KEY, async move |connection| {
            let revoked = query.execute(&mut *connection).await.during(REVOKING_KEY)?;
            once::forget_caller(connection, id).await.during(REVOKING_KEY)?;
            Ok(revoked.rows_affected() > 0)
        });
        write.await
    }

    /// Whether a key has not been revoked.
    pub fn is_valid(&self, key: &Key) -> bool {
        self.valid.read().values().any(|valid| valid.id == key.id)
    }

    /// Completes when a key is revoked.
    pub fn revoked(&self, key: &Key) -> impl Future<Output = ()> + Send + use<> {
        let (valid, id, mut revocations) =
            (self.valid.clone(), key.id, self.revocations.subscribe());
        async move {
            while valid.read().values().any(|key| key.id == id) {
                if revocations.changed().await.is_err() {
                    // The service ends, and its streams with it.
                    return;
                }
            }
        }
    }
}

fn check_name(name: &str) -> StoreResult<()> {
    if name.trim().is_empty() || name.chars().count() > KEY_NAME_MAX_CHARS {
        return Err(refused("must have 1 to 100 characters"));
    }
    if violated(name, KEY_NAME_MAX_CHARS).is_some() {
        return Err(refused("must have no control characters"));
    }
    if name == KEYLESS || name.ends_with(KEYLESS_SUFFIX) {
        return Err(refused(
            "must not be `local` or end in `(local)`: these names mean a caller without a key",
        ));
    }
    Ok(())
}

fn refused(limit: &'static str) -> StoreError {
    StoreError::Refused { operation: CREATING_KEY, field: "name", limit }
}

impl Store {
    /// Returns all keys, also revoked ones, oldest first.
    ///
    /// # Errors
    /// `Sql` or `Unreadable` if the read fails.
    pub async fn keys(&self) -> StoreResult<Vec<KeyRow>> {
        let query = sqlx::query("SELECT * FROM api_keys ORDER BY id");
        self.rows("listing keys", query, KeyRow::read).await
    }
}
