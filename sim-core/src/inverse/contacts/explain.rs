//! Several explanations of a frame: their shares of the evidence, and which are reported.
//! PURE. Uses: `fit`, `search`. Never: the model; an explanation twice.

use super::fit::{Explanation, FittedContact};
use super::place_of;
use super::search::{Hypothesis, closest_mm, same};
use super::shapes::Place;

/// Smallest share of the evidence of a reported explanation.
const LEAST_PROBABILITY: f64 = 0.05;
/// Largest number of explanations in addition to the answer.
const MOST_ALTERNATIVES: usize = 3;

/// Share of the evidence of each hypothesis. `scores`: -2 ln evidence, best first.
pub(super) fn shares(scores: &[f64]) -> Vec<f64> {
    let Some(best) = scores.first() else { return Vec::new() };
    let odds: Vec<f64> = scores.iter().map(|score| (0.5 * (best - score)).exp()).collect();
    let all: f64 = odds.iter().sum();
    odds.iter().map(|odds| odds / all).collect()
}

/// Index of the answer: the most probable of the hypotheses with the most probable number of contacts. Two places for
/// the third contact share the evidence for three. `counts`: number of contacts of each hypothesis; `shares`: most
/// probable first.
pub(super) fn answer(counts: &[usize], shares: &[f64]) -> usize {
    let of_count = |count: usize| -> f64 {
        counts.iter().zip(shares).filter(|(c, _)| **c == count).map(|(_, share)| share).sum()
    };
    let better = |best: usize, at: usize| {
        if of_count(counts[at]) > of_count(counts[best]) { at } else { best }
    };
    (0..counts.len()).reduce(better).unwrap_or(0)
}

/// The first of these hypotheses with a sufficient share.
pub(super) fn probable<'h>(
    others: impl Iterator<Item = (&'h Hypothesis, &'h f64)>,
) -> impl Iterator<Item = (&'h Hypothesis, &'h f64)> {
    others.take_while(|(_, share)| **share >= LEAST_PROBABILITY).take(MOST_ALTERNATIVES)
}

#[derive(Debug)]
pub(super) struct Explanations {
    /// Probability of the answer.
    pub probability: f64,
    /// The others, in the order in which they were added.
    pub alternatives: Vec<Explanation>,
    /// Smallest distance of two contacts of an explanation, mm.
    least_distance_mm: f64,
    /// Share of the evidence that does not count: of explanations that are known already or collapsed.
    excluded: f64,
}

impl Explanations {
    /// The answer alone, with its share.
    pub fn of(probability: f64, least_distance_mm: f64) -> Self {
        Self { probability, alternatives: Vec::new(), least_distance_mm, excluded: 0.0 }
    }

    /// Adds an explanation with its share. If its descent ended at the answer or at a known one, it is that one,
    /// whose evidence is counted already; if it ended with two contacts at one place, it is none.
    pub fn add(&mut self, answer: &[FittedContact], other: Explanation) {
        let places = |contacts: &[FittedContact]| -> Vec<Place> {
            contacts.iter().map(|found| place_of(&found.contact)).collect()
        };
        let ended = places(&other.contacts);
        let is_other = |known: &[FittedContact]| same(&places(known), &ended);
        if closest_mm(&ended) < self.least_distance_mm
            || is_other(answer)
            || self.alternatives.iter().any(|known| is_other(&known.contacts))
        {
            self.excluded += other.probability;
        } else {
            self.alternatives.push(other);
        }
    }

    /// Makes the shares those of the evidence that is counted once.
    pub fn counted_once(mut self) -> Self {
        let all = 1.0 - self.excluded;
        self.probability /= all;
        self.alternatives.iter_mut().for_each(|other| other.probability /= all);
        self.excluded = 0.0;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::Contact;

    fn at(x_mm: f64) -> Vec<FittedContact> {
        let contact = Contact { x_mm, y_mm: 100.0, force_n: 9.0 };
        let (x_sd_mm, y_sd_mm, force_sd_n, by_model) = (2.0, 2.0, 0.5, [0.5; 3]);
        vec![FittedContact { contact, x_sd_mm, y_sd_mm, force_sd_n, by_model }]
    }

    #[test]
    fn shares_follow_from_the_evidence() {
        // Odds of 3 to 1 to 1e-9.
        let third = 2.0 * 3f64.ln();
        let shares = shares(&[40.0, 40.0 + third, 40.0 + 2.0 * 1e9f64.ln()]);
        assert!((shares[0] - 0.75).abs() < 1e-6 && (shares[1] - 0.25).abs() < 1e-6, "{shares:?}");
        assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(super::shares(&[]).is_empty());
    }

    #[test]
    fn the_answer_has_the_most_probable_number_of_contacts() {
        assert_eq!(answer(&[2, 3, 3, 2], &[0.4, 0.35, 0.2, 0.05]), 1);
        assert_eq!(answer(&[2, 3, 3, 4], &[0.5, 0.25, 0.2, 0.05]), 0);
        assert_eq!(answer(&[3, 2], &[0.5, 0.5]), 0, "the first of equal ones");
        assert_eq!(answer(&[], &[]), 0);
    }

    #[test]
    fn few_and_improbable_explanations_are_not_reported() {
        let hypothesis = Hypothesis { places: Vec::new(), score: 0.0 };
        let number = |shares: &[f64]| probable(shares.iter().map(|s| (&hypothesis, s))).count();
        assert_eq!(number(&[0.3, 0.05, 0.049]), 2);
        assert_eq!(number(&[0.2, 0.2, 0.2, 0.2]), MOST_ALTERNATIVES);
    }

    #[test]
    fn descents_that_end_at_one_place_are_one_explanation_and_count_once() {
        let mut found = Explanations::of(0.4, 20.0);
        for (x_mm, probability) in [(200.0, 0.2), (103.0, 0.15), (300.0, 0.1), (202.0, 0.05)] {
            found.add(&at(100.0), Explanation { probability, contacts: at(x_mm) });
        }
        // 0.15 of the answer and 0.05 of the explanation at 200 mm are the same evidence again.
        let found = found.counted_once();
        assert!((found.probability - 0.5).abs() < 1e-12);
        let places: Vec<f64> =
            found.alternatives.iter().map(|e| e.contacts[0].contact.x_mm).collect();
        assert_eq!(places, [200.0, 300.0]);
        let shares: Vec<f64> = found.alternatives.iter().map(|e| e.probability).collect();
        assert!(
            (shares[0] - 0.25).abs() < 1e-12 && (shares[1] - 0.125).abs() < 1e-12,
            "{shares:?}"
        );
    }

    #[test]
    fn contacts_that_collapse_are_no_explanation() {
        let mut found = Explanations::of(0.6, 20.0);
        let close = [at(200.0), at(215.0)].concat();
        found.add(&at(100.0), Explanation { probability: 0.2, contacts: close });
        let apart = [at(200.0), at(225.0)].concat();
        found.add(&at(100.0), Explanation { probability: 0.2, contacts: apart.clone() });
        let found = found.counted_once();
        assert!((found.probability - 0.75).abs() < 1e-12);
        assert_eq!(found.alternatives.len(), 1);
        assert_eq!(found.alternatives[0].contacts, apart);
    }
}
