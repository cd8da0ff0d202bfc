//! Keys and operator lock of a data folder that no service uses: neither needs the rig.
//! Uses: `store`, the lock of the data folder. Never: a check of rights: who may open the folder may do so.

use std::path::Path;

use jiff::Timestamp;

use super::auth::Caller;
use super::people::CreatedKey;
use super::{LockFile, ServeError, data_folder};
use crate::clock::Clock;
use crate::journal::error_chain;
use crate::store::{KeyRing, KeyRow, LockRow, NewAction, Role, Store, StoreResult};

/// The database of a data folder, open in this process only. Its changes are in the log of actions.
pub struct Offline {
    store: Store,
    keys: KeyRing,
    caller: Caller,
    _lock: LockFile,
}

impl Offline {
    /// Opens the database of a data folder.
    ///
    /// # Errors
    /// `ServeError::Data` or `Store` if the folder cannot be used, `Locked` if another process uses it.
    pub async fn open(data: &Path) -> Result<Self, ServeError> {
        let mut lock = data_folder::open(data)?;
        lock.note_no_rig();
        let store = Store::open(&data_folder::database(data), Clock::new(1.0)).await?;
        let keys = KeyRing::load(store.clone()).await?;
        Ok(Self { store, keys, caller: Caller { key: None, role: Role::Admin }, _lock: lock })
    }

    /// Closes the database.
    pub async fn close(self) {
        self.store.close().await;
    }

    /// Returns the keys, also revoked ones.
    ///
    /// # Errors
    /// As [`Store::keys`].
    pub async fn keys(&self) -> StoreResult<Vec<KeyRow>> {
        self.store.keys().await
    }

    /// Creates a key.
    ///
    /// # Errors
    /// As [`KeyRing::create`].
    pub async fn create_key(&self, name: &str, role: Role) -> StoreResult<CreatedKey> {
        let made = self.keys.create(name, role, rand::random()).await;
        let (key, secret) = self.logged("key", None, Some(name), made.is_ok(), made).await?;
        Ok(CreatedKey { key, secret })
    }

    /// Revokes a key; false if no valid key has this number.
    ///
    /// # Errors
    /// As [`KeyRing::revoke`].
    pub async fn revoke_key(&self, id: i64) -> StoreResult<bool> {
        let key = format!("key {id}");
        let revoked = self.keys.revoke(id).await;
        let accepted = matches!(revoked, Ok(true));
        self.logged("revoke_key", None, Some(&key), accepted, revoked).await
    }

    /// Returns the operator lock.
    ///
    /// # Errors
    /// As [`Store::lock`].
    pub async fn lock(&self) -> StoreResult<Option<LockRow>> {
        self.store.lock().await
    }

    /// Takes the operator lock for a person, without a key.
    ///
    /// # Errors
    /// As [`Store::set_lock`].
    pub async fn take_lock(&self, who: &str, note: &str) -> StoreResult<LockRow> {
        let taken = self.store.set_lock(&self.caller.holder(Some(who)), note).await;
        self.logged("lock", Some(who), Some(note), taken.is_ok(), taken).await
    }

    /// Releases the operator lock of any holder.
    ///
    /// # Errors
    /// As [`Store::clear_lock`].
    pub async fn clear_lock(&self) -> StoreResult<Option<LockRow>> {
        let cleared = self.store.clear_lock().await;
        self.logged("unlock", None, None, cleared.is_ok(), cleared).await
    }

    /// Logs an action, and returns its outcome.
    async fn logged<T>(
        &self,
        action: &str,
        who: Option<&str>,
        why: Option<&str>,
        accepted: bool,
        outcome: StoreResult<T>,
    ) -> StoreResult<T> {
        let new = NewAction {
            at: Timestamp::now(),
            run: None,
            action: action.into(),
            who: self.caller.name(who),
            key_id: None,
            why: why.map(Into::into),
            accepted,
            detail: outcome.as_ref().err().map(ToString::to_string),
        };
        if let Err(error) = self.store.log_action(new).await {
            tracing::error!(error = error_chain(&error), action, "an action is not logged");
        }
        outcome
    }
}
