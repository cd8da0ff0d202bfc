//! The errors of a skin's model, estimated from trials whose contacts are known.
//! Uses: `skin`, `skin_errors`, `rehearsal`, sim-core's `inverse`, std threads. Never: files.

use std::thread;

use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::inverse::contacts::{
    ErrorModel, ErrorModelError, Fit, FitError, FitWork, FittedContact, FramePair, Observation,
};
use sim_core::inverse::skin::{MeasuredTrial, noise_v};
use sim_core::stats::{sorted, upper_quantile};

use super::rehearsal::{Rehearsal, Rehearsed, is_light};
use super::skin::ExactSkin;
use super::skin_errors::{LEAST_KNOWN, SkinErrors, Stretch, grown};
use super::untouched::Untouched;
use crate::infer::error::InferResult;
use crate::infer::untouched_frame::UntouchedBefore;

/// Standard deviation of a voltage's noise if neither known trials nor the calibration state it, V.
const NOISE_SD_V: f64 = 1.2e-3;
/// Largest number of directions of the model's error that are estimated from known trials: with
/// fewer, the residual is fitted as an additional contact (592 trials, 48 or 96 of them: exact
/// count 75 or 77 %, each +-3.5).
const ERROR_DIRECTIONS: usize = 96;
/// Number of known trials needed per direction.
const KNOWN_FOR_EACH: usize = 4;
/// Largest number of threads that prepare a skin.
const SKIN_THREADS_MAX: usize = 8;
/// Number of known trials from which the factors on standard deviations are estimated.
const STRETCHED_BY: usize = 200;
/// Number of trials of light contacts, of others and of many contacts that are answered to compare the answers.
const REHEARSED_OF_EACH: usize = 200;
/// Number of parts of the configurations: the errors with which one is answered are learned from the others.
const REHEARSED_PARTS: usize = 2;
/// Smallest force of a contact used for these factors, N: the paper's deadband.
const CLEAR_N: f64 = 5.0;
/// Quantile at which the factors are determined: users rely on the limits of the errors, regions of 95 %.
/// `TOLD_BY_SD` is this quantile of |x|, for a normal x of standard deviation 1.
const TOLD_BY: f64 = 0.95;
const TOLD_BY_SD: f64 = 1.96;
/// Largest factor, and number of halvings of its range. In frames whose noise hides the model's error any factor
/// fits.
const STRETCH_MOST: f64 = 5.0;
const STRETCH_HALVINGS: usize = 20;

/// A measured trial whose contacts are known.
#[derive(Debug, Clone)]
pub struct KnownTrial {
    /// Number of its configuration: trials of one share their errors.
    pub configuration: u32,
    /// Contacts that pressed the skin.
    pub contacts: Vec<Contact>,
    /// Measured frame, V.
    pub frame_v: Vec<f32>,
    /// Number of averaged frames.
    pub frames: f64,
    /// The untouched skin before it, if it was measured.
    pub untouched: Option<UntouchedBefore>,
}

/// The trials of a run from which the errors of a skin are estimated.
#[derive(Debug, Clone, Default)]
pub struct KnownTrials {
    /// With contacts, of configurations that no skin is fitted to.
    pub pressed: Vec<KnownTrial>,
    /// With more contacts, likewise: no errors are learned from them, as heavier frames have others, but an answer
    /// may find a part of them.
    pub crowded: Vec<KnownTrial>,
    /// Untouched frames of the run.
    pub untouched: Untouched,
}

/// Error of a known contact.
#[derive(Debug, Clone, Copy)]
struct Missed {
    /// Size, in stated standard deviations.
    in_sd: f64,
    /// Share of the stated variance by the model's error.
    by_model: f64,
}

impl ExactSkin {
    /// Prepares a model, calibrated or not. Its difference from this skin is estimated from known
    /// trials, if there are enough; otherwise every misfit counts as noise.
    ///
    /// # Errors
    /// `InferError` if the error model is invalid or a known trial cannot be fitted.
    pub fn new(model: &ForwardModel, trials: &KnownTrials) -> InferResult<Self> {
        let KnownTrials { pressed: known, crowded, untouched } = trials;
        let channels = model.sensor().channels();
        let offset_v = model.sensor().offsets_v();
        let enough = known.len() >= LEAST_KNOWN;
        let noise_sd_v = untouched.noise_sd_v().filter(|_| enough);
        let noise_sd_v = noise_sd_v.or_else(|| enough.then(|| seen(known, &offset_v)).flatten());
        let evidence = model.sensor().skin().map(|skin| skin.evidence.noise_v);
        let noise_sd_v = noise_sd_v.or(evidence).unwrap_or(NOISE_SD_V);
        let white = ErrorModel::white(channels, noise_sd_v)?;
        let unknown = SkinErrors {
            noise_sd_v,
            drift: untouched.drift(&offset_v),
            model: white.clone(),
            stretch: Stretch { place: 1.0, force: 1.0 },
            rehearsal: None,
            learnt_from: 0,
        };
        let skin = Self::with(model, unknown.clone())?;
        if !enough {
            return Ok(skin);
        }
        let frames = skin.modelled(model, known)?;
        // Trials below the noise contain no information except the noise.
        let Some(learnt) = learnt(&white, frames.iter())? else { return Ok(skin) };
        let errors = SkinErrors { model: learnt, learnt_from: known.len(), ..unknown };
        let mut skin = Self::with(model, errors)?;
        skin.errors.stretch = skin.stretch(known)?;
        skin.errors.rehearsal =
            skin.rehearse(model, &rehearsed(known, crowded), &frames, &white)?;
        Ok(skin)
    }

    /// Answers known trials as in use, but without proposals of a net, each part of the configurations with the errors
    /// that the others show. `None` with too few trials, or with trials of one configuration.
    fn rehearse(
        &self,
        model: &ForwardModel,
        trials: &[&KnownTrial],
        frames: &[ModelledFrame],
        white: &ErrorModel,
    ) -> InferResult<Option<Rehearsal>> {
        let mut answers = Vec::with_capacity(trials.len());
        let mut configurations: Vec<u32> = trials.iter().map(|trial| trial.configuration).collect();
        configurations.extend(frames.iter().map(|frame| frame.configuration));
        configurations.sort_unstable();
        configurations.dedup();
        for part in 0..REHEARSED_PARTS {
            // By turns: the numbers of imported ones may all be even.
            let is_in = |number: u32| {
                let at = configurations.binary_search(&number);
                at.is_ok_and(|at| at % REHEARSED_PARTS == part)
            };
            let others = frames.iter().filter(|frame| !is_in(frame.configuration));
            let Some(learnt) = learnt(white, others)? else { return Ok(None) };
            let skin = Self::with(model, SkinErrors { model: learnt, ..self.errors.clone() })?;
            let trials: Vec<&KnownTrial> =
                trials.iter().copied().filter(|trial| is_in(trial.configuration)).collect();
            answers.extend(skin.each(&trials, |trial, observation, work| {
                let fit = skin.fitter.fit(observation, &[], work)?;
                Ok(Rehearsed::of(&trial.contacts, &skin.reading(&fit, None, trial.frames)))
            })?);
        }
        Ok(Rehearsal::of(&answers))
    }

    /// Factors with which the limits of the fits of known contacts hold the true ones.
    fn stretch(&self, known: &[KnownTrial]) -> InferResult<Stretch> {
        let some: Vec<&KnownTrial> =
            known.iter().step_by(known.len().div_ceil(STRETCHED_BY)).collect();
        let (mut places, mut forces) = (Vec::new(), Vec::new());
        let fits = self.each(&some, |trial, observation, work| {
            Ok(self.fitter.refine(observation, &trial.contacts, work)?)
        })?;
        for (trial, fit) in some.iter().zip(fits) {
            if fit.contacts.len() != trial.contacts.len() {
                continue;
            }
            // Contacts of a fit are in another order; a search would not report the lightest.
            let clear = trial.contacts.iter().filter(|truth| truth.force_n >= CLEAR_N);
            for (truth, found) in clear.filter_map(|truth| Some((truth, nearest(&fit, truth)?))) {
                let (is, [x, y, force]) = (found.contact, found.by_model);
                let missed =
                    |error: f64, sd: f64, by_model| Missed { in_sd: error.abs() / sd, by_model };
                places.push(missed(is.x_mm - truth.x_mm, found.x_sd_mm, x));
                places.push(missed(is.y_mm - truth.y_mm, found.y_sd_mm, y));
                forces.push(missed(is.force_n - truth.force_n, found.force_sd_n, force));
            }
        }
        Ok(Stretch { place: stretched(&places), force: stretched(&forces) })
    }

    /// Fits these trials on several threads, and returns what `fit` does in their order.
    fn each<T: Send>(
        &self,
        known: &[&KnownTrial],
        fit: impl Fn(&KnownTrial, &Observation<'_>, &mut FitWork) -> InferResult<T> + Sync,
    ) -> InferResult<Vec<T>> {
        let fit_share = |trials: &[&KnownTrial]| {
            let (mut work, mut frame_v) = (FitWork::default(), Vec::new());
            let one = |trial: &&KnownTrial| {
                let untouched = self.better(trial.untouched.as_ref());
                self.take_offsets(&trial.frame_v, untouched, &mut frame_v);
                let observation = self.observation(&frame_v, trial.frames, untouched);
                fit(trial, &observation, &mut work)
            };
            trials.iter().map(one).collect::<InferResult<Vec<_>>>()
        };
        let threads = thread::available_parallelism().map_or(1, |n| n.get().min(SKIN_THREADS_MAX));
        let shares = known.chunks(known.len().div_ceil(threads).max(1));
        let done: InferResult<Vec<_>> = thread::scope(|scope| {
            let working: Vec<_> = shares.map(|share| scope.spawn(|| fit_share(share))).collect();
            let join = |handle: thread::ScopedJoinHandle<'_, _>| {
                handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            working.into_iter().map(join).collect()
        });
        Ok(done?.into_iter().flatten().collect())
    }

    /// Models the frames of known trials at contacts that were refined from the true ones (reason: sim-core's
    /// [`ErrorModel::with_pairs`]).
    fn modelled(
        &self,
        model: &ForwardModel,
        known: &[KnownTrial],
    ) -> InferResult<Vec<ModelledFrame>> {
        self.each(&known.iter().collect::<Vec<_>>(), |trial, observation, work| {
            let fit = self.fitter.refine(observation, &trial.contacts, work)?;
            let refined: Vec<Contact> = fit.contacts.iter().map(|found| found.contact).collect();
            let mut forward = Workspace::default();
            let modelled_v = model.voltages(&refined, &mut forward).map_err(FitError::from)?;
            Ok(ModelledFrame {
                configuration: trial.configuration,
                measured_v: observation.frame_v.to_vec(),
                modelled_v: modelled_v.to_vec(),
                frames: trial.frames,
                offset_sd_v: observation.offset_sd_v,
            })
        })
    }
}

/// A known trial's frame and that of its contacts, V.
struct ModelledFrame {
    configuration: u32,
    measured_v: Vec<f64>,
    modelled_v: Vec<f64>,
    frames: f64,
    offset_sd_v: f64,
}

/// Estimates the part of known trials that no contact explains; `None` with too few above the noise.
fn learnt<'f>(
    white: &ErrorModel,
    frames: impl Iterator<Item = &'f ModelledFrame>,
) -> InferResult<Option<ErrorModel>> {
    let pair = |frame: &'f ModelledFrame| FramePair {
        measured_v: &frame.measured_v,
        modelled_v: &frame.modelled_v,
        frames: frame.frames,
        offset_sd_v: frame.offset_sd_v,
    };
    let pairs: Vec<FramePair<'_>> = frames.map(pair).collect();
    let directions = ERROR_DIRECTIONS.min(pairs.len() / KNOWN_FOR_EACH);
    match white.clone().with_pairs(&pairs, directions) {
        Ok(learnt) => Ok(Some(learnt)),
        Err(ErrorModelError::FewPairs { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The trials whose answers are compared: those in which each contact can be found, evenly.
fn rehearsed<'k>(known: &'k [KnownTrial], crowded: &'k [KnownTrial]) -> Vec<&'k KnownTrial> {
    let (light, heavy): (Vec<&KnownTrial>, Vec<&KnownTrial>) =
        known.iter().partition(|trial| is_light(trial.contacts.iter().map(|c| c.force_n)));
    let is_clear = |trial: &&KnownTrial| {
        !trial.contacts.is_empty() && trial.contacts.iter().all(|c| c.force_n >= CLEAR_N)
    };
    let evenly = |trials: Vec<&'k KnownTrial>| {
        let clear: Vec<&KnownTrial> = trials.into_iter().filter(is_clear).collect();
        let count = clear.len().min(REHEARSED_OF_EACH);
        (0..count).map(move |n| clear[n * clear.len() / count])
    };
    [light, heavy, crowded.iter().collect()].into_iter().flat_map(evenly).collect()
}

/// Standard deviation of the noise in one frame, estimated from known trials, V.
fn seen(known: &[KnownTrial], offset_v: &[f64]) -> Option<f64> {
    let single = |trial: &KnownTrial| {
        let root = trial.frames.sqrt();
        let volts = trial.frame_v.iter().zip(offset_v);
        let frame_v = volts.map(|(v, offset)| (root * (f64::from(*v) - offset)) as f32).collect();
        MeasuredTrial { contacts: Vec::new(), frame_v }
    };
    noise_v(&known.iter().map(single).collect::<Vec<_>>())
}

/// The fitted contact nearest to a true one.
fn nearest<'a>(fit: &'a Fit, truth: &Contact) -> Option<&'a FittedContact> {
    let square_mm2 = |found: &FittedContact| {
        (found.contact.x_mm - truth.x_mm).powi(2) + (found.contact.y_mm - truth.y_mm).powi(2)
    };
    fit.contacts.iter().min_by(|a, b| square_mm2(a).total_cmp(&square_mm2(b)))
}

/// The smallest factor on the part by the model's error, from 1 to [`STRETCH_MOST`], with which 95 % of these are
/// within the limits of a normal.
fn stretched(missed: &[Missed]) -> f64 {
    let holds = |factor: f64| {
        let in_sd = missed.iter().map(|m| m.in_sd / grown(m.by_model, factor));
        let in_sd = sorted(in_sd.filter(|z| z.is_finite()));
        upper_quantile(&in_sd, TOLD_BY).is_none_or(|edge| edge <= TOLD_BY_SD)
    };
    if holds(1.0) {
        return 1.0;
    }
    let (mut low, mut high) = (1.0, STRETCH_MOST);
    for _ in 0..STRETCH_HALVINGS {
        let factor = 0.5 * (low + high);
        if holds(factor) { high = factor } else { low = factor }
    }
    high
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Errors of fits that know their noise, and whose model is wrong by `factor` times what they assume.
    fn missed(factor: f64, share: impl Fn(f64) -> f64) -> Vec<Missed> {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut one = || {
            let by_model = share(rng.random_range(0.0..1.0));
            let normal = (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
            Missed { in_sd: (normal * grown(by_model, factor)).abs(), by_model }
        };
        (0..4000).map(|_| one()).collect()
    }

    #[test]
    fn the_factor_is_that_of_the_models_error_for_any_noise() {
        for (low, high) in [(0.3, 0.7), (0.8, 1.0)] {
            let factor = stretched(&missed(2.0, |u| low + (high - low) * u));
            assert!((factor - 2.0).abs() < 0.2, "{factor} with shares of {low} to {high}");
        }
        assert!(stretched(&missed(1.0, |u| u)) < 1.15);
        assert_eq!(stretched(&missed(0.5, |u| u)), 1.0, "limits that hold are not narrowed");
        assert_eq!(stretched(&[]), 1.0);
        // No factor on a part that is absent helps.
        let noise = missed(1.0, |_| 0.0);
        let twice: Vec<Missed> =
            noise.iter().map(|m| Missed { in_sd: 2.0 * m.in_sd, ..*m }).collect();
        assert_eq!(stretched(&twice), STRETCH_MOST);
    }
}
