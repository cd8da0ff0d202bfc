//! Scores of quantities: positions, patterns, counts and forces of whole frames.
//! PURE. Uses: `learn::targets`, `score`. Never: nets, a row without the quantity (it is counted).

use std::collections::BTreeMap;

use nets::quantity::Quantity;
use serde::{Deserialize, Serialize};
use sim_core::stats::median;
use utoipa::ToSchema;

use super::score::Mean;
use crate::learn::targets::Targets;
use crate::store::Contact;

/// Scores of the answers to rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct QuantityScores {
    /// `position`, `pattern`, `count` or `force`.
    pub quantity: String,
    /// Number of rows that have the quantity.
    pub rows: u64,
    /// Number of rows without it, which have no score: a position has one contact.
    pub left_out: u64,
    /// Mean error of a row: distance, mm; wrong places; difference of counts; difference of forces, N.
    pub error: Mean,
    /// Median error of the answers, in the unit of the quantity.
    pub median_error: f64,
    /// Share of rows that are right, 0 to 1: all places of a pattern, or the number of contacts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub right: Option<Mean>,
    /// Mean error of the same answer to all rows, chosen with the truth: a net that learned nothing.
    pub constant_error: f64,
}

/// Error of an answer to one row.
struct Error {
    /// Distance, mm; wrong places; difference of counts; difference of forces, N.
    size: f64,
    /// Whether the answer is right; `None` for a quantity that has no right and wrong.
    is_right: Option<bool>,
}

impl QuantityScores {
    /// Scores answers, each as a net of the quantity gives it, to rows given by their contacts; `seed`
    /// is that of the bootstrap. `None` if no row has the quantity.
    pub fn of(targets: &Targets, rows: &[(&[Contact], &[f32])], seed: u64) -> Option<Self> {
        let of = |(contacts, answer): &(&[Contact], &[f32])| error(targets, contacts, answer);
        let errors: Vec<Error> = rows.iter().filter_map(of).collect();
        let values: Vec<f64> = errors.iter().map(|error| error.size).collect();
        let rights = errors.iter().filter_map(|error| Some(f64::from(u8::from(error.is_right?))));
        let same = constant(targets, rows.iter().map(|(contacts, _)| *contacts))?;
        let same = rows.iter().filter_map(|(contacts, _)| error(targets, contacts, &same));
        let same: Vec<f64> = same.map(|error| error.size).collect();
        Some(Self {
            quantity: targets.quantity.name().into(),
            rows: errors.len() as u64,
            left_out: (rows.len() - errors.len()) as u64,
            error: Mean::of_rows(&values, seed)?,
            median_error: median(values.iter().copied())?,
            right: Mean::of_rows(&rights.collect::<Vec<f64>>(), seed),
            constant_error: same.iter().sum::<f64>() / same.len() as f64,
        })
    }

    /// What must be small: the share of rows that are not right, or the mean error.
    pub fn cost(&self) -> f64 {
        self.right.map_or(self.error.mean, |right| 1.0 - right.mean)
    }

    /// Whether the 95 % intervals of the costs of two nets overlap; `false` if one is unknown.
    pub fn overlaps(&self, other: &Self) -> bool {
        let both = self.cost_95().zip(other.cost_95());
        both.is_some_and(|([low, high], [other_low, other_high])| {
            low <= other_high && other_low <= high
        })
    }

    /// Ends of the 95 % interval of the cost.
    fn cost_95(&self) -> Option<[f64; 2]> {
        let ends = |mean: Mean| Some([mean.low_95?, mean.high_95?]);
        match self.right {
            Some(right) => ends(right).map(|[low, high]| [1.0 - high, 1.0 - low]),
            None => ends(self.error),
        }
    }
}

/// Error of an answer; `None` if the row does not have the quantity.
fn error(targets: &Targets, contacts: &[Contact], answer: &[f32]) -> Option<Error> {
    let difference = |truth: &[f32]| f64::from(answer[0]) - f64::from(truth[0]);
    match targets.quantity {
        Quantity::Position => {
            let truth = targets.of_row(contacts)?;
            let apart = |axis: usize| f64::from(answer[axis]) - f64::from(truth[axis]);
            Some(Error { size: apart(0).hypot(apart(1)), is_right: None })
        }
        Quantity::Force => {
            let size = difference(&targets.of_row(contacts)?).abs();
            Some(Error { size, is_right: None })
        }
        Quantity::Count => {
            let truth = contacts.len() as f64;
            let apart = (f64::from(answer[0]).round().max(0.0) - truth).abs();
            Some(Error { size: apart, is_right: Some(apart == 0.0) })
        }
        Quantity::Pattern => {
            let truth = targets.pressed(contacts)?;
            let wrong = truth.places.iter().zip(answer).filter(|(is, y)| **is != (**y > 0.0));
            let wrong = wrong.count() as u32 + truth.elsewhere;
            Some(Error { size: f64::from(wrong), is_right: Some(wrong == 0) })
        }
    }
}

/// The best answer that is the same for all rows.
fn constant<'a>(
    targets: &Targets,
    rows: impl Iterator<Item = &'a [Contact]> + Clone,
) -> Option<Vec<f32>> {
    match targets.quantity {
        Quantity::Position | Quantity::Force => {
            let known: Vec<Vec<f32>> = rows.filter_map(|row| targets.of_row(row)).collect();
            let of = |axis: usize| {
                let values = known.iter().map(|target| f64::from(target[axis]));
                Some(median(values)? as f32)
            };
            (0..targets.len()).map(of).collect()
        }
        Quantity::Count => most_common(rows.map(<[Contact]>::len)).map(|count| vec![count as f32]),
        Quantity::Pattern => {
            let pressed = rows.filter_map(|row| targets.pressed(row)).map(|pressed| pressed.places);
            let signs = |is: bool| if is { 1.0 } else { -1.0 };
            most_common(pressed).map(|places| places.into_iter().map(signs).collect())
        }
    }
}

fn most_common<T: Ord>(values: impl Iterator<Item = T>) -> Option<T> {
    let mut counts = BTreeMap::new();
    values.for_each(|value| *counts.entry(value).or_insert(0u64) += 1);
    counts.into_iter().max_by_key(|(_, count)| *count).map(|(value, _)| value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contact(x_mm: f64, force_n: f64) -> Contact {
        Contact { x_mm: Some(x_mm), y_mm: Some(10.0), force_n: Some(force_n), diameter_mm: None }
    }

    fn scores(quantity: Quantity, rows: &[(&[Contact], &[f32])]) -> QuantityScores {
        let all = rows.iter().map(|(contacts, _)| *contacts);
        QuantityScores::of(&Targets::of(quantity, all).unwrap(), rows, 1).unwrap()
    }

    #[test]
    fn each_quantity_has_its_error() {
        let [one, other] = [[contact(10.0, 5.0)], [contact(50.0, 9.0)]];
        let both = [contact(10.0, 5.0), contact(50.0, 9.0)];
        let of_position = scores(
            Quantity::Position,
            &[(&one, &[13.0, 14.0]), (&other, &[50.0, 10.0]), (&both, &[0.0, 0.0])],
        );
        assert_eq!((of_position.rows, of_position.left_out), (2, 1));
        assert_eq!((of_position.error.mean, of_position.right), (2.5, None));
        assert_eq!(of_position.constant_error, 20.0);
        let of_count = scores(Quantity::Count, &[(&one, &[1.4]), (&both, &[1.4]), (&[], &[-0.7])]);
        assert_eq!(of_count.error.mean, 1.0 / 3.0);
        assert_eq!(of_count.right.unwrap().mean, 2.0 / 3.0);
        let of_force = scores(Quantity::Force, &[(&both, &[12.0]), (&[], &[1.0])]);
        assert_eq!((of_force.error.mean, of_force.right), (1.5, None));
        let rows: [(&[Contact], &[f32]); 3] =
            [(&one, &[0.2, -0.1]), (&both, &[0.2, -0.1]), (&other, &[0.1, 0.1])];
        let of_pattern = scores(Quantity::Pattern, &rows);
        assert_eq!(of_pattern.error.mean, 2.0 / 3.0);
        assert_eq!(of_pattern.right.unwrap().mean, 1.0 / 3.0);
        assert!((of_pattern.cost() - 2.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn rows_without_the_quantity_have_no_score() {
        let both = [contact(10.0, 5.0), contact(50.0, 9.0)];
        let targets = Targets { quantity: Quantity::Position, places_mm: Vec::new() };
        assert_eq!(QuantityScores::of(&targets, &[(&both, &[0.0, 0.0])], 1), None);
    }
}
