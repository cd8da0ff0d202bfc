//! The store as the `Journal` of the campaign: a record is durable when its method returns.
//! Uses: the other files of `bench`. Never: SQL, a deadline (the campaign has its own), a record
//! twice because its write was repeated after an error.

use async_trait::async_trait;
use jiff::Timestamp;
use serde_json::Value;

use crate::core::{Store, StoreError};
use crate::ids::{RunUid, TrialId, TrialKey};
use crate::journal::{Event, ExitStatus, Journal, JournalError, Mounting, Progress};
use crate::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord, Untouched,
};
use crate::state::StateChange;

/// Implements each method of the journal by one of the store. The text names the record in the error.
macro_rules! journal {
    ($($method:ident($($value:ident: $kind:ty),*) -> $made:ty = $own:ident, $what:literal;)*) => {
        #[async_trait]
        impl Journal for Store {
            $(async fn $method(&self, $($value: $kind),*) -> Result<$made, JournalError> {
                self.$own($($value),*).await.map_err(StoreError::of($what))
            })*
        }
    };
}

journal! {
    trial(run: RunUid, trial: &TrialRecord) -> TrialId = insert_trial, "a trial";
    attempt(run: RunUid, attempt: &AttemptRecord) -> () = insert_attempt, "an attempt";
    tare(run: RunUid, tare: &TareRecord) -> () = insert_tare, "a tare";
    untouched(run: RunUid, skin: &Untouched) -> () = insert_untouched, "the untouched skin";
    reference(run: RunUid, press: &ReferenceRecord) -> () = insert_reference, "a reference press";
    touch_off(run: RunUid, found: &TouchOffRecord) -> () = insert_touch_off, "a touch-off";
    skip(run: RunUid, configuration: u32, reason: &str, at: Timestamp) -> () =
        insert_skip, "a skip";
    discard(run: RunUid, key: TrialKey, reason: &str) -> () = discard_trial, "a discarded trial";
    progress(run: RunUid) -> Progress = read_progress, "the progress of a run";
    run_state(run: RunUid, change: StateChange, at: Timestamp) -> () =
        set_run_state, "the state of a run";
    end_run(run: RunUid, status: ExitStatus, reason: &str, at: Timestamp) -> () =
        finish_run, "the end of a run";
    event(run: Option<RunUid>, kind: &str, data: Value, at: Timestamp) -> Event =
        append_event_once, "an event";
    mounted(mounting: &Mounting, at: Timestamp) -> () =
        insert_mounting, "the number of mounted tips";
    last_mounted() -> Option<Mounting> = read_last_mounted, "the number of mounted tips";
    lock_since(at: Timestamp) -> Option<String> = taken_since, "the operator lock";
    free_bytes() -> u64 = free_bytes, "the free space";
}
