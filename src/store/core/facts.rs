//! The facts of a run that never change once it has left the queue.
//! Uses: `core::columns`. Never: the state of a run, which changes.

use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteConnection;
use strum::IntoStaticStr;
use utoipa::ToSchema;

use super::columns::{Columns, row};
use super::error::{During, StoreError, StoreResult};
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

/// Facts of a run that never change once it has left the queue.
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
    /// Reads the facts of a run, and whether it is queued: an edit may still change them then.
    pub(super) async fn read(
        connection: &mut SqliteConnection,
        run: RunUid,
        operation: &'static str,
    ) -> StoreResult<(Self, bool)> {
        let row = sqlx::query(
            "SELECT scan_id, kind, deadband_n, state = 'queued' AS is_queued FROM runs WHERE uid = ?1",
        )
        .bind(run.to_string())
        .fetch_optional(connection)
        .await
        .during(operation)?
        .ok_or(StoreError::NoSuchRun(run))?;
        let columns = Columns::of(&row, operation);
        let facts = row!(columns, Self {}, get: scan_id, deadband_n; word: kind);
        Ok((facts, columns.get("is_queued")?))
    }
}
