//! How often answers are right that state a probability: the calibration of ambiguity.
//! PURE. Uses: `score`. Never: an answer without a stated probability.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::score::Mean;

/// Ends of the ranges of the stated probability; the last range holds its upper end.
const RANGES: [[f64; 2]; 6] =
    [[0.0, 0.2], [0.2, 0.4], [0.4, 0.6], [0.6, 0.8], [0.8, 0.95], [0.95, 1.0]];

/// An answer with its stated probability, compared with the truth. It is right if it has the right number of
/// contacts, each within the distance of a ghost of its true one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JudgedAnswer {
    /// Stated probability, 0 to 1.
    pub probability: f64,
    /// Whether it is right.
    pub right: bool,
    /// Whether it or one of its alternatives is right.
    pub any_right: bool,
}

/// The answers with a stated probability in one range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReliabilityRange {
    /// Lower end of the range.
    pub from: f64,
    /// Upper end; answers with this probability are in the next range, if there is one.
    pub to: f64,
    /// Mean of the stated probabilities.
    pub stated: f64,
    /// Share of the answers that are right: the right number of contacts, each within
    /// `distances.ghost_mm` of the report.
    pub right: Mean,
}

/// How often answers are right, by their stated probability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Reliability {
    /// The ranges that have answers, ascending.
    pub ranges: Vec<ReliabilityRange>,
    /// Share of all answers that are right.
    pub right: Mean,
    /// Share of all answers that are right, or have a right alternative.
    pub any_right: Mean,
}

impl Reliability {
    /// Of these answers; `None` without any. `seed` is that of the bootstrap.
    pub fn of(answers: &[JudgedAnswer], seed: u64) -> Option<Self> {
        let share = |of: &mut dyn Iterator<Item = bool>| {
            Mean::of_rows(&of.map(f64::from).collect::<Vec<_>>(), seed)
        };
        let last = RANGES.len() - 1;
        let range = |(n, [from, to]): (usize, [f64; 2])| {
            let is_in = |p: f64| p >= from && (p < to || n == last);
            let here: Vec<&JudgedAnswer> =
                answers.iter().filter(|answer| is_in(answer.probability)).collect();
            let right = share(&mut here.iter().map(|answer| answer.right))?;
            let stated = here.iter().map(|answer| answer.probability).sum::<f64>();
            Some(ReliabilityRange { from, to, stated: stated / here.len() as f64, right })
        };
        Some(Self {
            ranges: RANGES.into_iter().enumerate().filter_map(range).collect(),
            right: share(&mut answers.iter().map(|answer| answer.right))?,
            any_right: share(&mut answers.iter().map(|answer| answer.any_right))?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(probability: f64, right: bool, any_right: bool) -> JudgedAnswer {
        JudgedAnswer { probability, right, any_right }
    }

    #[test]
    fn answers_are_counted_in_the_range_of_what_they_state() {
        let answers = [
            answer(0.6, false, true),
            answer(0.79, true, true),
            answer(0.8, true, true),
            answer(1.0, true, true),
            answer(0.97, false, false),
        ];
        let found = Reliability::of(&answers, 1).unwrap();
        let ranges: Vec<(f64, f64, u64)> = found
            .ranges
            .iter()
            .map(|range| (range.from, range.right.mean, range.right.n))
            .collect();
        assert_eq!(ranges, [(0.6, 0.5, 2), (0.8, 1.0, 1), (0.95, 0.5, 2)]);
        assert!((found.ranges[0].stated - 0.695).abs() < 1e-12);
        assert_eq!((found.right.mean, found.any_right.mean), (0.6, 0.8));
        assert_eq!(Reliability::of(&[], 1), None);
    }
}
