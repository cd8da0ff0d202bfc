//! The wait for rows: of a dataset that the service makes, of an import that it stores, or of blocking work in this
//! process, with those that are done.
//! Uses: `client`, `progress`. Never: the work itself.

use std::future::ready;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use serde::Deserialize;

use super::client::Client;
use super::error::CliResult;
use super::progress::counted_wait;
use crate::dataset::build::Progress;
use crate::dataset::error::DatasetError;
use crate::dataset::making::{Making, MakingKind};

/// What a service makes.
#[derive(Deserialize)]
struct AllMade {
    /// Absent from an older service.
    #[serde(default)]
    making: Vec<Making>,
}

/// Waits for the answer to a request for a dataset, and shows the progress of the one that is made.
///
/// # Errors
/// That of the answer.
pub async fn dataset<T>(
    client: &Client,
    answer: impl Future<Output = CliResult<T>>,
) -> CliResult<T> {
    // One is made at a time, and the other ones wait for it.
    let is_this = |one: &Making| one.kind == MakingKind::Dataset;
    counted_wait("making the dataset", "rows", || rows(client, is_this), answer).await
}

/// Waits for the answer to an import of this name, and shows how many of its trials are stored.
///
/// # Errors
/// That of the answer.
pub async fn import<T>(
    client: &Client,
    name: &str,
    answer: impl Future<Output = CliResult<T>>,
) -> CliResult<T> {
    let is_this = |one: &Making| one.kind == MakingKind::Import && one.name == name.trim();
    let stored = || rows(client, is_this);
    counted_wait("storing the trials", "trials stored", stored, answer).await
}

/// Carries out blocking work that counts its rows, and shows those that are done.
///
/// # Errors
/// Those of the work; `Worker` if it panics.
pub async fn here<T: Send + 'static>(
    words: &str,
    unit: &'static str,
    work: impl FnOnce(&Progress) -> Result<T, DatasetError> + Send + 'static,
) -> Result<T, DatasetError> {
    let progress = Arc::<Progress>::default();
    let own = progress.clone();
    let working = tokio::task::spawn_blocking(move || work(&own));
    let count = || {
        let total = progress.total.load(Relaxed);
        ready((total > 0).then(|| (progress.done.load(Relaxed), total)))
    };
    counted_wait(words, unit, count, working).await.unwrap_or(Err(DatasetError::Worker))
}

/// Number of rows that are done, and of all, of work that has counted them.
async fn rows(client: &Client, is_this: impl Fn(&Making) -> bool) -> Option<(u64, u64)> {
    let all: AllMade = client.quiet().get("/api/v1/datasets?limit=1").await.ok()?;
    counted(&all, is_this)
}

fn counted(all: &AllMade, is_this: impl Fn(&Making) -> bool) -> Option<(u64, u64)> {
    let one = all.making.iter().find(|one| one.rows_total > 0 && is_this(one))?;
    Some((one.rows_done, one.rows_total))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_work_that_has_counted_its_rows_is_shown() {
        let one = |kind, name: &str, rows_done, rows_total| Making {
            kind,
            name: name.into(),
            rows_done,
            rows_total,
        };
        let making = vec![
            one(MakingKind::Dataset, "waits", 0, 0),
            one(MakingKind::Import, "pad", 3, 9),
            one(MakingKind::Dataset, "real", 12, 40),
        ];
        let answer = json!({ "items": [], "making": making });
        let busy: AllMade = serde_json::from_value(answer).unwrap();
        assert_eq!(counted(&busy, |one| one.kind == MakingKind::Dataset), Some((12, 40)));
        assert_eq!(counted(&busy, |one| one.name == "pad"), Some((3, 9)));
        assert_eq!(counted(&busy, |one| one.name == "waits"), None);
        let older: AllMade = serde_json::from_value(json!({ "items": [] })).unwrap();
        assert_eq!(counted(&older, |_| true), None);
    }
}
