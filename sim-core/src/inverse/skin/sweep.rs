//! A pass over all trials at one model, on several threads, with sums in the order of the trials.
//! Uses: `frame`, std threads. Never: an order that depends on the threads.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use faer::Mat;

use super::frame::{FrameMisfit, FrameTerms, FrameWork, Pass, WhiteColumns};
use super::parameters::{LAW_PIECES, LAW_STEP_MM, Parameters};
use super::{MeasuredTrial, SkinFitError, SkinFitOptions, SkinProgress};
use crate::forward::ForwardModel;
use crate::stats::{sorted, upper_quantile};

/// How often a step processes each trial, unless it is shortened.
const PASSES: usize = 3;
/// Number of trials whose terms are in memory at a time (about 1 MB each).
const BLOCK_TRIALS: usize = 64;
/// The pull of a misfit is linear above this multiple of the median's root.
const EDGE: f64 = 3.0;
/// From this number of untouched skins on, they alone determine the offsets: the model error under
/// a light load is not an offset.
const UNTOUCHED_ENOUGH: usize = 8;

/// All trials of a fit.
pub(super) struct Sweep<'a> {
    parameters: &'a Parameters,
    trials: &'a [MeasuredTrial],
    options: &'a SkinFitOptions,
    progress: &'a mut dyn FnMut(SkinProgress),
    at: SkinProgress,
    /// Trials that are processed at the end of the step.
    end: usize,
    work: Vec<FrameWork>,
}

/// Misfits of all trials at a model.
pub(super) struct Misfits {
    misfits: Vec<f64>,
    /// Residuals of untouched skins.
    untouched: Residuals,
    touched: Residuals,
    channels: f64,
}

/// Sums of residuals, from which the offsets follow.
struct Residuals {
    /// Sum of residual (before the offset) over variance, for each channel.
    sums: Vec<f64>,
    /// Sum of the inverse variances.
    weight: f64,
    trials: usize,
}

impl Misfits {
    fn new(channels: usize) -> Self {
        let none = || Residuals { sums: vec![0.0; channels], weight: 0.0, trials: 0 };
        let (untouched, touched) = (none(), none());
        Self { misfits: Vec::new(), untouched, touched, channels: channels as f64 }
    }

    fn push(&mut self, trial: &MeasuredTrial, of: &FrameMisfit) {
        self.misfits.push(of.misfit);
        // A frame with a large misfit contributes little to the offsets.
        let square = of.residual_v.iter().map(|r| r * r).sum::<f64>() / self.channels;
        let weight = match trial.contacts.as_slice() {
            [] => 1.0 / of.variance,
            _ => 1.0 / (of.variance + square),
        };
        let to = if trial.contacts.is_empty() { &mut self.untouched } else { &mut self.touched };
        to.weight += weight;
        to.trials += 1;
        for (sum, r) in to.sums.iter_mut().zip(&of.residual_v) {
            *sum += weight * r;
        }
    }

    /// Misfit above which a trial is doubted.
    pub fn edge(&self) -> f64 {
        let middle = upper_quantile(&sorted(self.misfits.iter().copied()), 0.5);
        EDGE * EDGE * middle.expect("there are trials")
    }

    /// Sum of rho over trials.
    pub fn cost(&self, edge: f64) -> f64 {
        let rho = |&m: &f64| if m <= edge { m } else { 2.0 * (m * edge).sqrt() - edge };
        self.channels * self.misfits.iter().map(rho).sum::<f64>()
    }

    /// Weight of each trial, 0 to 1.
    pub fn factors(&self, edge: f64) -> Vec<f64> {
        self.misfits.iter().map(|m| if *m <= edge { 1.0 } else { (edge / m).sqrt() }).collect()
    }

    /// Offsets estimated from these residuals, V.
    pub fn offsets_v(&self, prior_sd_v: f64) -> Vec<f64> {
        let [rest, all] = [&self.untouched, &self.touched];
        let touched = if rest.trials < UNTOUCHED_ENOUGH { 1.0 } else { 0.0 };
        let whole = rest.weight + touched * all.weight + 1.0 / prior_sd_v.powi(2);
        rest.sums.iter().zip(&all.sums).map(|(r, t)| (r + touched * t) / whole).collect()
    }
}

/// How often trials are processed if a fit takes all its steps.
pub(super) fn most_done(trials: usize, options: &SkinFitOptions) -> usize {
    PASSES * options.steps * trials
}

impl<'a> Sweep<'a> {
    pub fn new(
        parameters: &'a Parameters,
        trials: &'a [MeasuredTrial],
        options: &'a SkinFitOptions,
        progress: &'a mut dyn FnMut(SkinProgress),
    ) -> Self {
        let total = most_done(trials.len(), options);
        let at = SkinProgress { step: 0, steps: options.steps, cost: None, done: 0, total };
        let mut work = Vec::new();
        work.resize_with(options.threads.max(1), FrameWork::default);
        Self { parameters, trials, options, progress, at, end: 0, work }
    }

    /// Parameters of the fit.
    pub fn parameters(&self) -> &'a Parameters {
        self.parameters
    }

    /// Starts the next step; false if all are taken.
    pub fn begin(&mut self, cost: Option<f64>) -> bool {
        if self.is_over() {
            return false;
        }
        let step = PASSES * self.trials.len();
        self.at.done = step * self.at.step;
        self.at.step += 1;
        self.end = step * self.at.step;
        self.at.cost = cost;
        true
    }

    /// Whether all steps are taken.
    pub fn is_over(&self) -> bool {
        self.at.step == self.at.steps
    }

    /// The current step, from 1.
    pub fn step(&self) -> usize {
        self.at.step
    }

    /// Prior standard deviation of a channel's offset, V.
    pub fn offset_sd_v(&self) -> f64 {
        self.options.prior.offset_sd_v
    }

    /// Computes the misfits of all trials.
    ///
    /// # Errors
    /// `SkinFitError::Contact` if the model rejects a contact.
    pub fn misfits(
        &mut self,
        model: &ForwardModel,
        offsets_v: &[f64],
    ) -> Result<Misfits, SkinFitError> {
        let mut misfits = Misfits::new(offsets_v.len());
        let trials = self.trials;
        self.each(
            model,
            offsets_v,
            |pass, i, work| Ok((i, pass.misfit(&trials[i], work)?)),
            |(i, of)| misfits.push(&trials[i], &of),
        )?;
        Ok(misfits)
    }

    /// All trials of the fit.
    pub fn trials(&self) -> &'a [MeasuredTrial] {
        self.trials
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.work.len()
    }

    /// Computes terms and columns of some trials, weighted by `factor`.
    ///
    /// # Errors
    /// `SkinFitError::Contact` if the model rejects a contact.
    pub fn look(
        &mut self,
        model: &ForwardModel,
        offsets_v: &[f64],
        trials: &[usize],
        factor: impl Fn(usize) -> f64 + Sync,
    ) -> Result<Vec<(FrameTerms, WhiteColumns)>, SkinFitError> {
        let pass = self.pass(model, offsets_v);
        in_order(0..trials.len(), &mut self.work, |i, work| {
            pass.terms_and_columns(&self.trials[trials[i]], factor(trials[i]), work)
        })
    }

    /// Computes the normal equations: J'WJ (lower triangle) and J'Wr, without the prior.
    ///
    /// # Errors
    /// `SkinFitError::Contact` if the model rejects a contact.
    pub fn normal(
        &mut self,
        model: &ForwardModel,
        offsets_v: &[f64],
        factors: &[f64],
    ) -> Result<(Mat<f64>, Vec<f64>), SkinFitError> {
        let count = self.parameters.len();
        let mut normal = Mat::<f64>::zeros(count, count);
        let mut pull = vec![0.0; count];
        let (trials, scale) = (self.trials, vec![1.0; count]);
        self.each(
            model,
            offsets_v,
            |pass, i, work| pass.terms(&trials[i], factors[i], work),
            |terms| terms.add_to(&mut normal, &mut pull, &scale),
        )?;
        Ok((normal, pull))
    }

    /// Data shared by all trials at a model.
    fn pass<'p>(&self, model: &'p ForwardModel, offsets_v: &'p [f64]) -> Pass<'p>
    where
        'a: 'p,
    {
        let (parameters, errors) = (self.parameters, &self.options.errors);
        let (circuit, law_slopes) = (parameters.circuit_changes(model), law_slopes(model));
        Pass { parameters, model, circuit, law_slopes, offsets_v, errors }
    }

    /// Processes each trial on the threads; results are consumed in the order of the trials.
    fn each<T: Send>(
        &mut self,
        model: &ForwardModel,
        offsets_v: &[f64],
        of_trial: impl Fn(&Pass<'_>, usize, &mut FrameWork) -> Result<T, SkinFitError> + Sync,
        mut take: impl FnMut(T),
    ) -> Result<(), SkinFitError> {
        let pass = self.pass(model, offsets_v);
        for start in (0..self.trials.len()).step_by(BLOCK_TRIALS) {
            let end = (start + BLOCK_TRIALS).min(self.trials.len());
            let of_block =
                in_order(start..end, &mut self.work, |i, work| of_trial(&pass, i, work))?;
            of_block.into_iter().for_each(&mut take);
            self.at.done = (self.at.done + end - start).min(self.end);
            (self.progress)(self.at);
        }
        Ok(())
    }
}

/// Processes each index on one thread per memory; returns the results in the order of the indices.
pub(super) fn in_order<W: Send, T: Send>(
    range: Range<usize>,
    work: &mut [W],
    of: impl Fn(usize, &mut W) -> Result<T, SkinFitError> + Sync,
) -> Result<Vec<T>, SkinFitError> {
    let next = AtomicUsize::new(range.start);
    let worker = |work: &mut W| {
        let mut results = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= range.end {
                return results;
            }
            results.push((i, of(i, work)));
        }
    };
    let mut results: Vec<_> = thread::scope(|scope| {
        let handles: Vec<_> = work.iter_mut().map(|work| scope.spawn(|| worker(work))).collect();
        let join = |h: thread::ScopedJoinHandle<'_, _>| {
            h.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        handles.into_iter().flat_map(join).collect()
    });
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Slopes of the foam law's pieces.
fn law_slopes(model: &ForwardModel) -> [f64; LAW_PIECES] {
    let law = model.fields().displacement.as_ref();
    let middle = |piece: usize| (piece as f64 + 0.5) * LAW_STEP_MM;
    std::array::from_fn(|piece| law.map_or(1.0, |law| law.slope(middle(piece))))
}
