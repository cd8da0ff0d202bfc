//! The facts of a run that never change, kept in memory: every insert and most queries need them.
//! Uses: `core::{store, writer}`. Never: a state of the run, which changes.

use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteConnection;
use utoipa::ToSchema;

use super::columns;
use super::error::{During, StoreError};
use super::store::Store;
use super::writer::Writer;
use crate::ids::RunUid;

/// Where trials come from: the two measured experiments of Table I, or elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RunKind {
    /// The multi-point indenter's; contacts under the deadband are removed from the labels.
    RealHex,
    /// Weights placed by hand; nominal contacts are all kept, also under the deadband.
    RealRandom,
    /// Trials measured elsewhere, with contacts as they were handed in.
    Imported,
}

impl RunKind {
    /// The kind as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        match self {
            RunKind::RealHex => "real-hex",
            RunKind::RealRandom => "real-random",
            RunKind::Imported => "imported",
        }
    }
}

/// Whether a skin was touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Label {
    /// On a real rig.
    Measured,
    /// On the virtual rig.
    Virtual,
    /// Nowhere: computed by somebody's model, and imported.
    Simulated,
}

impl Label {
    /// The label as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        match self {
            Label::Measured => "measured",
            Label::Virtual => "virtual",
            Label::Simulated => "simulated",
        }
    }
}

/// What never changes in a run and every insert needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RunFacts {
    pub(crate) scan_id: i64,
    pub(crate) kind: RunKind,
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
    /// What every insert of a run needs, for reads.
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

    /// The same for the campaign: however many read, it is not kept waiting for a connection.
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
