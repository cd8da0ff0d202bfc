//! The hand of the virtual operator: where it puts weights, and its mistakes.
//! Uses: rand, sim-core's sensor (the points). Never: the service, the rig.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::sensor::Sensor;

use crate::bench::Weight;

/// Least distance of a wrong point from every point that was asked, mm: a mistake, not a neighbour.
const MISTAKE_MM: f64 = 60.0;

/// Reason why a hand cannot err as requested.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum HandError {
    #[error("--mistakes {0}: must be from 0 to 1, with --sensor FILE")]
    Mistakes(f64),
}

/// The hand of the operator: where it puts weights.
pub struct Hand {
    mistakes: f64,
    points_mm: Vec<[f64; 2]>,
    chance: ChaCha8Rng,
}

impl Hand {
    /// A hand that errs with a probability, on the points of a sensor.
    ///
    /// # Errors
    /// `HandError` if the probability is not from 0 to 1, or above 0 without points.
    pub fn new(mistakes: f64, seed: u64, sensor: Option<&Sensor>) -> Result<Self, HandError> {
        let points = sensor.into_iter().flat_map(|sensor| sensor.points());
        let points_mm: Vec<[f64; 2]> = points.map(|p| [p.x_mm, p.y_mm]).collect();
        let is_share = (0.0..=1.0).contains(&mistakes);
        if !is_share || mistakes > 0.0 && points_mm.is_empty() {
            return Err(HandError::Mistakes(mistakes));
        }
        let chance = ChaCha8Rng::seed_from_u64(seed);
        Ok(Self { mistakes, points_mm, chance })
    }

    /// Places weights as asked, or one of them on a point that is far from all that were asked.
    pub fn places(&mut self, asked: &[Weight]) -> Vec<Weight> {
        let mut placed = asked.to_vec();
        if placed.is_empty() || !self.chance.random_bool(self.mistakes) {
            return placed;
        }
        let far = |p: &&[f64; 2]| {
            asked.iter().all(|w| (w.x_mm - p[0]).hypot(w.y_mm - p[1]) >= MISTAKE_MM)
        };
        let wrong: Vec<&[f64; 2]> = self.points_mm.iter().filter(far).collect();
        if let Some([x_mm, y_mm]) = wrong.get(self.chance.random_range(0..wrong.len().max(1))) {
            let slip = self.chance.random_range(0..placed.len());
            (placed[slip].x_mm, placed[slip].y_mm) = (*x_mm, *y_mm);
        }
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hand_slips_with_its_probability_and_the_same_seed_slips_again() {
        let text = include_str!("../../experiments/sensors/ert-28.toml");
        let sensor = Sensor::from_toml(text).unwrap();
        let hand = |mistakes| Hand::new(mistakes, 1, Some(&sensor)).unwrap();
        let weight = |x_mm, y_mm| Weight { x_mm, y_mm, force_n: 4.905 };
        let asked = [weight(100.0, 80.0), weight(300.0, 300.0)];
        let (mut one, mut two) = (hand(0.3), hand(0.3));
        let mut slips = 0;
        for _ in 0..1000 {
            let placed = one.places(&asked);
            assert_eq!(placed, two.places(&asked));
            let moved: Vec<_> = placed.iter().zip(&asked).filter(|(p, a)| p != a).collect();
            assert!(moved.len() <= 1);
            slips += moved.len();
            for (placed, asked) in moved {
                let far = (placed.x_mm - asked.x_mm).hypot(placed.y_mm - asked.y_mm);
                assert!(far >= MISTAKE_MM && placed.force_n == asked.force_n);
            }
        }
        assert!((230..370).contains(&slips), "{slips}");
        assert_eq!(hand(0.0).places(&asked), asked);
        assert!(matches!(Hand::new(0.1, 1, None), Err(HandError::Mistakes(_))), "no points");
        assert!(matches!(Hand::new(1.1, 1, Some(&sensor)), Err(HandError::Mistakes(_))));
    }
}
