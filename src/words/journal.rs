//! What a campaign requires of a store: durable records, and access to what is stored.
//! Uses: `record`, `ids`. Never: SQL (the store implements this trait).
//!
//! Every method returns only when its record is durable, however long that takes: the campaign
//! writes through its diary (`campaign::diary`), which limits its own waits. `at` is the time of
//! the event.

use std::collections::BTreeSet;

use async_trait::async_trait;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use crate::ids::{RunUid, TrialId, TrialKey};
use crate::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord, Untouched,
};
use crate::state::StateChange;

/// A record could not be made durable, or could not be read.
#[derive(Debug, thiserror::Error)]
#[error("storing {what} failed")]
pub struct JournalError {
    /// Record that was to be stored or read.
    pub what: &'static str,
    /// Whether the store works but refuses this record: a retry does not help.
    pub refused: bool,
    /// Error of the store.
    #[source]
    pub source: Box<dyn std::error::Error + Send + Sync>,
}

impl JournalError {
    /// Creates a failure with this message.
    pub fn of(what: &'static str, why: &str) -> Self {
        Self { what, refused: false, source: why.into() }
    }

    /// Copies the failure for another waiting caller, with its causes as one text.
    pub fn again(&self) -> Self {
        Self { source: error_chain(self.source.as_ref()).into(), ..Self::of(self.what, "") }
    }
}

/// Formats an error with its causes, for people. A cause whose message is already part of the text
/// is omitted.
pub fn error_chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let message = error.to_string();
        if !text.contains(&message) {
            text = format!("{text}: {message}");
        }
        cause = error.source();
    }
    text
}

/// Tips that a person has entered as mounted, and the state of the cells at that time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mounting {
    /// Number of tips, on arms 1 to n.
    pub tips: u8,
    /// Number of connected cells: at least one for each tip, up to six.
    pub live_cells: u8,
    /// Name of the person who mounted them.
    pub who: String,
}

/// State of a run's trials when it starts or resumes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress {
    /// Keys of the stored trials.
    pub stored: BTreeSet<TrialKey>,
    /// Indices of the skipped configurations.
    pub skipped: BTreeSet<u32>,
    /// Number of failed attempts.
    pub retries: u64,
}

/// How a run ended.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum ExitStatus {
    /// Every planned trial is stored, or its configuration was skipped.
    Success,
    /// Stopped by request before the end of its plan.
    Stopped,
    /// Aborted by request.
    Abort,
    /// Ended because it could not continue.
    Fail,
}

impl ExitStatus {
    /// All statuses.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Name of the status, as stored.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// A record of something that happened, for people: numbered without gaps in the order of storage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Number of the event, from 1.
    pub seq: i64,
    /// Run that the event belongs to; null outside a run.
    pub run: Option<RunUid>,
    /// Wall time of the event.
    pub at: Timestamp,
    /// Kind, one of [`crate::event::KINDS`].
    pub kind: String,
    /// Details, depending on the kind.
    pub data: serde_json::Value,
}

/// Durable storage of a run's records. A record that is written again after an error is stored once, also if the first
/// write was stored.
///
/// # Errors
/// Every method returns `JournalError` if the store fails or refuses the record.
#[async_trait]
pub trait Journal: Send + Sync {
    /// Stores a trial with its forces and frames in one transaction. If the key is already stored,
    /// nothing is stored and the existing id is returned.
    async fn trial(&self, run: RunUid, trial: &TrialRecord) -> Result<TrialId, JournalError>;
    /// Stores a failed attempt.
    async fn attempt(&self, run: RunUid, attempt: &AttemptRecord) -> Result<(), JournalError>;
    /// Stores a tare.
    async fn tare(&self, run: RunUid, tare: &TareRecord) -> Result<(), JournalError>;
    /// Stores a frame of the untouched skin.
    async fn untouched(&self, run: RunUid, skin: &Untouched) -> Result<(), JournalError>;
    /// Stores a reference press.
    async fn reference(&self, run: RunUid, press: &ReferenceRecord) -> Result<(), JournalError>;
    /// Stores a touch-off.
    async fn touch_off(&self, run: RunUid, found: &TouchOffRecord) -> Result<(), JournalError>;
    /// Stores that a configuration was skipped, with the reason.
    async fn skip(
        &self,
        run: RunUid,
        configuration: u32,
        reason: &str,
        at: Timestamp,
    ) -> Result<(), JournalError>;
    /// Withdraws a stored trial, so that it can be measured again (Real-Random); its record moves
    /// to the attempts.
    async fn discard(&self, run: RunUid, key: TrialKey, reason: &str) -> Result<(), JournalError>;
    /// Reads the progress of a run.
    async fn progress(&self, run: RunUid) -> Result<Progress, JournalError>;
    /// Stores the state of a run that has started or changed.
    async fn run_state(
        &self,
        run: RunUid,
        change: StateChange,
        at: Timestamp,
    ) -> Result<(), JournalError>;
    /// Stores the end of a run.
    async fn end_run(
        &self,
        run: RunUid,
        status: ExitStatus,
        reason: &str,
        at: Timestamp,
    ) -> Result<(), JournalError>;
    /// Appends an event and returns it with its number; numbers follow the order of storage.
    async fn event(
        &self,
        run: Option<RunUid>,
        kind: &str,
        data: serde_json::Value,
        at: Timestamp,
    ) -> Result<Event, JournalError>;
    /// Stores the number of tips that a person has mounted.
    async fn mounted(&self, mounting: &Mounting, at: Timestamp) -> Result<(), JournalError>;
    /// Reads the last entry of mounted tips; none if there is none.
    async fn last_mounted(&self) -> Result<Option<Mounting>, JournalError>;
    /// Returns who took the operator lock after a time, with the note; none if it was not taken.
    async fn lock_since(&self, at: Timestamp) -> Result<Option<String>, JournalError>;
    /// Returns the free disk space, bytes.
    async fn free_bytes(&self) -> Result<u64, JournalError>;
}
