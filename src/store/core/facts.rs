//! The facts of a run that never change, cached in memory: every insert and most queries need them.
//! Uses: `core::{store, writer}`. Never: the state of a run, which changes.

use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteConnection;
use strum::IntoStaticStr;
use utoipa::ToSchema;

use super::columns;
use super::error::{During, StoreError};
use super::store::Store;
use super::writer::Writer;
use crate::ids::RunUid;
pub use crate::record::Label;

/// Origin of the trials of a run: Real-Hex or Real-Random (paper, Table I), or an import.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum RunKind {
    /// Pressed by the multi-point indenter; contacts below the deadband are removed from the labels.
    RealHex,
    /// Weights placed manually; all nominal contacts are labels, also those below the deadband.
    RealRandom,
    /// Measured elsewhere; the contacts are those of the imported file.
    Imported,
}

impl RunKind {
    /// Returns the kind as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Facts of a run that never change.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RunFacts {
    /// Number of the run, which the column `run` of other tables holds.
    pub(crate) scan_id: i64,
    /// Origin of the trials.
    pub(crate) kind: RunKind,
    /// Force below which contacts are removed from the labels, N.
    pub(crate) deadband_n: f64,
}

impl RunFacts {
    async fn read(
        connection: &mut SqliteConnection,
        run: RunUid,
        operation: &'static str,
    ) -> Result<Self, StoreError> {
        let row = sqlx::query("SELECT scan_id, kind, deadband_n FROM runs WHERE uid = ?1")
            .bind(run.to_string())
            .fetch_optional(connection)
            .await
            .during(operation)?
            .ok_or(StoreError::NoSuchRun(run))?;
        let columns = columns::Columns::of(&row, operation);
        Ok(Self {
            scan_id: columns.get("scan_id")?,
            kind: columns.word("kind")?,
            deadband_n: columns.get("deadband_n")?,
        })
    }
}

impl Store {
    /// Returns the facts of a run, for a read.
    ///
    /// # Errors
    /// `NoSuchRun` if it is not stored; `Sql` or `Unreadable` if the read fails.
    pub(crate) async fn facts(
        &self,
        run: RunUid,
        operation: &'static str,
    ) -> Result<RunFacts, StoreError> {
        if let Some(facts) = self.known(run) {
            return Ok(facts);
        }
        let mut view = self.read(operation).await?;
        Ok(self.keep(run, RunFacts::read(&mut view, run, operation).await?))
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
    ) -> Result<RunFacts, StoreError> {
        self.facts_by(&self.inner.writer.patient(), run, operation).await
    }

    pub(crate) async fn facts_by(
        &self,
        writer: &Writer,
        run: RunUid,
        operation: &'static str,
    ) -> Result<RunFacts, StoreError> {
        if let Some(facts) = self.known(run) {
            return Ok(facts);
        }
        let read = async move |c: &mut SqliteConnection| RunFacts::read(c, run, operation).await;
        Ok(self.keep(run, writer.run(operation, read).await?))
    }

    fn known(&self, run: RunUid) -> Option<RunFacts> {
        self.inner.runs.lock().get(&run).copied()
    }

    pub(crate) fn keep(&self, run: RunUid, facts: RunFacts) -> RunFacts {
        self.inner.runs.lock().insert(run, facts);
        facts
    }
}
