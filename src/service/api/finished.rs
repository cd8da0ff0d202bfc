//! Makes the dataset of each run that has ended: Parquet file and card.
//! Uses: `dataset`, `twins`, `store`. Never: work while a run is active.

use std::time::Duration;

use tracing::Instrument;

use super::App;
use crate::campaign::spans::run_span;
use crate::dataset::definition::Definition;
use crate::journal::error_chain;
use crate::state::StoredState;
use crate::store::RunKind;

/// Interval of checking for runs that have ended.
const FINISHED_POLL: Duration = Duration::from_secs(5);
/// Number of runs that are checked, newest first.
const CHECKED_RUNS: u32 = 20;

/// Makes the dataset of every run that has ended and has its twins, while no run is active.
pub async fn keep(app: App) {
    let mut done = std::collections::HashSet::new();
    loop {
        tokio::time::sleep(FINISHED_POLL).await;
        if app.campaign.status().run.is_some() {
            continue;
        }
        let runs = match app.store.runs(CHECKED_RUNS, None).await {
            Ok(page) => page.runs,
            Err(error) => {
                tracing::warn!(error = error_chain(&error), "the runs could not be read");
                continue;
            }
        };
        for run in runs.iter().filter(|run| run.state == StoredState::Ended) {
            // An import may be of a skin without a model: its twins are not awaited.
            let gets_twins = app.twins.status().workers > 0 && run.kind != RunKind::Imported;
            let twins_wait = match app.twins.count(run.uid).await {
                Ok(count) => gets_twins && count.pending() > 0,
                Err(_) => true,
            };
            // A stopped run may have been resumed meanwhile.
            if twins_wait || !done.insert((run.uid, run.ended_at)) {
                continue;
            }
            let making = async {
                let made = app.datasets.make(&Definition::of_run(run.scan_id)).await;
                if let Err(error) = made {
                    let error = error_chain(&error);
                    tracing::info!(error, "the dataset of an ended run was not made");
                }
            };
            making.instrument(run_span(run.uid, run.scan_id)).await;
        }
    }
}
