//! What one trial says about the parameters: its share of the normal equations, or of the cost.
//! Uses: `jacobian`, faer's dense product. Never: other trials, threads.
//!
//! `r = v - offset - model`, each reading with variance `noise^2 + (error |v|)^2 / directions`: what
//! no model of the skin can know (tilted tips, cells, drift) is a share of the frame, in few directions.

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, MatMut, MatRef, Par};

use super::parameters::{CircuitChanges, LAW_PIECES, Parameters};
use super::{MeasuredTrial, SkinFitError, TrialErrors};
use crate::forward::{ForwardModel, Workspace};
use crate::jacobian::{Field, JacobianWork, Linearised, Mode};

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
    /// Mean of `r^2 / variance` over channels: about 1 where model and errors are as stated.
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
    pub circuit: &'a CircuitChanges,
    pub law_slopes: &'a [f64; LAW_PIECES],
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
        let modelled_v = self.model.voltages(&trial.contacts, &mut work.forward)?;
        let residual_v = residual(trial, modelled_v);
        let variance = self.errors.variance(&trial.frame_v);
        let apart = residual_v.iter().zip(self.offsets_v).map(|(r, o)| (r - o).powi(2));
        let misfit = apart.sum::<f64>() / (variance * residual_v.len() as f64);
        Ok(FrameMisfit { misfit, residual_v, variance })
    }

    /// The cost of each electrode's own readings: those while it is the sink, and those that its
    /// voltage is in.
    pub fn of_electrodes(
        &self,
        trial: &MeasuredTrial,
        factor: f64,
        work: &mut FrameWork,
    ) -> Result<Vec<f64>, SkinFitError> {
        let modelled_v = self.model.voltages(&trial.contacts, &mut work.forward)?;
        let residual_v = residual(trial, modelled_v);
        let weight = factor / self.errors.variance(&trial.frame_v);
        let count = self.model.circuit().electrodes.len();
        let mut costs = vec![0.0; count];
        for (channel, (r, o)) in residual_v.iter().zip(self.offsets_v).enumerate() {
            let cost = weight * (r - o).powi(2);
            let (sink, first) = (channel / count, channel % count);
            let second = (first + 1) % count;
            costs[sink] += cost;
            for k in [first, second].into_iter().filter(|&k| k != sink) {
                costs[k] += cost;
            }
        }
        Ok(costs)
    }

    /// The share of the normal equations, weighted by a factor.
    pub fn terms(
        &self,
        trial: &MeasuredTrial,
        factor: f64,
        work: &mut FrameWork,
    ) -> Result<FrameTerms, SkinFitError> {
        let FrameWork { jacobian, modes, mode_of, columns, gram, .. } = work;
        let mut linear = self.model.linearise(&trial.contacts, jacobian)?;
        let mut active = Vec::new();
        modes.clear();
        self.law_modes(&linear, modes, &mut active);
        self.foam_modes(linear.to_top_s(), modes, mode_of, &mut active);
        columns.clear();
        columns.extend_from_slice(linear.modes(modes));
        columns.extend_from_slice(linear.resistors(&self.circuit.resistors));
        columns.extend_from_slice(linear.modes(&self.circuit.leads));
        active.extend(self.circuit.at.iter().map(|&i| i as u32));
        let residual_v = residual(trial, linear.frame_v());
        columns.extend(residual_v.iter().zip(self.offsets_v).map(|(r, o)| r - o));
        let (count, with_residual) = (active.len(), active.len() + 1);
        let variance = self.errors.variance(&trial.frame_v) / factor;
        weighted_gram(columns, with_residual, variance, gram);
        let column = |i: usize| &gram[i * with_residual..][..with_residual];
        let pull = (0..count).map(|i| column(i)[count]).collect();
        let mut products = Vec::with_capacity(count * count);
        (0..count).for_each(|i| products.extend_from_slice(&column(i)[..count]));
        let gram = products;
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
