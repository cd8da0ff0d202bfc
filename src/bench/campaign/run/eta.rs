//! Remaining time of a run, from its measured pace or, before it has one, from the plan.
//! PURE. Uses: `campaign::shown::status`. Never: the clock (durations are passed in).

use crate::campaign::shown::status::Eta;

/// Half width of the band that contains 90 % of a normal distribution, in standard deviations.
const BAND_SD: f64 = 1.645;
/// Share of the estimate that remains uncertain at any pace (a retry, a slow disk).
const FLOOR_SHARE: f64 = 0.02;
/// Relative half width assumed while the run has no measured pace.
const PLAN_SHARE: f64 = 0.15;

/// Running mean and spread of the wall time per trial, over configurations.
#[derive(Debug, Clone, Default)]
pub struct Pace {
    predicted_s: f64,
    trials: f64,
    total_s: f64,
    configurations: f64,
    mean_s: f64,
    m2: f64,
}

impl Pace {
    /// Starts from the plan: predicted wall seconds per trial.
    pub fn predicted(per_trial_s: f64) -> Self {
        Self { predicted_s: per_trial_s, ..Self::default() }
    }

    /// Adds the duration of `trials` trials of one configuration, wall s.
    pub fn note(&mut self, trials: u32, wall_s: f64) {
        if trials == 0 {
            return;
        }
        let per_trial = wall_s / f64::from(trials);
        self.trials += f64::from(trials);
        self.total_s += wall_s;
        self.configurations += 1.0;
        let delta = per_trial - self.mean_s;
        self.mean_s += delta / self.configurations;
        self.m2 += delta * (per_trial - self.mean_s);
    }

    /// Remaining time for `remaining` trials in configurations of `depths` trials, wall s.
    pub fn eta(&self, remaining: u64, depths: u32) -> Eta {
        let n = remaining as f64;
        if self.configurations < 3.0 {
            let s = n * self.predicted_s;
            return band(s, PLAN_SHARE * s);
        }
        let per_trial = self.total_s / self.trials;
        let sd = (self.m2 / (self.configurations - 1.0)).sqrt();
        let configurations = (n / f64::from(depths.max(1))).max(1.0);
        let trials_each = n / configurations;
        // Spread of the sum, and error of the mean from which it is predicted.
        let spread = sd * trials_each * configurations.sqrt();
        let mean_error = sd / self.configurations.sqrt() * n;
        let s = n * per_trial;
        band(s, BAND_SD * spread.hypot(mean_error) + FLOOR_SHARE * s)
    }
}

fn band(s: f64, half: f64) -> Eta {
    Eta { remaining_s: s, low_s: (s - half).max(0.0), high_s: s + half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_pace_follows_the_plan() {
        let eta = Pace::predicted(2.5).eta(100, 11);
        assert_eq!(eta.remaining_s, 250.0);
        assert!(eta.low_s < 250.0 && eta.high_s > 250.0);
    }

    #[test]
    fn the_band_narrows_with_the_number_of_configurations_seen() {
        let mut early = Pace::predicted(2.5);
        let mut late = Pace::predicted(2.5);
        for i in 0..200 {
            let wall_s = 30.0 + f64::from(i % 5);
            if i < 5 {
                early.note(11, wall_s);
            }
            late.note(11, wall_s);
        }
        let (early, late) = (early.eta(1100, 11), late.eta(1100, 11));
        assert!(early.high_s - early.low_s > late.high_s - late.low_s);
        assert!((late.remaining_s - 3200.0).abs() < 40.0, "{late:?}");
    }
}
