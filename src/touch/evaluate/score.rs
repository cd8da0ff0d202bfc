//! The score of many frames: means, standard deviations and 95 % intervals.
//! PURE. Uses: `touch`, `distances`, `Chance`, sim-core's quantiles. Never: a value for a metric without measurements
//! (it is absent).
//!
//! The mean of a metric is over contacts or pairs of all frames together, as the paper counts them,
//! or over frames. Its 95 % interval is a percentile bootstrap over frames, since the contacts of a
//! frame share its errors. Each of [`RESAMPLES`] rounds draws the number of frames with replacement
//! and yields a mean; rounds without a value yield none. Of more than [`HANDS`] frames, frames are
//! assigned to [`HANDS`] groups in turn, and groups are resampled: the means have the same spread,
//! at bounded cost.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use sim_core::stats::{median, quantile};
use utoipa::ToSchema;

use crate::chance::Chance;

use super::distances::Distances;
use super::touch::{Metric, Touch};

/// Rounds of the bootstrap: the ends of an interval are then accurate to about 3 % of its width.
pub const RESAMPLES: usize = 1000;
/// Largest number of groups, and of draws in a round of the bootstrap.
pub const HANDS: usize = 2000;
/// Share of the rounds below an interval, and above it.
const TAIL: f64 = 0.025;

/// A mean of measured values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Mean {
    /// Value of the mean.
    pub mean: f64,
    /// Standard deviation of the values (n - 1); absent for a single one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sd: Option<f64>,
    /// Number of values.
    pub n: u64,
    /// Lower end of the mean's 95 % interval; absent for values of a single frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_95: Option<f64>,
    /// Upper end of the mean's 95 % interval; absent for values of a single frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_95: Option<f64>,
}

/// The score of a set of frames. A metric without measurements is absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Score {
    /// Number of frames, untouched ones included.
    pub trials: u64,
    /// Number of true contacts.
    pub contacts: u64,
    /// Number of estimated contacts.
    pub estimates: u64,
    /// (estimated - true) / true number of contacts, %, over touched frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number_percent: Option<Mean>,
    /// Distance within Hungarian pairs, mm, over pairs; not affected by missed contacts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub location_mm: Option<Mean>,
    /// Median of those distances, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub location_median_mm: Option<f64>,
    /// Distance from each true contact to its closest estimate, mm, over true contacts; increased
    /// by misses. Contacts of frames without any estimate have none and are not counted in `n`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub closest_mm: Option<Mean>,
    /// (estimated - true) / true force, %, over pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_percent: Option<Mean>,
    /// Median of its absolute value, %.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_median_percent: Option<f64>,
    /// (estimated - true) / true diameter, %, over pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter_percent: Option<Mean>,
    /// Share of frames with the right number of contacts, 0 to 1; on an untouched skin, none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exact_rate: Option<Mean>,
    /// Estimates farther than `distances.ghost_mm` of the report from every true contact, over frames; on an
    /// untouched skin each estimate is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ghosts_per_trial: Option<Mean>,
    /// Share of the pairs whose 95 % region of the position holds the true one, 0 to 1; only of a method
    /// that states standard deviations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_in_95: Option<Mean>,
    /// Share of the pairs whose 95 % interval of the force holds the true one, 0 to 1; likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_in_95: Option<Mean>,
}

/// The score of the frames with a given number of true contacts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CountScore {
    /// Number of true contacts of each frame.
    pub contacts: u32,
    /// Score of these frames.
    pub score: Score,
}

/// The score of the frames whose spacing, the distance between the two closest true contacts, is in one range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SpacingScore {
    /// Least spacing of the range, mm.
    pub from_mm: f64,
    /// Upper end of the range, mm; frames with this spacing are in the next one. Absent for the last range.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_mm: Option<f64>,
    /// Score of these frames.
    pub score: Score,
}

/// A score over all frames, by their number of contacts, and by their spacing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Scores {
    /// Over all frames.
    pub all: Score,
    /// For each number of contacts that occurs, ascending.
    pub by_contacts: Vec<CountScore>,
    /// For each range of the spacing that occurs, ascending: frames with two true contacts or more, all at
    /// known positions. Older reports have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_spacing: Vec<SpacingScore>,
}

impl Mean {
    /// The mean of values, one of each row, with its interval by the bootstrap; `None` without values.
    pub fn of_rows(values: &[f64], seed: u64) -> Option<Self> {
        let mut hands = vec![[Tally::default()]; values.len().min(HANDS)];
        for (row, value) in values.iter().enumerate() {
            hands[row % HANDS][0].sum += value;
            hands[row % HANDS][0].count += 1.0;
        }
        mean_of(values, &hands, &resampled(&hands, seed), 0)
    }
}

impl Scores {
    /// Computes the scores of frames. `distances` are those of their skin, `seed` that of the bootstrap.
    pub fn of(touches: &[Touch], distances: &Distances, seed: u64) -> Self {
        let score_of = |is_in: &dyn Fn(&Touch) -> bool| {
            let chosen: Vec<&Touch> = touches.iter().filter(|touch| is_in(touch)).collect();
            Score::of(&chosen, seed)
        };
        let counts: BTreeSet<u32> = touches.iter().map(|touch| touch.contacts).collect();
        let of_count = |contacts: u32| CountScore {
            contacts,
            score: score_of(&|touch: &Touch| touch.contacts == contacts),
        };
        let [close_mm, far_mm] = distances.spacings_mm();
        let ranges = [(0.0, Some(close_mm)), (close_mm, Some(far_mm)), (far_mm, None)];
        let of_range = |(from_mm, to_mm): (f64, Option<f64>)| {
            let is_in = |mm: f64| mm >= from_mm && to_mm.is_none_or(|to_mm| mm < to_mm);
            let score = score_of(&|touch: &Touch| touch.spacing_mm.is_some_and(is_in));
            SpacingScore { from_mm, to_mm, score }
        };
        let by_spacing = ranges.into_iter().map(of_range);
        Self {
            all: score_of(&|_: &Touch| true),
            by_contacts: counts.into_iter().map(of_count).collect(),
            by_spacing: by_spacing.filter(|range| range.score.trials > 0).collect(),
        }
    }
}

impl Score {
    /// Criterion of the paper's best of many nets (V-D: "the minimum average location error and
    /// close to zero average force and diameter error"): location from each true contact to its
    /// closest estimate, as under its Table IV, in units of 100 mm, force and diameter in units of
    /// 100 %. So that a net that finds almost no contact is not the best, a contact of a frame
    /// without any estimate counts as far off as a guess: `guess_mm`, mm.
    pub fn paper_cost(&self, guess_mm: f64) -> f64 {
        let found = self.closest_mm.map_or(0.0, |closest| closest.n as f64);
        let sum_mm = self.closest_mm.map_or(0.0, |closest| found * closest.mean);
        let contacts = self.contacts as f64;
        let location_mm = (sum_mm + (contacts - found) * guess_mm) / contacts.max(1.0);
        let off = |mean: Option<Mean>| mean.map_or(1.0, |mean| mean.mean.abs() / 100.0);
        location_mm / 100.0 + off(self.force_percent) + off(self.diameter_percent)
    }

    /// Computes the score of frames; `seed` is that of the bootstrap.
    pub fn of(touches: &[&Touch], seed: u64) -> Self {
        let [number, location, closest, force, diameter, exact, ghosts, place_in_95, force_in_95] =
            means(touches, seed);
        let values = |metric| touches.iter().flat_map(move |touch| touch.values(metric));
        Self {
            trials: touches.len() as u64,
            contacts: touches.iter().map(|touch| u64::from(touch.contacts)).sum(),
            estimates: touches.iter().map(|touch| u64::from(touch.estimates)).sum(),
            number_percent: number,
            location_mm: location,
            location_median_mm: median(values(Metric::Location)),
            closest_mm: closest,
            force_percent: force,
            force_median_percent: median(values(Metric::Force).map(f64::abs)),
            diameter_percent: diameter,
            exact_rate: exact,
            ghosts_per_trial: ghosts,
            place_in_95,
            force_in_95,
        }
    }
}

/// Sum and count of the values of a group of frames.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    sum: f64,
    count: f64,
}

type Tallies<const METRICS: usize> = [Tally; METRICS];

/// The mean of each metric, in the order of [`Metric::ALL`].
fn means(touches: &[&Touch], seed: u64) -> [Option<Mean>; Metric::ALL.len()] {
    let values: Vec<Vec<f64>> = Metric::ALL
        .iter()
        .map(|metric| touches.iter().flat_map(|touch| touch.values(*metric)).collect())
        .collect();
    let hands = dealt(touches);
    let rounds = resampled(&hands, seed);
    std::array::from_fn(|metric| mean_of(&values[metric], &hands, &rounds, metric))
}

/// The mean of the values of a metric, with the interval of the rounds.
fn mean_of<const METRICS: usize>(
    values: &[f64],
    hands: &[Tallies<METRICS>],
    rounds: &[Vec<f64>; METRICS],
    metric: usize,
) -> Option<Mean> {
    if values.is_empty() {
        return None;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    // All rounds drawn from one frame's values would be equal.
    let several = hands.iter().filter(|hand| hand[metric].count > 0.0).count() > 1;
    let end = |share| quantile(&rounds[metric], share).filter(|_| several);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some(Mean {
        mean,
        sd: (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt()),
        n: values.len() as u64,
        low_95: end(TAIL),
        high_95: end(1.0 - TAIL),
    })
}

/// Assigns frames to at most [`HANDS`] groups in turn, and sums the values of each group.
fn dealt(touches: &[&Touch]) -> Vec<Tallies<{ Metric::ALL.len() }>> {
    let none = [Tally::default(); Metric::ALL.len()];
    let mut hands = vec![none; touches.len().min(HANDS)];
    for (frame, touch) in touches.iter().enumerate() {
        for (tally, &metric) in hands[frame % HANDS].iter_mut().zip(Metric::ALL) {
            for value in touch.values(metric) {
                tally.sum += value;
                tally.count += 1.0;
            }
        }
    }
    hands
}

/// The sorted means of each metric over the rounds of the bootstrap; empty for fewer than two
/// groups.
fn resampled<const METRICS: usize>(hands: &[Tallies<METRICS>], seed: u64) -> [Vec<f64>; METRICS] {
    let mut rounds: [Vec<f64>; METRICS] = std::array::from_fn(|_| Vec::new());
    let count = hands.len() as u32;
    if count < 2 {
        return rounds;
    }
    let mut chance = Chance::named(seed, "bootstrap");
    for _ in 0..RESAMPLES {
        let mut drawn = [Tally::default(); METRICS];
        for _ in 0..count {
            let hand = &hands[chance.below(count) as usize];
            for (total, tally) in drawn.iter_mut().zip(hand) {
                total.sum += tally.sum;
                total.count += tally.count;
            }
        }
        for (means, total) in rounds.iter_mut().zip(drawn) {
            if total.count > 0.0 {
                means.push(total.sum / total.count);
            }
        }
    }
    for means in &mut rounds {
        means.sort_by(f64::total_cmp);
    }
    rounds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Contact;

    fn contact(x_mm: f64, force_n: f64) -> Contact {
        let (x_mm, y_mm, force_n) = (Some(x_mm), Some(0.0), Some(force_n));
        Contact { x_mm, y_mm, force_n, diameter_mm: None }
    }

    fn touch(truths: &[Contact], estimates: &[Contact]) -> Touch {
        Touch::of(truths, estimates, Distances::PAPER.ghost_mm).unwrap()
    }

    fn scores_of(touches: &[Touch], seed: u64) -> Scores {
        Scores::of(touches, &Distances::PAPER, seed)
    }

    /// One contact, found 3 mm off; two, found 6 and 9 mm off and one ghost; none, and one found.
    fn frames() -> Vec<Touch> {
        let two = [contact(0.0, 10.0), contact(200.0, 10.0)];
        let found = [contact(6.0, 15.0), contact(209.0, 10.0), contact(400.0, 6.0)];
        vec![
            touch(&[contact(0.0, 10.0)], &[contact(3.0, 8.0)]),
            touch(&two, &found),
            touch(&[], &[contact(0.0, 5.0)]),
        ]
    }

    #[test]
    fn means_are_over_pairs_and_frames_and_untouched_ones_count_where_they_can() {
        let scores = scores_of(&frames(), 1);
        let all = &scores.all;
        assert_eq!((all.trials, all.contacts, all.estimates), (3, 3, 5));
        let location = all.location_mm.unwrap();
        assert_eq!((location.mean, location.sd, location.n), (6.0, Some(3.0), 3));
        assert_eq!(all.location_median_mm, Some(6.0));
        let number = all.number_percent.unwrap();
        assert_eq!((number.mean, number.n), (25.0, 2));
        let force = all.force_percent.unwrap();
        assert!((force.mean - 10.0).abs() < 1e-12 && force.n == 3);
        assert_eq!(all.force_median_percent, Some(20.0));
        assert_eq!(all.diameter_percent, None);
        assert!((all.exact_rate.unwrap().mean - 1.0 / 3.0).abs() < 1e-12);
        assert!((all.ghosts_per_trial.unwrap().mean - 2.0 / 3.0).abs() < 1e-12);
        let counts: Vec<u32> = scores.by_contacts.iter().map(|group| group.contacts).collect();
        assert_eq!(counts, [0, 1, 2]);
        let single = &scores.by_contacts[1].score;
        let mean = Mean { mean: 3.0, sd: None, n: 1, low_95: None, high_95: None };
        assert_eq!(single.location_mm, Some(mean));
        assert_eq!(scores.by_contacts[0].score.closest_mm, None);
        assert_eq!(Score::of(&[], 1), Score::default());
    }

    #[test]
    fn frames_with_two_contacts_or_more_are_split_by_the_distance_of_the_closest_two() {
        let row = |places_mm: &[f64]| -> Vec<Contact> {
            places_mm.iter().map(|x_mm| contact(*x_mm, 10.0)).collect()
        };
        let found = |truth: &[f64], estimate: &[f64]| touch(&row(truth), &row(estimate));
        let nowhere = Contact { x_mm: None, ..contact(0.0, 10.0) };
        let touches = [
            // Taken for one contact; both found, 2 and 4 mm off.
            found(&[100.0, 150.0], &[130.0]),
            found(&[100.0, 159.9, 400.0], &[102.0, 163.9, 400.0]),
            // A distance at a limit is in the range above it.
            found(&[100.0, 160.0], &[109.0, 160.0]),
            found(&[100.0, 220.0], &[101.0, 220.0]),
            found(&[300.0], &[300.0]),
            found(&[], &[300.0]),
            touch(&[nowhere, nowhere], &[nowhere]),
        ];
        let scores = scores_of(&touches, 1);
        let ends = scores.by_spacing.iter().map(|range| (range.from_mm, range.to_mm));
        let ranges = [(0.0, Some(60.0)), (60.0, Some(120.0)), (120.0, None)];
        assert_eq!(ends.collect::<Vec<_>>(), ranges);
        let trials: Vec<u64> = scores.by_spacing.iter().map(|range| range.score.trials).collect();
        assert_eq!(trials, [2, 1, 1]);
        let close = &scores.by_spacing[0].score;
        let location = close.location_mm.unwrap();
        assert!((location.mean - 6.5).abs() < 1e-9 && location.n == 4, "{location:?}");
        assert_eq!(close.number_percent.unwrap().mean, -25.0);
        let right = close.exact_rate.unwrap();
        assert_eq!((right.mean, right.low_95, right.high_95), (0.5, Some(0.0), Some(1.0)));
        assert_eq!(scores.by_spacing[1].score.location_mm.unwrap().mean, 4.5);
        // A range without frames is absent, as in reports of older versions.
        assert_eq!(scores_of(&touches[3..], 1).by_spacing.len(), 1);
        let mut json = serde_json::to_value(scores_of(&touches, 1)).unwrap();
        json.as_object_mut().unwrap().remove("by_spacing").unwrap();
        let older: Scores = serde_json::from_value(json).unwrap();
        assert_eq!(older, Scores { by_spacing: Vec::new(), ..scores });
    }

    #[test]
    fn intervals_hold_the_mean_as_often_as_they_say_and_depend_on_the_seed_alone() {
        let mut chance = Chance::named(3, "frames");
        let mut draw = |frames: usize| -> Vec<Touch> {
            let mut off = || f64::from(chance.below(1000)) / 50.0;
            (0..frames).map(|_| touch(&[contact(0.0, 10.0)], &[contact(off(), 10.0)])).collect()
        };
        let runs = 200;
        let held = (0..runs).filter(|seed| {
            let mean = scores_of(&draw(40), *seed).all.location_mm.unwrap();
            mean.low_95.unwrap() <= 9.99 && 9.99 <= mean.high_95.unwrap()
        });
        let held = held.count() as f64 / runs as f64;
        assert!((0.89..=0.99).contains(&held), "{held} of the intervals hold the mean");
        let frames = draw(40);
        assert_eq!(scores_of(&frames, 5), scores_of(&frames, 5));
        assert_ne!(scores_of(&frames, 5), scores_of(&frames, 6));
    }

    #[test]
    fn dealt_into_hands_many_frames_have_the_interval_of_the_normal_distribution() {
        let mut chance = Chance::named(4, "frames");
        let frames: Vec<Touch> = (0..2 * HANDS + HANDS / 2)
            .map(|_| f64::from(chance.below(1000)) / 50.0)
            .map(|off| touch(&[contact(0.0, 10.0)], &[contact(off, 10.0)]))
            .collect();
        let mean = scores_of(&frames, 1).all.location_mm.unwrap();
        let normal = 2.0 * 1.96 * mean.sd.unwrap() / (frames.len() as f64).sqrt();
        let width = mean.high_95.unwrap() - mean.low_95.unwrap();
        assert!((width / normal - 1.0).abs() < 0.12, "{width} mm against {normal}");
        assert!(
            (f64::midpoint(mean.low_95.unwrap(), mean.high_95.unwrap()) - mean.mean).abs() < 0.03
        );
    }

    #[test]
    fn a_net_that_finds_one_contact_well_is_not_the_papers_best() {
        let pressed = [contact(0.0, 10.0)];
        let cost = |near: usize, off_mm: f64| {
            let found = |i: usize| if i < near { vec![contact(off_mm, 10.0)] } else { Vec::new() };
            let frames: Vec<Touch> = (0..100).map(|i| touch(&pressed, &found(i))).collect();
            scores_of(&frames, 1).all.paper_cost(Distances::PAPER.guess_mm)
        };
        assert!(cost(100, 60.0) < cost(1, 5.0));
        assert!(cost(100, 30.0) < cost(100, 60.0));
        assert!(cost(0, 0.0).is_finite());
    }

    #[test]
    fn a_contact_without_an_estimate_costs_a_guess_on_its_skin() {
        let missed = scores_of(&[touch(&[contact(0.0, 10.0)], &[])], 1).all;
        // Force and diameter, which are unknown, cost 1 each.
        for (skin_mm, location) in [([540.0, 560.0], 2.87), ([60.0, 100.0], 0.5125)] {
            let cost = missed.paper_cost(Distances::on_skin(skin_mm).guess_mm);
            assert!((cost - 2.0 - location).abs() < 1e-12, "{skin_mm:?}: {cost}");
        }
    }

    #[test]
    fn contacts_of_a_frame_are_drawn_together() {
        // Five contacts of a frame share its error: the mean is as uncertain as with one of each.
        let frames = |contacts: usize| -> Vec<Touch> {
            let row = |off: f64| {
                let at = |i: usize| contact(80.0 * i as f64 + off, 10.0);
                (0..contacts).map(at).collect::<Vec<_>>()
            };
            (0..30).map(|i| touch(&row(0.0), &row(f64::from(i % 3)))).collect()
        };
        let width = |contacts| {
            let mean = scores_of(&frames(contacts), 1).all.location_mm.unwrap();
            mean.high_95.unwrap() - mean.low_95.unwrap()
        };
        assert!((width(5) / width(1) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn an_answer_survives_json_and_leaves_out_what_is_absent() {
        let scores = scores_of(&frames(), 1);
        let json = serde_json::to_string(&scores).unwrap();
        assert_eq!(serde_json::from_str::<Scores>(&json).unwrap(), scores);
        assert!(!json.contains("diameter_percent"), "{json}");
    }
}
