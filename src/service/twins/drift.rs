//! The rolling fit of a run: detects a drift of the skin, or of one electrode, from the model.
//! PURE. Uses: sim-core's median, `evaluate::simulation`, `schedule` (the limits). Never: an action (the
//! caller takes it).

use std::collections::VecDeque;

use serde::Serialize;
use serde_json::json;
use sim_core::stats::median;
use utoipa::ToSchema;

use crate::evaluate::simulation::{PairFit, pair_fits};
use crate::schedule::experiment::TwinLimits;

/// Number of pairs of electrodes in a finding, the worst first.
const WORST_PAIRS: usize = 5;
/// Share of the window that must be filled before the fit is evaluated.
const WINDOW_SHARE: f64 = 0.5;
/// Share of its limit that a value must not exceed before a warning ends: a value that varies about its limit warns
/// once.
const END_SHARE: f64 = 0.8;

/// A trial with its twin.
#[derive(Debug, Clone)]
pub struct Pairing {
    /// Largest force, N.
    pub max_force_n: f64,
    /// Measured frame, V, injection-major.
    pub measured_v: Vec<f32>,
    /// Simulated frame, V.
    pub simulated_v: Vec<f32>,
    /// Fraction of variance unexplained of the measured frame.
    pub fvu: f64,
}

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Within all limits.
    Ok,
    /// Over a limit that warns.
    Warn,
    /// Over the limit that suspends the run.
    Suspend,
}

/// The fit over the window.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RollingFit {
    /// Severity of the fit.
    pub level: Level,
    /// Number of trials in the window, each with at least `min_force_n`.
    pub trials: usize,
    /// Median of the trials' FVU.
    pub median_fvu: f64,
    /// Number of electrode pairs over their limit.
    pub pairs_over_limit: usize,
    /// The worst pairs, at most five.
    pub worst_pairs: Vec<PairFit>,
}

impl RollingFit {
    /// Data of the event that reports a change of the level: a sentence, and the numbers that decided.
    pub fn event(&self, limits: &TwinLimits) -> serde_json::Value {
        json!({
            "level": self.level,
            "words": self.describe(limits),
            "median_fvu": self.median_fvu,
            "warn_fvu": limits.warn_fvu,
            "suspend_fvu": limits.suspend_fvu,
            "trials": self.trials,
            "pairs_over_limit": self.pairs_over_limit,
            "pair_warn_fvu": limits.pair_warn_fvu,
            "fit": self,
        })
    }

    /// Description as text, for events and for the reason of a suspended run.
    pub fn describe(&self, limits: &TwinLimits) -> String {
        let (level, limit) = match (self.level, limits.suspend_fvu) {
            (Level::Ok, _) => ("the model fits the skin again", limits.warn_fvu),
            (Level::Suspend, Some(limit)) => ("the model does not fit the skin", limit),
            (Level::Warn | Level::Suspend, _) => ("the model fits the skin badly", limits.warn_fvu),
        };
        let median = format!(
            "median FVU {:.2} (limit {limit:.2}) over the last {} trials of at least {} N",
            self.median_fvu, self.trials, limits.min_force_n
        );
        let Some(worst) = self.worst_pairs.first().filter(|_| self.pairs_over_limit > 0) else {
            return format!("{level}: {median}");
        };
        let [from, to] = worst.electrodes;
        let pairs = format!(
            "electrode pairs over FVU {}: {}, worst {from} and {to} at {:.2}",
            limits.pair_warn_fvu, self.pairs_over_limit, worst.fvu
        );
        // What exceeds its limit is first.
        match self.median_fvu > limit {
            true => format!("{level}: {median}; {pairs}"),
            false => format!("{level}: {pairs}; {median}"),
        }
    }
}

/// What has exceeded its limit since a warning began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Excess {
    /// Whether the median has.
    median: bool,
    /// Largest number of pairs of electrodes that have at the same time.
    pairs: usize,
}

/// The last trials of a run with their twins.
#[derive(Debug)]
pub struct DriftWatch {
    limits: TwinLimits,
    electrodes: usize,
    window: VecDeque<Pairing>,
    /// What was reported; nothing without a warning.
    warned: Excess,
}

impl DriftWatch {
    /// Starts with an empty window, for a sensor with `electrodes` electrodes.
    pub fn new(limits: TwinLimits, electrodes: usize) -> Self {
        Self { limits, electrodes, window: VecDeque::new(), warned: Excess::default() }
    }

    /// Limits of the experiment.
    pub fn limits(&self) -> &TwinLimits {
        &self.limits
    }

    /// Adds a trial; returns the fit if it suspends the run, if a warning begins or ends, and if more exceeds its limit
    /// than was reported: a standing warning must not hide another cause. After a suspension the window is cleared, so
    /// that a resumed run is not suspended again by the same trials.
    pub fn push(&mut self, pairing: Pairing) -> Option<RollingFit> {
        if pairing.max_force_n < self.limits.min_force_n {
            return None;
        }
        let window = self.limits.window as usize;
        while self.window.len() >= window {
            self.window.pop_front();
        }
        self.window.push_back(pairing);
        if (self.window.len() as f64) < WINDOW_SHARE * window as f64 {
            return None;
        }
        let fit = self.fit();
        let before = self.warned;
        match fit.level {
            Level::Suspend => {
                self.window.clear();
                self.warned = Excess::default();
                return Some(fit);
            }
            Level::Warn => {
                self.warned.median |= fit.median_fvu > self.limits.warn_fvu;
                self.warned.pairs = before.pairs.max(fit.pairs_over_limit);
            }
            Level::Ok if self.is_near_limit(&fit) => {}
            Level::Ok => self.warned = Excess::default(),
        }
        (self.warned != before).then_some(fit)
    }

    /// Whether a value of the fit is so close to its limit that a warning continues.
    fn is_near_limit(&self, fit: &RollingFit) -> bool {
        let (median, pair) = (self.limits.warn_fvu, self.limits.pair_warn_fvu);
        fit.median_fvu > END_SHARE * median
            || fit.worst_pairs.first().is_some_and(|worst| worst.fvu > END_SHARE * pair)
    }

    /// The fit over the current window.
    pub fn fit(&self) -> RollingFit {
        let median_fvu = median(self.window.iter().map(|p| p.fvu)).unwrap_or(0.0);
        let frames = self.window.iter().map(|p| (&p.measured_v[..], &p.simulated_v[..]));
        let mut pairs = pair_fits(&frames.collect::<Vec<_>>(), self.electrodes);
        pairs.sort_by(|a, b| b.fvu.total_cmp(&a.fvu));
        let over = pairs.iter().filter(|p| p.fvu > self.limits.pair_warn_fvu).count();
        let level = if self.limits.suspend_fvu.is_some_and(|limit| median_fvu > limit) {
            Level::Suspend
        } else if median_fvu > self.limits.warn_fvu || over > 0 {
            Level::Warn
        } else {
            Level::Ok
        };
        pairs.truncate(WORST_PAIRS);
        RollingFit {
            level,
            trials: self.window.len(),
            median_fvu,
            pairs_over_limit: over,
            worst_pairs: pairs,
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::{DriftWatch, Level, Pairing};
    use crate::schedule::experiment::TwinLimits;

    const LIMITS: TwinLimits = TwinLimits {
        window: 10,
        min_force_n: 10.0,
        warn_fvu: 0.3,
        suspend_fvu: Some(0.6),
        pair_warn_fvu: 1.0,
    };

    /// Two electrodes: four readings. `off` is added to the last reading's twin.
    fn pairing(n: u32, fvu: f64, off: f32) -> Pairing {
        let v = if n.is_multiple_of(2) { 1.0 } else { -1.0 };
        Pairing {
            max_force_n: 20.0,
            measured_v: vec![v, -v, v, -v],
            simulated_v: vec![v, -v, v, -v + off],
            fvu,
        }
    }

    #[test]
    fn a_change_of_level_is_reported_once() {
        let mut watch = DriftWatch::new(LIMITS, 2);
        let levels: Vec<Option<Level>> = (0..40)
            .map(|n| {
                let fvu = if (10..20).contains(&n) { 0.4 } else { 0.1 };
                watch.push(pairing(n, fvu, 0.0)).map(|fit| fit.level)
            })
            .collect();
        let changes: Vec<(usize, Level)> =
            levels.iter().enumerate().filter_map(|(n, level)| Some((n, (*level)?))).collect();
        // The median of ten passes a limit when more than half of them have.
        // A warning ends below 0.8 of its limit: at 24 the median is 0.25.
        assert_eq!(changes, [(15, Level::Warn), (25, Level::Ok)]);
    }

    #[test]
    fn a_fit_that_varies_about_its_limit_warns_once() {
        let mut watch = DriftWatch::new(LIMITS, 2);
        let levels: Vec<Level> = (0..40)
            .filter_map(|n| {
                let fvu = if n % 20 < 10 { 0.31 } else { 0.29 };
                watch.push(pairing(n, fvu, 0.0)).map(|fit| fit.level)
            })
            .collect();
        assert_eq!(levels, [Level::Warn]);
    }

    #[test]
    fn a_warning_does_not_hide_pairs_that_exceed_their_limit_later() {
        let mut watch = DriftWatch::new(LIMITS, 2);
        let told: Vec<(u32, usize)> = (0..40)
            .filter_map(|n| {
                let off = if n < 10 { 0.0 } else { 3.0 };
                let fit = watch.push(pairing(n, 0.4, off))?;
                Some((n, fit.pairs_over_limit))
            })
            .collect();
        // Three of ten trials are off by 3 in one of the two readings of a pair: 27 of 20.
        assert_eq!(told, [(4, 0), (12, 1)]);
    }

    #[test]
    fn the_window_is_cleared_after_a_suspension() {
        let mut watch = DriftWatch::new(LIMITS, 2);
        let suspended = (0..30).filter(|n| {
            watch.push(pairing(*n, 0.9, 0.0)).is_some_and(|fit| fit.level == Level::Suspend)
        });
        // Half a window each time.
        assert_eq!(suspended.collect::<Vec<_>>(), [4, 9, 14, 19, 24, 29]);
    }

    #[test]
    fn a_bad_pair_is_named_and_light_trials_are_ignored() {
        let mut watch = DriftWatch::new(LIMITS, 2);
        for n in 0..20 {
            let light = Pairing { max_force_n: 9.0, ..pairing(n, 5.0, 9.0) };
            assert_eq!(watch.push(light), None);
        }
        let changes: Vec<_> = (0..5).filter_map(|n| watch.push(pairing(n, 0.1, 3.0))).collect();
        let [fit] = &changes[..] else { panic!("one change: {changes:?}") };
        assert_eq!((fit.level, fit.pairs_over_limit), (Level::Warn, 1));
        assert_eq!(fit.worst_pairs[0].electrodes, [1, 0]);
        assert!(fit.describe(&LIMITS).contains("worst 1 and 0"), "{}", fit.describe(&LIMITS));
        let event = fit.event(&LIMITS);
        let words = event["words"].as_str().unwrap();
        let pairs = "the model fits the skin badly: electrode pairs over FVU 1: 1, worst 1 and 0";
        assert!(words.starts_with(pairs) && words.contains("; median FVU 0.10"), "{words}");
        assert_eq!((&event["level"], &event["warn_fvu"]), (&json!("warn"), &json!(0.3)));
    }
}
