//! Several explanations of a frame: their shares of the evidence, and which are reported.
//! PURE. Uses: `fit`, `search`. Never: the model; an explanation twice.

use super::fit::{Explanation, FittedContact};
use super::place_of;
use super::search::{Hypothesis, same};
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

/// The first of these hypotheses with a sufficient share.
pub(super) fn probable<'h>(
    others: impl Iterator<Item = (&'h Hypothesis, &'h f64)>,
) -> impl Iterator<Item = (&'h Hypothesis, &'h f64)> {
    others.take_while(|(_, share)| **share >= LEAST_PROBABILITY).take(MOST_ALTERNATIVES)
}

/// The explanations of a frame.
#[derive(Debug)]
pub(super) struct Explanations {
    /// Probability of the answer.
    pub probability: f64,
    /// The others, the most probable first.
    pub alternatives: Vec<Explanation>,
}

impl Explanations {
    /// The answer alone, with its probability.
    pub fn of(probability: f64) -> Self {
        Self { probability, alternatives: Vec::new() }
    }

    /// Adds an explanation. If its descent ended at the answer or at a known one, it is that one.
    pub fn add(&mut self, answer: &[FittedContact], other: Explanation) {
        let places = |contacts: &[FittedContact]| -> Vec<Place> {
            contacts.iter().map(|found| place_of(&found.contact)).collect()
        };
        let is_other = |known: &[FittedContact]| same(&places(known), &places(&other.contacts));
        if is_other(answer) {
            self.probability += other.probability;
        } else if let Some(known) = self.alternatives.iter_mut().find(|k| is_other(&k.contacts)) {
            known.probability += other.probability;
        } else {
            self.alternatives.push(other);
        }
        self.alternatives.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::Contact;

    fn at(x_mm: f64) -> Vec<FittedContact> {
        let contact = Contact { x_mm, y_mm: 100.0, force_n: 9.0 };
        vec![FittedContact { contact, x_sd_mm: 2.0, y_sd_mm: 2.0, force_sd_n: 0.5 }]
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
    fn few_and_improbable_explanations_are_not_reported() {
        let hypothesis = Hypothesis { places: Vec::new(), score: 0.0 };
        let number = |shares: &[f64]| probable(shares.iter().map(|s| (&hypothesis, s))).count();
        assert_eq!(number(&[0.3, 0.05, 0.049]), 2);
        assert_eq!(number(&[0.2, 0.2, 0.2, 0.2]), MOST_ALTERNATIVES);
    }

    #[test]
    fn descents_that_end_at_one_place_are_one_explanation() {
        let mut found = Explanations::of(0.4);
        for (x_mm, probability) in [(200.0, 0.1), (103.0, 0.2), (300.0, 0.15), (202.0, 0.1)] {
            found.add(&at(100.0), Explanation { probability, contacts: at(x_mm) });
        }
        assert!((found.probability - 0.6).abs() < 1e-12);
        let others: Vec<(f64, f64)> = found
            .alternatives
            .iter()
            .map(|e| (e.contacts[0].contact.x_mm, e.probability))
            .collect();
        assert_eq!(others, [(200.0, 0.2), (300.0, 0.15)]);
    }
}
