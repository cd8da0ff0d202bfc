//! The skin that explains measured trials: fields, electrodes, resistances and offsets, fitted by
//! Gauss-Newton steps with the adjoint Jacobian.
//! Uses: `forward`, `jacobian`, `skin`, `stats`, faer. Never: files, a clock, chance.
//!
//! `cost = sum over trials of rho(r^2 / variance) + prior`. rho is Huber's function of the root of
//! a trial's misfit: the pull of a bad frame does not exceed that of one at the edge. Trials are
//! added in their order: the result does not depend on the number of threads.

mod descent;
mod frame;
mod parameters;
mod places;
mod sweep;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use crate::forward::{Contact, ContactError, ContactResult, ForwardModel, ModelError, Workspace};
use crate::jacobian::Field;
use crate::mesh::Mesh;
use crate::responses::UnitResponses;
use crate::sensor::Sensor;
use crate::skin::{FieldPrior, FvuSummary, SkinElectrodes, SkinFields, rounded};
use crate::stats::{fvu, quantile, sorted, upper_quantile};

use descent::{Start, Step, descended};
use parameters::Parameters;
use sweep::{Sweep, most_done};

/// The fit ends after a step that lowers the cost by less than this share.
const ENOUGH: f64 = 2e-3;
/// Electrode positions are searched after a step that lowers the cost by less than this share.
const NEARLY: f64 = 5e-2;
/// How often electrode positions are searched, each time after the other parameters have converged: a search among
/// inaccurate parameters ends with electrodes that are displaced for good.
const PLACINGS: usize = 5;
/// Lower limit of the noise, V: a converter's step.
const LEAST_NOISE_V: f64 = 1e-5;

/// One measured trial.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredTrial {
    /// Contacts that pressed the skin; empty for an untouched skin, which determines the offsets.
    pub contacts: Vec<Contact>,
    /// The frame, V after gain.
    pub frame_v: Vec<f32>,
}

/// Prior of a skin before it is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinPrior {
    /// Prior of ln a.
    pub ln_a: FieldPrior,
    /// Prior of ln b.
    pub ln_b: FieldPrior,
    /// Prior of ln c.
    pub ln_c: FieldPrior,
    /// Prior of ln compliance.
    pub ln_compliance: FieldPrior,
    /// Prior of ln sheet conductance.
    pub ln_sheet_conductance: FieldPrior,
    /// Standard deviation of ln of the sheet's conductance along x over that along y.
    pub anisotropy_ln_sd: f64,
    /// Standard deviation of the logarithm of the foam law's slope.
    pub foam_sd: f64,
    /// Correlation length of that slope, mm of compression.
    pub foam_mm: f64,
    /// Standard deviation of an electrode's position, mm per axis.
    pub electrode_sd_mm: f64,
    /// Median contact resistance, ohm.
    pub contact_ohm: f64,
    /// Standard deviation of ln of the contact resistance.
    pub contact_ln_sd: f64,
    /// Median lead resistance, ohm.
    pub lead_ohm: f64,
    /// Standard deviation of ln of the lead resistance.
    pub lead_ln_sd: f64,
    /// Standard deviation of a channel's offset, V.
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
            anisotropy_ln_sd: 0.3,
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

/// Errors of a trial under a perfect model: effects that no skin explains (tilted tips, load cells,
/// drift) shift the apparent contacts and are estimated for each trial; the rest is noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialErrors {
    /// Standard deviation of a reading, V.
    pub noise_v: f64,
    /// Standard deviation of the apparent position of a contact, mm per axis.
    pub place_mm: f64,
    /// Standard deviation of the apparent force of a contact, as a share of it.
    pub force_share: f64,
    /// Standard deviation of the apparent gain of a frame, as a share.
    pub gain_share: f64,
    /// Residual error, as a share of a frame's norm.
    pub model_error: f64,
    /// Number of independent directions of the residual error: far fewer than channels.
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

/// Prior, weights and limits of a fit of a skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinFitOptions {
    /// Prior of the parameters.
    pub prior: SkinPrior,
    /// Errors of the trials, which determine the weights.
    pub errors: TrialErrors,
    /// Largest distance between corners of the finest fields, mm; see [`spacing_mm`].
    pub spacing_mm: f64,
    /// Largest number of Gauss-Newton steps of each fit in the series.
    pub steps: usize,
    /// Number of trials from which on a fit begins at the end of one of a quarter of them, at least 1.
    pub many_trials: usize,
    /// Number of threads; the result does not depend on it.
    pub threads: usize,
}

impl SkinFitOptions {
    /// Defaults for the number of trials.
    pub fn for_trials(trials: usize, threads: usize) -> Self {
        Self {
            prior: SkinPrior::default(),
            errors: TrialErrors::default(),
            spacing_mm: spacing_mm(trials),
            steps: 30,
            many_trials: 1000,
            threads,
        }
    }
}

/// Spacing of the finest fields, mm: finer for more trials.
pub fn spacing_mm(trials: usize) -> f64 {
    match trials {
        0..500 => 45.0,
        500..4000 => 30.0,
        _ => 18.0,
    }
}

/// Progress of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinProgress {
    /// The current step, from 1.
    pub step: usize,
    /// Largest number of steps.
    pub steps: usize,
    /// Cost after the previous step; `None` in the first step.
    pub cost: Option<f64>,
    /// Trials processed in all steps, each as often as it was processed: a step processes all of them three times.
    pub done: usize,
    /// Number to process if the fit takes all its steps.
    pub total: usize,
}

/// Why a fit failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SkinFitError {
    /// There are no trials with a contact.
    #[error("fitting a skin: no trials with a contact")]
    NoTrials,
    /// The length of a frame is not that of the sensor's frames, or a value is not finite.
    #[error("fitting a skin: trial {trial}: {found} finite voltages, the sensor has {needed}")]
    Frame { trial: usize, found: usize, needed: usize },
    /// The model rejects a contact.
    #[error("fitting a skin: {0}")]
    Contact(#[from] ContactError),
    /// The model of an intermediate skin cannot be built.
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
    Normal { step: usize },
}

/// Result of a fit.
#[derive(Debug, Clone)]
pub struct SkinFit {
    /// The fitted fields.
    pub fields: SkinFields,
    /// The fitted electrodes.
    pub electrodes: SkinElectrodes,
    /// Offset of each channel, mV.
    pub offsets_mv: Vec<f64>,
    /// Number of fitted parameters.
    pub parameters: usize,
    /// Cost of the fit of all trials before its first step and after each that was kept; it may rise where electrodes were
    /// moved.
    pub costs: Vec<f64>,
    /// Indices of the trials with contacts whose weight is below one half.
    pub doubted: Vec<usize>,
}

impl SkinFit {
    /// Builds the model of the fitted skin, as a calibration file would describe it.
    ///
    /// # Errors
    /// `ModelError` if the mesh, the foam's law or an electrode is invalid.
    pub fn model(
        &self,
        sensor: &Sensor,
        responses: Arc<UnitResponses>,
    ) -> Result<ForwardModel, ModelError> {
        let fields = self.fields.over(sensor, &Mesh::new(sensor)?)?;
        ForwardModel::with(sensor, responses, fields, self.electrodes.circuit(sensor))
    }
}

/// Fits a skin to trials. `sensor` describes all such skins (its file, a calibration of Eq. 1 and
/// moduli); `responses` must be those of the sensor.
///
/// # Errors
/// `SkinFitError` if the trials or the prior are invalid, or a step has no solution.
pub fn fit(
    sensor: &Sensor,
    responses: Arc<UnitResponses>,
    trials: &[MeasuredTrial],
    options: &SkinFitOptions,
    progress: &mut dyn FnMut(SkinProgress),
) -> Result<SkinFit, SkinFitError> {
    check(sensor, trials)?;
    let strides = strides(trials.len(), options.many_trials);
    let steps = strides.len() * options.steps;
    let total = strides.iter().map(|s| most_done(trials.len().div_ceil(*s), options)).sum();
    let mut at = SkinProgress { step: 0, steps, cost: None, done: 0, total };
    let mut coarser: Option<(Parameters, End)> = None;
    for stride in strides {
        let few: Vec<MeasuredTrial> = trials.iter().step_by(stride).cloned().collect();
        let spacing_mm = options.spacing_mm.max(spacing_mm(few.len()));
        let parameters =
            Parameters::new(sensor, Arc::clone(&responses), options.prior, spacing_mm)?;
        let (vector, offsets_v) = match coarser {
            Some((from, end)) => (parameters.refined(&from, &end.vector), end.offsets_v),
            None => (vec![0.0; parameters.len()], vec![0.0; sensor.channels()]),
        };
        let start = Start { model: parameters.model(&vector)?, vector, offsets_v };
        let (step, done) = (at.step, at.done);
        let mut shown = |p: SkinProgress| {
            at = SkinProgress { step: step + p.step, done: done + p.done, cost: p.cost, ..at };
            progress(at);
        };
        let end = search(&mut Sweep::new(&parameters, &few, options, &mut shown), start)?;
        (at.step, at.done) = (step + options.steps, done + most_done(few.len(), options));
        coarser = Some((parameters, end));
    }
    let (parameters, End { vector, offsets_v, factors, costs }) =
        coarser.expect("the last stride is 1");
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

/// Strides through the trials of a series of fits, the largest first: a fit of many trials begins where that of a quarter of
/// them, with coarser fields, has ended.
fn strides(trials: usize, many_trials: usize) -> Vec<usize> {
    let mut strides = vec![1];
    while trials / strides[0] >= many_trials.max(1) {
        strides.insert(0, 4 * strides[0]);
    }
    strides
}

/// Where a search has ended.
struct End {
    vector: Vec<f64>,
    offsets_v: Vec<f64>,
    /// Weight of each trial, 0 to 1.
    factors: Vec<f64>,
    costs: Vec<f64>,
}

/// Descends from a start, moves electrodes while this ends better, and descends to the end. Before the last try to move
/// them the other parameters are as good as they get.
fn search(sweep: &mut Sweep<'_>, start: Start) -> Result<End, SkinFitError> {
    let (vector, offsets_v) = (start.vector.clone(), start.offsets_v.clone());
    let mut costs = Vec::new();
    let mut best = descended(sweep, start, NEARLY, &mut costs)?;
    let (mut placings, mut is_end) = (0, false);
    while let Some(found) = &best {
        let may_move = placings < PLACINGS && !sweep.is_over();
        let moved = if may_move { found.placed(sweep)? } else { None };
        placings += 1;
        if let Some(there) = moved {
            let mut after = costs.clone();
            let moved = descended(sweep, there, NEARLY, &mut after)?;
            if moved.as_ref().is_some_and(|moved| moved.is_better(found, sweep.parameters())) {
                (best, costs, is_end) = (moved, after, false);
                continue;
            }
        }
        if is_end {
            break;
        }
        is_end = true;
        if let Some(last) = descended(sweep, found.start(), ENOUGH, &mut costs)? {
            best = Some(last);
        }
    }
    let factors = vec![1.0; sweep.trials().len()];
    Ok(match best {
        Some(Step { vector, offsets_v, factors, .. }) => End { vector, offsets_v, factors, costs },
        None => End { vector, offsets_v, factors, costs },
    })
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

/// Standard deviation of a reading, V, estimated from frames: the differences around each
/// injection's ring sum to zero except for noise. `None` without frames.
pub fn noise_v(trials: &[MeasuredTrial]) -> Option<f64> {
    let ring = |frame: &[f32]| frame.iter().map(|&v| f64::from(v)).sum::<f64>().abs();
    let mut sums = Vec::new();
    for trial in trials {
        let electrodes = (trial.frame_v.len() as f64).sqrt() as usize;
        let rings = trial.frame_v.chunks_exact(electrodes.max(1));
        sums.extend(rings.map(|r| ring(r) / (electrodes as f64).sqrt()));
    }
    // The median of |x| of a normal x, over its standard deviation.
    let median = upper_quantile(&sorted(sums), 0.5)? / 0.6745;
    Some(median.max(LEAST_NOISE_V))
}

/// FVU of a model on each trial; infinite for a constant frame, of which a model explains nothing.
///
/// # Errors
/// `ContactError` if the model rejects a contact.
pub fn fvus(model: &ForwardModel, trials: &[MeasuredTrial]) -> ContactResult<Vec<f64>> {
    let mut work = Workspace::default();
    let mut of = |t: &MeasuredTrial| {
        let modelled_v = model.voltages(&t.contacts, &mut work)?;
        Ok(fvu(&t.frame_v, modelled_v.iter().copied()).unwrap_or(f64::INFINITY))
    };
    trials.iter().map(&mut of).collect()
}

/// Median and mean; `None` of an empty list.
pub fn summary(fvus: &[f64]) -> Option<FvuSummary> {
    let sorted = sorted(fvus.iter().copied());
    Some(FvuSummary {
        median: rounded(quantile(&sorted, 0.5)?),
        mean: rounded(sorted.iter().sum::<f64>() / sorted.len() as f64),
    })
}
