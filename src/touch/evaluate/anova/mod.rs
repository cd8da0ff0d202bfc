//! Fixed-effects analysis of variance on a full factorial design, with all interactions (paper
//! V-C2: pixel size x force distribution diameter x noise level).
//! PURE. Uses: statrs (Fisher's F). Never: single samples (cells store count, mean and sum of
//! squares), a cell without samples.
//!
//! Sums of squares are of type III: each effect is tested with every other one in the model, as a
//! hypothesis on the unweighted means of the cells, so that unequal cell sizes have no influence.
//! With cell means `m`, counts `n` and the contrasts `K` of an effect (differences to the first
//! level of its factors, averages over the levels of the others),
//!
//! ```text
//! SS = (K m)' [K diag(1/n) K']^-1 (K m)        df = rows of K
//! SS_error = sum of squares within cells        df_error = samples - cells
//! F = (SS / df) / (SS_error / df_error)
//! ```
//!
//! which is least squares on sum-to-zero contrasts (`statsmodels` with `C(.., Sum)`, `typ=3`), and
//! equals types I and II for equal cells. An estimated marginal mean is an unweighted average of
//! cell means; its standard error is `sqrt(SS_error / df_error * sum of w^2 / n)`.

use std::cmp::Reverse;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use utoipa::ToSchema;

#[cfg(test)]
mod tests;

/// Largest number of cells of a design.
pub const CELLS_MAX: usize = 256;

/// A varied quantity.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Factor {
    /// Name of the quantity.
    pub name: String,
    /// Its levels, two or more.
    pub levels: Vec<String>,
}

/// Why a design or its samples cannot be analysed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum AnovaError {
    #[error("a design needs a factor")]
    NoFactors,
    #[error("factor {name}: {levels} levels; it needs two or more")]
    Levels { name: String, levels: usize },
    #[error("a design of more than {CELLS_MAX} cells")]
    Cells,
    #[error("sample at {at:?}: the design has no such cell")]
    Place { at: Vec<usize> },
    #[error("sample {value}: must be finite")]
    Sample { value: f64 },
    /// `at`: `factor = level`, for each factor.
    #[error("no samples at {}: interactions cannot be determined", .at.join(", "))]
    EmptyCell { at: Vec<String> },
    /// One sample in each cell: the variance within cells cannot be estimated.
    #[error("{samples} samples for {cells} cells: at least one cell needs more than one")]
    TooFew { samples: u64, cells: usize },
}

/// Samples of a factorial design, summed cell by cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Factorial {
    factors: Vec<Factor>,
    /// One entry per cell; the index of the last factor's level varies fastest.
    cells: Vec<Moments>,
}

/// Count, mean and sum of squares around it (Welford 1962; joined as in Chan 1979).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Moments {
    n: f64,
    mean: f64,
    squares: f64,
}

impl FromIterator<f64> for Moments {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let one = |value| Self { n: 1.0, mean: value, squares: 0.0 };
        values.into_iter().fold(Self::default(), |all, value| all.join(one(value)))
    }
}

impl Moments {
    /// Number of values.
    pub fn count(&self) -> u64 {
        self.n as u64
    }

    /// The mean; `None` without values.
    pub fn mean(&self) -> Option<f64> {
        (self.n > 0.0).then_some(self.mean)
    }

    /// Standard deviation (n - 1); `None` with fewer than two values.
    pub fn sd(&self) -> Option<f64> {
        (self.n > 1.0).then(|| (self.squares / (self.n - 1.0)).sqrt())
    }

    fn join(self, other: Self) -> Self {
        let n = self.n + other.n;
        if n == 0.0 {
            return self;
        }
        let apart = other.mean - self.mean;
        Self {
            n,
            mean: self.mean + apart * other.n / n,
            squares: self.squares + other.squares + apart * apart * self.n * other.n / n,
        }
    }
}

/// Analysis of a design's samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Anova {
    /// Factors of the design.
    pub factors: Vec<Factor>,
    /// Number of samples.
    pub samples: u64,
    /// Main effects first, then interactions of two factors, and so on.
    pub effects: Vec<Effect>,
    /// Sum of squares within cells.
    pub error_sum_of_squares: f64,
    /// Number of samples minus number of cells.
    pub error_df: u64,
    /// For each effect, a mean for each combination of its levels; those of the last effect are the
    /// cells themselves.
    pub means: Vec<MarginalMean>,
}

/// A main effect or an interaction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Effect {
    /// Indices of its factors, ascending.
    pub factors: Vec<usize>,
    /// Sum of squares, type III.
    pub sum_of_squares: f64,
    /// Degrees of freedom.
    pub df: u64,
    /// Ratio of mean squares; absent if no cell has variance.
    pub f: Option<f64>,
    /// Probability of such an F or a larger one without the effect (0 if below the range of f64).
    pub p: Option<f64>,
}

/// An estimated marginal mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MarginalMean {
    /// For each factor of the design the index of its level, absent where it is averaged over.
    pub levels: Vec<Option<usize>>,
    /// Number of samples in the averaged cells.
    pub n: u64,
    /// Unweighted average of the cells' means.
    pub mean: f64,
    /// Standard error of the mean, from the variance within cells.
    pub standard_error: f64,
    /// Standard deviation of these samples around their mean (n - 1); absent for one sample.
    pub sd: Option<f64>,
}

impl Factorial {
    /// Builds a design without samples.
    ///
    /// # Errors
    /// `NoFactors`, `Levels` or `Cells` if the design is empty, has a constant factor or is too
    /// large.
    pub fn new(factors: Vec<Factor>) -> Result<Self, AnovaError> {
        if factors.is_empty() {
            return Err(AnovaError::NoFactors);
        }
        let mut cells: usize = 1;
        for Factor { name, levels } in &factors {
            if levels.len() < 2 {
                return Err(AnovaError::Levels { name: name.clone(), levels: levels.len() });
            }
            cells = cells.saturating_mul(levels.len());
        }
        if cells > CELLS_MAX {
            return Err(AnovaError::Cells);
        }
        Ok(Self { factors, cells: vec![Moments::default(); cells] })
    }

    /// Adds a sample taken at these levels, one index per factor.
    ///
    /// # Errors
    /// `AnovaError::Sample` if the value is not finite; `Place` if there is no such cell.
    pub fn add(&mut self, at: &[usize], value: f64) -> Result<(), AnovaError> {
        if !value.is_finite() {
            return Err(AnovaError::Sample { value });
        }
        self.join(at, [value].into_iter().collect())
    }

    /// Adds samples taken at these levels, by their moments.
    ///
    /// # Errors
    /// `AnovaError::Place` if there is no such cell.
    pub fn join(&mut self, at: &[usize], samples: Moments) -> Result<(), AnovaError> {
        let inside = at.iter().zip(&self.factors).all(|(level, f)| *level < f.levels.len());
        if at.len() != self.factors.len() || !inside {
            return Err(AnovaError::Place { at: at.to_vec() });
        }
        let cell = at.iter().zip(&self.factors).fold(0, |cell, (l, f)| cell * f.levels.len() + l);
        self.cells[cell] = self.cells[cell].join(samples);
        Ok(())
    }

    /// Analyses the samples; every cell needs a sample, and one of them a second one.
    ///
    /// # Errors
    /// `AnovaError::EmptyCell` or `TooFew` if there are not enough samples.
    pub fn analyse(&self) -> Result<Anova, AnovaError> {
        if let Some(empty) = self.cells.iter().position(|cell| cell.n == 0.0) {
            let levels = self.levels_of(empty);
            let named = levels.iter().zip(&self.factors);
            let at = named.map(|(level, f)| format!("{} = {}", f.name, f.levels[*level])).collect();
            return Err(AnovaError::EmptyCell { at });
        }
        let samples: f64 = self.cells.iter().map(|cell| cell.n).sum();
        let error_df = samples - self.cells.len() as f64;
        if error_df < 1.0 {
            let (samples, cells) = (samples as u64, self.cells.len());
            return Err(AnovaError::TooFew { samples, cells });
        }
        let error_sum_of_squares: f64 = self.cells.iter().map(|cell| cell.squares).sum();
        let mean_square = error_sum_of_squares / error_df;
        let mut sets: Vec<u32> = (1..1 << self.factors.len()).collect();
        sets.sort_by_key(|set| (set.count_ones(), Reverse(set.reverse_bits())));
        Ok(Anova {
            factors: self.factors.clone(),
            samples: samples as u64,
            effects: sets.iter().map(|set| self.effect(*set, mean_square, error_df)).collect(),
            error_sum_of_squares,
            error_df: error_df as u64,
            means: sets.iter().flat_map(|set| self.means(*set, mean_square)).collect(),
        })
    }

    fn levels_of(&self, mut cell: usize) -> Vec<usize> {
        let mut levels = vec![0; self.factors.len()];
        for (level, factor) in levels.iter_mut().zip(&self.factors).rev() {
            *level = cell % factor.levels.len();
            cell /= factor.levels.len();
        }
        levels
    }

    /// Rows of weights over the cells: products of weights of each factor's levels.
    fn weights(&self, of_factor: impl Fn(usize, usize) -> Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let mut rows = vec![vec![1.0]];
        for (number, factor) in self.factors.iter().enumerate() {
            let own = of_factor(number, factor.levels.len());
            let product = |row: &Vec<f64>, own: &Vec<f64>| {
                row.iter().flat_map(|r| own.iter().map(move |o| r * o)).collect::<Vec<f64>>()
            };
            rows =
                rows.iter().flat_map(|row| own.iter().map(move |own| product(row, own))).collect();
        }
        rows
    }

    fn effect(&self, set: u32, mean_square: f64, error_df: f64) -> Effect {
        let contrasts = self.weights(|factor, levels| match has(set, factor) {
            true => (1..levels).map(|level| difference(level, levels)).collect(),
            false => vec![average(levels)],
        });
        let values: Vec<f64> = contrasts.iter().map(|row| self.mean_of(row)).collect();
        let covariance: Vec<Vec<f64>> = contrasts
            .iter()
            .map(|a| contrasts.iter().map(|b| self.product_over_n(a, b)).collect())
            .collect();
        let sum_of_squares = quadratic(covariance, values);
        let df = contrasts.len() as f64;
        let f = (mean_square > 0.0).then(|| sum_of_squares / df / mean_square);
        let p = f.and_then(|f| Some(FisherSnedecor::new(df, error_df).ok()?.sf(f)));
        let factors = (0..self.factors.len()).filter(|factor| has(set, *factor)).collect();
        Effect { factors, sum_of_squares, df: contrasts.len() as u64, f, p }
    }

    fn means(&self, set: u32, mean_square: f64) -> Vec<MarginalMean> {
        let rows = self.weights(|factor, levels| match has(set, factor) {
            true => (0..levels).map(|level| only(level, levels)).collect(),
            false => vec![average(levels)],
        });
        rows.iter()
            .map(|row| {
                let behind = || row.iter().zip(&self.cells).filter(|(weight, _)| **weight > 0.0);
                let all = behind().fold(Moments::default(), |all, (_, cell)| all.join(*cell));
                let first = row.iter().position(|weight| *weight > 0.0).unwrap_or_default();
                let levels = self.levels_of(first).into_iter().enumerate();
                MarginalMean {
                    levels: levels.map(|(f, level)| has(set, f).then_some(level)).collect(),
                    n: all.n as u64,
                    mean: self.mean_of(row),
                    standard_error: (mean_square * self.product_over_n(row, row)).sqrt(),
                    sd: all.sd(),
                }
            })
            .collect()
    }

    fn mean_of(&self, weights: &[f64]) -> f64 {
        weights.iter().zip(&self.cells).map(|(weight, cell)| weight * cell.mean).sum()
    }

    fn product_over_n(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.cells).map(|((a, b), cell)| a * b / cell.n).sum()
    }
}

fn has(set: u32, factor: usize) -> bool {
    set >> factor & 1 == 1
}

/// Weights of levels: a single one, one minus the first, all equal.
fn only(level: usize, levels: usize) -> Vec<f64> {
    (0..levels).map(|l| f64::from(l == level)).collect()
}

fn difference(level: usize, levels: usize) -> Vec<f64> {
    let mut weights = only(level, levels);
    weights[0] = -1.0;
    weights
}

fn average(levels: usize) -> Vec<f64> {
    vec![1.0 / levels as f64; levels]
}

/// `v' A^-1 v` for a positive definite `A`: with A = L L', the square of `L^-1 v`. The few unknowns
/// do not justify a matrix library.
fn quadratic(mut a: Vec<Vec<f64>>, mut v: Vec<f64>) -> f64 {
    for k in 0..v.len() {
        let pivot = a[k][k].sqrt();
        v[k] /= pivot;
        for i in k + 1..v.len() {
            let factor = a[i][k] / pivot;
            a[i][k] = factor;
            v[i] -= factor * v[k];
        }
        for i in k + 1..v.len() {
            for j in k + 1..=i {
                a[i][j] -= a[i][k] * a[j][k];
            }
        }
    }
    v.iter().map(|value| value * value).sum()
}
