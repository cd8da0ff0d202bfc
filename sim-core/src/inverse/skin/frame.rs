//! Contribution of one trial to the normal equations, or to the cost.
//! Uses: `jacobian`, faer's dense product. Never: other trials, threads.
//!
//! `r = v - offset - model`. Effects that no model of the skin can contain (tilted tips, cells,
//! drift) are unknowns of the trial: small shifts of its contacts, changes of their forces and of
//! the gain, each with its standard deviation, eliminated from the trial's equations (a Schur
//! complement). The residual has variance `noise^2 + (error |v|)^2 / directions`.

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::solvers::{Llt, Solve};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};

use super::parameters::{CircuitChanges, LAW_PIECES, Parameters};
use super::{MeasuredTrial, SkinFitError, TrialErrors};
use crate::forward::ForwardModel;
use crate::jacobian::{CONTACT_PARAMETERS, Field, JacobianWork, Linearised, Mode};

/// A node is included if it carries at least this share of the total conductance to the top.
const LEAST_SHARE: f64 = 3e-6;

/// Memory of one thread; may be reused.
#[derive(Default)]
pub(super) struct FrameWork {
    jacobian: JacobianWork,
    modes: Vec<Mode>,
    /// For each corner of a field: its mode, plus one; 0 for none.
    mode_of: Vec<u32>,
    columns: Vec<f64>,
    gram: Vec<f64>,
}

/// Contribution of a trial to the normal equations.
pub(super) struct FrameTerms {
    /// Indices of the parameters that affect its frame.
    pub active: Vec<u32>,
    /// J' W J over them, column-major; only the lower triangle is filled.
    pub gram: Vec<f64>,
    /// J' W r over them.
    pub pull: Vec<f64>,
}

impl FrameTerms {
    /// Adds the contribution to the normal equations (lower triangle) and their right side; `scale`
    /// is the unit of each parameter.
    pub fn add_to(&self, normal: &mut Mat<f64>, pull: &mut [f64], scale: &[f64]) {
        for (j, column) in self.gram.chunks_exact(self.active.len()).enumerate() {
            let at = self.active[j] as usize;
            pull[at] += scale[at] * self.pull[j];
            for (i, &value) in column.iter().enumerate().skip(j) {
                let other = self.active[i] as usize;
                normal[(other.max(at), other.min(at))] += scale[at] * scale[other] * value;
            }
        }
    }
}

/// Columns of a trial, in standard deviations of its readings: the trial's unknowns, the parameters
/// that affect its frame, the residual.
pub(super) struct WhiteColumns {
    pub channels: usize,
    pub unknowns: usize,
    /// Columns one after the other.
    pub values: Vec<f32>,
    /// Standard deviations per volt.
    pub per_volt: f64,
}

/// A trial's residual and misfit.
pub(super) struct FrameMisfit {
    /// Mean of `r^2 / variance` over channels: about 1 if model and errors are as stated.
    pub misfit: f64,
    /// Measured minus modelled, before the offset, V.
    pub residual_v: Vec<f64>,
    /// Variance of a reading, V^2.
    pub variance: f64,
}

/// Data shared by all trials of a pass.
pub(super) struct Pass<'a> {
    pub parameters: &'a Parameters,
    pub model: &'a ForwardModel,
    pub circuit: CircuitChanges,
    pub law_slopes: [f64; LAW_PIECES],
    pub offsets_v: &'a [f64],
    pub errors: &'a TrialErrors,
}

impl Pass<'_> {
    /// Computes the misfit at this model.
    ///
    /// # Errors
    /// `SkinFitError::Contact` if the model rejects a contact.
    pub fn misfit(
        &self,
        trial: &MeasuredTrial,
        work: &mut FrameWork,
    ) -> Result<FrameMisfit, SkinFitError> {
        let variance = self.errors.variance(&trial.frame_v);
        let FrameWork { jacobian, columns, gram, .. } = work;
        let mut linear = self.model.linearise(&trial.contacts, jacobian)?;
        columns.clear();
        let unknowns = self.unknowns(trial, &mut linear, columns);
        let residual_v = residual(trial, linear.frame_v());
        columns.extend(residual_v.iter().zip(self.offsets_v).map(|(r, o)| r - o));
        let count = unknowns + 1;
        weighted_gram(columns, count, variance, gram);
        let last = |column: usize| gram[column * count + unknowns];
        let pull = Mat::from_fn(unknowns, 1, |i, _| last(i));
        let found = own(gram, count, unknowns).solve(&pull);
        let explained: f64 = (0..unknowns).map(|i| last(i) * found[(i, 0)]).sum();
        let misfit = (last(unknowns) - explained) / residual_v.len() as f64;
        Ok(FrameMisfit { misfit, residual_v, variance })
    }

    /// Writes the columns of a trial's unknowns, each for one standard deviation; returns their
    /// number.
    fn unknowns(
        &self,
        trial: &MeasuredTrial,
        linear: &mut Linearised<'_>,
        columns: &mut Vec<f64>,
    ) -> usize {
        let (errors, first) = (self.errors, columns.len());
        columns.extend_from_slice(linear.contacts());
        let channels = linear.frame_v().len();
        let of_contacts = columns[first..].chunks_exact_mut(channels);
        for (index, column) in of_contacts.enumerate() {
            let sd = match index % CONTACT_PARAMETERS {
                0 | 1 => errors.place_mm,
                _ => errors.force_share * trial.contacts[index / CONTACT_PARAMETERS].force_n,
            };
            column.iter_mut().for_each(|v| *v *= sd);
        }
        columns.extend(linear.frame_v().iter().map(|v| errors.gain_share * v));
        CONTACT_PARAMETERS * trial.contacts.len() + 1
    }

    /// Computes the contribution to the normal equations, weighted by a factor.
    ///
    /// # Errors
    /// `SkinFitError::Contact` if the model rejects a contact.
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
        let unknowns = self.unknowns(trial, &mut linear, columns);
        columns.extend_from_slice(linear.modes(modes));
        columns.extend_from_slice(linear.resistors(&self.circuit.resistors));
        columns.extend_from_slice(linear.modes(&self.circuit.leads));
        active.extend(self.circuit.at.iter().map(|&i| i as u32));
        let residual_v = residual(trial, linear.frame_v());
        columns.extend(residual_v.iter().zip(self.offsets_v).map(|(r, o)| r - o));
        let (count, whole) = (active.len(), unknowns + active.len() + 1);
        let variance = self.errors.variance(&trial.frame_v) / factor;
        weighted_gram(columns, whole, variance, gram);
        eliminate(gram, whole, unknowns);
        let column = |i: usize| &gram[(unknowns + i) * whole + unknowns..][..count + 1];
        let pull = (0..count).map(|i| column(i)[count]).collect();
        let mut products = Vec::with_capacity(count * count);
        (0..count).for_each(|i| products.extend_from_slice(&column(i)[..count]));
        let gram = products;
        Ok(FrameTerms { active, gram, pull })
    }

    /// As [`Self::terms`], with the columns from which the contribution is computed.
    ///
    /// # Errors
    /// `SkinFitError::Contact` if the model rejects a contact.
    pub fn terms_and_columns(
        &self,
        trial: &MeasuredTrial,
        factor: f64,
        work: &mut FrameWork,
    ) -> Result<(FrameTerms, WhiteColumns), SkinFitError> {
        let terms = self.terms(trial, factor, work)?;
        let columns = WhiteColumns {
            channels: trial.frame_v.len(),
            unknowns: CONTACT_PARAMETERS * trial.contacts.len() + 1,
            values: work.columns.iter().map(|&v| v as f32).collect(),
            per_volt: (factor / self.errors.variance(&trial.frame_v)).sqrt(),
        };
        Ok((terms, columns))
    }

    /// The modes of the foam's law: they change compressions, as the compliance does.
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
            let shares = Parameters::law_shares(&self.law_slopes, compression_mm);
            for (mode, share) in modes[first..].iter_mut().zip(shares) {
                if share > 0.0 {
                    mode.entries.push((node as u32, share));
                }
            }
        }
    }

    /// The modes of the foam's fields that affect this load, restricted to the nodes it presses.
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

/// Conductance below which a node is skipped, S.
fn least_s(to_top_s: &[f64]) -> f64 {
    LEAST_SHARE * to_top_s.iter().sum::<f64>()
}

/// The equations of a trial's unknowns, which come first: their products and their prior, which is
/// the identity.
fn own(gram: &[f64], count: usize, unknowns: usize) -> Llt<f64> {
    let product = |i: usize, j: usize| gram[i.min(j) * count + i.max(j)];
    let prior = |i: usize, j: usize| if i == j { 1.0 } else { 0.0 };
    let whole = Mat::from_fn(unknowns, unknowns, |i, j| product(i, j) + prior(i, j));
    whole.llt(Side::Lower).expect("a Gram matrix and the identity are positive definite")
}

/// Eliminates the first unknowns from the equations; of the rest, the lower triangle is valid.
fn eliminate(gram: &mut [f64], count: usize, unknowns: usize) {
    let factor = own(gram, count, unknowns);
    let rest = count - unknowns;
    let mut across = Mat::from_fn(unknowns, rest, |i, j| gram[i * count + unknowns + j]);
    solve_lower_triangular_in_place(factor.L(), across.as_mut(), Par::Seq);
    let whole = MatMut::from_column_major_slice_mut(gram, count, count);
    matmul(
        whole.submatrix_mut(unknowns, unknowns, rest, rest),
        BlockStructure::TriangularLower,
        Accum::Add,
        across.transpose(),
        BlockStructure::Rectangular,
        across.as_ref(),
        BlockStructure::Rectangular,
        -1.0,
        Par::Seq,
    );
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

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Solves equations whose lower triangle, and right side in the last row, are those of `gram`.
    fn solved(gram: &[f64], whole: usize, from: usize, prior: impl Fn(usize) -> f64) -> Vec<f64> {
        let count = whole - 1 - from;
        let product = |i: usize, j: usize| gram[(from + i.min(j)) * whole + from + i.max(j)];
        let own = |i: usize, j: usize| if i == j { prior(i) } else { 0.0 };
        let left = Mat::from_fn(count, count, |i, j| product(i, j) + own(i, j));
        let right = Mat::from_fn(count, 1, |i, _| product(i, count));
        let found = left.llt(Side::Lower).unwrap().solve(&right);
        (0..count).map(|i| found[(i, 0)]).collect()
    }

    #[test]
    fn without_a_trials_own_unknowns_the_rest_are_what_both_together_say() {
        let (channels, unknowns, rest) = (40, 4, 6);
        let whole = unknowns + rest + 1;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut columns: Vec<f64> =
            (0..channels * whole).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut gram = Vec::new();
        weighted_gram(&mut columns, whole, 0.3, &mut gram);
        let together = solved(&gram, whole, 0, |i| if i < unknowns { 1.0 } else { 0.5 });
        eliminate(&mut gram, whole, unknowns);
        let alone = solved(&gram, whole, unknowns, |_| 0.5);
        for (alone, together) in alone.iter().zip(&together[unknowns..]) {
            assert!((alone - together).abs() < 1e-12, "{alone} for {together}");
        }
    }
}
