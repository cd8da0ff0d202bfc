//! What one trial says about the parameters: its share of the normal equations, or of the cost.
//! Uses: `jacobian`, faer's dense product. Never: other trials, threads.
//!
//! `r = v - offset - model`, each reading with variance `s^2 = noise^2 + (error |v|)^2 / channels`.
//! What a trial does not tell (where a tilted tip's weight really stands, how hard it presses within
//! the cell's error, the frame's gain) are directions `C` of its own, scaled by their standard
//! deviations and integrated out: `W = (s^2 + C C')^-1`. With the Gram matrix of `[C J r] / s` that
//! is the elimination of C's columns.

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, MatMut, MatRef, Par};

use super::parameters::Parameters;
use super::{MeasuredTrial, SkinFitError, TrialErrors};
use crate::forward::ForwardModel;
use crate::jacobian::{CONTACT_PARAMETERS, Field, JacobianWork, Linearised, Mode};

/// A node counts where it carries at least this share of all conductance to the top.
const LEAST_SHARE: f64 = 1e-7;

/// Memory of one thread.
#[derive(Default)]
pub(super) struct FrameWork {
    jacobian: JacobianWork,
    modes: Vec<Mode>,
    /// For each corner of a field: its mode, plus one; 0 for none.
    mode_of: Vec<u32>,
    columns: Vec<f64>,
    gram: Vec<f64>,
}

/// A trial's share of the normal equations.
pub(super) struct FrameTerms {
    /// The parameters that it says something about.
    pub active: Vec<u32>,
    /// J' W J over them, column-major; only the lower triangle is filled.
    pub gram: Vec<f64>,
    /// J' W r over them.
    pub pull: Vec<f64>,
}

/// A trial's residual and misfit.
pub(super) struct FrameMisfit {
    /// `r' W r` by channel: about 1 where model and errors are as stated.
    pub misfit: f64,
    /// Measured minus modelled, before the offset, V.
    pub residual_v: Vec<f64>,
    /// Variance of a reading, V^2.
    pub variance: f64,
}

/// What is the same for all trials of a pass.
pub(super) struct Pass<'a> {
    pub parameters: &'a Parameters,
    pub model: &'a ForwardModel,
    pub electrode_modes: &'a [Mode],
    pub sheet_modes: &'a [Mode],
    pub offsets_v: &'a [f64],
    pub errors: &'a TrialErrors,
}

impl Pass<'_> {
    /// The misfit at this model.
    pub fn misfit(
        &self,
        trial: &MeasuredTrial,
        work: &mut FrameWork,
    ) -> Result<FrameMisfit, SkinFitError> {
        let FrameWork { jacobian, columns, gram, .. } = work;
        let mut linear = self.model.linearise(&trial.contacts, jacobian)?;
        let residual_v: Vec<f64> =
            trial.frame_v.iter().zip(linear.frame_v()).map(|(v, m)| f64::from(*v) - m).collect();
        let variance = self.errors.variance(&trial.frame_v);
        columns.clear();
        let nuisances = self.nuisances(trial, &mut linear, columns);
        columns.extend(residual_v.iter().zip(self.offsets_v).map(|(r, o)| r - o));
        let count = nuisances + 1;
        weighted_gram(columns, count, variance, gram);
        eliminate(gram, count, nuisances);
        let misfit = gram[count * count - 1] / trial.frame_v.len() as f64;
        Ok(FrameMisfit { misfit, residual_v, variance })
    }

    /// The share of the normal equations, weighted by a factor.
    pub fn terms(
        &self,
        trial: &MeasuredTrial,
        factor: f64,
        work: &mut FrameWork,
    ) -> Result<FrameTerms, SkinFitError> {
        let FrameWork { jacobian, modes, mode_of, columns, gram } = work;
        let mut linear = self.model.linearise(&trial.contacts, jacobian)?;
        columns.clear();
        let nuisances = self.nuisances(trial, &mut linear, columns);
        let mut active = Vec::new();
        self.foam_modes(linear.to_top_s(), modes, mode_of, &mut active);
        columns.extend_from_slice(linear.modes(modes));
        for (fixed, at) in [
            (self.sheet_modes, self.parameters.blocks[4].at.clone()),
            (self.electrode_modes, self.parameters.electrodes_at()),
        ] {
            columns.extend_from_slice(linear.modes(fixed));
            active.extend(at.map(|i| i as u32));
        }
        let modelled = linear.frame_v().iter().zip(self.offsets_v);
        columns.extend(trial.frame_v.iter().zip(modelled).map(|(v, (m, o))| f64::from(*v) - m - o));
        let count = nuisances + active.len() + 1;
        weighted_gram(columns, count, self.errors.variance(&trial.frame_v) / factor, gram);
        eliminate(gram, count, nuisances);
        let column = |i: usize| &gram[(nuisances + i) * count + nuisances..][..active.len() + 1];
        let pull = (0..active.len()).map(|i| column(i)[active.len()]).collect();
        let gram =
            (0..active.len()).flat_map(|i| column(i)[..active.len()].iter().copied()).collect();
        Ok(FrameTerms { active, gram, pull })
    }

    /// Appends the directions that a trial leaves open, scaled by their standard deviations; returns
    /// how many.
    fn nuisances(
        &self,
        trial: &MeasuredTrial,
        linear: &mut Linearised<'_>,
        columns: &mut Vec<f64>,
    ) -> usize {
        let gain = self.errors.gain_sd;
        columns.extend(linear.frame_v().iter().map(|v| gain * v));
        let channels = trial.frame_v.len();
        let by_contacts = linear.contacts().chunks_exact(channels);
        for (i, column) in by_contacts.enumerate() {
            let sd = match i % CONTACT_PARAMETERS {
                2 => self.errors.force_sd * trial.contacts[i / CONTACT_PARAMETERS].force_n,
                _ => self.errors.place_sd_mm,
            };
            columns.extend(column.iter().map(|slope| sd * slope));
        }
        1 + CONTACT_PARAMETERS * trial.contacts.len()
    }

    /// The modes of the foam's fields that this load reaches, restricted to the nodes it presses.
    fn foam_modes(
        &self,
        to_top_s: &[f64],
        modes: &mut Vec<Mode>,
        mode_of: &mut Vec<u32>,
        active: &mut Vec<u32>,
    ) {
        modes.clear();
        let least_s = LEAST_SHARE * to_top_s.iter().sum::<f64>();
        for block in self.parameters.blocks.iter().filter(|b| b.field != Field::LnSheetConductance)
        {
            mode_of.clear();
            mode_of.resize(block.at.len(), 0);
            for (node, corners) in block.corners.iter().enumerate() {
                if to_top_s[node] < least_s {
                    continue;
                }
                for &(corner, weight) in corners.iter().filter(|(_, weight)| *weight != 0.0) {
                    if mode_of[corner] == 0 {
                        modes.push(Mode { field: block.field, entries: Vec::new() });
                        active.push((block.at.start + corner) as u32);
                        mode_of[corner] = modes.len() as u32;
                    }
                    modes[mode_of[corner] as usize - 1].entries.push((node as u32, weight));
                }
            }
        }
    }
}

/// The lower triangle of `A' A / variance`, column-major, for a column-major A.
fn weighted_gram(columns: &mut [f64], count: usize, variance: f64, gram: &mut Vec<f64>) {
    let scale = 1.0 / variance.sqrt();
    columns.iter_mut().for_each(|v| *v *= scale);
    let channels = columns.len() / count;
    let a = MatRef::from_column_major_slice(columns, channels, count);
    gram.clear();
    gram.resize(count * count, 0.0);
    matmul(
        MatMut::from_column_major_slice_mut(gram, count, count),
        BlockStructure::TriangularLower,
        Accum::Replace,
        a.transpose(),
        BlockStructure::Rectangular,
        a,
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
}

/// Integrates out the first parameters, whose priors have variance 1: what is left below and beside
/// them is the Schur complement.
fn eliminate(gram: &mut [f64], count: usize, first: usize) {
    let mut column = vec![0.0; count];
    for k in 0..first {
        let scale = 1.0 / (1.0 + gram[k * count + k]).sqrt();
        for i in k + 1..count {
            column[i] = scale * gram[k * count + i];
        }
        for j in k + 1..count {
            let (by, target) = (column[j], &mut gram[j * count + j..(j + 1) * count]);
            for (value, of_row) in target.iter_mut().zip(&column[j..]) {
                *value -= by * of_row;
            }
        }
    }
}
