//! What the loop of the pool knows between two pages: which trials it has passed, and which it has given up.
//! Uses: `store`'s rows, `twins::{make, drift}`. Never: the store itself, a simulation.

use std::collections::{HashMap, HashSet};

use tokio::task::JoinError;

use super::PoolError;
use super::drift::DriftWatch;
use super::make::Recipe;
use crate::ids::{RunUid, TrialId};
use crate::store::Twin;

/// Number of panics of a worker over one page after which the page is set aside.
const PAGE_PANICS: u32 = 3;

/// State of the loop between two pages.
#[derive(Default)]
pub(super) struct Progress {
    /// Recipes of runs with pending trials.
    pub(super) recipes: HashMap<RunUid, Recipe>,
    /// The last trial that was read, per run.
    pub(super) passed: HashMap<RunUid, TrialId>,
    /// Runs without pending trials.
    pub(super) done: HashSet<RunUid>,
    /// Runs whose files are invalid, or that have a damaged trial.
    pub(super) unusable: HashSet<RunUid>,
    /// Panics of a worker over a page, by its first trial; 0: over the model of the run.
    panics: HashMap<(RunUid, TrialId), u32>,
    /// Trials of pages that were set aside. The next process tries them again.
    pub(super) set_aside: HashSet<TrialId>,
    pub(super) watch: Option<(RunUid, DriftWatch)>,
}

impl Progress {
    /// The runs of which no further twin is made.
    pub(super) fn settled(&self) -> HashSet<RunUid> {
        self.done.union(&self.unusable).copied().collect()
    }

    /// Counts a panic over a page that begins with this trial. Returns whether it is not tried again.
    pub(super) fn panicked(&mut self, run: RunUid, first: TrialId) -> bool {
        let panics = self.panics.entry((run, first)).or_default();
        *panics += 1;
        *panics >= PAGE_PANICS
    }

    /// Returns the twins of a page. The page has none if it is set aside, because a worker panics over it each time:
    /// other pages and older runs still get their twins.
    ///
    /// # Errors
    /// `PoolError::Worker` if a worker panicked, and the page is tried again.
    pub(super) fn made(
        &mut self,
        run: RunUid,
        page: &[TrialId],
        made: Result<Vec<Twin>, JoinError>,
    ) -> Result<Vec<Twin>, PoolError> {
        let panic = match made {
            Ok(twins) => return Ok(twins),
            Err(panic) => panic,
        };
        let first = page.first().copied().unwrap_or(TrialId(0));
        if !self.panicked(run, first) {
            return Err(PoolError::Worker);
        }
        let (trials, first) = (page.len(), first.0);
        tracing::error!(%panic, first, trials, "trials get no twins before the next start");
        self.set_aside.extend(page);
        Ok(Vec::new())
    }
}

#[cfg(test)]
mod tests {
    use tokio::task::spawn_blocking;

    use super::*;
    use crate::store::TwinOutcome;

    #[tokio::test]
    async fn a_page_over_which_a_worker_panics_is_set_aside_and_others_get_their_twins() {
        let (mut progress, [run, older]) = (Progress::default(), [RunUid::new(), RunUid::new()]);
        let panics = async || spawn_blocking(|| -> Vec<Twin> { panic!("a test") }).await;
        let (page, next) = ([1, 2].map(TrialId), [3, 4].map(TrialId));
        for _ in 1..PAGE_PANICS {
            let made = progress.made(run, &page, panics().await);
            assert!(matches!(made, Err(PoolError::Worker)), "it is tried again: {made:?}");
            assert!(progress.set_aside.is_empty());
        }
        let made = progress.made(run, &page, panics().await);
        assert!(made.is_ok_and(|twins| twins.is_empty()), "the loop continues after it");
        assert_eq!(progress.set_aside, HashSet::from(page));
        for (run, page) in [(run, next), (older, page)] {
            assert!(progress.made(run, &page, panics().await).is_err(), "its first panic");
        }
        let outcome = TwinOutcome::Failure("a contact off the skin".into());
        let twins = vec![Twin { trial: next[0], outcome }];
        let made = progress.made(run, &next, Ok(twins.clone()));
        assert_eq!(made.unwrap(), twins);
        assert!(progress.made(run, &[], Ok(Vec::new())).is_ok(), "all of a page are set aside");
    }
}
