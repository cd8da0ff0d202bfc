//! Makes the dataset of each run that has ended, Parquet file and card. The file is written while the run is
//! active, 1000 trials at a time, so that little is missing when it ends. One for which the disk has no room, or that
//! the store could not answer for, is made later.
//! Uses: `dataset`, `twins`, `store`. Never: more than a few seconds of work at a time while a run is active.

use std::collections::{HashMap, HashSet};
use std::time::Duration;

use jiff::Timestamp;
use tokio::time::{sleep, timeout};
use tracing::Instrument;

use super::App;
use crate::campaign::spans::run_span;
use crate::dataset::definition::Definition;
use crate::dataset::error::DatasetError;
use crate::dataset::space::KEPT_FREE_BYTES;
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::store::RunKind;

/// Interval of checking for runs that have ended, and for trials of the active run.
const FINISHED_POLL: Duration = Duration::from_secs(5);
/// Interval of checking whether the active run has ended; then also of checking for its last twins.
const END_POLL: Duration = Duration::from_millis(500);
/// Number of such checks for its last twins.
const END_POLLS: u32 = 20;
/// Number of ended runs that are checked, the last ones by their times, and as many of the newest.
const CHECKED_RUNS: u32 = 20;
/// Number of tries to make a dataset that fail although nothing is wrong with the request.
const DATASET_TRIES: u32 = 10;

/// An end of a run; a stopped run may be resumed, and ends again.
type End = (RunUid, Option<Timestamp>);

/// What became of the dataset of an end.
#[derive(Debug, Default)]
struct Outcome {
    /// Number of tries that failed although nothing is wrong with the request.
    failed: u32,
    /// Free space of the disk from which on it is tried again, bytes; absent if it is not.
    awaited: Option<u64>,
}

/// The ends of runs whose datasets were made, or could not be.
#[derive(Debug, Default)]
struct Handled(HashMap<End, Outcome>);

impl Handled {
    /// Notes how the dataset of an end was made, with the error if it was not: it may wait for room on the disk, or for
    /// the store. Returns whether it is tried again.
    fn note(&mut self, end: End, error: Option<&DatasetError>) -> bool {
        let outcome = self.0.entry(end).or_default();
        outcome.awaited = match error {
            Some(DatasetError::DiskFull { needed, kept, .. }) => Some(needed.saturating_add(*kept)),
            Some(error) if error.may_pass() => {
                outcome.failed += 1;
                (outcome.failed < DATASET_TRIES).then_some(KEPT_FREE_BYTES)
            }
            _ => None,
        };
        outcome.awaited.is_some()
    }

    /// Whether nothing is to be made for an end. `free`: free space of the disk, bytes.
    fn has(&self, end: &End, free: u64) -> bool {
        let is_done = |outcome: &Outcome| outcome.awaited.is_none_or(|awaited| free < awaited);
        self.0.get(end).is_some_and(is_done)
    }
}

/// Writes the trials of the active run ahead, and makes the dataset of every run that has ended and has its
/// twins: while a run is active, only that of a run whose file was begun.
pub async fn keep(app: App) {
    let (mut handled, mut given_up, mut soon) = (Handled::default(), HashSet::new(), 0_u32);
    loop {
        let before = app.campaign.status().run.map(|run| run.uid);
        let changed = async {
            while app.campaign.status().run.map(|run| run.uid) == before {
                sleep(END_POLL).await;
            }
        };
        // The next check is due after this time without a change, too.
        let _ = timeout(if soon > 0 { END_POLL } else { FINISHED_POLL }, changed).await;
        let active = app.campaign.status().run.map(|run| (run.uid, run.scan_id));
        let has_ended = before.is_some() && active.map(|(run, _)| run) != before;
        soon = if has_ended { END_POLLS } else { soon.saturating_sub(1) };
        if let Some((run, scan_id)) = active
            && !given_up.contains(&run)
        {
            let writing = app.datasets.write_ahead(run, scan_id);
            if let Err(error) = writing.instrument(run_span(run, scan_id)).await {
                let error = error_chain(&error);
                tracing::info!(error, "the dataset of this run is written when it has ended");
                given_up.insert(run);
            }
        }
        let begun = app.datasets.begun().filter(|begun| active.is_none_or(|(_, id)| id != *begun));
        if active.is_some() && begun.is_none() {
            continue;
        }
        let runs = match app.store.ended_runs(CHECKED_RUNS).await {
            Ok(runs) => runs,
            Err(error) => {
                tracing::warn!(error = error_chain(&error), "the runs could not be read");
                continue;
            }
        };
        // Unknown: as a full disk.
        let free = app.store.free_bytes().await.unwrap_or(0);
        for run in &runs {
            let this = (run.uid, run.ended_at);
            if handled.has(&this, free) || active.is_some() && begun != Some(run.scan_id) {
                continue;
            }
            // An import may be of a skin without a model: its twins are not awaited.
            let twins_wait = match app.twins.awaits(run.uid).await {
                Ok(awaits) => awaits && run.kind != RunKind::Imported,
                Err(_) => true,
            };
            if twins_wait {
                continue;
            }
            let making = async {
                let made = app.datasets.make(&Definition::of_run(run.scan_id)).await.err();
                let is_tried_again = handled.note(this, made.as_ref());
                let Some(failed) = made else { return false };
                let error = error_chain(&failed);
                if is_tried_again {
                    let words = "the dataset of an ended run is made later";
                    tracing::warn!(error, "{words}");
                } else {
                    tracing::info!(error, "the dataset of an ended run was not made");
                }
                is_tried_again
            };
            if making.instrument(run_span(run.uid, run.scan_id)).await {
                // Its tries must not be used up in seconds.
                soon = 0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::error::Product;

    #[test]
    fn a_dataset_for_which_the_disk_had_no_room_is_made_once_it_has() {
        let (end, mut handled) = ((RunUid::new(), None), Handled::default());
        assert!(!handled.has(&end, 0), "a new end");
        let product = Product::Dataset;
        let full = DatasetError::DiskFull { product, needed: 30, free: 80, kept: 100 };
        assert!(handled.note(end, Some(&full)));
        assert!(handled.has(&end, 129) && !handled.has(&end, 130));
        for error in [None, Some(&DatasetError::Worker)] {
            assert!(!handled.note(end, error));
            assert!(handled.has(&end, u64::MAX), "{error:?}");
        }
    }

    #[test]
    fn a_dataset_whose_disk_became_full_while_it_was_written_is_tried_again_up_to_a_limit() {
        let (end, mut handled) = ((RunUid::new(), None), Handled::default());
        let (operation, path) = ("writing", "ds-1.parquet".into());
        let source = std::io::ErrorKind::StorageFull.into();
        let full = DatasetError::File { operation, path, source };
        for _ in 1..DATASET_TRIES {
            assert!(handled.note(end, Some(&full)));
            assert!(handled.has(&end, KEPT_FREE_BYTES - 1) && !handled.has(&end, KEPT_FREE_BYTES));
        }
        assert!(!handled.note(end, Some(&full)));
        assert!(handled.has(&end, u64::MAX));
    }
}
