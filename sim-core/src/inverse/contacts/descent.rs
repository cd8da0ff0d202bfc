//! Levenberg-Marquardt on contacts' positions and forces, with evidence and standard deviations at
//! the optimum. Uses: a model that predicts projected frames. Never: adding or dropping a contact.
//!
//! Parameters of a contact: x, y (mm, limited) and ln F. Prior: uniform on the skin, normal in
//! ln F. Evidence is Laplace's approximation: the height of the optimum times the width that data
//! and prior leave, over the width of the prior. A contact must therefore lower the misfit by twice
//! the logarithm of the skin's area over `2 pi sd_x sd_y`, and of the prior's width in ln F over
//! its sd: about 14 for a contact known to 10 mm. This threshold is like that of the Bayesian
//! information criterion (3 ln 784 = 20; earlier 2 ln 784 = 13,
//! `docs/references.md`, "Feasibility study"), but follows from the case instead of being chosen.

use super::basis::Projected;
use super::dense::{cholesky, dot, solve};
use super::shapes::Place;
use crate::forward::ContactResult;

/// Number of parameters of a contact.
pub(super) const EACH: usize = 3;
/// Damping at the start, and its factors after a good and after a bad step.
const DAMPING: f64 = 1e-3;
const LESS: f64 = 0.2;
const MORE: f64 = 5.0;
/// Number of consecutive bad steps that end the descent.
const BAD_STEPS: usize = 8;
/// Longest step: mm, and ln F.
const STEP: Place = [25.0, 25.0, 0.7];
/// Limits of ln F: 0.3 N to 150 N.
const LN_FORCE: [f64; 2] = [-1.2, 5.01];

/// Prior distribution of a contact.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prior {
    pub ln_force_mean: f64,
    pub ln_force_sd: f64,
    /// ln of the prior odds of one further contact.
    pub ln_odds: f64,
    /// Limits of a position, mm: `[axis][end]`.
    pub limits_mm: [[f64; 2]; 2],
}

impl Prior {
    /// Contribution of the forces to -2 ln evidence.
    fn of_forces(&self, places: &[Place]) -> f64 {
        let of = |p: &Place| ((p[2] - self.ln_force_mean) / self.ln_force_sd).powi(2);
        places.iter().map(of).sum()
    }

    /// Precision of x, y and ln F, for x and y that of a normal as wide as the uniform one.
    fn precision(&self) -> Place {
        let of = |[low, high]: [f64; 2]| 12.0 / (high - low).powi(2);
        let [x, y] = self.limits_mm;
        [of(x), of(y), self.ln_force_sd.powi(-2)]
    }

    pub fn clamp(&self, place: Place) -> Place {
        let [[x0, x1], [y0, y1]] = self.limits_mm;
        let [x, y, f] = place;
        [x.clamp(x0, x1), y.clamp(y0, y1), f.clamp(LN_FORCE[0], LN_FORCE[1])]
    }

    /// Contribution of `count` contacts to -2 ln evidence, without misfit, force and width.
    fn of_count(&self, count: usize) -> f64 {
        let area = self.limits_mm.map(|[low, high]| high - low).iter().product::<f64>();
        let each = (std::f64::consts::TAU * self.ln_force_sd.powi(2)).ln() + 2.0 * area.ln()
            - EACH as f64 * std::f64::consts::TAU.ln()
            - 2.0 * self.ln_odds;
        // Contacts are interchangeable: k! labellings are one load.
        let ln_orders: f64 = (1..=count).map(|n| (n as f64).ln()).sum();
        count as f64 * each - 2.0 * ln_orders
    }
}

/// Predicts projected frames, whitened as the measured one.
pub(super) trait Predict {
    /// Writes the frame of contacts, and its slopes by x, y and ln F of each (each of the frame's
    /// length).
    fn predict(
        &mut self,
        places: &[Place],
        z: &mut Vec<f64>,
        slopes: &mut Vec<f64>,
    ) -> ContactResult<()>;
}

/// The fitted frame, whitened, and the prior.
#[derive(Debug, Clone, Copy)]
pub(super) struct Problem<'a> {
    pub z: &'a [f64],
    pub prior: &'a Prior,
}

/// Limits of a descent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    pub iterations: usize,
    /// The descent ends when the cost decreases by less than this.
    pub tolerance: f64,
}

/// Result of a descent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Optimum {
    /// Sum of squares of the whitened residual.
    pub misfit: f64,
    /// -2 ln evidence, up to a constant of the frame.
    pub score: f64,
    /// Number of model evaluations.
    pub predictions: usize,
}

/// Uncertainty of a contact.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Spread {
    /// Variances of x, y and ln F.
    pub variance: Place,
    /// Share of each that the model's error has, 0 to 1.
    pub by_model: Place,
}

/// Memory of descents; may be reused.
#[derive(Debug, Default)]
pub(super) struct DescentWork {
    z: Vec<f64>,
    slopes: Vec<f64>,
    trial_z: Vec<f64>,
    trial_slopes: Vec<f64>,
    trial: Vec<Place>,
    residual: Vec<f64>,
    damped: Vec<f64>,
    normal: Vec<f64>,
    factor: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
}

impl DescentWork {
    /// Residual at the last optimum.
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }

    /// Slopes at the last optimum.
    pub fn slopes(&self) -> &[f64] {
        &self.slopes
    }

    /// Uncertainty of each contact at the last optimum of a frame.
    pub fn spreads(&mut self, count: usize, frame: &Projected) -> Vec<Spread> {
        let (size, width) = (EACH * count, frame.z.len());
        let mut spreads = vec![Spread::default(); count];
        if !cholesky(&self.normal, size, &mut self.factor) {
            return spreads;
        }
        let (mut column, mut gain, mut of_numbers) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..size {
            column.clear();
            column.resize(size, 0.0);
            column[i] = 1.0;
            solve(&self.factor, size, &mut column);
            // What the parameter changes by with each number of the frame.
            gain.clear();
            gain.resize(width, 0.0);
            for (slope, weight) in self.slopes.chunks_exact(width).zip(&column) {
                gain.iter_mut().zip(slope).for_each(|(g, s)| *g += weight * s);
            }
            frame.whitener.transposed(&gain, &mut of_numbers);
            let by_model: f64 =
                of_numbers.iter().zip(&frame.by_model).map(|(g, v2)| g * g * v2).sum();
            let spread = &mut spreads[i / EACH];
            spread.variance[i % EACH] = column[i];
            spread.by_model[i % EACH] = (by_model / column[i]).clamp(0.0, 1.0);
        }
        spreads
    }
}

/// Descends from `places`, and leaves the optimum in it.
pub(super) fn descend(
    problem: &Problem<'_>,
    model: &mut impl Predict,
    places: &mut [Place],
    effort: Effort,
    work: &mut DescentWork,
) -> ContactResult<Optimum> {
    let prior = problem.prior;
    places.iter_mut().for_each(|p| *p = prior.clamp(*p));
    model.predict(places, &mut work.z, &mut work.slopes)?;
    let mut misfit = work.take_residual(problem);
    let mut cost = misfit + prior.of_forces(places);
    let (mut damping, mut bad, mut predictions) = (DAMPING, 0, 1);
    let mut converged = places.is_empty();
    work.assemble(problem, places);
    while !converged && predictions < effort.iterations && bad < BAD_STEPS {
        let expected = work.take_step(prior, places, damping);
        if expected < effort.tolerance {
            break;
        }
        let DescentWork { trial, trial_z, trial_slopes, .. } = work;
        model.predict(trial, trial_z, trial_slopes)?;
        predictions += 1;
        let trial_misfit = misfit_of(problem, trial_z);
        let trial_cost = trial_misfit + prior.of_forces(trial);
        if trial_cost < cost {
            converged = cost - trial_cost < effort.tolerance;
            (misfit, cost, bad) = (trial_misfit, trial_cost, 0);
            damping = (damping * LESS).max(1e-9);
            places.copy_from_slice(trial);
            std::mem::swap(&mut work.z, &mut work.trial_z);
            std::mem::swap(&mut work.slopes, &mut work.trial_slopes);
            work.take_residual(problem);
            work.assemble(problem, places);
        } else {
            bad += 1;
            damping *= MORE;
        }
    }
    let score = cost + prior.of_count(places.len()) + work.ln_determinant(EACH * places.len());
    Ok(Optimum { misfit, score, predictions })
}

fn misfit_of(problem: &Problem<'_>, z: &[f64]) -> f64 {
    problem.z.iter().zip(z).map(|(measured, z)| (measured - z).powi(2)).sum()
}

impl DescentWork {
    fn take_residual(&mut self, problem: &Problem<'_>) -> f64 {
        self.residual.clear();
        self.residual.extend(problem.z.iter().zip(&self.z).map(|(measured, z)| measured - z));
        misfit_of(problem, &self.z)
    }

    /// Normal equations with the prior, at the current slopes and residual.
    fn assemble(&mut self, problem: &Problem<'_>, places: &[Place]) {
        let (size, width) = (EACH * places.len(), problem.z.len());
        self.normal.clear();
        self.normal.resize(size * size, 0.0);
        self.gradient.clear();
        for (i, slope) in self.slopes.chunks_exact(width).enumerate() {
            self.gradient.push(dot(slope, &self.residual));
            for (j, column) in self.slopes.chunks_exact(width).enumerate().take(i + 1) {
                self.normal[i * size + j] = dot(slope, column);
            }
        }
        let precision = problem.prior.precision();
        for (c, place) in places.iter().enumerate() {
            for (parameter, precision) in precision.iter().enumerate() {
                let i = EACH * c + parameter;
                self.normal[i * size + i] += precision;
            }
            // The uniform prior of the position has no slope; its width only bounds the normal
            // matrix.
            let prior = problem.prior;
            self.gradient[EACH * c + 2] += (prior.ln_force_mean - place[2]) * precision[2];
        }
    }

    /// Writes the places after a damped step, and returns the predicted decrease of the cost.
    fn take_step(&mut self, prior: &Prior, places: &[Place], damping: f64) -> f64 {
        let size = EACH * places.len();
        let mut damped = std::mem::take(&mut self.damped);
        damped.clear();
        damped.extend_from_slice(&self.normal);
        self.step.clear();
        self.step.extend_from_slice(&self.gradient);
        for (c, place) in places.iter().enumerate() {
            for axis in 0..EACH {
                let i = EACH * c + axis;
                damped[i * size + i] *= 1.0 + damping;
                let mut pushed = *place;
                pushed[axis] += 1e-6 * self.gradient[i].signum();
                if prior.clamp(pushed)[axis] == place[axis] && self.gradient[i] != 0.0 {
                    // At a limit and pushed against it: the parameter stays.
                    self.step[i] = 0.0;
                    for j in 0..size {
                        damped[i.max(j) * size + i.min(j)] = f64::from(u8::from(i == j));
                    }
                }
            }
        }
        let solvable = cholesky(&damped, size, &mut self.factor);
        self.damped = damped;
        if !solvable {
            return 0.0;
        }
        solve(&self.factor, size, &mut self.step);
        let longest = self.step.iter().enumerate().map(|(i, s)| s.abs() / STEP[i % EACH]);
        let scale = 1.0 / longest.fold(1.0, f64::max);
        self.trial.clear();
        self.trial.extend(places.iter().zip(self.step.chunks_exact(EACH)).map(|(p, step)| {
            prior.clamp(std::array::from_fn(|axis| p[axis] + scale * step[axis]))
        }));
        scale * dot(&self.gradient, &self.step)
    }

    fn ln_determinant(&mut self, size: usize) -> f64 {
        if !cholesky(&self.normal, size, &mut self.factor) {
            return f64::INFINITY;
        }
        (0..size).map(|i| 2.0 * self.factor[i * size + i].ln()).sum()
    }
}
