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

use super::parameters::{CircuitChanges, LAW_PIECES, Parameters};
use super::{MeasuredTrial, SkinFitError, TrialErrors};
use crate::forward::{ForwardModel, Workspace};
use crate::jacobian::{CONTACT_PARAMETERS, Field, JacobianWork, Linearised, Mode};

/// A node counts where it carries at least this share of all conductance to the top.
const LEAST_SHARE: f64 = 3e-6;

/// Memory of one thread.
#[derive(Default)]
pub(super) struct FrameWork {
    forward: Workspace,
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

/// The directions C of a trial, column by column, V. They are kept while a step is looked for: a cost
/// whose weights moved with the model could fall without a better fit.
pub(super) type OpenDirections = Vec<f32>;

/// What is the same for all trials of a pass.
pub(super) struct Pass<'a> {
    pub parameters: &'a Parameters,
    pub model: &'a ForwardModel,
    pub circuit: &'a CircuitChanges,
    pub law_slopes: &'a [f64; LAW_PIECES],
    pub offsets_v: &'a [f64],
    pub errors: &'a TrialErrors,
}

impl Pass<'_> {
    /// The directions that a trial leaves open at this model, and its misfit.
    pub fn open(
        &self,
        trial: &MeasuredTrial,
        work: &mut FrameWork,
    ) -> Result<(OpenDirections, FrameMisfit), SkinFitError> {
        let mut linear = self.model.linearise(&trial.contacts, &mut work.jacobian)?;
        let residual_v = residual(trial, linear.frame_v());
        // A model that overshoots has slopes to match: they count as those of the measured frame.
        let size = |frame: &mut dyn Iterator<Item = f64>| frame.map(|v| v * v).sum::<f64>().sqrt();
        let measured = size(&mut trial.frame_v.iter().map(|&v| f64::from(v)));
        let modelled = size(&mut linear.frame_v().iter().copied());
        let scale = if modelled > measured { measured / modelled } else { 1.0 };
        let gain = self.errors.gain_sd as f32;
        let mut open: OpenDirections = trial.frame_v.iter().map(|v| gain * v).collect();
        for (i, column) in linear.contacts().chunks_exact(trial.frame_v.len()).enumerate() {
            let sd = match i % CONTACT_PARAMETERS {
                2 => self.errors.force_sd * trial.contacts[i / CONTACT_PARAMETERS].force_n,
                _ => self.errors.place_sd_mm,
            };
            open.extend(column.iter().map(|slope| (scale * sd * slope) as f32));
        }
        let misfit = self.weighted(trial, residual_v, &open, work);
        Ok((open, misfit))
    }

    /// The misfit at this model, with directions that were found at another.
    pub fn misfit(
        &self,
        trial: &MeasuredTrial,
        open: &OpenDirections,
        work: &mut FrameWork,
    ) -> Result<FrameMisfit, SkinFitError> {
        let residual_v = residual(trial, self.model.voltages(&trial.contacts, &mut work.forward)?);
        Ok(self.weighted(trial, residual_v, open, work))
    }

    fn weighted(
        &self,
        trial: &MeasuredTrial,
        residual_v: Vec<f64>,
        open: &OpenDirections,
        work: &mut FrameWork,
    ) -> FrameMisfit {
        let FrameWork { columns, gram, .. } = work;
        let (channels, variance) = (trial.frame_v.len(), self.errors.variance(&trial.frame_v));
        columns.clear();
        columns.extend(open.iter().map(|&v| f64::from(v)));
        columns.extend(residual_v.iter().zip(self.offsets_v).map(|(r, o)| r - o));
        let count = columns.len() / channels;
        weighted_gram(columns, count, variance, gram);
        eliminate(gram, count, count - 1);
        let misfit = gram[count * count - 1] / channels as f64;
        FrameMisfit { misfit, residual_v, variance }
    }

    /// The share of the normal equations, weighted by a factor.
    pub fn terms(
        &self,
        trial: &MeasuredTrial,
        open: &OpenDirections,
        factor: f64,
        work: &mut FrameWork,
    ) -> Result<FrameTerms, SkinFitError> {
        let FrameWork { jacobian, modes, mode_of, columns, gram, .. } = work;
        let mut linear = self.model.linearise(&trial.contacts, jacobian)?;
        columns.clear();
        columns.extend(open.iter().map(|&v| f64::from(v)));
        let nuisances = open.len() / trial.frame_v.len();
        let mut active = Vec::new();
        modes.clear();
        self.law_modes(&linear, modes, &mut active);
        self.foam_modes(linear.to_top_s(), modes, mode_of, &mut active);
        columns.extend_from_slice(linear.modes(modes));
        columns.extend_from_slice(linear.resistors(&self.circuit.resistors));
        columns.extend_from_slice(linear.modes(&self.circuit.leads));
        active.extend(self.circuit.first as u32..self.parameters.len() as u32);
        let residual_v = residual(trial, linear.frame_v());
        columns.extend(residual_v.iter().zip(self.offsets_v).map(|(r, o)| r - o));
        let count = nuisances + active.len() + 1;
        weighted_gram(columns, count, self.errors.variance(&trial.frame_v) / factor, gram);
        eliminate(gram, count, nuisances);
        let column = |i: usize| &gram[(nuisances + i) * count + nuisances..][..active.len() + 1];
        let pull = (0..active.len()).map(|i| column(i)[active.len()]).collect();
        let gram =
            (0..active.len()).flat_map(|i| column(i)[..active.len()].iter().copied()).collect();
        Ok(FrameTerms { active, gram, pull })
    }

    /// The modes of the foam's law: they move compressions, as the compliance does.
    fn law_modes(&self, linear: &Linearised<'_>, modes: &mut Vec<Mode>, active: &mut Vec<u32>) {
        let first = modes.len();
        let piece = |_| Mode { field: Field::LnCompliance, entries: Vec::new() };
        modes.extend((0..LAW_PIECES).map(piece));
        active.extend(0..LAW_PIECES as u32);
        let (to_top_s, compression_mm) = (linear.to_top_s(), linear.compression_mm());
        let least_s = least_s(to_top_s);
        for (node, &compression_mm) in compression_mm.iter().enumerate() {
            if to_top_s[node] < least_s {
                continue;
            }
            let shares = Parameters::law_shares(self.law_slopes, compression_mm);
            for (mode, share) in modes[first..].iter_mut().zip(shares) {
                if share > 0.0 {
                    mode.entries.push((node as u32, share));
                }
            }
        }
    }

    /// The modes of the foam's fields that this load reaches, restricted to the nodes it presses.
    fn foam_modes(
        &self,
        to_top_s: &[f64],
        modes: &mut Vec<Mode>,
        mode_of: &mut Vec<u32>,
        active: &mut Vec<u32>,
    ) {
        let least_s = least_s(to_top_s);
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

/// Measured minus modelled, V.
fn residual(trial: &MeasuredTrial, modelled_v: &[f64]) -> Vec<f64> {
    trial.frame_v.iter().zip(modelled_v).map(|(v, m)| f64::from(*v) - m).collect()
}

/// Conductance below which a node is left out, S.
fn least_s(to_top_s: &[f64]) -> f64 {
    LEAST_SHARE * to_top_s.iter().sum::<f64>()
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
