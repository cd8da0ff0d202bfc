//! The facts of runs that the store has read or written, cached in memory: every insert and most queries need them.
//! Uses: `core::{facts, store, writer}`. Never: the state of a run, which changes; the facts of a queued run, which an
//! edit may change although it fails or is late.

use sqlx::sqlite::SqliteConnection;

use super::error::StoreResult;
use super::facts::RunFacts;
use super::store::Store;
use super::writer::Writer;
use crate::ids::RunUid;

impl Store {
    /// Returns the facts of a run, for a read.
    ///
    /// # Errors
    /// `NoSuchRun` if it is not stored; `Sql` or `Unreadable` if the read fails.
    pub(crate) async fn facts(
        &self,
        run: RunUid,
        operation: &'static str,
    ) -> StoreResult<RunFacts> {
        if let Some(facts) = self.known(run) {
            return Ok(facts);
        }
        let mut view = self.read(operation).await?;
        Ok(self.keep_lasting(run, RunFacts::read(&mut view, run, operation).await?))
    }

    /// Returns the facts of a run, for a write of the campaign: it never waits for a connection that
    /// reads.
    ///
    /// # Errors
    /// As [`Store::facts`], and `Closed`.
    pub(crate) async fn facts_to_write(
        &self,
        run: RunUid,
        operation: &'static str,
    ) -> StoreResult<RunFacts> {
        self.facts_by(&self.inner.writer.patient(), run, operation).await
    }

    pub(crate) async fn facts_by(
        &self,
        writer: &Writer,
        run: RunUid,
        operation: &'static str,
    ) -> StoreResult<RunFacts> {
        if let Some(facts) = self.known(run) {
            return Ok(facts);
        }
        let read = async move |c: &mut SqliteConnection| RunFacts::read(c, run, operation).await;
        Ok(self.keep_lasting(run, writer.run(operation, read).await?))
    }

    fn known(&self, run: RunUid) -> Option<RunFacts> {
        self.inner.runs.lock().get(&run).copied()
    }

    /// Keeps what was read of a run, unless it is queued.
    fn keep_lasting(&self, run: RunUid, (facts, is_queued): (RunFacts, bool)) -> RunFacts {
        if is_queued { facts } else { self.keep(run, facts) }
    }

    pub(crate) fn keep(&self, run: RunUid, facts: RunFacts) -> RunFacts {
        self.inner.runs.lock().insert(run, facts);
        facts
    }
}
