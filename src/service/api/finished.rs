//! What a run that has ended is given: its Parquet file and card.
//! Uses: `dataset`, `simulate::twins`, `store`. Never: work while a run is under way.

use std::time::Duration;

use super::App;
use crate::dataset::definition::Definition;
use crate::state::StoredState;
use crate::store::RunKind;

/// How often runs that have ended are looked for.
const LOOK_FOR_FINISHED: Duration = Duration::from_secs(5);
/// Runs that are looked at, newest first.
const FINISHED_AT_ONCE: u32 = 20;

/// Gives every run that has ended, and has its twins, its Parquet file and card; while no run is
/// under way.
pub async fn keep(app: App) {
    let mut kept = std::collections::HashSet::new();
    loop {
        tokio::time::sleep(LOOK_FOR_FINISHED).await;
        if app.campaign.status().run.is_some() {
            continue;
        }
        let runs = match app.store.runs(FINISHED_AT_ONCE, None).await {
            Ok(page) => page.runs,
            Err(error) => {
                tracing::warn!(%error, "finished runs are not looked for");
                continue;
            }
        };
        for run in runs.iter().filter(|run| run.state == StoredState::Ended) {
            // An import may be of a skin that has no model: nothing is waited for.
            let gets_twins = app.twins.status().workers > 0 && run.kind != RunKind::Imported;
            let twins_wait = match app.twins.count(run.uid).await {
                Ok(count) => gets_twins && count.pending() > 0,
                Err(_) => true,
            };
            if twins_wait || !kept.insert(run.uid) {
                continue;
            }
            if let Err(error) = app.datasets.make(&Definition::of_run(run.scan_id)).await {
                tracing::info!(run = run.scan_id, %error, "a finished run has no file");
            }
        }
    }
}
