//! The forces of a run over depth: quartiles of the largest force of a trial, also for reports.
//! Uses: `store`. Never: a trial by itself (`trials` has it).

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use sim_core::stats::{quantile, sorted};
use utoipa::ToSchema;

use super::App;
use super::pages::Page;
use super::problem::{ApiError, ApiResult, Path};
use super::runs::find;
use crate::store::DepthForce;

/// Largest forces of the trials at one depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ForcesAtDepth {
    /// Number of tips of the trials; null: of all trials.
    pub tips: Option<u8>,
    /// Planned depth, mm.
    pub depth_mm: f64,
    /// Number of trials.
    pub trials: u64,
    /// First quartile, N.
    pub q1_n: f64,
    /// Median, N.
    pub median_n: f64,
    /// Third quartile, N.
    pub q3_n: f64,
}

/// Returns the largest forces of the trials of a run over depth: first of all trials, then for each number of tips.
#[utoipa::path(get, operation_id = "run_forces", path = "/api/v1/runs/{run}/forces", tag = "runs",
    responses((status = 200, body = Page<ForcesAtDepth>)))]
pub async fn of_run(app: App, Path(run): Path<String>) -> ApiResult<Page<ForcesAtDepth>> {
    let run = find(&app, &run).await?;
    let forces = app.store.forces_over_depth(run.uid).await?;
    // To sort those of 198,000 trials is not for a thread that answers requests.
    let found = tokio::task::spawn_blocking(move || over_depth(&forces)).await;
    Ok(Page::whole(found.map_err(ApiError::internal)?))
}

/// Forces of all trials, then of each number of tips.
fn over_depth(forces: &[DepthForce]) -> Vec<ForcesAtDepth> {
    let tips: BTreeSet<u8> = forces.iter().map(|force| force.tips).collect();
    let groups = std::iter::once(None).chain(tips.into_iter().map(Some));
    let of_group = |tips: Option<u8>| {
        let group = forces.iter().filter(|force| tips.is_none_or(|tips| tips == force.tips));
        forces_by_depth(tips, group.map(|force| (force.depth_mm, force.force_n)))
    };
    groups.flat_map(of_group).collect()
}

/// Quartiles of forces by depth, in ascending order of depth. `values`: depth, mm, and force, N; a value that is not
/// finite is skipped. `tips` is that of their trials, or none.
pub fn forces_by_depth(
    tips: Option<u8>,
    values: impl Iterator<Item = (f64, f64)>,
) -> Vec<ForcesAtDepth> {
    // Depths are planned to 0.01 mm.
    let mut groups = BTreeMap::<i64, Vec<f64>>::new();
    for (depth_mm, force_n) in
        values.filter(|(depth, force)| depth.is_finite() && force.is_finite())
    {
        groups.entry((depth_mm * 100.0).round() as i64).or_default().push(force_n);
    }
    let quartiles = |(depth, forces): (i64, Vec<f64>)| {
        let sorted = sorted(forces);
        Some(ForcesAtDepth {
            tips,
            depth_mm: depth as f64 / 100.0,
            trials: sorted.len() as u64,
            q1_n: quantile(&sorted, 0.25)?,
            median_n: quantile(&sorted, 0.5)?,
            q3_n: quantile(&sorted, 0.75)?,
        })
    };
    groups.into_iter().filter_map(quartiles).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_have_quartiles_at_each_depth_of_all_trials_and_of_each_number_of_tips() {
        let force = |tips, depth_mm, force_n| DepthForce { tips, depth_mm, force_n };
        let found = over_depth(&[
            force(1, 0.5, 2.0),
            force(3, 0.0, 1.0),
            force(1, 0.5, 4.0),
            force(3, 0.501, 3.0),
        ]);
        let keys: Vec<_> = found.iter().map(|at| (at.tips, at.depth_mm, at.trials)).collect();
        let of_all = [(None, 0.0, 1), (None, 0.5, 3)];
        let of_each = [(Some(1), 0.5, 2), (Some(3), 0.0, 1), (Some(3), 0.5, 1)];
        assert_eq!(keys, [&of_all[..], &of_each].concat());
        assert_eq!((found[1].q1_n, found[1].median_n, found[1].q3_n), (2.5, 3.0, 3.5));
    }

    #[test]
    fn a_force_that_is_not_finite_is_skipped() {
        let values = [(0.5, 2.0), (0.0, 1.0), (0.5, 4.0), (0.501, 3.0), (1.0, f64::NAN)];
        let found = forces_by_depth(None, values.into_iter());
        let counts: Vec<_> = found.iter().map(|at| (at.depth_mm, at.trials)).collect();
        assert_eq!(counts, [(0.0, 1), (0.5, 3)]);
        assert_eq!((found[1].q1_n, found[1].median_n, found[1].q3_n), (2.5, 3.0, 3.5));
        assert!(forces_by_depth(None, std::iter::empty()).is_empty());
    }
}
