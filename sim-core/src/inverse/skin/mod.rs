//! The skin behind measured trials: fields, electrodes, resistances and offsets, fitted by
//! Gauss-Newton steps with the adjoint Jacobian.
//! Uses: `forward`, `jacobian`, `skin`, faer. Never: files, a clock, chance.
//!
//! `cost = sum over trials of rho(r^2 / variance) + prior`. rho is Huber's on the root of a trial's misfit, so
//! that a bad frame pulls no harder than a bad one at its edge. Trials are added in their order: the
//! result does not depend on the number of threads.

mod frame;
mod parameters;
mod places;
mod sweep;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

use crate::forward::{Contact, ContactError, ForwardModel, ModelError, Workspace};
use crate::jacobian::Field;
use crate::mesh::Mesh;
use crate::responses::UnitResponses;
use crate::sensor::Sensor;
use crate::skin::{FieldPrior, FvuSummary, SkinElectrodes, SkinFields, rounded};

use parameters::Parameters;
use sweep::{Misfits, Sweep};

/// A step that lowers the cost by less than this share is the last.
const ENOUGH: f64 = 2e-3;
/// Steps in which electrodes are looked for: at first the rest is too far off to tell a wrong place by.
const PLACING: [usize; 2] = [2, 4];
/// Largest change of ln of an electrode's resistance in a step: voltages are linear in the resistance
/// itself, so that a loose electrode's logarithm would run away to an open end.
const RESISTANCE_STEP: f64 = 1.0;
/// With more damping than this no step would be worth its pass.
const MOST_DAMPING: f64 = 1e3;
/// Noise is taken to be at least this, V: a converter's step.
const LEAST_NOISE_V: f64 = 1e-5;

/// One measured trial.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredTrial {
    /// What pressed; none on an untouched skin, which tells the offsets.
    pub contacts: Vec<Contact>,
    /// The frame, V after gain.
    pub frame_v: Vec<f32>,
}

/// What is expected of a skin before it is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinPrior {
    /// Of ln a.
    pub ln_a: FieldPrior,
    /// Of ln b.
    pub ln_b: FieldPrior,
    /// Of ln c.
    pub ln_c: FieldPrior,
    /// Of ln compliance.
    pub ln_compliance: FieldPrior,
    /// Of ln sheet conductance.
    pub ln_sheet_conductance: FieldPrior,
    /// Of the logarithm of the foam law's slope.
    pub foam_sd: f64,
    /// Over which compression that forgets, mm.
    pub foam_mm: f64,
    /// Electrodes off their places, mm per axis.
    pub electrode_sd_mm: f64,
    /// Median contact resistance, ohm.
    pub contact_ohm: f64,
    /// Spread of its logarithm.
    pub contact_ln_sd: f64,
    /// Median lead resistance, ohm.
    pub lead_ohm: f64,
    /// Spread of its logarithm.
    pub lead_ln_sd: f64,
    /// Offset of a channel, V.
    pub offset_sd_v: f64,
}

impl Default for SkinPrior {
    fn default() -> Self {
        let field = |overall_sd: f64, smooth_sd: f64, local_sd: f64| FieldPrior {
            overall_sd,
            smooth_sd,
            smooth_mm: 60.0,
            local_sd,
            local_mm: 20.0,
        };
        Self {
            ln_a: field(1.0, 0.5, 0.25),
            ln_b: field(0.3, 0.1, 0.0),
            ln_c: field(0.5, 0.2, 0.0),
            ln_compliance: field(0.3, 0.1, 0.05),
            ln_sheet_conductance: field(0.3, 0.1, 0.0),
            foam_sd: 0.3,
            foam_mm: 0.8,
            electrode_sd_mm: 4.0,
            contact_ohm: 30.0,
            contact_ln_sd: 1.0,
            lead_ohm: 300.0,
            lead_ln_sd: 2.0,
            offset_sd_v: 1e-2,
        }
    }
}

impl SkinPrior {
    fn fields(&self) -> [FieldPrior; 5] {
        [self.ln_a, self.ln_b, self.ln_c, self.ln_compliance, self.ln_sheet_conductance]
    }
}

/// How far a trial may be from a perfect model: what no skin explains (tilted tips, load cells, drift)
/// moves what seems to press, and is looked for in each trial; the rest is noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialErrors {
    /// Standard deviation of a reading, V.
    pub noise_v: f64,
    /// By how much a contact may seem to stand elsewhere, mm per axis.
    pub place_mm: f64,
    /// By how much it may seem to press more or less, as a share of its force.
    pub force_share: f64,
    /// By how much a whole frame may seem larger or smaller, as a share of it.
    pub gain_share: f64,
    /// What is then left, as a share of a frame's norm.
    pub model_error: f64,
    /// In how many independent directions of the frame that is: far fewer than it has channels.
    pub directions: f64,
}

impl Default for TrialErrors {
    fn default() -> Self {
        Self {
            noise_v: 1.2e-3,
            place_mm: 2.0,
            force_share: 0.05,
            gain_share: 0.03,
            model_error: 0.02,
            directions: 30.0,
        }
    }
}

impl TrialErrors {
    fn variance(&self, frame_v: &[f32]) -> f64 {
        let square = frame_v.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>();
        self.noise_v.powi(2) + self.model_error.powi(2) * square / self.directions
    }
}

/// How to fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinFitOptions {
    /// What is expected.
    pub prior: SkinPrior,
    /// The weights.
    pub errors: TrialErrors,
    /// Corners of the finest fields are at most so far apart, mm; see [`spacing_mm`].
    pub spacing_mm: f64,
    /// Most Gauss-Newton steps.
    pub steps: usize,
    /// Threads; the result does not depend on them.
    pub threads: usize,
}

impl SkinFitOptions {
    /// Defaults for so many trials.
    pub fn for_trials(trials: usize, threads: usize) -> Self {
        Self {
            prior: SkinPrior::default(),
            errors: TrialErrors::default(),
            spacing_mm: spacing_mm(trials),
            steps: 10,
            threads,
        }
    }
}

/// Spacing of the finest fields for so many trials, mm: finer when there is more to tell them.
pub fn spacing_mm(trials: usize) -> f64 {
    match trials {
        0..500 => 45.0,
        500..4000 => 30.0,
        _ => 18.0,
    }
}

/// How far a fit is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinProgress {
    /// Steps done.
    pub step: usize,
    /// Most steps.
    pub steps: usize,
    /// Cost so far; `None` in the first step.
    pub cost: Option<f64>,
    /// Work done of this step, as trials; a step goes over all of them three times, and twice that where
    /// electrodes are looked for.
    pub done: usize,
    /// Work of this step.
    pub total: usize,
}

/// Why there is no fit.
#[derive(Debug, thiserror::Error)]
pub enum SkinFitError {
    /// No trials.
    #[error("fitting a skin: no trials with a contact")]
    NoTrials,
    /// A frame has another length than the sensor's, or is not finite.
    #[error("fitting a skin: trial {trial}: {found} finite voltages, the sensor has {needed}")]
    Frame {
        /// Index of the trial.
        trial: usize,
        /// Finite voltages found.
        found: usize,
        /// Voltages needed.
        needed: usize,
    },
    /// A contact that the model does not take.
    #[error("fitting a skin: {0}")]
    Contact(#[from] ContactError),
    /// A skin on the way could not be built.
    #[error("fitting a skin: {0}")]
    Model(#[from] ModelError),
    /// A field's prior has no inverse: a standard deviation or length is not positive.
    #[error("fitting a skin: the prior of {0:?} is degenerate")]
    Prior(Field),
    /// The prior of the foam's law has no inverse.
    #[error("fitting a skin: the prior of the foam's law is degenerate")]
    FoamPrior,
    /// The normal equations have no solution.
    #[error("fitting a skin: step {step}: the normal equations are not positive definite")]
    Normal {
        /// The step.
        step: usize,
    },
}

/// A fitted skin.
#[derive(Debug, Clone)]
pub struct SkinFit {
    /// The fields.
    pub fields: SkinFields,
    /// The electrodes.
    pub electrodes: SkinElectrodes,
    /// Offset of each channel, mV.
    pub offsets_mv: Vec<f64>,
    /// Parameters fitted.
    pub parameters: usize,
    /// Cost before the first step and after each.
    pub costs: Vec<f64>,
    /// Trials of contacts (by index) that counted for less than half.
    pub doubted: Vec<usize>,
}

impl SkinFit {
    /// The model of the fitted skin, as a calibration file of it gives it.
    pub fn model(
        &self,
        sensor: &Sensor,
        responses: Arc<UnitResponses>,
    ) -> Result<ForwardModel, ModelError> {
        let fields = self.fields.over(sensor, &Mesh::new(sensor)?)?;
        ForwardModel::with(sensor, responses, fields, self.electrodes.circuit(sensor))
    }
}

/// Fits a skin to trials. `sensor` holds what is known of all such skins (its file, a calibration of
/// Eq. 1 and moduli); `responses` are its own.
pub fn fit(
    sensor: &Sensor,
    responses: Arc<UnitResponses>,
    trials: &[MeasuredTrial],
    options: &SkinFitOptions,
    progress: &mut dyn FnMut(SkinProgress),
) -> Result<SkinFit, SkinFitError> {
    check(sensor, trials)?;
    let parameters = Parameters::new(sensor, responses, options.prior, options.spacing_mm)?;
    let mut sweep = Sweep::new(&parameters, trials, options, progress);
    let mut vector = vec![0.0; parameters.len()];
    let mut offsets_v = vec![0.0; sensor.channels()];
    let mut model = parameters.model(&vector)?;
    let (mut costs, mut factors, mut damping) = (Vec::new(), vec![1.0; trials.len()], 0.0);
    for step in 1..=options.steps {
        sweep.begin(step, costs.last().copied());
        let mut best = stepped(&mut sweep, &vector, &model, &offsets_v, (step, damping))?;
        let mut moved = false;
        if PLACING.contains(&step)
            && let Some(there) = places::placed(&mut sweep, &model, &offsets_v, &factors, &vector)?
        {
            let model = parameters.model(&there)?;
            let there = stepped(&mut sweep, &there, &model, &offsets_v, (step, damping))?;
            let worth =
                |there: &Step| best.as_ref().is_none_or(|b| there.is_better(b, &parameters));
            if there.as_ref().is_some_and(worth) {
                (best, moved) = (there, true);
            }
        }
        let Some(next) = best else { break };
        if costs.is_empty() {
            costs.push(next.before);
        }
        offsets_v = next.there.offsets_v(options.prior.offset_sd_v);
        costs.push(next.after);
        let gain = next.before - next.after;
        (vector, model, factors, damping) = (next.vector, next.model, next.factors, next.damping);
        if gain < ENOUGH * next.before && !moved && step >= PLACING[0] {
            break;
        }
    }
    let doubted = (0..trials.len()).filter(|&i| factors[i] < 0.5 && !trials[i].contacts.is_empty());
    Ok(SkinFit {
        fields: parameters.skin_fields(&vector),
        electrodes: parameters.skin_electrodes(&vector),
        offsets_mv: offsets_v.iter().map(|v| rounded(1e3 * v)).collect(),
        parameters: parameters.len(),
        costs,
        doubted: doubted.collect(),
    })
}

/// A step that lowered the cost.
struct Step {
    vector: Vec<f64>,
    model: ForwardModel,
    there: Misfits,
    /// Weight of each trial.
    factors: Vec<f64>,
    edge: f64,
    before: f64,
    after: f64,
    damping: f64,
}

impl Step {
    /// Whether it leads to a lower cost than another, by the other's doubts.
    fn is_better(&self, other: &Self, parameters: &Parameters) -> bool {
        let cost = |s: &Self| s.there.cost(other.edge) + parameters.prior_cost(&s.vector);
        cost(self) < cost(other)
    }
}

/// The Gauss-Newton step from a vector, as short as it must be; `None` where none lowers the cost.
fn stepped(
    sweep: &mut Sweep<'_>,
    vector: &[f64],
    model: &ForwardModel,
    offsets_v: &[f64],
    (step, mut damping): (usize, f64),
) -> Result<Option<Step>, SkinFitError> {
    let parameters = sweep.parameters();
    let here = sweep.misfits(model, offsets_v)?;
    let edge = here.edge();
    let factors = here.factors(edge);
    let before = here.cost(edge) + parameters.prior_cost(vector);
    let (normal, pull) = sweep.normal(model, offsets_v, &factors)?;
    while damping < MOST_DAMPING {
        let move_by = solve(parameters, &normal, &pull, vector, damping)
            .ok_or(SkinFitError::Normal { step })?;
        let next: Vec<f64> = vector.iter().zip(&move_by).map(|(v, d)| v + d).collect();
        let model = parameters.model(&next)?;
        let there = sweep.misfits(&model, offsets_v)?;
        let after = there.cost(edge) + parameters.prior_cost(&next);
        if after < before {
            let damping = if damping < 1e-3 { 0.0 } else { 0.1 * damping };
            let vector = next;
            return Ok(Some(Step { vector, model, there, factors, edge, before, after, damping }));
        }
        damping = f64::max(10.0 * damping, 1e-2);
    }
    Ok(None)
}

/// `(J'WJ + P + damping diag) d = J'Wr - P x`.
fn solve(
    parameters: &Parameters,
    normal: &Mat<f64>,
    pull: &[f64],
    vector: &[f64],
    damping: f64,
) -> Option<Vec<f64>> {
    let mut whole = normal + &parameters.precision;
    for i in 0..whole.nrows() {
        whole[(i, i)] *= 1.0 + damping;
    }
    let mut prior = parameters.prior_pull(vector);
    // Places are looked for, not stepped to.
    prior[parameters.places_at()].fill(0.0);
    let right = Mat::from_fn(pull.len(), 1, |i, _| pull[i] - prior[i]);
    let factor = whole.llt(Side::Lower).ok()?;
    let step = factor.solve(&right);
    let resistances = parameters.places_at().end;
    let bound = |i: usize| if i < resistances { f64::INFINITY } else { RESISTANCE_STEP };
    Some((0..pull.len()).map(|i| step[(i, 0)].clamp(-bound(i), bound(i))).collect())
}

fn check(sensor: &Sensor, trials: &[MeasuredTrial]) -> Result<(), SkinFitError> {
    let needed = sensor.channels();
    for (trial, t) in trials.iter().enumerate() {
        let found = t.frame_v.iter().filter(|v| v.is_finite()).count();
        if found != needed || t.frame_v.len() != needed {
            return Err(SkinFitError::Frame { trial, found, needed });
        }
    }
    if trials.iter().all(|t| t.contacts.is_empty()) {
        return Err(SkinFitError::NoTrials);
    }
    Ok(())
}

/// Standard deviation of a reading, V, as frames show it themselves: the differences around each
/// injection's ring sum to zero but for noise. `None` without frames.
pub fn noise_v(trials: &[MeasuredTrial]) -> Option<f64> {
    let ring = |frame: &[f32]| frame.iter().map(|&v| f64::from(v)).sum::<f64>().abs();
    let mut sums = Vec::new();
    for trial in trials {
        let electrodes = (trial.frame_v.len() as f64).sqrt() as usize;
        let rings = trial.frame_v.chunks_exact(electrodes.max(1));
        sums.extend(rings.map(|r| ring(r) / (electrodes as f64).sqrt()));
    }
    sums.sort_by(f64::total_cmp);
    // The median of |x| of a normal x, over its standard deviation.
    let median = sums.get(sums.len() / 2)? / 0.6745;
    Some(median.max(LEAST_NOISE_V))
}

/// Fraction of variance unexplained of one frame (Eq. 2).
pub fn fvu(measured_v: &[f32], modelled_v: &[f64]) -> f64 {
    let mean = measured_v.iter().map(|&v| f64::from(v)).sum::<f64>() / measured_v.len() as f64;
    let error: f64 =
        measured_v.iter().zip(modelled_v).map(|(&v, m)| (f64::from(v) - m).powi(2)).sum();
    error / measured_v.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>()
}

/// FVU of a model on each trial.
pub fn fvus(model: &ForwardModel, trials: &[MeasuredTrial]) -> Result<Vec<f64>, ContactError> {
    let mut work = Workspace::default();
    let of = |t: &MeasuredTrial| Ok(fvu(&t.frame_v, model.voltages(&t.contacts, &mut work)?));
    trials.iter().map(of).collect()
}

/// Median and mean; `None` of nothing.
pub fn summary(fvus: &[f64]) -> Option<FvuSummary> {
    let mut sorted = fvus.to_vec();
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len();
    let middle = [sorted.get(count.checked_sub(1)? / 2)?, sorted.get(count / 2)?];
    Some(FvuSummary {
        median: rounded((middle[0] + middle[1]) / 2.0),
        mean: rounded(sorted.iter().sum::<f64>() / count as f64),
    })
}
