//! Progress of a run along its tour: what is stored, what failed, where it is and where it goes next.
//! Uses: `tour`, `store`, `campaign::shown::status`. Never: a wait of the campaign.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use axum::Json;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sim_core::stats::median;
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiResult, Path};
use super::runs::find;
use super::tour::Tour;
use crate::campaign::shown::status::RunStatus;
use crate::state::StoredState;
use crate::store::{RunRow, StoredParts};

/// Progress of a run. Lists have one entry for each configuration of the tour, in its order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunProgress {
    /// Number of trials in the plan.
    pub trials_planned: u64,
    /// Number of stored trials.
    pub trials_stored: u64,
    /// Number of stored trials of each configuration.
    pub stored: Vec<u16>,
    /// Number of failed attempts at each configuration.
    pub attempts_failed: Vec<u16>,
    /// Indices in the tour of the configurations that were given up.
    pub skipped: Vec<usize>,
    /// Index in the tour of the configuration that is being driven; null without one.
    pub current: Option<usize>,
    /// Index in the tour of the next configuration; null if none remains or the run has ended.
    pub next: Option<usize>,
    /// Largest force of the trials of each configuration, N, rounded to 1 mN; null if none was measured.
    pub largest_force_n: Vec<Option<f64>>,
    /// The largest forces, for each number of tips.
    pub forces_by_tips: Vec<ForcesOfTips>,
    /// Median FVU of the twins of each configuration, rounded to 0.0001; null without twins.
    pub fvu: Vec<Option<f64>>,
    /// Time of this progress; the stored part of it may be 2 s older, or more on a slow disk.
    pub at: Timestamp,
}

/// Largest forces of the configurations with one number of tips.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ForcesOfTips {
    /// Number of tips.
    pub tips: u8,
    /// Number of configurations whose force was measured.
    pub configurations: u32,
    /// Median of their largest forces, N.
    pub median_n: f64,
    /// The largest one, N.
    pub largest_n: f64,
}

/// Returns the progress of a run along its tour.
#[utoipa::path(get, operation_id = "run_progress", path = "/api/v1/runs/{run}/progress",
    tag = "runs", responses((status = 200, body = RunProgress),
        (status = 404, description = "no run has this uid or scan_id, or it has no plan")))]
pub async fn of_run(app: App, Path(run): Path<String>) -> ApiResult<Json<RunProgress>> {
    let run = find(&app, &run).await?;
    let kept = app.tour(&run).await?;
    Ok(Json(along(&app, &run, &kept.tour).await?))
}

/// The progress of a run along its tour.
pub(super) async fn along(app: &App, run: &RunRow, tour: &Tour) -> ApiResult<RunProgress> {
    let reading = async { app.store.progress_by_configuration(run.uid).await.map(Arc::new) };
    let stored = app.facts.memory.progress.get(run.uid, reading).await?;
    let active = app.campaign.status().run.filter(|active| active.uid == run.uid);
    let now = Now {
        trials_planned: run.trials_planned,
        is_over: (run.exit_status.is_some() && !run.is_resumable)
            || run.state == StoredState::Removed,
        driven: active.as_ref().and_then(driven),
        at: Timestamp::now(),
    };
    Ok(progress(tour, &stored, now))
}

/// State of a run.
#[derive(Debug, Clone, Copy)]
struct Now {
    trials_planned: u64,
    /// Whether nothing of it remains to be driven.
    is_over: bool,
    /// Configuration that is being driven.
    driven: Option<u32>,
    at: Timestamp,
}

/// Arranges what is stored in the order of the tour.
fn progress(tour: &Tour, stored: &StoredParts, now: Now) -> RunProgress {
    let order = &tour.steps.configuration;
    let index: HashMap<u32, usize> = order.iter().enumerate().map(|(i, c)| (*c, i)).collect();
    let of = |configuration: &u32| index.get(configuration).copied();
    let mut shown = RunProgress {
        trials_planned: now.trials_planned,
        trials_stored: stored.trials.iter().map(|c| u64::from(c.stored)).sum(),
        stored: vec![0; order.len()],
        attempts_failed: vec![0; order.len()],
        skipped: stored.skipped.iter().filter_map(of).collect(),
        largest_force_n: vec![None; order.len()],
        fvu: vec![None; order.len()],
        at: now.at,
        ..RunProgress::default()
    };
    shown.skipped.sort_unstable();
    let count = |n: u32| u16::try_from(n).unwrap_or(u16::MAX);
    for c in &stored.trials {
        if let Some(i) = of(&c.part) {
            shown.stored[i] = count(c.stored);
            shown.largest_force_n[i] = c.largest_force_n.map(|f| rounded(f, 1e3));
        }
    }
    shown.forces_by_tips = by_tips(&tour.steps.tips, &shown.largest_force_n);
    for (configuration, failed) in &stored.attempts_failed {
        if let Some(i) = of(configuration) {
            shown.attempts_failed[i] = count(*failed);
        }
    }
    for (configuration, fvu) in &stored.median_fvu {
        if let Some(i) = of(configuration) {
            shown.fvu[i] = Some(rounded(*fvu, 1e4));
        }
    }
    shown.current = now.driven.as_ref().and_then(of);
    if !now.is_over {
        let is_open = |i: &usize| {
            u32::from(shown.stored[*i]) < tour.trials_each()
                && shown.current != Some(*i)
                && shown.skipped.binary_search(i).is_err()
        };
        shown.next = (0..order.len()).find(is_open);
    }
    shown
}

/// The largest forces of the configurations, for each number of tips.
fn by_tips(tips: &[u8], largest_n: &[Option<f64>]) -> Vec<ForcesOfTips> {
    let mut forces: BTreeMap<u8, Vec<f64>> = BTreeMap::new();
    for (tips, force_n) in tips.iter().zip(largest_n) {
        if let Some(force_n) = force_n {
            forces.entry(*tips).or_default().push(*force_n);
        }
    }
    let of = |(tips, forces): (u8, Vec<f64>)| {
        Some(ForcesOfTips {
            tips,
            configurations: forces.len() as u32,
            median_n: median(forces.iter().copied())?,
            largest_n: forces.iter().copied().reduce(f64::max)?,
        })
    };
    forces.into_iter().filter_map(of).collect()
}

/// Configuration that a run is driving; none while it waits.
fn driven(run: &RunStatus) -> Option<u32> {
    match run.state {
        StoredState::Running | StoredState::Pausing | StoredState::Stopping => {
            run.trial.map(|key| key.configuration)
        }
        StoredState::Queued
        | StoredState::Idle
        | StoredState::Paused
        | StoredState::Aborting
        | StoredState::Suspending
        | StoredState::Panicked
        | StoredState::Interrupted
        | StoredState::Ended
        | StoredState::Removed => None,
    }
}

/// Rounds to a multiple of 1 / `per_unit`.
fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::visits::Visits;
    use crate::store::{PartTrials, RunKind};

    fn tour() -> Tour {
        // Driven in another order than that of the indices.
        let steps = Visits {
            configuration: vec![2, 0, 1, 3],
            tips: vec![1; 4],
            contacts_mm: vec![vec![[0.0, 0.0]]; 4],
        };
        Tour {
            scan_id: 1,
            experiment: "t".into(),
            kind: RunKind::RealHex,
            depths_mm: vec![0.0, 0.5],
            force_limit_n: None,
            force_sum_limit_n: None,
            steps,
        }
    }

    fn stored() -> StoredParts {
        let trials = |part, stored| PartTrials { part, stored, largest_force_n: Some(1.23456) };
        StoredParts {
            trials: vec![trials(0, 1), trials(2, 2)],
            attempts_failed: vec![(0, 3), (99, 1)],
            skipped: vec![1],
            median_fvu: vec![(2, 0.123456)],
        }
    }

    #[test]
    fn forces_are_grouped_by_the_number_of_tips() {
        let found = by_tips(&[3, 1, 1, 3, 2], &[Some(9.0), Some(4.0), Some(1.0), None, None]);
        let of = |tips, configurations, median_n, largest_n| ForcesOfTips {
            tips,
            configurations,
            median_n,
            largest_n,
        };
        assert_eq!(found, [of(1, 2, 2.5, 4.0), of(3, 1, 9.0, 9.0)]);
    }

    #[test]
    fn lists_are_in_the_order_of_the_tour() {
        let at = Timestamp::UNIX_EPOCH;
        let now = Now { trials_planned: 8, is_over: false, driven: Some(0), at };
        let shown = progress(&tour(), &stored(), now);
        assert_eq!(shown.stored, [2, 1, 0, 0]);
        assert_eq!(shown.attempts_failed, [0, 3, 0, 0]);
        assert_eq!(shown.skipped, [2]);
        assert_eq!(shown.largest_force_n, [Some(1.235), Some(1.235), None, None]);
        let forces = ForcesOfTips { tips: 1, configurations: 2, median_n: 1.235, largest_n: 1.235 };
        assert_eq!(shown.forces_by_tips, [forces]);
        assert_eq!(shown.fvu, [Some(0.1235), None, None, None]);
        assert_eq!((shown.current, shown.next, shown.trials_stored), (Some(1), Some(3), 3));
        // A run that waits resumes at the incomplete configuration.
        let shown = progress(&tour(), &stored(), Now { driven: None, ..now });
        assert_eq!((shown.current, shown.next), (None, Some(1)));
        let shown = progress(&tour(), &stored(), Now { driven: None, is_over: true, ..now });
        assert_eq!((shown.current, shown.next), (None, None));
    }
}
