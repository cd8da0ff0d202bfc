//! Analysis by synthesis: the contacts that explain a frame, by the exact forward model.
//! Uses: `forward`, `jacobian`, `batch`, an error model. Never: threads, clock, chance, nets (their
//! proposals are passed in).
//!
//! A frame is projected on the few directions in which the model's frames differ (`basis`), and whitened by the
//! covariance of its error (`whitener`). A
//! search over a table of single contacts (`shapes`, `search`) finds hypotheses of every count; the
//! best are finished with the exact model (`exact`, `descent`), and evidence chooses among them; what else
//! is probable is part of the result (`explain`).

mod basis;
mod dense;
mod descent;
pub mod error;
mod exact;
mod explain;
mod fit;
mod search;
mod shapes;
pub mod steady;
mod whitener;

use crate::batch::{BatchError, BatchModel, BatchWork, Kernel};
use crate::forward::{Contact, ContactResult, ForwardModel, Workspace};
use basis::{Basis, Projected};
use descent::{EACH, Effort, Optimum, Predict, Prior, Problem, Spread, descend};
pub use error::{ErrorModel, ErrorModelError, FramePair};
use exact::ExactWork;
use explain::{Explanations, shares};
pub use fit::{
    Explanation, Fit, FitError, FitOptions, FittedContact, FitterError, Found, Observation, Origin,
    Proposal,
};
use search::{Hypothesis, Search, SearchWork, Sum, closest_mm, same};
use shapes::{Place, Shapes};
pub use steady::{Steady, SteadyError, SteadyMean, SteadySettings};

/// Proposals with a smaller weight are skipped.
const LEAST_WEIGHT: f64 = 0.15;

/// Limits of a descent that tracks a load; each step evaluates a frame and its slopes.
const TRACKING: Effort = Effort { iterations: 5, tolerance: 0.1 };
/// Growth of the misfit, in standard deviations of chi-square, that shows a new load.
const CHANGE_SD: f64 = 4.0;
/// A contact whose force has at least this relative standard deviation may have vanished,
const FADED_SHARE: f64 = 0.5;
/// unless its force was hardly better known when it was found: this factor of deterioration counts
/// as a change, as does a value near the width of the prior.
const FADED_GROWTH: f64 = 1.5;
const FADED_MOST: f64 = 0.75;
/// If the number of frames in the mean grew by this factor, further contacts may be detectable.
const FRAMES_GROWTH: f64 = 5.0;
/// Number of comparisons of the hypotheses with exact frames.
const COMPARISONS: usize = 3;

/// Fits contacts to the frames of one skin. `Send + Sync`; each thread needs its own [`FitWork`].
pub struct ContactFitter {
    model: ForwardModel,
    batch: BatchModel,
    options: FitOptions,
    basis: Basis,
    shapes: Shapes,
    prior: Prior,
    none: Vec<f64>,
}

/// Memory of a fit; may be reused.
#[derive(Default)]
pub struct FitWork {
    search: SearchWork,
    exact: ExactWork,
    batch: BatchWork,
    frames_v: Vec<f32>,
    frame: Projected,
    frame_v: Vec<f64>,
    scratch: Vec<f64>,
}

impl ContactFitter {
    /// Computes the tables of a model; takes some seconds.
    ///
    /// # Errors
    /// `FitterError` if the error model has other channels, an option is outside its limits, or a
    /// table cannot be computed.
    pub fn new(
        model: &ForwardModel,
        error: &ErrorModel,
        options: FitOptions,
    ) -> Result<Self, FitterError> {
        let needed = model.sensor().channels();
        if error.channels() != needed {
            return Err(FitterError::Channels { found: error.channels(), needed });
        }
        options.check()?;
        let batch = BatchModel::new(model, Kernel::detect());
        let mut rest = Workspace::default();
        let rest_v = model.voltages(&[], &mut rest).unwrap_or_default();
        let basis = Basis::new(&batch, model.sensor(), rest_v, error)?;
        let shapes = Shapes::new(model, &batch, &basis)?;
        let prior = Prior {
            ln_force_mean: options.force_median_n.ln(),
            ln_force_sd: options.force_ln_sd,
            ln_odds: options.ln_odds,
            limits_mm: shapes.limits_mm,
        };
        let none = vec![0.0; basis.width()];
        Ok(Self { model: model.clone(), batch, options, basis, shapes, prior, none })
    }

    /// Finds the contacts that explain a frame, without prior contacts. Proposals are tried in
    /// addition to the starts that the search finds.
    ///
    /// # Errors
    /// `FitError` if the observation is invalid or a proposal is not a contact on this skin.
    pub fn fit(
        &self,
        observation: &Observation<'_>,
        proposals: &[Proposal],
        work: &mut FitWork,
    ) -> Result<Fit, FitError> {
        for (index, proposal) in proposals.iter().enumerate() {
            self.model.check(index, &proposal.contact)?;
        }
        self.measure(observation, work)?;
        let starts = starts(proposals);
        let mut hypotheses = self.search(&starts, work)?;
        hypotheses.truncate(self.options.finalists);
        self.approach(&mut hypotheses, work)?;
        let scores: Vec<f64> = hypotheses.iter().map(|h| h.score).collect();
        let mut shares = shares(&scores);
        let counts: Vec<usize> = hypotheses.iter().map(|h| h.places.len()).collect();
        let answer = explain::answer(&counts, &shares);
        if answer > 0 {
            hypotheses[..=answer].rotate_right(1);
            shares[..=answer].rotate_right(1);
        }
        let best = hypotheses.first().map(|h| h.places.clone()).unwrap_or_default();
        let mut fit = self.report(best, observation, self.effort(), work)?;
        fit.origin = Origin::Search;
        self.explain(&hypotheses, &shares, observation, &mut fit, work)?;
        Ok(fit)
    }

    /// Adds to the fit of the first hypothesis its probability, and the most probable others, each finished
    /// with the exact model. The evidence is compared before that: it has the same effort for all. Without a
    /// hypothesis, since the contacts of each collapsed, nothing states how probable the answer is.
    fn explain(
        &self,
        hypotheses: &[Hypothesis],
        shares: &[f64],
        observation: &Observation<'_>,
        fit: &mut Fit,
        work: &mut FitWork,
    ) -> ContactResult<()> {
        let Some(&best) = shares.first() else { return Ok(()) };
        let mut found = Explanations::of(best, self.options.least_distance_mm);
        let others = hypotheses.iter().zip(shares).skip(1);
        for (hypothesis, &probability) in explain::probable(others) {
            let other = self.report(hypothesis.places.clone(), observation, self.effort(), work)?;
            fit.exact_runs += other.exact_runs;
            found.add(&fit.contacts, Explanation { probability, contacts: other.contacts });
        }
        let found = found.counted_once();
        (fit.probability, fit.alternatives) = (Some(found.probability), found.alternatives);
        Ok(())
    }

    /// Finds the contacts that explain a frame, starting from those of the previous fit: some steps
    /// of the exact model if the load only moved, a new search if it changed.
    ///
    /// # Errors
    /// `FitError` if the observation is invalid or a contact of `before` is off the skin.
    pub fn track(
        &self,
        observation: &Observation<'_>,
        before: &Fit,
        work: &mut FitWork,
    ) -> Result<Fit, FitError> {
        self.measure(observation, work)?;
        let places: Vec<Place> = before.contacts.iter().map(|c| place_of(&c.contact)).collect();
        let mut tracked = self.report(places, observation, TRACKING, work)?;
        if self.changed(&before.found, &tracked) {
            let proposals: Vec<Proposal> = tracked.contacts.iter().map(Proposal::sure).collect();
            return self.fit(observation, &proposals, work);
        }
        tracked.found = before.found;
        (tracked.probability, tracked.alternatives) =
            (before.probability, before.alternatives.clone());
        Ok(tracked)
    }

    /// Whether the tracked contacts may no longer be the load: the residual exceeds chance, a
    /// contact faded, or the mean has many more frames.
    fn changed(&self, found: &Found, tracked: &Fit) -> bool {
        let free = self.basis.directions().saturating_sub(EACH * tracked.contacts.len()) as f64;
        let usual = found.inside_chi2.max(free);
        let Found { frames, inside_chi2, worst_share } = tracked.found;
        inside_chi2 > usual + CHANGE_SD * (2.0 * usual).sqrt()
            || worst_share > (FADED_GROWTH * found.worst_share).clamp(FADED_SHARE, FADED_MOST)
            || frames >= FRAMES_GROWTH * found.frames
    }

    /// Finds the best fit with the same number of contacts, starting from `contacts`.
    ///
    /// # Errors
    /// `FitError` if the observation or a contact is invalid.
    pub fn refine(
        &self,
        observation: &Observation<'_>,
        contacts: &[Contact],
        work: &mut FitWork,
    ) -> Result<Fit, FitError> {
        for (index, contact) in contacts.iter().enumerate() {
            self.model.check(index, contact)?;
        }
        self.measure(observation, work)?;
        let places = contacts.iter().map(place_of).collect();
        Ok(self.report(places, observation, self.effort(), work)?)
    }

    fn effort(&self) -> Effort {
        Effort { iterations: self.options.iterations, tolerance: self.options.tolerance }
    }

    fn measure(&self, observation: &Observation<'_>, work: &mut FitWork) -> Result<(), FitError> {
        let Observation { frame_v, frames, offset_sd_v, offset_spectrum } = *observation;
        let needed = self.model.sensor().channels();
        if frame_v.len() != needed {
            return Err(FitError::Length { found: frame_v.len(), needed });
        }
        if let Some(channel) = frame_v.iter().position(|v| !v.is_finite()) {
            return Err(FitError::NotFinite { channel });
        }
        if !(frames >= 1.0 && frames.is_finite()) {
            return Err(FitError::Frames { frames });
        }
        if !(offset_sd_v >= 0.0 && offset_sd_v.is_finite()) {
            return Err(FitError::Offset { offset_sd_v });
        }
        let (found, needed) = (offset_spectrum.len(), self.basis.pairs() / 2 + 1);
        let sound = offset_spectrum.iter().all(|share| *share >= 0.0 && share.is_finite());
        if !(sound && (found == 0 || found == needed)) {
            return Err(FitError::Spectrum { found, needed });
        }
        self.basis.measure(observation, &mut work.scratch, &mut work.frame);
        Ok(())
    }

    fn search(&self, starts: &[Vec<Place>], work: &mut FitWork) -> ContactResult<Vec<Hypothesis>> {
        let search = Search {
            model: &self.model,
            shapes: &self.shapes,
            frame: &work.frame,
            prior: &self.prior,
            options: &self.options,
            none: &self.none,
        };
        search.run(starts, &mut work.search)
    }

    /// Compares hypotheses with the exact model, corrects the table's sums by the difference, and
    /// fits the hypotheses again. The result is sorted, best first, without duplicates.
    fn approach(&self, hypotheses: &mut Vec<Hypothesis>, work: &mut FitWork) -> ContactResult<()> {
        let channels = self.batch.frame_len();
        let (mut lacks, mut sum, mut slopes) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..COMPARISONS {
            let loads: Vec<Vec<Contact>> = hypotheses
                .iter()
                .map(|h| h.places.iter().map(|&place| shapes::contact(place)).collect())
                .collect();
            let trials: Vec<&[Contact]> = loads.iter().map(Vec::as_slice).collect();
            work.frames_v.resize(trials.len() * channels, 0.0);
            match self.batch.voltages(&trials, &mut work.frames_v, &mut work.batch) {
                Err(BatchError::Trial { source, .. }) => return Err(source),
                other => other.expect("the frames have the batch's length"),
            }
            let frames = work.frames_v.chunks_exact(channels);
            for (hypothesis, frame) in hypotheses.iter_mut().zip(frames) {
                work.frame_v.clear();
                work.frame_v.extend(frame.iter().map(|&v| f64::from(v)));
                self.basis.project_frame(&work.frame_v, &mut work.scratch, &mut lacks);
                let whitener = &work.frame.whitener;
                whitener.apply(&mut lacks);
                let (model, shapes) = (&self.model, &self.shapes);
                let mut table = Sum { model, shapes, whitener, lacks: &self.none };
                table.predict(&hypothesis.places, &mut sum, &mut slopes)?;
                lacks.iter_mut().zip(&sum).for_each(|(lacks, sum)| *lacks -= sum);
                table.lacks = &lacks;
                let problem = Problem { z: &work.frame.z, prior: &self.prior };
                let places = &mut hypothesis.places;
                let descent = work.exact.descent();
                hypothesis.score =
                    descend(&problem, &mut table, places, search::EFFORT, descent)?.score;
            }
        }
        hypotheses.sort_by(|a, b| a.score.total_cmp(&b.score));
        let mut kept: Vec<Hypothesis> = Vec::with_capacity(hypotheses.len());
        for hypothesis in hypotheses.drain(..) {
            if closest_mm(&hypothesis.places) >= self.options.least_distance_mm
                && !kept.iter().any(|h| same(&h.places, &hypothesis.places))
            {
                kept.push(hypothesis);
            }
        }
        *hypotheses = kept;
        Ok(())
    }

    /// Descends on the exact model.
    fn finish(
        &self,
        places: &mut [Place],
        effort: Effort,
        work: &mut FitWork,
    ) -> ContactResult<Optimum> {
        let Projected { z, whitener, .. } = &work.frame;
        let (mut model, descent) = work.exact.model(&self.model, &self.basis, whitener);
        let problem = Problem { z, prior: &self.prior };
        descend(&problem, &mut model, places, effort, descent)
    }

    /// Finishes places and computes their standard deviations; the origin is set to `Tracked`.
    fn report(
        &self,
        mut places: Vec<Place>,
        observation: &Observation<'_>,
        effort: Effort,
        work: &mut FitWork,
    ) -> ContactResult<Fit> {
        let optimum = self.finish(&mut places, effort, work)?;
        let spreads = work.exact.descent().spreads(places.len(), &work.frame);
        let mut contacts: Vec<FittedContact> = places
            .iter()
            .zip(spreads)
            .map(|(&place, Spread { variance, by_model })| {
                let contact = shapes::contact(place);
                let [x_sd_mm, y_sd_mm, ln_sd] = variance.map(f64::sqrt);
                let force_sd_n = contact.force_n * ln_sd;
                FittedContact { contact, x_sd_mm, y_sd_mm, force_sd_n, by_model }
            })
            .collect();
        contacts.sort_by(|a, b| b.contact.force_n.total_cmp(&a.contact.force_n));
        let parameters = EACH * contacts.len();
        let shares = contacts.iter().map(|c| c.force_sd_n / c.contact.force_n);
        let worst_share = shares.fold(0.0, f64::max);
        let (frames, inside_chi2) = (observation.frames, optimum.misfit);
        Ok(Fit {
            contacts,
            found: Found { frames, inside_chi2, worst_share },
            chi2: optimum.misfit + work.frame.outside_chi2,
            inside_chi2,
            degrees_of_freedom: (self.model.sensor().channels() - parameters) as f64,
            score: optimum.score,
            probability: None,
            alternatives: Vec::new(),
            origin: Origin::Tracked,
            exact_runs: optimum.predictions,
        })
    }
}

fn place_of(contact: &Contact) -> Place {
    [contact.x_mm, contact.y_mm, contact.force_n.max(1e-3).ln()]
}

/// Starts from the proposals: all with sufficient weight, then without the weakest ones in turn.
fn starts(proposals: &[Proposal]) -> Vec<Vec<Place>> {
    let mut sorted: Vec<&Proposal> =
        proposals.iter().filter(|p| p.weight >= LEAST_WEIGHT).collect();
    sorted.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let places: Vec<Place> = sorted.iter().map(|p| place_of(&p.contact)).collect();
    (1..=places.len()).map(|count| places[..count].to_vec()).collect()
}
