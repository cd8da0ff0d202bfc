//! Nonlinear least squares with few parameters, and the confidence intervals of these.
//! PURE. Uses: statrs (Student's t). Never: the meaning of the parameters.
//!
//! Levenberg-Marquardt on the normal equations, damped by their diagonal (Marquardt 1963), so that
//! the scale of parameters has no influence. Three unknowns do not justify a matrix library: the
//! MINPACK port (levenberg-marquardt, on nalgebra) would add eight crates to the build.
//! `tests/it/independent_fit.rs` compares it with scipy. Covariance `s2 (J'J)^-1` with
//! `s2 = |r|2 / (n - p)`, intervals with Student's t: valid for small residuals and independent
//! errors of equal variance.

use sim_core::calibration::Fitted;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Number of steps after which a fit fails.
const MOST_STEPS: usize = 100;
/// Largest cosine between residuals and a column of the Jacobian at an optimum.
const ORTHOGONAL: f64 = 1e-8;
/// A shorter step ends the fit (parameters are logarithms: a relative change).
const NO_STEP: f64 = 1e-9;
/// Least squared sine between a column of the Jacobian and the others: below, they are dependent.
const INDEPENDENT: f64 = 1e-10;

/// Values of a model for given parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction<const P: usize> {
    /// One value per observation.
    pub values: Vec<f64>,
    /// Derivative of each value by each parameter.
    pub slopes: Vec<[f64; P]>,
}

/// Why a fit failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum RegressionError<E: std::error::Error + 'static> {
    /// There are not more observations than parameters: the errors cannot be estimated.
    #[error(
        "{observations} rows are too few for {parameters} unknowns; at least one more is needed"
    )]
    TooFew { observations: usize, parameters: usize },
    /// The data do not determine the parameter of this index, from 0.
    #[error("the data do not determine unknown {parameter}")]
    Undetermined { parameter: usize },
    #[error("no optimum after {MOST_STEPS} steps")]
    NoConvergence,
    #[error(transparent)]
    Model(E),
}

/// The optimum with its statistics.
#[derive(Debug, Clone, PartialEq)]
pub struct Regression<const P: usize> {
    /// Parameters at the optimum.
    pub parameters: [f64; P],
    /// Covariance of the parameters.
    pub covariance: [[f64; P]; P],
    /// Observed minus predicted.
    pub residuals: Vec<f64>,
    /// Derivatives of the predictions at the optimum.
    pub slopes: Vec<[f64; P]>,
    /// Standard deviation of the residuals, by their degrees of freedom.
    pub residual_sd: f64,
    /// Number of observations minus number of parameters.
    pub freedom: usize,
}

impl<const P: usize> Regression<P> {
    /// Half-width of a 95 % interval in standard deviations: Student's t at 97.5 %.
    pub fn t_95(&self) -> f64 {
        t_95(self.freedom)
    }

    /// `exp` of a parameter, with the interval of the parameter: above 0 at both ends.
    pub fn exponential(&self, parameter: usize) -> Fitted {
        let half = self.t_95() * self.covariance[parameter][parameter].sqrt();
        let at = self.parameters[parameter];
        Fitted { value: at.exp(), low_95: (at - half).exp(), high_95: (at + half).exp() }
    }

    /// Standard deviation of a prediction with these derivatives, due to the parameters alone.
    pub fn prediction_sd(&self, slope: &[f64; P]) -> f64 {
        let row = |i: usize| (0..P).map(|j| self.covariance[i][j] * slope[j]).sum::<f64>();
        (0..P).map(|i| slope[i] * row(i)).sum::<f64>().max(0.0).sqrt()
    }
}

/// Student's t at 97.5 % for some degrees of freedom (at least 1).
pub fn t_95(freedom: usize) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1) as f64)
        .expect("location 0, scale 1 and at least one degree of freedom are legal")
        .inverse_cdf(0.975)
}

/// Fits parameters (logarithms, by the size of the steps) to observations, from start values.
///
/// # Errors
/// `RegressionError` if there are too few observations, a parameter is undetermined, the steps do
/// not converge, or the model fails.
pub fn fit<const P: usize, E: std::error::Error + 'static>(
    observed: &[f64],
    start: [f64; P],
    mut model: impl FnMut(&[f64; P]) -> Result<Prediction<P>, E>,
) -> Result<Regression<P>, RegressionError<E>> {
    if observed.len() <= P {
        let (observations, parameters) = (observed.len(), P);
        return Err(RegressionError::TooFew { observations, parameters });
    }
    let mut evaluate = |parameters: [f64; P]| {
        let prediction = model(&parameters).map_err(RegressionError::Model)?;
        Ok(State::new(observed, parameters, prediction))
    };
    let mut at = evaluate(start)?;
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        if at.is_optimal() {
            return at.finish();
        }
        let step = at.step(damping)?;
        let next = evaluate(std::array::from_fn(|k| at.parameters[k] + step[k]))?;
        if next.squares < at.squares {
            at = next;
            damping = (damping * 0.1f64).max(1e-12);
        } else if step.iter().all(|s| s.abs() < NO_STEP) {
            return at.finish();
        } else {
            damping *= 10.0;
        }
    }
    Err(RegressionError::NoConvergence)
}

/// State of the iteration.
struct State<const P: usize> {
    parameters: [f64; P],
    residuals: Vec<f64>,
    slopes: Vec<[f64; P]>,
    squares: f64,
    /// Length of each column of the Jacobian.
    scale: [f64; P],
    /// J'J of the columns scaled to length 1.
    normal: [[f64; P]; P],
    /// J'r of the columns scaled to length 1.
    gradient: [f64; P],
}

impl<const P: usize> State<P> {
    fn new(observed: &[f64], parameters: [f64; P], prediction: Prediction<P>) -> Self {
        let Prediction { values, slopes } = prediction;
        let residuals: Vec<f64> = observed.iter().zip(&values).map(|(o, v)| o - v).collect();
        let squares = residuals.iter().map(|r| r * r).sum();
        let sum = |term: &dyn Fn(&[f64; P], f64) -> f64| -> f64 {
            slopes.iter().zip(&residuals).map(|(s, &r)| term(s, r)).sum()
        };
        let scale: [f64; P] = std::array::from_fn(|k| sum(&|s, _| s[k] * s[k]).sqrt());
        let normal = std::array::from_fn(|i| {
            std::array::from_fn(|j| sum(&|s, _| s[i] * s[j]) / (scale[i] * scale[j]))
        });
        let gradient = std::array::from_fn(|k| sum(&|s, r| s[k] * r) / scale[k]);
        Self { parameters, residuals, slopes, squares, scale, normal, gradient }
    }

    fn is_optimal(&self) -> bool {
        let length = self.squares.sqrt();
        self.gradient.iter().all(|g| g.abs() <= ORTHOGONAL * length)
    }

    fn step<E: std::error::Error>(&self, damping: f64) -> Result<[f64; P], RegressionError<E>> {
        let mut damped = self.normal;
        for (k, row) in damped.iter_mut().enumerate() {
            row[k] *= 1.0 + damping;
        }
        let factor = cholesky(&damped, 0.0).map_err(undetermined)?;
        let step = solve(&factor, self.gradient);
        Ok(std::array::from_fn(|k| step[k] / self.scale[k]))
    }

    fn finish<E: std::error::Error>(self) -> Result<Regression<P>, RegressionError<E>> {
        let factor = cholesky(&self.normal, INDEPENDENT).map_err(undetermined)?;
        let freedom = self.residuals.len() - P;
        let variance = self.squares / freedom as f64;
        let columns: [[f64; P]; P] =
            std::array::from_fn(|j| solve(&factor, std::array::from_fn(|i| f64::from(i == j))));
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| variance * columns[j][i] / (self.scale[i] * self.scale[j]))
        });
        Ok(Regression {
            parameters: self.parameters,
            covariance,
            residuals: self.residuals,
            slopes: self.slopes,
            residual_sd: variance.sqrt(),
            freedom,
        })
    }
}

fn undetermined<E: std::error::Error>(parameter: usize) -> RegressionError<E> {
    RegressionError::Undetermined { parameter }
}

/// Lower triangle L of `L L' = a`; the index of the first pivot that is not above `least`.
fn cholesky<const P: usize>(a: &[[f64; P]; P], least: f64) -> Result<[[f64; P]; P], usize> {
    let mut l = [[0.0; P]; P];
    for i in 0..P {
        for j in 0..=i {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i != j {
                l[i][j] = rest / l[j][j];
            } else if rest > least {
                l[i][i] = rest.sqrt();
            } else {
                return Err(i);
            }
        }
    }
    Ok(l)
}

/// Solves `L L' x = b`.
fn solve<const P: usize>(l: &[[f64; P]; P], b: [f64; P]) -> [f64; P] {
    let mut x = b;
    for i in 0..P {
        x[i] = (x[i] - (0..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
    }
    for i in (0..P).rev() {
        x[i] = (x[i] - (i + 1..P).map(|k| l[k][i] * x[k]).sum::<f64>()) / l[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    /// A straight line, for which everything is known in closed form.
    fn line(x: &[f64]) -> impl Fn(&[f64; 2]) -> Result<Prediction<2>, Infallible> {
        move |p| {
            let values = x.iter().map(|x| p[0] + p[1] * x).collect();
            Ok(Prediction { values, slopes: x.iter().map(|&x| [1.0, x]).collect() })
        }
    }

    #[test]
    fn a_straight_line_has_the_textbook_estimates_and_errors() {
        let (x, y) = ([1.0, 2.0, 3.0, 4.0, 5.0], [1.1, 1.9, 3.2, 3.9, 5.1]);
        let fit = fit(&y, [0.0, 0.0], line(&x)).unwrap();
        // Calculated manually: Sxx = 10, Sxy = 10, mean x 3, mean y 3.04.
        assert!((fit.parameters[1] - 1.0).abs() < 1e-7, "{:?}", fit.parameters);
        assert!((fit.parameters[0] - 0.04).abs() < 1e-7);
        let residual_squares: f64 = [0.06f64, -0.14, 0.16, -0.14, 0.06].iter().map(|r| r * r).sum();
        let variance = residual_squares / 3.0;
        assert!((fit.residual_sd.powi(2) - variance).abs() < 1e-12);
        assert!((fit.covariance[1][1] - variance / 10.0).abs() < 1e-12);
        assert!((fit.covariance[0][0] - variance * (0.2 + 9.0 / 10.0)).abs() < 1e-12);
        assert!((fit.covariance[0][1] + variance * 3.0 / 10.0).abs() < 1e-12);
        // At the mean of x only the error of the mean remains.
        assert!((fit.prediction_sd(&[1.0, 3.0]).powi(2) - variance / 5.0).abs() < 1e-12);
    }

    #[test]
    fn students_t_has_the_values_of_the_tables() {
        for (freedom, value) in [(1, 12.706), (2, 4.303), (5, 2.571), (30, 2.042), (10_000, 1.960)]
        {
            assert!((t_95(freedom) - value).abs() < 6e-4, "{freedom}: {}", t_95(freedom));
        }
    }

    #[test]
    fn what_the_data_leave_free_is_said() {
        let same = fit(&[1.0, 2.0, 3.0], [0.0, 0.0], line(&[2.0, 2.0, 2.0])).unwrap_err();
        assert!(matches!(same, RegressionError::Undetermined { parameter: 1 }), "{same}");
        let few = fit(&[1.0, 2.0], [0.0, 0.0], line(&[1.0, 2.0])).unwrap_err();
        assert!(matches!(few, RegressionError::TooFew { observations: 2, parameters: 2 }), "{few}");
    }

    #[test]
    fn a_curved_valley_is_followed_to_its_end() {
        // Rosenbrock's valley as least squares: residuals 10 (y - x2) and 1 - x, and a third
        // observation with residual zero.
        let valley = |p: &[f64; 2]| -> Result<Prediction<2>, Infallible> {
            let [x, y] = *p;
            Ok(Prediction {
                values: vec![10.0 * (y - x * x), x, 0.0],
                slopes: vec![[-20.0 * x, 10.0], [1.0, 0.0], [0.0, 0.0]],
            })
        };
        let fit = fit(&[0.0, 1.0, 0.0], [-1.2, 1.0], valley).unwrap();
        assert!(fit.parameters.iter().all(|p| (p - 1.0).abs() < 1e-6), "{:?}", fit.parameters);
    }
}
