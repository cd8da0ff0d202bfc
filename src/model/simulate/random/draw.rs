//! The contacts of a Sim-Random trial (paper IV-B, Table I), from seed and trial number alone.
//! PURE. Uses: `chance`, sim-core's sensor. Never: the order in which trials are made.
//!
//! The paper (IV-B): "The number of contact points was randomly selected from one to six, the
//! points were selected randomly, and the force magnitude at each point was randomly chosen from
//! the range of 5N to 40N", on "different combinations of the 804 predefined contact points".
//! Interpreted as follows, each draw independent of the others:
//! - the number of contacts is uniform over 1..6. Table I's counts (33,275 33,450 33,190 33,047
//!   33,630 33,408) agree: chi-squared 6.4 at 5 degrees of freedom;
//! - the points are different, every set of that size equally likely. Neighbouring points are
//!   allowed: their hexagons share an edge and do not overlap, and a model has no tips that could
//!   collide. (Real-Random, placed manually, excludes such pairs: 20 mm tips at a distance of
//!   17.3 mm.)
//! - each force is uniform over its range, independent of the others.

use serde::{Deserialize, Serialize};
use sim_core::forward::Contact;
use sim_core::sensor::Point;

use crate::chance::Chance;
use crate::problem::Checks;
use crate::record::CONTACTS_MAX;

/// Version of these draws: increased by a change that draws other contacts for a seed.
pub const DRAW_VERSION: u32 = 1;

/// Largest load of a trial, N; the model is checked up to it.
pub const LOAD_MAX_N: f64 = 240.0;

/// Number of steps of a force over its range.
const FORCE_STEPS: u32 = 1 << 24;

/// Distribution of the contacts of trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Draws {
    /// Seed of all trials.
    pub seed: u64,
    /// Smallest and largest number of contacts.
    pub contacts: [u8; 2],
    /// Smallest and largest force of a contact, N.
    pub force_n: [f64; 2],
}

impl Draws {
    /// The paper's distribution: one to six contacts, 5 to 40 N.
    pub fn paper(seed: u64) -> Self {
        Self { seed, contacts: [1, 6], force_n: [5.0, 40.0] }
    }

    /// Adds the problems of these settings; `points` is the number of points of the skin.
    pub fn check(&self, points: usize, checks: &mut Checks<'_>) {
        let [fewest, most] = self.contacts;
        let shown = format!("{fewest}..{most}");
        let in_order = fewest <= most && usize::from(most) <= CONTACTS_MAX;
        let limit = format!("must be A..B with 0 <= A <= B <= {CONTACTS_MAX}");
        checks.require(in_order, "contacts", &shown, &limit);
        let limit = format!("the skin has {points} points");
        checks.require(usize::from(most) <= points, "contacts", &shown, &limit);
        let [least, largest] = self.force_n;
        let shown = format!("{least} {largest}");
        let in_order = 0.0 < least && least <= largest && largest.is_finite();
        checks.require(in_order, "force-n", &shown, "must be two numbers, 0 < MIN <= MAX");
        let load_n = largest * f64::from(most);
        let limit = format!("{most} contacts of {largest} N: at most {LOAD_MAX_N} N in sum");
        checks.require(!in_order || load_n <= LOAD_MAX_N, "force-n", &shown, &limit);
    }

    /// Appends the contacts of trial `index` to `into`. Forces are exact in f32, so that a file
    /// with f32 contains the simulated forces.
    ///
    /// `points` are the skin's, at least as many as the largest number of contacts.
    pub fn trial(&self, points: &[Point], index: u64, into: &mut Vec<Contact>) {
        let mut chance = Chance::numbered(self.seed, "sim-random", index);
        let [fewest, most] = self.contacts;
        let count = usize::from(fewest) + chance.below(u32::from(most - fewest) + 1) as usize;
        let mut drawn = [0; CONTACTS_MAX];
        for n in 0..count {
            drawn[n] = loop {
                let point = chance.below(points.len() as u32) as usize;
                if !drawn[..n].contains(&point) {
                    break point;
                }
            };
        }
        let [least, largest] = self.force_n;
        into.extend(drawn[..count].iter().map(|&point| {
            let step = f64::from(chance.below(FORCE_STEPS)) + 0.5;
            let force_n = least + (largest - least) * step / f64::from(FORCE_STEPS);
            let Point { x_mm, y_mm, .. } = points[point];
            Contact { x_mm, y_mm, force_n: f64::from(force_n as f32) }
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_core::sensor::Sensor;
    use std::collections::BTreeSet;

    use crate::calibrate::paper;
    use crate::problem::Problem;

    const TRIALS: u64 = 60_000;

    fn trial(draws: &Draws, sensor: &Sensor, index: u64) -> Vec<Contact> {
        let mut contacts = Vec::new();
        draws.trial(sensor.points(), index, &mut contacts);
        contacts
    }

    fn chi_squared(counts: &[u64]) -> f64 {
        let expected = counts.iter().sum::<u64>() as f64 / counts.len() as f64;
        counts.iter().map(|&c| (c as f64 - expected).powi(2) / expected).sum()
    }

    /// 99.9 % point of chi-squared with `n` degrees of freedom (Wilson and Hilferty).
    fn chi_squared_limit(n: usize) -> f64 {
        let n = n as f64;
        n * (1.0 - 2.0 / (9.0 * n) + 3.09 * (2.0 / (9.0 * n)).sqrt()).powi(3)
    }

    #[test]
    fn counts_points_and_forces_are_uniform_and_points_of_a_trial_differ() {
        let (sensor, draws) = (paper::sensor(), Draws::paper(1));
        let (mut counts, mut points, mut forces) = ([0u64; 6], vec![0u64; 804], [0u64; 35]);
        let mut neighbours = 0;
        for index in 0..TRIALS {
            let contacts = trial(&draws, &sensor, index);
            counts[contacts.len() - 1] += 1;
            let mut seen = BTreeSet::new();
            for c in &contacts {
                let point = sensor.point_near([c.x_mm, c.y_mm], 1e-9).unwrap();
                assert!(seen.insert(point), "trial {index} presses a point twice");
                points[point] += 1;
                assert!((5.0..=40.0).contains(&c.force_n), "{}", c.force_n);
                assert_eq!(f64::from(c.force_n as f32), c.force_n);
                forces[((c.force_n - 5.0) as usize).min(34)] += 1;
            }
            neighbours += u32::from(contacts.iter().enumerate().any(|(i, a)| {
                contacts[..i].iter().any(|b| (a.x_mm - b.x_mm).hypot(a.y_mm - b.y_mm) < 20.0)
            }));
        }
        for (name, found) in [("count", &counts[..]), ("point", &points), ("force", &forces)] {
            let (chi2, limit) = (chi_squared(found), chi_squared_limit(found.len() - 1));
            assert!(chi2 < limit, "{name}: {chi2} is above {limit}");
        }
        // Expected: mean pairs (35 / 6) x the mean number of neighbours (5.7) of 803 others = 4 %.
        let share = f64::from(neighbours) / TRIALS as f64;
        assert!((0.02..0.06).contains(&share), "{share}");
    }

    #[test]
    fn the_limit_finds_a_count_that_is_off_by_a_twentieth() {
        let counts = [10_500, 9_900, 9_900, 9_900, 9_900, 9_900];
        assert!(chi_squared(&counts) > chi_squared_limit(5));
    }

    #[test]
    fn a_trial_depends_on_seed_and_number_alone() {
        let (sensor, one) = (paper::sensor(), Draws::paper(1));
        assert_eq!(trial(&one, &sensor, 123_456), trial(&one, &sensor, 123_456));
        assert_ne!(trial(&one, &sensor, 0), trial(&one, &sensor, 1));
        assert_ne!(trial(&one, &sensor, 0), trial(&Draws::paper(2), &sensor, 0));
    }

    fn problems(draws: &Draws, points: usize) -> Vec<Problem> {
        let mut checks = Checks::of("draws");
        draws.check(points, &mut checks);
        checks.done().err().unwrap_or_default()
    }

    #[test]
    fn settings_outside_their_limits_are_named() {
        let paper = Draws::paper(1);
        assert_eq!(problems(&paper, 804), []);
        let with = |contacts, force_n| Draws { contacts, force_n, ..paper.clone() };
        for (draws, key) in [
            (with([3, 2], [5.0, 40.0]), "contacts"),
            (with([1, 7], [5.0, 20.0]), "contacts"),
            (with([1, 6], [0.0, 40.0]), "force-n"),
            (with([1, 6], [f64::NAN, 40.0]), "force-n"),
            (with([1, 6], [5.0, f64::INFINITY]), "force-n"),
            (with([1, 6], [9.0, 8.0]), "force-n"),
            (with([1, 6], [5.0, 41.0]), "force-n"),
        ] {
            let keys: Vec<_> = problems(&draws, 804).into_iter().map(|p| p.key).collect();
            assert_eq!(keys, [key], "{draws:?}");
        }
        assert_eq!(problems(&paper, 5).len(), 1);
    }
}
