//! A journal in memory that hangs, fails or panics on request, and keeps what it took in order.

use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use async_trait::async_trait;
use jiff::Timestamp;
use palpate::ids::{RunUid, TrialId, TrialKey};
use palpate::journal::{Event, ExitStatus, Journal, JournalError, Mounting, Progress};
use palpate::record::{
    AttemptRecord, ReferenceRecord, TareRecord, TouchOffRecord, TrialRecord, Untouched,
};
use palpate::state::StateChange;
use serde_json::Value;
use tokio::sync::watch;

/// What the journal does when it is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mood {
    /// It takes everything.
    Sound,
    /// It does not answer.
    Hangs,
    /// It refuses everything, as a full disk or a locked database does.
    Fails,
    /// It panics, as a fault in the store's code would.
    Panics,
}

/// What it took, in order.
#[derive(Debug, Default)]
pub struct Taken {
    /// Kinds of all records, with the event's own kind.
    pub order: Vec<String>,
    /// Events: kind, data, when they happened.
    pub events: Vec<(String, Value, Timestamp)>,
    /// Trials that it stored.
    pub trials: Vec<TrialRecord>,
    /// Failed attempts.
    pub attempts: Vec<AttemptRecord>,
    /// How runs ended.
    pub ends: Vec<(ExitStatus, String)>,
    /// When a person took the operator lock.
    pub locked_at: Option<Timestamp>,
    mounting: Option<Mounting>,
}

pub struct Scripted {
    mood: watch::Sender<Mood>,
    taken: Mutex<Taken>,
}

impl Default for Scripted {
    fn default() -> Self {
        Self { mood: watch::Sender::new(Mood::Sound), taken: Mutex::default() }
    }
}

impl Scripted {
    /// Changes how it behaves.
    pub fn set(&self, mood: Mood) {
        self.mood.send_replace(mood);
    }

    /// What it took so far.
    pub fn taken(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap()
    }

    async fn write(&self, kind: &str) -> Result<MutexGuard<'_, Taken>, JournalError> {
        let mut mood = self.mood.subscribe();
        let mood = *mood.wait_for(|m| *m != Mood::Hangs).await.unwrap();
        match mood {
            Mood::Sound | Mood::Hangs => {}
            Mood::Fails => return Err(JournalError::of("a record", "database or disk is full")),
            Mood::Panics => panic!("the journal panics"),
        }
        // As long as a commit takes.
        tokio::time::sleep(Duration::from_millis(1)).await;
        let mut taken = self.taken();
        taken.order.push(kind.to_owned());
        Ok(taken)
    }
}

#[async_trait]
impl Journal for Scripted {
    async fn trial(&self, _: RunUid, trial: &TrialRecord) -> Result<TrialId, JournalError> {
        let mut taken = self.write("trial").await?;
        taken.trials.push(trial.clone());
        Ok(TrialId(taken.trials.len() as i64))
    }

    async fn attempt(&self, _: RunUid, attempt: &AttemptRecord) -> Result<(), JournalError> {
        self.write("attempt").await?.attempts.push(attempt.clone());
        Ok(())
    }

    async fn tare(&self, _: RunUid, _: &TareRecord) -> Result<(), JournalError> {
        self.write("tare").await.map(drop)
    }

    async fn untouched(&self, _: RunUid, _: &Untouched) -> Result<(), JournalError> {
        self.write("untouched").await.map(drop)
    }

    async fn reference(&self, _: RunUid, _: &ReferenceRecord) -> Result<(), JournalError> {
        self.write("reference").await.map(drop)
    }

    async fn touch_off(&self, _: RunUid, _: &TouchOffRecord) -> Result<(), JournalError> {
        self.write("touch_off").await.map(drop)
    }

    async fn skip(&self, _: RunUid, _: u32, _: &str, _: Timestamp) -> Result<(), JournalError> {
        self.write("skip").await.map(drop)
    }

    async fn discard(&self, _: RunUid, _: TrialKey, _: &str) -> Result<(), JournalError> {
        self.write("discard").await.map(drop)
    }

    async fn progress(&self, _: RunUid) -> Result<Progress, JournalError> {
        let taken = self.write("progress").await?;
        let stored: BTreeSet<TrialKey> = taken.trials.iter().map(|t| t.key).collect();
        Ok(Progress { stored, ..Progress::default() })
    }

    async fn run_state(
        &self,
        _: RunUid,
        change: StateChange,
        _: Timestamp,
    ) -> Result<(), JournalError> {
        self.write(&format!("run {}", change.state)).await.map(drop)
    }

    async fn end_run(
        &self,
        _: RunUid,
        status: ExitStatus,
        reason: &str,
        _: Timestamp,
    ) -> Result<(), JournalError> {
        self.write("end").await?.ends.push((status, reason.to_owned()));
        Ok(())
    }

    async fn event(
        &self,
        run: Option<RunUid>,
        kind: &str,
        data: Value,
        at: Timestamp,
    ) -> Result<Event, JournalError> {
        let mut taken = self.write(kind).await?;
        taken.events.push((kind.to_owned(), data.clone(), at));
        let seq = taken.events.len() as i64;
        Ok(Event { seq, run, at, kind: kind.to_owned(), data })
    }

    async fn lock_since(&self, at: Timestamp) -> Result<Option<String>, JournalError> {
        let locked = self.taken().locked_at;
        Ok(locked.filter(|since| *since > at).map(|_| "ada: hands in the rig".into()))
    }

    async fn mounted(&self, mounting: &Mounting, _: Timestamp) -> Result<(), JournalError> {
        self.write("mounted").await?.mounting = Some(mounting.clone());
        Ok(())
    }

    async fn last_mounted(&self) -> Result<Option<Mounting>, JournalError> {
        Ok(self.taken().mounting.clone())
    }

    async fn free_bytes(&self) -> Result<u64, JournalError> {
        Ok(1 << 40)
    }
}
