//! The paper's published values for comparison: Tables I, III and IV, Fig. 7F, V-C2 (Fig. 11) and V-D.
//! PURE. Uses: `force_map` (the twelve maps). Never: a number that the paper does not print.
//!
//! The paper prints one location error. Under Table IV it is called the distance from each true
//! contact to the closest estimate; the text (V-B2) matches contacts first. Palpate reports both.

use serde::Serialize;
use utoipa::ToSchema;

use crate::dataset::force_map::{self, ForceMapSpec};

use super::touch::Metric;

/// Table I: trials of Real-Hex with 1 to 6 contacts.
pub const REAL_HEX: [u64; 6] = [20_092, 21_313, 19_712, 14_487, 15_944, 2_126];
/// Table I: trials of Real-Random with 1 to 6 contacts.
pub const REAL_RANDOM: [u64; 6] = [0, 50, 50, 50, 0, 0];

/// Fig. 7F: median FVU of the simulation, read from the figure.
pub const SIMULATION_FVU: f64 = 0.1;

/// A published mean.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Printed {
    /// Value of the mean.
    pub mean: f64,
    /// Standard deviation, if it is printed.
    pub sd: Option<f64>,
}

/// A published score.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Published {
    /// Error of the number of contacts, %.
    pub number_percent: Printed,
    /// Error of the location, mm.
    pub location_mm: Printed,
    /// Error of the force, %.
    pub force_percent: Printed,
    /// Error of the diameter, %.
    pub diameter_percent: Printed,
}

const fn spread(mean: f64, sd: f64) -> Printed {
    Printed { mean, sd: Some(sd) }
}

const fn alone(mean: f64) -> Printed {
    Printed { mean, sd: None }
}

const fn map(number: [f64; 2], location: [f64; 2], force: [f64; 2], width: [f64; 2]) -> Published {
    Published {
        number_percent: spread(number[0], number[1]),
        location_mm: spread(location[0], location[1]),
        force_percent: spread(force[0], force[1]),
        diameter_percent: spread(width[0], width[1]),
    }
}

/// Table IV: Recon-Net alone, Maps 1 to 12 in the order of [`force_map::TABLE_IV_MAPS`].
pub const TABLE_IV: [Published; 12] = [
    map([-22.0, 23.0], [11.0, 22.0], [-1.0, 52.0], [-31.0, 12.0]),
    map([-18.0, 22.0], [11.0, 18.0], [-7.0, 42.0], [11.0, 17.0]),
    map([-14.0, 20.0], [11.0, 17.0], [-3.0, 42.0], [36.0, 18.0]),
    map([-11.0, 18.0], [13.0, 16.0], [5.0, 43.0], [69.0, 22.0]),
    map([-12.0, 18.0], [13.0, 14.0], [0.0, 40.0], [107.0, 25.0]),
    map([-12.0, 19.0], [15.0, 15.0], [-1.0, 39.0], [134.0, 28.0]),
    map([-28.0, 26.0], [12.0, 25.0], [-18.0, 44.0], [-34.0, 21.0]),
    map([-15.0, 20.0], [14.0, 22.0], [-2.0, 42.0], [19.0, 17.0]),
    map([-11.0, 18.0], [13.0, 18.0], [5.0, 46.0], [81.0, 22.0]),
    map([-12.0, 21.0], [16.0, 19.0], [-2.0, 41.0], [171.0, 28.0]),
    map([-15.0, 22.0], [15.0, 26.0], [-7.0, 43.0], [18.0, 15.0]),
    map([-4.0, 26.0], [23.0, 36.0], [-6.0, 48.0], [128.0, 18.0]),
];

/// Table IV's score of a map, if it is one of the twelve.
pub fn table_iv(spec: ForceMapSpec) -> Option<Published> {
    let number = force_map::TABLE_IV_MAPS.iter().position(|map| *map == spec)?;
    Some(TABLE_IV[number])
}

/// V-D: the whole pipeline on Real-Unseen, its best of 36 (Map 1, noise of 50 %).
pub const REAL_UNSEEN: Published = Published {
    number_percent: alone(-58.3),
    location_mm: alone(74.4),
    force_percent: alone(17.2),
    diameter_percent: alone(-9.3),
};

/// RMSE and FVU of one cell of Table III.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Transfer {
    /// Mean RMSE, V.
    pub rmse_v: f64,
    /// Mean FVU as printed in the paper, %.
    pub fvu_percent: f64,
}

/// One row of Table III.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Rung {
    /// Trained on frames of 1 to this many contacts.
    pub trained_to: u32,
    /// Fit on the training set.
    pub train: Transfer,
    /// Fit on the test sets of 1 to 6 contacts; beyond `trained_to` that is extrapolation.
    pub test: [Transfer; 6],
}

const fn rung(trained_to: u32, train: [f64; 2], test: [[f64; 2]; 6]) -> Rung {
    const fn cell(cell: [f64; 2]) -> Transfer {
        Transfer { rmse_v: cell[0], fvu_percent: cell[1] }
    }
    let [one, two, three, four, five, six] = test;
    let test = [cell(one), cell(two), cell(three), cell(four), cell(five), cell(six)];
    Rung { trained_to, train: cell(train), test }
}

/// Table III: Transfer-Net on R2S-Transfer.
pub const TABLE_III: [Rung; 6] = [
    rung(
        1,
        [0.002, 1.0],
        [[0.003, 4.8], [0.026, 75.5], [0.031, 64.4], [0.047, 92.8], [0.055, 97.8], [0.047, 78.7]],
    ),
    rung(
        2,
        [0.002, 0.5],
        [[0.003, 5.0], [0.009, 4.3], [0.019, 19.4], [0.025, 20.3], [0.034, 34.0], [0.029, 32.1]],
    ),
    rung(
        3,
        [0.004, 0.7],
        [[0.004, 5.1], [0.009, 4.7], [0.011, 4.1], [0.019, 13.2], [0.024, 14.3], [0.030, 16.0]],
    ),
    rung(
        4,
        [0.004, 0.7],
        [[0.004, 5.1], [0.009, 4.5], [0.011, 4.0], [0.010, 2.3], [0.019, 6.2], [0.027, 12.6]],
    ),
    rung(
        5,
        [0.006, 0.9],
        [[0.004, 5.2], [0.010, 4.8], [0.011, 4.2], [0.010, 2.4], [0.012, 2.1], [0.016, 5.6]],
    ),
    rung(
        6,
        [0.007, 1.1],
        [[0.004, 5.7], [0.010, 5.4], [0.012, 5.0], [0.010, 2.5], [0.012, 2.3], [0.014, 4.2]],
    ),
];

/// Levels of an average in V-C2: a factor with a level is fixed, the others are averaged.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Held {
    /// Side of a pixel, mm.
    pub pixel_mm: Option<f64>,
    /// Diameter over which forces are spread, mm.
    pub diameter_mm: Option<f64>,
    /// Noise in training, % of the transfer error's standard deviation.
    pub noise_percent: Option<f64>,
}

/// An estimated marginal mean that V-C2 quotes from Fig. 11.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marginal {
    /// Metric of the error: number %, location mm, force % or diameter %.
    pub metric: Metric,
    /// Levels of the fixed factors.
    pub held: Held,
    /// Value of the mean.
    pub mean: f64,
}

const fn at(
    metric: Metric,
    pixel_mm: Option<f64>,
    diameter_mm: Option<f64>,
    noise_percent: Option<f64>,
    mean: f64,
) -> Marginal {
    Marginal { metric, held: Held { pixel_mm, diameter_mm, noise_percent }, mean }
}

/// V-C2: the whole pipeline on the held-out part of *real*, with each contact as a sample.
pub const FIG_11: [Marginal; 17] = [
    at(Metric::Number, Some(20.0), Some(60.0), None, -11.9),
    at(Metric::Number, Some(4.0), Some(20.0), None, -29.2),
    at(Metric::Number, None, None, Some(0.0), -19.8),
    at(Metric::Number, None, None, Some(10.0), -14.9),
    at(Metric::Number, None, None, Some(50.0), -19.4),
    at(Metric::Location, Some(4.0), None, None, 18.2),
    at(Metric::Location, Some(20.0), None, None, 20.3),
    at(Metric::Location, None, None, Some(0.0), 19.0),
    at(Metric::Location, None, None, Some(10.0), 20.3),
    at(Metric::Location, None, None, Some(50.0), 18.3),
    at(Metric::Force, Some(20.0), Some(60.0), None, -13.5),
    at(Metric::Force, Some(4.0), Some(60.0), None, -1.9),
    at(Metric::Diameter, None, Some(20.0), None, 12.1),
    at(Metric::Diameter, None, Some(60.0), None, 132.3),
    at(Metric::Diameter, None, None, Some(0.0), 64.2),
    at(Metric::Diameter, None, None, Some(10.0), 77.1),
    at(Metric::Diameter, None, None, Some(50.0), 75.6),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_found_by_what_they_are() {
        assert_eq!(table_iv("4x60".parse().unwrap()), Some(TABLE_IV[5]));
        assert_eq!(table_iv("20x60".parse().unwrap()).unwrap().location_mm, spread(23.0, 36.0));
        assert_eq!(table_iv("4x24".parse().unwrap()), None);
    }

    /// Statements of the paper's text about its tables.
    #[test]
    fn the_tables_say_what_the_text_says_of_them() {
        let own = TABLE_III.iter().flat_map(|rung| &rung.test[..rung.trained_to as usize]);
        assert!(own.clone().all(|cell| cell.fvu_percent < 6.0), "less than 6 % where trained");
        assert_eq!(own.count(), 21);
        assert!(TABLE_III.iter().zip(1..).all(|(rung, count)| rung.trained_to == count));
        let spreads = TABLE_IV[..6].iter().map(|map| map.force_percent.sd.unwrap());
        assert_eq!(spreads.collect::<Vec<_>>(), [52.0, 42.0, 42.0, 43.0, 40.0, 39.0]);
        let mean_of = |metric, noise| {
            let held = Held { noise_percent: Some(noise), ..Held::default() };
            FIG_11.iter().find(|m| m.metric == metric && m.held == held).unwrap().mean
        };
        let noises = [0.0, 10.0, 50.0].map(|noise| mean_of(Metric::Number, noise).abs());
        assert!(noises[1] < noises[0] && noises[1] < noises[2], "10 % counts best");
        // Each factor's levels average to the same grand mean (the paper rounds to a tenth).
        let noises = [0.0, 10.0, 50.0].map(|noise| mean_of(Metric::Diameter, noise));
        let by_noise = noises.iter().sum::<f64>() / 3.0;
        assert!((by_noise - (12.1 + 132.3) / 2.0).abs() < 0.1);
    }
}
