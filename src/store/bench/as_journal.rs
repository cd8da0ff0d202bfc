//! The store as the `Journal` of the campaign: a record is durable when its method returns.
//! Uses: the other files of `bench`. Never: SQL, a deadline (the campaign has its own), a record
//! twice because its write was repeated after an error.

use async_trait::async_trait;
use jiff::Timestamp;

use crate::core::{Store, StoreError};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::{Event, ExitStatus, Journal, JournalError, Mounting, Progress};
use crate::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord, Untouched,
};
use crate::state::StateChange;

#[async_trait]
impl Journal for Store {
    async fn trial(&self, run: RunUid, trial: &TrialRecord) -> Result<TrialId, JournalError> {
        self.insert_trial(run, trial).await.map_err(StoreError::of("a trial"))
    }

    async fn attempt(&self, run: RunUid, attempt: &AttemptRecord) -> Result<(), JournalError> {
        self.insert_attempt(run, attempt).await.map_err(StoreError::of("an attempt"))
    }

    async fn tare(&self, run: RunUid, tare: &TareRecord) -> Result<(), JournalError> {
        self.insert_tare(run, tare).await.map_err(StoreError::of("a tare"))
    }

    async fn untouched(&self, run: RunUid, skin: &Untouched) -> Result<(), JournalError> {
        self.insert_untouched(run, skin).await.map_err(StoreError::of("the untouched skin"))
    }

    async fn reference(&self, run: RunUid, press: &ReferenceRecord) -> Result<(), JournalError> {
        self.insert_reference(run, press).await.map_err(StoreError::of("a reference press"))
    }

    async fn touch_off(&self, run: RunUid, found: &TouchOffRecord) -> Result<(), JournalError> {
        self.insert_touch_off(run, found).await.map_err(StoreError::of("a touch-off"))
    }

    async fn skip(
        &self,
        run: RunUid,
        configuration: u32,
        reason: &str,
        at: Timestamp,
    ) -> Result<(), JournalError> {
        self.insert_skip(run, configuration, reason, at).await.map_err(StoreError::of("a skip"))
    }

    async fn discard(&self, run: RunUid, key: TrialKey, reason: &str) -> Result<(), JournalError> {
        self.discard_trial(run, key, reason).await.map_err(StoreError::of("a discarded trial"))
    }

    async fn progress(&self, run: RunUid) -> Result<Progress, JournalError> {
        self.read_progress(run).await.map_err(StoreError::of("the progress of a run"))
    }

    async fn run_state(
        &self,
        run: RunUid,
        change: StateChange,
        at: Timestamp,
    ) -> Result<(), JournalError> {
        self.set_run_state(run, change, at).await.map_err(StoreError::of("the state of a run"))
    }

    async fn end_run(
        &self,
        run: RunUid,
        status: ExitStatus,
        reason: &str,
        at: Timestamp,
    ) -> Result<(), JournalError> {
        self.finish_run(run, status, reason, at).await.map_err(StoreError::of("the end of a run"))
    }

    async fn event(
        &self,
        run: Option<RunUid>,
        kind: &str,
        data: serde_json::Value,
        at: Timestamp,
    ) -> Result<Event, JournalError> {
        self.append_event_once(run, kind, data, at).await.map_err(StoreError::of("an event"))
    }

    async fn mounted(&self, mounting: &Mounting, at: Timestamp) -> Result<(), JournalError> {
        self.insert_mounting(mounting, at)
            .await
            .map_err(StoreError::of("the number of mounted tips"))
    }

    async fn last_mounted(&self) -> Result<Option<Mounting>, JournalError> {
        self.read_last_mounted().await.map_err(StoreError::of("the number of mounted tips"))
    }

    async fn lock_since(&self, at: Timestamp) -> Result<Option<String>, JournalError> {
        let lock = self.lock().await.map_err(StoreError::of("the operator lock"))?;
        Ok(lock
            .filter(|lock| lock.since > at)
            .map(|lock| format!("{}: {}", lock.holder, lock.note)))
    }

    async fn free_bytes(&self) -> Result<u64, JournalError> {
        Store::free_bytes(self).await.map_err(StoreError::of("the free space"))
    }
}
