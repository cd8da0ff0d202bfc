//! The diary: what happened, written after it happened. Noting costs no wait; one task writes the
//! notes in their order and tries again until the store takes them.
//! Uses: `campaign::{kept::journal, kept::record}`, tokio. Never: motion, a note dropped in silence.
//!
//! Nothing that moves waits for the store, with one exception: a trial must be durable before the
//! stage moves on (`docs/safety.md`). Trials go through the same queue, so that everything that was
//! noted before a trial is durable when the trial is.

use std::collections::VecDeque;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures::FutureExt;
use jiff::Timestamp;
use serde_json::json;
use tokio::sync::{mpsc, oneshot};

use crate::campaign::kept::journal::{ExitStatus, Journal, JournalError, Mounting};
use crate::campaign::kept::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord,
};
use crate::ids::{RunUid, TrialKey};

/// Notes that may wait for the store. A rig that stands still makes a few an hour.
const CAPACITY: usize = 4096;
/// Wait before a failed write is tried again; it doubles up to the second.
const RETRY: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(5)];

/// Something that happened.
#[derive(Debug, Clone)]
pub enum Note {
    /// For people.
    Event {
        /// The run it belongs to.
        run: Option<RunUid>,
        /// One word.
        kind: String,
        /// What it says.
        data: serde_json::Value,
    },
    /// A run's state: reached, asked for, why.
    RunState(RunUid, String, Option<String>, Option<String>),
    /// A run's end.
    EndRun(RunUid, ExitStatus, String),
    /// A failed attempt.
    Attempt(RunUid, AttemptRecord),
    /// Zeros of the cells.
    Tare(RunUid, TareRecord),
    /// A reference press.
    Reference(RunUid, Box<ReferenceRecord>),
    /// The surface.
    TouchOff(RunUid, TouchOffRecord),
    /// A configuration that was given up, and why.
    Skip(RunUid, u32, String),
    /// A trial that was taken back, and why.
    Discard(RunUid, TrialKey, String),
    /// Tips that a person says are mounted.
    Mounted(Mounting),
}

enum Entry {
    Note(Note, Timestamp),
    Trial(RunUid, Box<TrialRecord>, Answer),
    /// Answered when everything before it is durable.
    Flush(Answer),
}

type Answer = oneshot::Sender<Result<(), JournalError>>;

/// Takes notes. Clones share the queue.
#[derive(Debug, Clone)]
pub struct Diary {
    entries: mpsc::Sender<Entry>,
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
    /// Opens a diary: its task writes to the journal until every clone is gone.
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

    /// Notes something that happens now. Never waits: beyond the capacity notes are counted, and
    /// the count is stored in their place.
    pub fn note(&self, note: Note) {
        if let Err(error) = self.entries.try_send(Entry::Note(note, Timestamp::now())) {
            self.missing.fetch_add(1, Ordering::Relaxed);
            tracing::error!(%error, "a note is missing in the diary");
        }
    }

    /// Stores a trial; resolves when it, and everything noted before it, is durable.
    ///
    /// # Errors
    /// The store refused it or failed; it is then not stored. When the caller stops waiting, the
    /// trial is stored all the same as soon as the store takes it.
    pub async fn trial(&self, run: RunUid, trial: TrialRecord) -> Result<(), JournalError> {
        self.ask(|answer| Entry::Trial(run, Box::new(trial), answer)).await
    }

    /// Resolves when everything noted before is durable.
    ///
    /// # Errors
    /// The store fails: what was noted is kept and tried again.
    pub async fn flush(&self) -> Result<(), JournalError> {
        self.ask(Entry::Flush).await
    }

    async fn ask(&self, entry: impl FnOnce(Answer) -> Entry) -> Result<(), JournalError> {
        let gone = || JournalError::of("the diary", "its queue is full or its task has ended");
        let (answer, answered) = oneshot::channel();
        self.entries.try_send(entry(answer)).map_err(|_| gone())?;
        answered.await.map_err(|_| gone())?
    }
}

struct Writer {
    journal: Arc<dyn Journal>,
    inbox: mpsc::Receiver<Entry>,
    /// Taken from the inbox while an earlier note failed.
    behind: VecDeque<Entry>,
    missing: Arc<AtomicU64>,
}

impl Writer {
    async fn write_all(mut self) {
        loop {
            let next = match self.behind.pop_front() {
                Some(entry) => Some(entry),
                None => self.inbox.recv().await,
            };
            let Some(entry) = next else { return };
            match entry {
                Entry::Note(note, at) => self.write_note(&note, at).await,
                Entry::Trial(run, trial, answer) => {
                    let journal = self.journal.clone();
                    let stored = guarded(async move { journal.trial(run, &trial).await }).await;
                    // Who asked may have been called away by a stop.
                    let _ = answer.send(stored.map(|_| ()));
                }
                Entry::Flush(answer) => {
                    let _ = answer.send(Ok(()));
                }
            }
        }
    }

    /// Writes a note, however long it takes; a note that the store will never take is logged.
    async fn write_note(&mut self, note: &Note, at: Timestamp) {
        let mut pause = RETRY[0];
        loop {
            let missing = self.missing.swap(0, Ordering::Relaxed);
            let written = match missing {
                0 => Ok(()),
                n => {
                    let data = json!({ "notes": n });
                    guarded(self.journal.event(None, "diary_gap", data, at)).await.map(|_| ())
                }
            };
            let written = match written {
                Ok(()) => guarded(put(self.journal.as_ref(), note, at)).await,
                Err(error) => {
                    self.missing.fetch_add(missing, Ordering::Relaxed);
                    Err(error)
                }
            };
            let Err(error) = written else { return };
            if error.refused {
                tracing::error!(%error, ?note, "the store does not take this note");
                return;
            }
            tracing::warn!(%error, cause = ?error.source, "a note waits for the store");
            self.tell_who_waits(&error);
            tokio::time::sleep(pause).await;
            pause = (2 * pause).min(RETRY[1]);
        }
    }

    /// Answers those who wait behind a failed note: their trial is not stored. Notes stay.
    fn tell_who_waits(&mut self, error: &JournalError) {
        while self.behind.len() < CAPACITY
            && let Ok(entry) = self.inbox.try_recv()
        {
            self.behind.push_back(entry);
        }
        for entry in std::mem::take(&mut self.behind) {
            match entry {
                Entry::Note(..) => self.behind.push_back(entry),
                Entry::Trial(_, _, answer) | Entry::Flush(answer) => {
                    let _ = answer.send(Err(error.again()));
                }
            }
        }
    }
}

/// A journal that panics has failed to write.
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
        Note::RunState(run, state, requested, why) => {
            journal.run_state(*run, state, requested.as_deref(), why.as_deref(), at).await
        }
        Note::EndRun(run, status, reason) => journal.end_run(*run, *status, reason, at).await,
        Note::Attempt(run, attempt) => journal.attempt(*run, attempt).await,
        Note::Tare(run, tare) => journal.tare(*run, tare).await,
        Note::Reference(run, press) => journal.reference(*run, press).await,
        Note::TouchOff(run, found) => journal.touch_off(*run, found).await,
        Note::Skip(run, configuration, reason) => {
            journal.skip(*run, *configuration, reason, at).await
        }
        Note::Discard(run, key, reason) => journal.discard(*run, *key, reason).await,
        Note::Mounted(mounting) => journal.mounted(mounting, at).await,
    }
}
