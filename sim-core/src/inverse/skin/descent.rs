//! Gauss-Newton steps from one skin to another that explains the trials better.
//! Uses: `sweep`, `places`, `parameters`, faer. Never: the decision where a fit begins and ends.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

use super::parameters::Parameters;
use super::sweep::{Misfits, Sweep};
use super::{SkinFitError, places};
use crate::forward::ForwardModel;

/// Largest change of ln of an electrode's resistance in a step: voltages are linear in the
/// resistance itself, so that the logarithm of a loose electrode would diverge to an open circuit.
const RESISTANCE_STEP: f64 = 1.0;
/// Damping above which a step is not worth its pass.
const MOST_DAMPING: f64 = 1e3;

/// Where a descent begins.
pub(super) struct Start {
    pub vector: Vec<f64>,
    pub model: ForwardModel,
    pub offsets_v: Vec<f64>,
}

/// A step that lowered the cost.
pub(super) struct Step {
    pub vector: Vec<f64>,
    model: ForwardModel,
    there: Misfits,
    /// Offsets estimated from its residuals, V.
    pub offsets_v: Vec<f64>,
    /// Weight of each trial, 0 to 1.
    pub factors: Vec<f64>,
    edge: f64,
    before: f64,
    after: f64,
    damping: f64,
}

impl Step {
    /// Whether the step has a lower cost than another, with the other's edge of doubt.
    pub fn is_better(&self, other: &Self, parameters: &Parameters) -> bool {
        let cost = |s: &Self| s.there.cost(other.edge) + parameters.prior_cost(&s.vector);
        cost(self) < cost(other)
    }

    /// The same skin with electrodes moved to where they fit best; `None` if none moves.
    ///
    /// # Errors
    /// `SkinFitError` if a contact or the moved skin is invalid, or the normal equations have no solution.
    pub fn placed(&self, sweep: &mut Sweep<'_>) -> Result<Option<Start>, SkinFitError> {
        let Self { vector, model, offsets_v, factors, .. } = self;
        let Some(vector) = places::placed(sweep, model, offsets_v, factors, vector)? else {
            return Ok(None);
        };
        let model = sweep.parameters().model(&vector)?;
        Ok(Some(Start { vector, model, offsets_v: offsets_v.clone() }))
    }

    /// Where the next descent begins.
    pub fn start(&self) -> Start {
        let Self { vector, model, offsets_v, .. } = self;
        Start { vector: vector.clone(), model: model.clone(), offsets_v: offsets_v.clone() }
    }
}

/// The last of the steps from a start, up to the first that lowers the cost by less than the share `ends`; `None` if none
/// lowers it. Costs are appended.
///
/// # Errors
/// `SkinFitError` if a contact or a skin on the way is invalid, or a step has no solution.
pub(super) fn descended(
    sweep: &mut Sweep<'_>,
    start: Start,
    ends: f64,
    costs: &mut Vec<f64>,
) -> Result<Option<Step>, SkinFitError> {
    let Start { mut vector, mut model, mut offsets_v } = start;
    let (mut last, mut damping): (Option<Step>, f64) = (None, 0.0);
    while sweep.begin(costs.last().copied()) {
        let Some(next) = stepped(sweep, &vector, &model, &offsets_v, damping)? else { break };
        if costs.is_empty() {
            costs.push(next.before);
        }
        costs.push(next.after);
        Start { vector, model, offsets_v } = next.start();
        damping = next.damping;
        let is_last = next.before - next.after < ends * next.before;
        last = Some(next);
        if is_last {
            break;
        }
    }
    Ok(last)
}

/// The Gauss-Newton step from a vector, shortened as needed; `None` if none lowers the cost.
fn stepped(
    sweep: &mut Sweep<'_>,
    vector: &[f64],
    model: &ForwardModel,
    offsets_v: &[f64],
    mut damping: f64,
) -> Result<Option<Step>, SkinFitError> {
    let parameters = sweep.parameters();
    let here = sweep.misfits(model, offsets_v)?;
    let edge = here.edge();
    let factors = here.factors(edge);
    let before = here.cost(edge) + parameters.prior_cost(vector);
    let (normal, pull) = sweep.normal(model, offsets_v, &factors)?;
    while damping < MOST_DAMPING {
        let move_by = solve(parameters, &normal, &pull, vector, damping)
            .ok_or(SkinFitError::Normal { step: sweep.step() })?;
        let next: Vec<f64> = vector.iter().zip(&move_by).map(|(v, d)| v + d).collect();
        let model = parameters.model(&next)?;
        let there = sweep.misfits(&model, offsets_v)?;
        let after = there.cost(edge) + parameters.prior_cost(&next);
        if after < before {
            let damping = if damping < 1e-3 { 0.0 } else { 0.1 * damping };
            let (vector, offsets_v) = (next, there.offsets_v(sweep.offset_sd_v()));
            let step =
                Step { vector, model, there, offsets_v, factors, edge, before, after, damping };
            return Ok(Some(step));
        }
        damping = f64::max(10.0 * damping, 1e-2);
    }
    Ok(None)
}

/// Solves `(J'WJ + P + damping diag) d = J'Wr - P x`.
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
    // Positions are searched, not stepped.
    prior[parameters.places_at()].fill(0.0);
    let right = Mat::from_fn(pull.len(), 1, |i, _| pull[i] - prior[i]);
    let factor = whole.llt(Side::Lower).ok()?;
    let step = factor.solve(&right);
    let resistances = parameters.places_at().end;
    let bound = |i: usize| if i < resistances { f64::INFINITY } else { RESISTANCE_STEP };
    Some((0..pull.len()).map(|i| step[(i, 0)].clamp(-bound(i), bound(i))).collect())
}
