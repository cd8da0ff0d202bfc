//! Plans of runs: kept once per content, compared with their sha256 when they are read.
//! Uses: `core`, `digest`. Never: the meaning of a plan (`schedule` in the bench chapter).

use sqlx::sqlite::SqliteConnection;

use crate::core::{During, Store, StoreError, StoreResult};
use crate::digest::sha256_hex;
use crate::ids::RunUid;

impl Store {
    /// Returns the plan that a run was queued with, JSON; `None` if none was kept.
    ///
    /// # Errors
    /// `Damaged` if the text differs from its sha256; `NoSuchRun` if the run is not stored; `Sql` if
    /// the read fails.
    pub async fn plan_of(&self, run: RunUid) -> StoreResult<Option<String>> {
        let row: Option<(Option<String>, Option<String>)> = sqlx::query_as(
            "SELECT r.plan_sha256, p.plan FROM runs r LEFT JOIN plans p ON p.sha256 = r.plan_sha256
             WHERE r.uid = ?1",
        )
        .bind(run.to_string())
        .fetch_optional(&self.inner.readers)
        .await
        .during("reading the plan of a run")?;
        match row {
            None => Err(StoreError::NoSuchRun(run)),
            Some((None, _)) => Ok(None),
            Some((Some(sha256), Some(plan))) if sha256_hex(&plan) == sha256 => Ok(Some(plan)),
            Some(_) => Err(StoreError::damaged(format!(
                "the plan of run {run} was changed after it was stored"
            ))),
        }
    }

    /// Keeps the plan of a run that has none: one that an older version queued. A run that has a plan
    /// is not changed.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn keep_plan(&self, run: RunUid, plan: String) -> StoreResult<()> {
        const OPERATION: &str = "keeping the plan of a run";
        self.write(OPERATION, async move |connection| {
            let sha256 = keep(&mut *connection, &plan, OPERATION).await?;
            sqlx::query("UPDATE runs SET plan_sha256 = ?2 WHERE uid = ?1 AND plan_sha256 IS NULL")
                .bind(run.to_string())
                .bind(sha256)
                .execute(connection)
                .await
                .during(OPERATION)?;
            Ok(())
        })
        .await
    }
}

/// Removes a plan that no run has.
pub(super) async fn discard(
    connection: &mut SqliteConnection,
    sha256: &str,
    operation: &'static str,
) -> StoreResult<()> {
    sqlx::query(
        "DELETE FROM plans
         WHERE sha256 = ?1 AND NOT EXISTS (SELECT 1 FROM runs WHERE plan_sha256 = ?1)",
    )
    .bind(sha256)
    .execute(connection)
    .await
    .during(operation)?;
    Ok(())
}

/// Stores a plan unless an equal one is stored; replaces a stored one that was damaged. Returns its
/// sha256.
pub(super) async fn keep(
    connection: &mut SqliteConnection,
    plan: &str,
    operation: &'static str,
) -> StoreResult<String> {
    let sha256 = sha256_hex(plan);
    sqlx::query(
        "INSERT INTO plans (sha256, plan) VALUES (?1, ?2)
         ON CONFLICT (sha256) DO UPDATE SET plan = excluded.plan WHERE plan <> excluded.plan",
    )
    .bind(&sha256)
    .bind(plan)
    .execute(connection)
    .await
    .during(operation)?;
    Ok(sha256)
}
