//! What a campaign needs of a store: durable records, and what is already there.
//! Uses: `campaign::kept::record`, `ids`. Never: SQL (the store implements this; data flows to it while
//! the import points back).
//!
//! Every method returns only when its record is durable, however long that takes: the campaign
//! writes through its diary (`campaign::kept::diary`), which bounds its own waits. `at` is when it happened.

use std::collections::BTreeSet;

use async_trait::async_trait;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::campaign::kept::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord,
};
use crate::ids::{RunUid, TrialId, TrialKey};

/// A record could not be made durable, or could not be read.
#[derive(Debug, thiserror::Error)]
#[error("storing {what} failed")]
pub struct JournalError {
    /// What was to be stored or read.
    pub what: &'static str,
    /// The store is sound and will never take this record: trying again does not help.
    pub refused: bool,
    /// The store's own error.
    #[source]
    pub source: Box<dyn std::error::Error + Send + Sync>,
}

impl JournalError {
    /// A failure in these words.
    pub fn of(what: &'static str, why: &str) -> Self {
        Self { what, refused: false, source: why.into() }
    }

    /// The same failure for somebody else who waits, with its causes as one text.
    pub fn again(&self) -> Self {
        Self { source: error_chain(self.source.as_ref()).into(), ..Self::of(self.what, "") }
    }
}

/// An error with its causes, for people.
pub fn error_chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        words += ": ";
        words += &error.to_string();
        cause = error.source();
    }
    words
}

/// Tips that a person says are mounted, and what the cells showed then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mounting {
    /// Tips, on arms 1 to n.
    pub tips: u8,
    /// Cells on their cables: at least one for each tip, up to six.
    pub live_cells: u8,
    /// Who mounted them.
    pub who: String,
}

/// What is known of a run's trials when it starts or goes on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress {
    /// Stored trials.
    pub stored: BTreeSet<TrialKey>,
    /// Configurations given up.
    pub skipped: BTreeSet<u32>,
    /// Failed attempts so far.
    pub retries: u64,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum ExitStatus {
    /// Finished, or stopped by request.
    Success,
    /// Aborted by request.
    Abort,
    /// Could not go on.
    Fail,
}

impl ExitStatus {
    /// The status as it is stored.
    pub fn as_str(self) -> &'static str {
        match self {
            ExitStatus::Success => "success",
            ExitStatus::Abort => "abort",
            ExitStatus::Fail => "fail",
        }
    }
}

/// Something that happened, for people: numbered without gaps in the order of storage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Event {
    /// Number, from 1.
    pub seq: i64,
    /// The run it belongs to, if any.
    pub run: Option<RunUid>,
    /// Wall time.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// One word: `state`, `trial`, `skip`, `trip`, `tare`, ...
    pub kind: String,
    /// What it says, by kind.
    pub data: serde_json::Value,
}

/// Durable storage of a run's records.
#[async_trait]
pub trait Journal: Send + Sync {
    /// Stores a trial with its forces and frames in one transaction. A key that is already stored
    /// is not stored again: its id is returned.
    async fn trial(&self, run: RunUid, trial: &TrialRecord) -> Result<TrialId, JournalError>;
    /// Stores a failed attempt.
    async fn attempt(&self, run: RunUid, attempt: &AttemptRecord) -> Result<(), JournalError>;
    /// Stores a tare.
    async fn tare(&self, run: RunUid, tare: &TareRecord) -> Result<(), JournalError>;
    /// Stores a reference press.
    async fn reference(&self, run: RunUid, press: &ReferenceRecord) -> Result<(), JournalError>;
    /// Stores a touch-off.
    async fn touch_off(&self, run: RunUid, found: &TouchOffRecord) -> Result<(), JournalError>;
    /// Gives a configuration up.
    async fn skip(
        &self,
        run: RunUid,
        configuration: u32,
        reason: &str,
        at: Timestamp,
    ) -> Result<(), JournalError>;
    /// Takes a stored trial back, so that it can be measured again (Real-Random); its record moves
    /// to the attempts.
    async fn discard(&self, run: RunUid, key: TrialKey, reason: &str) -> Result<(), JournalError>;
    /// What is already there.
    async fn progress(&self, run: RunUid) -> Result<Progress, JournalError>;
    /// Notes that a run has started or goes on, in this state.
    async fn run_state(
        &self,
        run: RunUid,
        state: &str,
        requested: Option<&str>,
        why: Option<&str>,
        at: Timestamp,
    ) -> Result<(), JournalError>;
    /// Ends a run.
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
    /// Stores how many tips a person says are mounted.
    async fn mounted(&self, mounting: &Mounting, at: Timestamp) -> Result<(), JournalError>;
    /// What a person said last.
    async fn last_mounted(&self) -> Result<Option<Mounting>, JournalError>;
    /// Bytes that can still be stored.
    async fn free_bytes(&self) -> Result<u64, JournalError>;
}
