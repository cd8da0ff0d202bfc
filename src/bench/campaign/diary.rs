//! The diary: records of what happened, written after it happened. A note never blocks; one task
//! writes the notes in order and repeats a failed write until the store accepts it. The same task
//! logs them, in the spans in which they were made: what moves never waits for the log.
//! Uses: `campaign::{journal, record}`, tokio, tracing. Never: motion, a note dropped without a
//! count.
//!
//! Nothing that moves waits for the store, with one exception: a trial must be durable before the
//! stage continues (`docs/safety.md`). Trials go through the same queue, so that all earlier notes
//! are durable when the trial is.

use std::collections::VecDeque;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures::FutureExt;
use jiff::Timestamp;
use serde_json::json;
use tokio::sync::{mpsc, oneshot};
use tracing::{Instrument, Span};

use crate::ids::RunUid;
use crate::journal::{ExitStatus, Journal, JournalError, Mounting, error_chain};
use crate::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord, Untouched,
};
use crate::state::{PausedWhy, StateChange, StoredState};

/// Notes that may wait for the store. A rig at rest creates a few per hour.
const CAPACITY: usize = 4096;
/// Delays before a failed write is repeated: the first, doubled up to the second.
const WRITE_PAUSE: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(5)];

/// A record of something that happened.
#[derive(Debug, Clone)]
pub enum Note {
    /// An event for people.
    Event {
        /// Run that the event belongs to; none outside a run.
        run: Option<RunUid>,
        /// Kind of the event, one word.
        kind: String,
        /// Details of the event as JSON.
        data: serde_json::Value,
    },
    /// Change of a run's state: state reached, state requested, reason.
    RunState(RunUid, StateChange),
    /// End of a run: exit status and reason.
    EndRun(RunUid, ExitStatus, String),
    /// A failed attempt of a trial.
    Attempt(RunUid, AttemptRecord),
    /// Tare of the cells.
    Tare(RunUid, TareRecord),
    /// Frame of the untouched skin.
    Untouched(RunUid, Arc<Untouched>),
    /// Result of a reference press.
    Reference(RunUid, Box<ReferenceRecord>),
    /// Result of a touch-off.
    TouchOff(RunUid, TouchOffRecord),
    /// A configuration that was given up: index and reason.
    Skip(RunUid, u32, String),
    /// Tips that a person has entered as mounted.
    Mounted(Mounting),
}

enum Entry {
    Note(Note, Timestamp),
    Trial(RunUid, Box<TrialRecord>, Answer),
    /// Answered when all earlier entries are durable.
    Flush(Answer),
}

/// An entry, with the span in which it was made.
type Made = (Entry, Span);
type Answer = oneshot::Sender<Result<(), JournalError>>;

/// Accepts notes. All clones share one queue.
#[derive(Debug, Clone)]
pub struct Diary {
    entries: mpsc::Sender<Made>,
    missing: Arc<AtomicU64>,
}

impl std::fmt::Debug for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Entry::Note(note, at) => write!(f, "{at} {note:?}"),
            Entry::Trial(run, trial, _) => write!(f, "trial {:?} of run {run}", trial.key),
            Entry::Flush(_) => f.write_str("flush"),
        }
    }
}

impl Diary {
    /// Opens a diary and starts the task that writes to the journal until every clone is dropped.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn open(journal: Arc<dyn Journal>) -> (Self, tokio::task::JoinHandle<()>) {
        let (entries, inbox) = mpsc::channel(CAPACITY);
        let missing = Arc::<AtomicU64>::default();
        let writer = Writer { journal, inbox, behind: VecDeque::new(), missing: missing.clone() };
        let task = tokio::spawn(writer.write_all());
        (Self { entries, missing }, task)
    }

    /// Records something at the present time. Never waits: notes beyond the capacity are counted,
    /// and the count is stored in their place.
    pub fn note(&self, note: Note) {
        let entry = Entry::Note(note, Timestamp::now());
        if let Err(error) = self.entries.try_send((entry, Span::current())) {
            self.missing.fetch_add(1, Ordering::Relaxed);
            tracing::error!(%error, "a note was lost");
        }
    }

    /// Stores a trial; resolves when it and all earlier notes are durable.
    ///
    /// # Errors
    /// The store refused the trial or failed; the trial is then not stored. If the caller stops
    /// waiting, the trial is stored as soon as the store accepts it.
    pub async fn trial(&self, run: RunUid, trial: TrialRecord) -> Result<(), JournalError> {
        self.ask(|answer| Entry::Trial(run, Box::new(trial), answer)).await
    }

    /// Resolves when all earlier notes are durable.
    ///
    /// # Errors
    /// The store failed; the notes are kept and written again.
    pub async fn flush(&self) -> Result<(), JournalError> {
        self.ask(Entry::Flush).await
    }

    async fn ask(&self, entry: impl FnOnce(Answer) -> Entry) -> Result<(), JournalError> {
        let gone = || JournalError::of("the diary", "its queue is full or its task has ended");
        let (answer, answered) = oneshot::channel();
        self.entries.try_send((entry(answer), Span::current())).map_err(|_| gone())?;
        answered.await.map_err(|_| gone())?
    }
}

struct Writer {
    journal: Arc<dyn Journal>,
    inbox: mpsc::Receiver<Made>,
    /// Entries taken from the inbox while an earlier note could not be written.
    behind: VecDeque<Made>,
    missing: Arc<AtomicU64>,
}

impl Writer {
    async fn write_all(mut self) {
        loop {
            let next = match self.behind.pop_front() {
                Some(made) => Some(made),
                None => self.inbox.recv().await.inspect(log_made),
            };
            let Some((entry, span)) = next else { return };
            match entry {
                Entry::Note(note, at) => self.write_note(&note, at).instrument(span).await,
                Entry::Trial(run, trial, answer) => {
                    let (journal, attempt) = (self.journal.clone(), trial.attempt);
                    let storing = async move { journal.trial(run, &trial).await };
                    let stored = guarded(storing).instrument(span.clone()).await;
                    let is_stored = stored.is_ok();
                    // The caller may have stopped waiting because of a stop.
                    let _ = answer.send(stored.map(|_| ()));
                    if is_stored {
                        span.in_scope(|| tracing::debug!(attempt, "the trial is stored"));
                    }
                }
                Entry::Flush(answer) => {
                    let _ = answer.send(Ok(()));
                }
            }
        }
    }

    /// Writes a note, repeatedly until it succeeds; a note that the store refuses is logged.
    async fn write_note(&mut self, note: &Note, at: Timestamp) {
        let mut pause = WRITE_PAUSE[0];
        let (mut waits, mut gap) = (false, None);
        loop {
            gap = gap.or_else(|| match self.missing.swap(0, Ordering::Relaxed) {
                0 => None,
                // Not the time of the note: the gaps before it and before the next one may be alike.
                count => Some((count, Timestamp::now())),
            });
            let written = match gap {
                None => Ok(()),
                Some((count, at)) => {
                    // The same event again: what failed may be stored.
                    let data = json!({ "notes": count });
                    guarded(self.journal.event(None, "diary_gap", data, at)).await.map(|_| ())
                }
            };
            let written = match written {
                Ok(()) => {
                    gap = None;
                    guarded(put(self.journal.as_ref(), note, at)).await
                }
                Err(error) => Err(error),
            };
            let Err(error) = written else {
                if waits {
                    tracing::info!("the note that waited for the store is stored");
                }
                return;
            };
            let words = error_chain(&error);
            if error.refused {
                self.missing.fetch_add(gap.map_or(0, |(count, _)| count), Ordering::Relaxed);
                tracing::error!(error = words, ?note, "the store refuses this note");
                return;
            }
            if !std::mem::replace(&mut waits, true) {
                tracing::warn!(error = words, "a note waits for the store");
            }
            self.tell_who_waits(&error);
            tokio::time::sleep(pause).await;
            pause = (2 * pause).min(WRITE_PAUSE[1]);
        }
    }

    /// Reports a failed note to the callers that wait behind it: their trial is not stored. Notes
    /// stay in the queue.
    fn tell_who_waits(&mut self, error: &JournalError) {
        while self.behind.len() < CAPACITY
            && let Ok(made) = self.inbox.try_recv()
        {
            log_made(&made);
            self.behind.push_back(made);
        }
        for (entry, span) in std::mem::take(&mut self.behind) {
            match entry {
                Entry::Note(..) => self.behind.push_back((entry, span)),
                Entry::Trial(_, _, answer) | Entry::Flush(answer) => {
                    let _ = answer.send(Err(error.again()));
                }
            }
        }
    }
}

/// Logs a note when it is taken from the inbox, so that its line does not wait for the store.
fn log_made((entry, span): &Made) {
    if let Entry::Note(note, _) = entry {
        span.in_scope(|| log(note));
    }
}

/// Logs a note in the present span: what a person must know as a warning, the life of a run as
/// information, everything else for debugging. Causes are those of the note; they are logged here
/// only.
fn log(note: &Note) {
    match note {
        Note::RunState(_, StateChange { state, requested, why }) => {
            let state = state.as_str();
            let requested = requested.map(StoredState::as_str);
            let why = why.map(PausedWhy::as_str);
            tracing::info!(state, requested, why, "the state of the run has changed");
        }
        Note::EndRun(_, ExitStatus::Fail, reason) => tracing::warn!(reason, "the run has failed"),
        Note::EndRun(_, status, reason) => {
            tracing::info!(status = status.as_str(), reason, "the run has ended");
        }
        Note::Attempt(_, AttemptRecord { key, attempt, reason, .. }) => {
            let (configuration, depth_index) = (key.configuration, key.depth_index);
            tracing::info!(configuration, depth_index, attempt, reason, "an attempt has failed");
        }
        Note::Skip(_, configuration, reason) => {
            tracing::warn!(configuration, reason, "a configuration was given up");
        }
        Note::Event { kind, data, .. } => match kind.as_str() {
            "trip" => {
                let (cause, detail) = (data["kind"].as_str(), data["detail"].as_str());
                tracing::warn!(cause, detail, "the rig has tripped");
            }
            "wanted" => tracing::warn!(wanted = data["words"].as_str(), "the run needs a person"),
            "suspended" | "store" => {
                tracing::warn!(why = data["why"].as_str(), "the run is suspended");
            }
            kind => tracing::debug!(kind, "an event was recorded"),
        },
        Note::Tare(..)
        | Note::Untouched(..)
        | Note::Reference(..)
        | Note::TouchOff(..)
        | Note::Mounted(_) => {}
    }
}

/// Runs a write; a panic of the journal becomes an error.
async fn guarded<T>(
    write: impl Future<Output = Result<T, JournalError>>,
) -> Result<T, JournalError> {
    let panicked = |_| Err(JournalError::of("a record", "the store panicked"));
    AssertUnwindSafe(write).catch_unwind().await.unwrap_or_else(panicked)
}

async fn put(journal: &dyn Journal, note: &Note, at: Timestamp) -> Result<(), JournalError> {
    match note {
        Note::Event { run, kind, data } => {
            journal.event(*run, kind, data.clone(), at).await.map(|_| ())
        }
        Note::RunState(run, change) => journal.run_state(*run, *change, at).await,
        Note::EndRun(run, status, reason) => journal.end_run(*run, *status, reason, at).await,
        Note::Attempt(run, attempt) => journal.attempt(*run, attempt).await,
        Note::Tare(run, tare) => journal.tare(*run, tare).await,
        Note::Untouched(run, skin) => journal.untouched(*run, skin).await,
        Note::Reference(run, press) => journal.reference(*run, press).await,
        Note::TouchOff(run, found) => journal.touch_off(*run, found).await,
        Note::Skip(run, configuration, reason) => {
            journal.skip(*run, *configuration, reason, at).await
        }
        Note::Mounted(mounting) => journal.mounted(mounting, at).await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in::Forgetful;

    #[tokio::test]
    async fn two_gaps_of_one_note_before_notes_of_one_time_are_two_events() {
        let journal = Arc::new(Forgetful::default());
        let (diary, _writing) = Diary::open(journal.clone());
        let at = Timestamp::UNIX_EPOCH;
        for kind in ["state", "rig"] {
            diary.missing.store(1, Ordering::Relaxed);
            let note = Note::Event { run: None, kind: kind.into(), data: json!({}) };
            diary.entries.try_send((Entry::Note(note, at), Span::none())).unwrap();
            diary.flush().await.unwrap();
        }
        assert_eq!(*journal.events.lock(), ["diary_gap", "state", "diary_gap", "rig"]);
        let times = journal.times.lock();
        assert!(times[1] == at && times[3] == at && times[0] != times[2], "{times:?}");
    }
}
