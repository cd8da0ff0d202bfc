//! Agreement of voltages with simulated ones, by the number of contacts (paper, Table III).
//! PURE. Uses: sim-core's quantiles. Never: nets.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use sim_core::stats::{quantile, sorted};
use utoipa::ToSchema;

/// Trials with a given number of contacts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct VoltageScore {
    /// Number of contacts of each trial; all trials if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contacts: Option<u32>,
    /// Number of trials.
    pub trials: u64,
    /// Mean of the RMSE over a frame, V.
    pub rmse_v: f64,
    /// Mean FVU (Eq. 2), over trials whose target has variance.
    pub fvu: f64,
    /// Median FVU of these trials, a share.
    pub median_fvu: f64,
}

/// Scores of voltages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct VoltageScores {
    /// Over all trials.
    pub all: VoltageScore,
    /// For each number of contacts that occurs, ascending.
    pub by_contacts: Vec<VoltageScore>,
}

/// A trial: its number of contacts, RMSE (V), and FVU if its target has variance.
pub type VoltageFit = (u32, f64, Option<f64>);

impl VoltageScores {
    /// Computes the scores of trials; `None` without trials.
    pub fn of(fits: &[VoltageFit]) -> Option<Self> {
        let counts: BTreeSet<u32> = fits.iter().map(|fit| fit.0).collect();
        let of_count = |count: u32| {
            let chosen: Vec<VoltageFit> =
                fits.iter().copied().filter(|fit| fit.0 == count).collect();
            score(Some(count), &chosen)
        };
        let by_contacts = counts.into_iter().filter_map(of_count).collect();
        Some(Self { all: score(None, fits)?, by_contacts })
    }
}

fn score(contacts: Option<u32>, fits: &[VoltageFit]) -> Option<VoltageScore> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let rmse: Vec<f64> = fits.iter().map(|fit| fit.1).collect();
    let fvu = sorted(fits.iter().filter_map(|fit| fit.2));
    Some(VoltageScore {
        contacts,
        trials: fits.len() as u64,
        rmse_v: mean(&rmse),
        median_fvu: quantile(&fvu, 0.5)?,
        fvu: mean(&fvu),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trials_are_told_apart_by_their_contacts() {
        let fits = [(1, 0.1, Some(0.2)), (1, 0.3, Some(0.6)), (2, 0.5, Some(1.0)), (2, 0.7, None)];
        let scores = VoltageScores::of(&fits).unwrap();
        assert_eq!((scores.all.trials, scores.by_contacts.len()), (4, 2));
        let one = scores.by_contacts[0];
        assert!((one.rmse_v - 0.2).abs() < 1e-12 && (one.fvu - 0.4).abs() < 1e-12);
        assert_eq!(scores.by_contacts[1].trials, 2);
        assert_eq!(VoltageScores::of(&[]), None);
    }
}
