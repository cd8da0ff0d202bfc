//! The differences of two runs as numbers: keys of files, forces at the same place and depth, frames.
//! PURE. Uses: sim-core's quantiles, `answers`. Never: HTTP, a comparison of different places or depths.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde::Serialize;
use sim_core::stats::{quantile, sorted};

use super::answers::TrialFacts;
use crate::cli::watch::answers::Tour;

/// Fewest values of an interval: with fewer the extremes cover the median with less than 95 %.
const INTERVAL_VALUES_MIN: usize = 6;

/// A value that differs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Change {
    /// Dotted key, or name of a fact.
    pub key: String,
    /// Value of the earlier run; absent if it has none.
    pub before: Option<String>,
    /// Value of the later run; absent if it has none.
    pub after: Option<String>,
}

/// A median of differences with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// Number of values.
    pub n: usize,
    /// Median of the differences, in their unit.
    pub median: f64,
    /// Lower end of the interval; absent for fewer than 6 values.
    pub low_95: Option<f64>,
    /// Upper end of the interval.
    pub high_95: Option<f64>,
}

/// Differences of the largest force at one depth, N.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AtDepth {
    /// Planned depth of the trials, mm.
    pub depth_mm: f64,
    /// Later minus earlier, N, one value per configuration.
    #[serde(flatten)]
    pub difference_n: Difference,
}

/// Two trials at the same place and depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Number of the place.
    pub place: usize,
    /// Planned depth of the trials, mm.
    pub depth_mm: f64,
    /// Id of the trial of the earlier run.
    pub before: i64,
    /// Id of the trial of the later run.
    pub after: i64,
    /// Largest force, later minus earlier, N; absent if one was not measured.
    pub force_n: Option<f64>,
    /// Whether both have a contact.
    pub in_contact: bool,
}

/// The keys of two TOML texts whose values differ. A text that is no TOML is compared as a whole.
pub fn changes(before: Option<&str>, after: Option<&str>) -> Vec<Change> {
    let read = |text: Option<&str>| -> Option<BTreeMap<String, String>> {
        let table: toml::Table = text.unwrap_or_default().parse().ok()?;
        let mut keys = BTreeMap::new();
        flatten("", &toml::Value::Table(table), &mut keys);
        Some(keys)
    };
    let (Some(a), Some(b)) = (read(before), read(after)) else {
        let whole = |text: Option<&str>| text.map(|text| format!("{} lines", text.lines().count()));
        let change = Change { key: "text".into(), before: whole(before), after: whole(after) };
        return if before == after { Vec::new() } else { vec![change] };
    };
    let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    let change = |key: &&String| {
        let (before, after) = (a.get(*key).cloned(), b.get(*key).cloned());
        (before != after).then(|| Change { key: (*key).clone(), before, after })
    };
    keys.iter().filter_map(change).collect()
}

fn flatten(path: &str, value: &toml::Value, keys: &mut BTreeMap<String, String>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let below = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                flatten(&below, value, keys);
            }
        }
        toml::Value::String(text) => drop(keys.insert(path.into(), text.clone())),
        other => drop(keys.insert(path.into(), other.to_string())),
    }
}

/// The trials of two runs at the same place and depth. Of each run: where its plan presses, in the planned order, and
/// its stored trials. Places are compared to 0.1 mm, depths to 0.01 mm; a place that a plan has several times is paired
/// in the order of its configurations.
pub fn pairs(before: (&Tour, &[TrialFacts]), after: (&Tour, &[TrialFacts])) -> Vec<Pair> {
    let (a, b) = (places(before), places(after));
    let mut pairs = Vec::new();
    for (number, (place, trials)) in a.iter().enumerate() {
        let Some(others) = b.get(place) else { continue };
        for (depth, first) in trials {
            let Some(second) = others.get(depth) else { continue };
            pairs.push(Pair {
                place: number,
                depth_mm: *depth as f64 / 100.0,
                before: first.trial_id,
                after: second.trial_id,
                in_contact: first.contact_count > 0 && second.contact_count > 0,
                force_n: second.max_force_n.zip(first.max_force_n).map(|(b, a)| b - a),
            });
        }
    }
    pairs
}

/// Contacts in tenths of a millimetre, and how often the plan had them before.
type Place = (Vec<[i64; 2]>, usize);

fn places<'a>(
    (tour, trials): (&Tour, &'a [TrialFacts]),
) -> BTreeMap<Place, BTreeMap<i64, &'a TrialFacts>> {
    let mut of_configuration = HashMap::<u32, Vec<&TrialFacts>>::new();
    for trial in trials {
        of_configuration.entry(trial.configuration).or_default().push(trial);
    }
    let tenths = |mm: f64| (mm * 10.0).round() as i64;
    let mut steps: Vec<(u32, Vec<[i64; 2]>)> = tour
        .steps
        .configuration
        .iter()
        .zip(&tour.steps.contacts_mm)
        .map(|(configuration, contacts)| {
            let mut place: Vec<[i64; 2]> =
                contacts.iter().map(|[x, y]| [tenths(*x), tenths(*y)]).collect();
            place.sort_unstable();
            (*configuration, place)
        })
        .collect();
    // The order of driving may differ between versions; the plan's does not.
    steps.sort_unstable();
    let (mut seen, mut places) = (HashMap::<Vec<[i64; 2]>, usize>::new(), BTreeMap::new());
    for (configuration, place) in steps {
        let times = seen.entry(place.clone()).or_default();
        let trials = of_configuration.remove(&configuration).unwrap_or_default();
        let by_depth = trials.into_iter().map(|trial| {
            (trial.depth_mm.map_or(i64::MIN, |mm| (mm * 100.0).round() as i64), trial)
        });
        places.insert((place, *times), by_depth.collect());
        *times += 1;
    }
    places
}

/// Median of values with its 95 % interval by order statistics (sign test, normal approximation);
/// `None` without values.
pub fn difference(values: impl IntoIterator<Item = f64>) -> Option<Difference> {
    let sorted = sorted(values);
    let n = sorted.len();
    let median = quantile(&sorted, 0.5)?;
    // Rank of the lower end, from 1: (n - 1.96 sqrt(n)) / 2, at least the first value.
    let rank = ((n as f64 - 1.96 * (n as f64).sqrt()) / 2.0).floor().max(1.0) as usize;
    let interval = (n >= INTERVAL_VALUES_MIN).then(|| [sorted[rank - 1], sorted[n - rank]]);
    Some(Difference {
        n,
        median,
        low_95: interval.map(|ends| ends[0]),
        high_95: interval.map(|ends| ends[1]),
    })
}

/// Differences of the largest force at each depth, in ascending order of depth.
pub fn by_depth(pairs: &[Pair]) -> Vec<AtDepth> {
    let mut groups = BTreeMap::<i64, Vec<f64>>::new();
    for (pair, force_n) in pairs.iter().filter_map(|pair| Some((pair, pair.force_n?))) {
        groups.entry((pair.depth_mm * 100.0).round() as i64).or_default().push(force_n);
    }
    groups
        .into_iter()
        .filter_map(|(depth, values)| {
            let difference_n = difference(values)?;
            Some(AtDepth { depth_mm: depth as f64 / 100.0, difference_n })
        })
        .collect()
}

/// Difference over all depths: one value per place, the median of its depths, because the trials of one
/// place are not independent.
pub fn by_place(pairs: &[Pair]) -> Option<Difference> {
    let mut groups = BTreeMap::<usize, Vec<f64>>::new();
    for (pair, force_n) in pairs.iter().filter_map(|pair| Some((pair, pair.force_n?))) {
        groups.entry(pair.place).or_default().push(force_n);
    }
    difference(groups.into_values().filter_map(|values| quantile(&sorted(values), 0.5)))
}

/// At most `most` of the pairs, evenly.
pub fn sampled(pairs: &[Pair], most: usize) -> Vec<Pair> {
    let step = pairs.len().div_ceil(most.max(1)).max(1);
    pairs.iter().step_by(step).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::visits::Visits;

    fn tour(configuration: &[u32], contacts_mm: &[[f64; 2]]) -> Tour {
        let contacts_mm = contacts_mm.iter().map(|at| vec![*at]).collect();
        let configuration = configuration.to_vec();
        let steps = Visits { configuration, contacts_mm, ..Visits::default() };
        Tour { depths_mm: vec![0.0, 1.0], steps }
    }

    fn trial(trial_id: i64, configuration: u32, depth_mm: f64, force_n: f64) -> TrialFacts {
        let (depth_mm, max_force_n) = (Some(depth_mm), Some(force_n));
        TrialFacts { trial_id, configuration, depth_mm, max_force_n, ..TrialFacts::default() }
    }

    #[test]
    fn keys_that_differ_are_named_and_others_are_not() {
        let before = "name = \"a\"\n[real_hex]\ntips = [1, 4]\nblock = 6\n";
        let after = "name = \"a\"\n[real_hex]\ntips = [1]\nseed = 3\n";
        let found = changes(Some(before), Some(after));
        let keys: Vec<&str> = found.iter().map(|change| change.key.as_str()).collect();
        assert_eq!(keys, ["real_hex.block", "real_hex.seed", "real_hex.tips"]);
        assert_eq!(found[2].before.as_deref(), Some("[1, 4]"));
        assert_eq!((found[1].before.as_deref(), found[1].after.as_deref()), (None, Some("3")));
        assert!(changes(Some(before), Some(before)).is_empty());
        assert_eq!(changes(Some("no toml ="), Some("a = 1"))[0].key, "text");
        assert_eq!(changes(None, Some("a = 1")).len(), 1);
    }

    #[test]
    fn trials_are_paired_by_place_and_depth_whatever_their_configuration_is_called() {
        let a = tour(&[0, 1, 2], &[[10.0, 20.0], [30.0, 40.0], [10.0, 20.0]]);
        let b = tour(&[5, 4, 6], &[[30.02, 40.0], [10.0, 20.0], [90.0, 90.0]]);
        let before = [trial(1, 0, 1.0, 5.0), trial(2, 1, 1.0, 6.0), trial(3, 2, 1.0, 7.0)];
        let after = [trial(11, 4, 1.0, 5.5), trial(12, 5, 1.0, 8.0), trial(13, 5, 2.0, 1.0)];
        let found = pairs((&a, &before), (&b, &after));
        let ids: Vec<(i64, i64)> = found.iter().map(|pair| (pair.before, pair.after)).collect();
        assert_eq!(ids, [(1, 11), (2, 12)]);
        assert_eq!(found.iter().map(|pair| pair.force_n.unwrap()).collect::<Vec<_>>(), [0.5, 2.0]);
        let depths = by_depth(&found);
        assert_eq!((depths.len(), depths[0].depth_mm, depths[0].difference_n.n), (1, 1.0, 2));
        assert_eq!(by_place(&found).unwrap().median, 1.25);
        assert_eq!(sampled(&found, 1).len(), 1);
    }

    #[test]
    fn an_interval_needs_enough_values_and_contains_the_median() {
        let few = difference([1.0, 2.0, 9.0]).unwrap();
        assert_eq!((few.n, few.median, few.low_95), (3, 2.0, None));
        let many = difference((0..100).map(f64::from)).unwrap();
        // Of 100 values the 40th and the 61st are the ends.
        assert_eq!((many.low_95, many.high_95), (Some(39.0), Some(60.0)));
        let six = difference((0..6).map(f64::from)).unwrap();
        assert_eq!((six.low_95, six.high_95), (Some(0.0), Some(5.0)));
        assert_eq!(difference([]), None);
    }
}
