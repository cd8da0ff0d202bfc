//! How far answers to known trials are from the truth: factors on the regions that answers state.
//! PURE. Uses: `infer::{answer, matching}`, sim-core's `stats` and contacts. Never: a fit
//! (`errors` makes it), a narrower region.
//!
//! The standard deviations of a fit are those around one explanation, for errors that the error model contains. Errors
//! that contacts imitate are not in it, and a search may end at another explanation. Both are measured: known trials
//! are answered as in use, with errors that were learned from other configurations. A factor is the quantile of their
//! distances from the truth in units of the stated region (split conformal prediction): nothing is assumed of their
//! distribution, except that later trials are like these.

use serde::{Deserialize, Serialize};
use sim_core::forward::Contact;
use sim_core::inverse::contacts::FittedContact;
use sim_core::stats::sorted;

use crate::infer::answer::Reading;
use crate::infer::matching::matched;

/// Smallest number of answers from which factors are estimated.
pub(super) const LEAST_REHEARSED: usize = 40;
/// Smallest number of answers in a group of these.
const LEAST_IN_GROUP: usize = 20;
/// Contacts are light if all their forces are below this, N: weights that a person places.
pub(super) const LIGHT_N: f64 = 15.0;
/// Share of the true values that a region is to contain.
const HELD: f64 = 0.95;
/// Largest factor. Where it is not enough, regions hold a smaller share.
const FACTOR_MOST: f64 = 5.0;

/// What answers to known trials showed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Rehearsal {
    /// Of answers with light contacts.
    light: Seen,
    /// Of answers with a heavier contact.
    heavy: Seen,
}

/// What a group of answers showed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Seen {
    /// Factor on the standard deviations of positions, 1 to 5.
    pub place: f64,
    /// Factor on the standard deviations of forces, 1 to 5.
    pub force: f64,
}

/// An answer to a known trial.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rehearsed {
    /// Whether the forces of its contacts are below [`LIGHT_N`].
    is_light: bool,
    /// Distance of each matched true contact, in radii of the stated region.
    places: Vec<f64>,
    /// Difference of its force, in half widths of the stated interval.
    forces: Vec<f64>,
}

impl Rehearsed {
    /// Compares an answer with the contacts that pressed.
    pub fn of(truths: &[Contact], Reading { contacts: found, .. }: &Reading) -> Self {
        let true_mm: Vec<[f64; 2]> = truths.iter().map(|c| [c.x_mm, c.y_mm]).collect();
        let found_mm: Vec<[f64; 2]> = found.iter().map(|c| [c.x_mm, c.y_mm]).collect();
        let pairs = matched(&true_mm, &found_mm);
        let both = || pairs.iter().map(move |pair| (&truths[pair.truth], &found[pair.estimate]));
        Self {
            is_light: is_light(found.iter().filter_map(|c| c.force_n)),
            places: both().filter_map(|(t, f)| f.place_in_95(t.x_mm, t.y_mm)).collect(),
            forces: both().filter_map(|(t, f)| f.force_in_95(t.force_n)).collect(),
        }
    }
}

impl Rehearsal {
    /// What answers showed whose regions no rehearsal had changed; `None` with too few.
    pub fn of(answers: &[Rehearsed]) -> Option<Self> {
        if answers.len() < LEAST_REHEARSED {
            return None;
        }
        let all: Vec<&Rehearsed> = answers.iter().collect();
        let (light, heavy): (Vec<&Rehearsed>, Vec<&Rehearsed>) =
            answers.iter().partition(|answer| answer.is_light);
        let seen = |group: &[&Rehearsed]| {
            Seen::of(if group.len() >= LEAST_IN_GROUP { group } else { all.as_slice() })
        };
        Some(Self { light: seen(&light), heavy: seen(&heavy) })
    }

    /// What answers with contacts like these showed.
    pub fn of_contacts(&self, found: &[FittedContact]) -> &Seen {
        let is_light = is_light(found.iter().map(|found| found.contact.force_n));
        if is_light { &self.light } else { &self.heavy }
    }
}

impl Seen {
    fn of(answers: &[&Rehearsed]) -> Self {
        Self {
            place: factor(answers.iter().flat_map(|answer| answer.places.iter().copied())),
            force: factor(answers.iter().flat_map(|answer| answer.forces.iter().copied())),
        }
    }
}

/// Whether all forces, N, are those of weights that a person places.
pub(super) fn is_light(mut forces_n: impl Iterator<Item = f64>) -> bool {
    forces_n.all(|force_n| force_n < LIGHT_N)
}

/// The factor on regions with which they hold [`HELD`] of later values, from 1: of `n` values the one that split
/// conformal prediction prescribes, of rank `HELD (n + 1)`. The largest factor with fewer than 19 values.
fn factor(errors: impl Iterator<Item = f64>) -> f64 {
    let errors = sorted(errors.map(|error| if error.is_nan() { f64::INFINITY } else { error }));
    let rank = (HELD * (errors.len() + 1) as f64).ceil() as usize;
    errors.get(rank - 1).map_or(FACTOR_MOST, |&edge| edge.clamp(1.0, FACTOR_MOST))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::infer::answer::FoundContact;

    /// Standard deviations that answers state: mm, and N.
    const STATED: [f64; 2] = [4.0, 1.0];

    /// An answer to one contact of a force that is off in x, y, mm, and force, N.
    fn answer(force_n: f64, [x, y, force]: [f64; 3]) -> Rehearsed {
        let found = FoundContact {
            x_mm: 200.0 + x,
            y_mm: 300.0 + y,
            force_n: Some(force_n + force),
            x_sd_mm: Some(STATED[0]),
            y_sd_mm: Some(STATED[0]),
            force_sd_n: Some(STATED[1]),
            ..FoundContact::default()
        };
        let reading = Reading { contacts: vec![found], ..Reading::default() };
        Rehearsed::of(&[Contact { x_mm: 200.0, y_mm: 300.0, force_n }], &reading)
    }

    /// Answers whose places are wrong by `place` times what they state, and forces by `force` times.
    fn answers(seed: u64, count: usize, force_n: f64, [place, force]: [f64; 2]) -> Vec<Rehearsed> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut off = |sd: f64| sd * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let [place, force] = [place * STATED[0], force * STATED[1]];
        let mut one = || answer(force_n, [off(place), off(place), off(force)]);
        (0..count).map(|_| one()).collect()
    }

    fn fitted(force_n: f64) -> FittedContact {
        let contact = Contact { x_mm: 200.0, y_mm: 300.0, force_n };
        FittedContact { contact, x_sd_mm: 4.0, y_sd_mm: 4.0, force_sd_n: 1.0, by_model: [0.0; 3] }
    }

    #[test]
    fn regions_that_are_too_small_hold_95_percent_of_later_contacts() {
        let seen = Rehearsal::of(&answers(1, 2000, 9.0, [2.0, 1.5])).unwrap().light;
        assert!((seen.place - 2.0).abs() < 0.25 && (seen.force - 1.5).abs() < 0.25, "{seen:?}");
        let later = answers(2, 2000, 9.0, [2.0, 1.5]);
        let held = |values: Vec<f64>, factor: f64| {
            values.iter().filter(|value| **value <= factor).count() as f64 / values.len() as f64
        };
        let places = later.iter().flat_map(|answer| answer.places.clone()).collect();
        let forces = later.iter().flat_map(|answer| answer.forces.clone()).collect();
        let (places, forces) = (held(places, seen.place), held(forces, seen.force));
        assert!((0.92..0.98).contains(&places) && (0.92..0.98).contains(&forces));
    }

    #[test]
    fn the_factor_is_the_value_whose_rank_holds_a_further_one_with_95_percent() {
        let of = |count: u32| factor((0..count).rev().map(|n| 1.0 + 0.01 * f64::from(n)));
        // Of 39 values the second largest, of 38 and of 19 the largest.
        assert_eq!([39, 38, 19].map(of), [1.0 + 0.01 * 37.0, 1.0 + 0.01 * 37.0, 1.0 + 0.01 * 18.0]);
        assert_eq!([of(18), of(0)], [FACTOR_MOST; 2], "no rank of these is enough");
        assert_eq!(factor([f64::NAN; 40].into_iter()), FACTOR_MOST);
    }

    #[test]
    fn light_and_heavy_contacts_have_their_factors_and_no_region_is_narrowed() {
        let both = [answers(3, 400, 9.0, [1.0, 1.0]), answers(4, 400, 30.0, [2.0, 1.0])].concat();
        let seen = Rehearsal::of(&both).unwrap();
        assert!((seen.heavy.place - 2.0).abs() < 0.3 && seen.heavy.force < 1.2, "{seen:?}");
        assert!(seen.light.place < 1.2 && seen.light.force < 1.2, "{seen:?}");
        let is_near = |force_n| seen.of_contacts(&[fitted(force_n)]).place < 1.2;
        assert!(is_near(9.0) && !is_near(30.0), "{seen:?}");
        let wide = Rehearsal::of(&answers(5, 200, 9.0, [0.5, 0.5])).unwrap().light;
        assert_eq!((wide.place, wide.force), (1.0, 1.0));
        let wrong = Rehearsal::of(&answers(6, 200, 9.0, [30.0, 0.5])).unwrap();
        assert_eq!((wrong.light.place, wrong.light.force), (FACTOR_MOST, 1.0));
        assert_eq!(wrong.heavy, wrong.light, "no heavy contacts: what is known of all");
        assert_eq!(Rehearsal::of(&both[..LEAST_REHEARSED - 1]), None, "too few");
    }

    #[test]
    fn each_true_contact_is_compared_with_the_one_that_matches_it() {
        let truths = [(100.0, 9.0), (300.0, 9.0)].map(|(x_mm, force_n)| Contact {
            x_mm,
            y_mm: 100.0,
            force_n,
        });
        let at = |x_mm: f64| FoundContact {
            x_mm,
            y_mm: 100.0,
            force_n: Some(9.0),
            x_sd_mm: Some(10.0),
            y_sd_mm: Some(10.0),
            force_sd_n: Some(1.0),
            ..FoundContact::default()
        };
        let of = |contacts: Vec<FoundContact>| {
            Rehearsed::of(&truths, &Reading { contacts, ..Reading::default() }).places
        };
        let one = of(vec![at(310.0)]);
        assert!(one.len() == 1 && one[0] < 1.0, "{one:?}");
        let two = of(vec![at(330.0), at(90.0)]);
        assert!(two[0] < 1.0 && two[1] > 1.0, "{two:?}");
        assert!(of(Vec::new()).is_empty());
    }
}
