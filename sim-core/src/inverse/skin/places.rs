//! Search for the triangles that contain the electrodes.
//! Uses: `sweep`, `frame`, `parameters`, faer. Never: a trial of an electrode with the other
//! parameters fixed.
//!
//! A sheet warped around a wrong position explains readings almost as well as the right position. A
//! move is therefore ranked by the cost after all other parameters have adapted: with d the change
//! of all frames, `|r - d|^2 - (g - S)' M^-1 (g - S)`, where M and g are the normal equations of
//! the other parameters and `S = J' W d`. Every electrode is moved alone to each triangle around
//! it; frames of several moves are approximated by the sum, and the choice of one position for each
//! is improved electrode by electrode until the cost no longer decreases.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatRef, Par, Side};

use super::SkinFitError;
use super::frame::{FrameTerms, WhiteColumns};
use super::parameters::Parameters;
use super::sweep::{Sweep, in_order};
use crate::forward::{Contact, ForwardModel, Workspace};

/// Largest number of trials used, taken evenly from those with contacts: each is simulated with
/// every electrode in every candidate triangle.
const PLACED_BY: usize = 60;
/// Smallest gain of a move, in chi-square.
const LEAST_GAIN: f64 = 3.0;

/// An electrode in another triangle.
struct Candidate {
    electrode: usize,
    move_mm: [f64; 2],
}

/// Returns the vector with electrodes in the triangles that fit best; `None` if none moves.
pub(super) fn placed(
    sweep: &mut Sweep<'_>,
    model: &ForwardModel,
    offsets_v: &[f64],
    factors: &[f64],
    vector: &[f64],
) -> Result<Option<Vec<f64>>, SkinFitError> {
    let parameters = sweep.parameters();
    let touched = |&i: &usize| !sweep.trials()[i].contacts.is_empty();
    let trials: Vec<usize> = (0..factors.len()).filter(touched).collect();
    let count = trials.len().min(PLACED_BY);
    let trials: Vec<usize> = (0..count).map(|i| trials[i * trials.len() / count]).collect();
    let seen: Vec<(FrameTerms, WhiteColumns)> =
        sweep.look(model, offsets_v, &trials, |i| factors[i])?;
    let candidates = candidates(parameters)?;
    let loads: Vec<&[Contact]> =
        trials.iter().map(|&i| sweep.trials()[i].contacts.as_slice()).collect();
    let frames = Frames { parameters, model, vector, loads: &loads };
    let changes = frames.changes(&candidates, &seen, sweep.threads())?;
    let choice = Quadratic::new(parameters, vector, &candidates, &seen, &changes, sweep.threads())?;
    let chosen = choice.improved(&candidates, parameters.electrodes());
    if chosen.iter().all(Option::is_none) {
        return Ok(None);
    }
    let moves: Vec<_> =
        chosen.iter().map(|of| of.map(|candidate| candidates[candidate].move_mm)).collect();
    Ok(Some(parameters.moved_anew(vector, &moves)))
}

fn candidates(parameters: &Parameters) -> Result<Vec<Candidate>, SkinFitError> {
    let around = parameters.places()?;
    let of = |(electrode, moves): (usize, Vec<[f64; 2]>)| {
        moves.into_iter().map(move |move_mm| Candidate { electrode, move_mm })
    };
    Ok(around.into_iter().enumerate().flat_map(of).collect())
}

/// Frames of the trials with moved electrodes.
struct Frames<'a> {
    parameters: &'a Parameters,
    /// Model of the vector.
    model: &'a ForwardModel,
    vector: &'a [f64],
    loads: &'a [&'a [Contact]],
}

impl Frames<'_> {
    /// For each candidate: the change of the trials' frames, one after the other, in standard
    /// deviations.
    fn changes(
        &self,
        candidates: &[Candidate],
        seen: &[(FrameTerms, WhiteColumns)],
        threads: usize,
    ) -> Result<Vec<Vec<f32>>, SkinFitError> {
        let mut work: Vec<Workspace> = Vec::new();
        work.resize_with(threads, Workspace::default);
        let here = self.of(self.model, &mut work[0])?;
        let channels = here.len() / self.loads.len().max(1);
        in_order(0..candidates.len(), &mut work, |i, work| {
            let Candidate { electrode, move_mm } = &candidates[i];
            let mut moves = vec![None; self.parameters.electrodes()];
            moves[*electrode] = Some(*move_mm);
            let vector = self.parameters.with_moves(self.vector, &moves);
            let there =
                self.of(&self.model.with_circuit(self.parameters.circuit(&vector))?, work)?;
            let both = there.chunks_exact(channels).zip(here.chunks_exact(channels)).zip(seen);
            let of_trial = both.flat_map(|((there, here), (_, columns))| {
                let change = move |(t, h): (&f64, &f64)| (columns.per_volt * (t - h)) as f32;
                there.iter().zip(here).map(change)
            });
            Ok(of_trial.collect())
        })
    }

    fn of(&self, model: &ForwardModel, work: &mut Workspace) -> Result<Vec<f64>, SkinFitError> {
        let mut frames = Vec::new();
        for load in self.loads {
            frames.extend_from_slice(model.voltages(load, work)?);
        }
        Ok(frames)
    }
}

/// The cost of a choice of candidates, up to a constant: `linear' z + z' square z`, with 1 for
/// those chosen.
struct Quadratic {
    linear: Vec<f64>,
    square: Mat<f64>,
}

/// Contribution of one trial.
struct Share {
    square: Mat<f32>,
    /// J' W d over the active parameters.
    across: Mat<f32>,
    /// d' W r.
    along: Mat<f32>,
}

impl Quadratic {
    fn new(
        parameters: &Parameters,
        vector: &[f64],
        candidates: &[Candidate],
        seen: &[(FrameTerms, WhiteColumns)],
        changes: &[Vec<f32>],
        threads: usize,
    ) -> Result<Self, SkinFitError> {
        let (count, all) = (candidates.len(), parameters.len());
        let shares = in_order(0..seen.len(), &mut vec![(); threads], |trial, ()| {
            Ok(share(&seen[trial].1, changes, trial))
        })?;
        let mut square = Mat::<f64>::zeros(count, count);
        let mut across = Mat::<f64>::zeros(all, count);
        let mut along = vec![0.0; count];
        let mut normal = parameters.precision.clone();
        let mut pull = parameters.prior_pull(vector);
        // Positions are searched, not stepped.
        pull[parameters.places_at()].fill(0.0);
        pull.iter_mut().for_each(|p| *p = -*p);
        // A resistance of almost zero must be able to grow to a usual value.
        let scale = parameters.resistance_scales(vector);
        for (share, (terms, _)) in shares.iter().zip(seen) {
            terms.add_to(&mut normal, &mut pull, &scale);
            for column in 0..count {
                for row in 0..count {
                    square[(row, column)] += f64::from(share.square[(row, column)]);
                }
                for (row, &at) in terms.active.iter().enumerate() {
                    let at = at as usize;
                    across[(at, column)] += scale[at] * f64::from(share.across[(row, column)]);
                }
                along[column] += f64::from(share.along[(column, 0)]);
            }
        }
        let Ok(factor) = normal.llt(Side::Lower) else {
            return Err(SkinFitError::Normal { step: 0 });
        };
        let followed = factor.solve(&across);
        let pull = Mat::from_fn(all, 1, |i, _| pull[i]);
        let step = factor.solve(&pull);
        matmul(square.as_mut(), Accum::Add, across.transpose(), followed.as_ref(), -1.0, Par::Seq);
        let linear = |i: usize| {
            let by_step: f64 = (0..all).map(|row| across[(row, i)] * step[(row, 0)]).sum();
            let Candidate { electrode, move_mm } = candidates[i];
            let prior = parameters.move_cost(move_mm)
                - parameters.move_cost(parameters.move_of(vector, electrode));
            -2.0 * along[i] + 2.0 * by_step + prior
        };
        Ok(Self { linear: (0..count).map(linear).collect(), square })
    }

    /// Chooses the best candidate of each electrode, or none, electrode by electrode.
    fn improved(&self, candidates: &[Candidate], electrodes: usize) -> Vec<Option<usize>> {
        let mut chosen: Vec<Option<usize>> = vec![None; electrodes];
        for _ in 0..2 * electrodes {
            // The single change with the largest gain.
            let mut best = (LEAST_GAIN, None);
            for electrode in 0..electrodes {
                let others = || {
                    let other = |(k, of): (usize, &Option<usize>)| of.filter(|_| k != electrode);
                    chosen.iter().enumerate().filter_map(other)
                };
                let cost = |of: Option<usize>| match of {
                    Some(i) => {
                        let both: f64 = others().map(|other| self.square[(i, other)]).sum();
                        self.linear[i] + self.square[(i, i)] + 2.0 * both
                    }
                    None => 0.0,
                };
                let now = cost(chosen[electrode]);
                let own = (0..candidates.len()).filter(|&i| candidates[i].electrode == electrode);
                for of in own.map(Some).chain([None]) {
                    let gain = now - cost(of);
                    if gain > best.0 {
                        best = (gain, Some((electrode, of)));
                    }
                }
            }
            let Some((electrode, of)) = best.1 else { break };
            chosen[electrode] = of;
        }
        chosen
    }
}

/// Contribution of one trial, its unknowns eliminated.
fn share(columns: &WhiteColumns, changes: &[Vec<f32>], trial: usize) -> Share {
    let channels = columns.channels;
    let whole = columns.values.len() / channels;
    let all = MatRef::from_column_major_slice(&columns.values, channels, whole);
    let own = all.subcols(0, columns.unknowns);
    let rest = all.subcols(columns.unknowns, whole - columns.unknowns - 1);
    let residual = all.subcols(whole - 1, 1);
    let changes =
        Mat::from_fn(channels, changes.len(), |row, i| changes[i][trial * channels + row]);
    // W d: the part that the trial's unknowns explain is removed.
    let product = own.transpose() * own + Mat::<f32>::identity(own.ncols(), own.ncols());
    let factor = product.llt(Side::Lower).expect("a Gram matrix and the identity");
    let left = &changes - own * factor.solve(own.transpose() * &changes);
    Share {
        square: changes.transpose() * &left,
        across: rest.transpose() * &left,
        along: left.transpose() * residual,
    }
}
