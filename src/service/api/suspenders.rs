//! What may suspend a run: each monitor with its present value, its threshold, and since when the value
//! is beyond it.
//! PURE, except that `Beyond` remembers times that it is given. Uses: `twins::drift`, `schedule` (the
//! limits). Never: a suspension (the campaign and the pool of twins request it).

use std::collections::BTreeMap;

use jiff::Timestamp;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::schedule::experiment::TwinLimits;
use crate::twins::drift::RollingFit;

/// A monitor that may suspend the active run, or that warns before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Suspender {
    /// Name: `disk` (free space below what the run needs), `frame_age` (age of the newest frame),
    /// `twin_fvu` (median FVU of the last trials), `electrode_pairs` (FVU of the worst pair of
    /// electrodes).
    pub name: String,
    /// Name for people.
    pub title: String,
    /// Present value; null while it is unknown.
    pub value: Option<f64>,
    /// Threshold. `disk` is beyond it below, all others above.
    pub threshold: f64,
    /// Unit of value and threshold: `bytes`, `ms`, or `1` for a ratio.
    pub unit: String,
    /// Time since which the value is beyond the threshold; null while it is not.
    pub since: Option<Timestamp>,
    /// Whether the run is suspended beyond the threshold; otherwise an event warns.
    pub suspends: bool,
}

/// Present values of the active run.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Readings<'a> {
    /// Free space of the disk of the data folder, bytes.
    pub free_bytes: Option<u64>,
    /// Space that the remaining trials need, bytes.
    pub needed_bytes: u64,
    /// Age of the newest frame, wall ms.
    pub frame_age_ms: Option<f64>,
    /// Limit of that age, wall ms.
    pub frame_age_limit_ms: u64,
    /// Fit of the last trials.
    pub fit: Option<&'a RollingFit>,
    /// Limits of the fit; absent if the experiment file cannot be read.
    pub limits: Option<&'a TwinLimits>,
}

impl Readings<'_> {
    /// The monitors, each with whether its value is beyond its threshold.
    fn monitors(&self) -> Vec<(Suspender, bool)> {
        let above = |(name, title): (&str, &str),
                     value: Option<f64>,
                     threshold,
                     unit: &str,
                     suspends| {
            let is_beyond = value.is_some_and(|value| value > threshold);
            let (name, title, unit) = (name.into(), title.into(), unit.into());
            (Suspender { name, title, value, threshold, unit, since: None, suspends }, is_beyond)
        };
        let (free, needed) = (self.free_bytes, self.needed_bytes);
        let free_bytes = free.map(|bytes| bytes as f64);
        let (disk, _) = above(("disk", "free disk"), free_bytes, needed as f64, "bytes", true);
        let limit_ms = self.frame_age_limit_ms as f64;
        let frame_age = ("frame_age", "age of the newest frame");
        let mut monitors = vec![
            (disk, free.is_some_and(|free| free < needed)),
            above(frame_age, self.frame_age_ms, limit_ms, "ms", false),
        ];
        if let Some(limits) = self.limits {
            let fit = self.fit.filter(|fit| fit.trials > 0);
            let (fvu, threshold) =
                (fit.map(|fit| fit.median_fvu), limits.suspend_fvu.unwrap_or(limits.warn_fvu));
            let worst = fit.and_then(|fit| fit.worst_pairs.first()).map(|pair| pair.fvu);
            let twins = ("twin_fvu", "fit of the twins (FVU)");
            monitors.push(above(twins, fvu, threshold, "1", limits.suspend_fvu.is_some()));
            let pairs = ("electrode_pairs", "worst electrode pair (FVU)");
            monitors.push(above(pairs, worst, limits.pair_warn_fvu, "1", false));
        }
        monitors
    }
}

/// Since when values are beyond their thresholds, by the names of the monitors.
#[derive(Debug, Default)]
pub struct Beyond(Mutex<BTreeMap<String, Timestamp>>);

impl Beyond {
    /// Returns the monitors of the active run at `now`; none without a run.
    pub(super) fn suspenders(
        &self,
        readings: Option<&Readings<'_>>,
        now: Timestamp,
    ) -> Vec<Suspender> {
        let monitors = readings.map_or_else(Vec::new, Readings::monitors);
        let mut beyond = self.0.lock();
        beyond.retain(|name, _| {
            monitors.iter().any(|(of, is_beyond)| of.name == *name && *is_beyond)
        });
        let dated = |(mut monitor, is_beyond): (Suspender, bool)| {
            let since = || *beyond.entry(monitor.name.clone()).or_insert(now);
            monitor.since = is_beyond.then(since);
            monitor
        };
        monitors.into_iter().map(dated).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::simulation::PairFit;
    use crate::twins::drift::Level;

    fn at(second: i64) -> Timestamp {
        Timestamp::from_second(second).unwrap()
    }

    #[test]
    fn a_value_is_beyond_its_threshold_since_the_first_time_until_it_returns() {
        let beyond = Beyond::default();
        let readings =
            |free| Readings { free_bytes: Some(free), needed_bytes: 100, ..Readings::default() };
        let disk = |free, now| beyond.suspenders(Some(&readings(free)), at(now))[0].clone();
        assert_eq!(disk(100, 1).since, None);
        assert_eq!(disk(99, 2).since, Some(at(2)));
        assert_eq!(disk(50, 3).since, Some(at(2)));
        assert_eq!((disk(500, 4).since, disk(0, 5).since), (None, Some(at(5))));
        // Another run begins afresh.
        assert_eq!(beyond.suspenders(None, at(6)), []);
        assert_eq!(disk(0, 7).since, Some(at(7)));
    }

    #[test]
    fn the_fit_suspends_only_if_the_experiment_says_so_and_is_unknown_before_the_first_twin() {
        let (warns, beyond) = (TwinLimits::default(), Beyond::default());
        let suspends = TwinLimits { suspend_fvu: Some(0.5), ..TwinLimits::default() };
        let pair = PairFit { electrodes: [3, 4], fvu: 2.0 };
        let fit = RollingFit {
            level: Level::Warn,
            trials: 9,
            median_fvu: 0.4,
            pairs_over_limit: 1,
            worst_pairs: vec![pair],
        };
        let fits = |fit, limits| {
            let readings = Readings { fit, limits: Some(limits), ..Readings::default() };
            let rows = beyond.suspenders(Some(&readings), at(1));
            rows[2..]
                .iter()
                .map(|r| (r.value, r.threshold, r.since.is_some(), r.suspends))
                .collect()
        };
        let unknown: Vec<_> = fits(None, &warns);
        assert_eq!(unknown, [(None, 0.3, false, false), (None, 1.0, false, false)]);
        let over: Vec<_> = fits(Some(&fit), &warns);
        assert_eq!(over, [(Some(0.4), 0.3, true, false), (Some(2.0), 1.0, true, false)]);
        let below: Vec<_> = fits(Some(&fit), &suspends);
        assert_eq!(below[0], (Some(0.4), 0.5, false, true));
    }
}
