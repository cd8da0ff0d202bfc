//! Derivative of a frame by the network's conductances and leads: the adjoint method.
//! Uses: `kron`, `readout`, `circuit`. Never: the dependence of conductances on parameters.
//!
//! With `U = A^-1 E` (potential below the top at every node, per ampere drawn at each electrode), a
//! conductance `dg` from node i to the top changes `Z` by `-dg u_i u_i'`, and one between a and b
//! by `-dg (u_a - u_b)(u_a - u_b)'`. One elimination and one back-substitution give U.
//!
//! Rounding: on a light load all of U contains one huge common number (1e8 ohm and more) that does
//! not affect the frame, in addition to differences of 1e4 ohm that do. So `U = common + D`, and D
//! is computed: electrodes at `Z - common`, the top at `-common`. The frame's change is then a sum
//! of terms of the same magnitude.

use super::TILE;
use super::kron::{KronFactor, KronReduction, four};
use super::lane::{Lane32, LaneJob, Portable};
#[cfg(target_arch = "x86_64")]
use super::lane_x86;
use super::readout::ReadoutWork;
use crate::circuit::ReadoutCircuit;

/// Number of rows that are summed together: they fit into the first-level cache.
const BLOCK_ROWS: usize = 128;

/// Potentials at every node per ampere drawn at each electrode.
#[derive(Debug, Default)]
pub struct Potentials {
    electrodes: usize,
    width: usize,
    common_ohm: f64,
    relative_ohm: Vec<f64>,
    kept: Vec<f64>,
}

impl Potentials {
    /// Solves for the potentials, after `reduction.factor` and `readout.evaluate`.
    pub fn solve(
        &mut self,
        reduction: &KronReduction,
        factor: &mut KronFactor,
        readout: &ReadoutWork,
        electrodes: usize,
    ) {
        let z = readout.impedance_ohm();
        self.electrodes = electrodes;
        self.width = electrodes.next_multiple_of(TILE);
        self.common_ohm = z.iter().sum::<f64>() / z.len() as f64;
        self.kept.clear();
        self.kept.resize(electrodes * self.width, 0.0);
        for (row, z) in self.kept.chunks_exact_mut(self.width).zip(z.chunks_exact(electrodes)) {
            for (relative, z) in row.iter_mut().zip(z) {
                *relative = z - self.common_ohm;
            }
        }
        let top = -self.common_ohm;
        reduction.solve_columns(factor, &self.kept, top, self.width, &mut self.relative_ohm);
    }

    /// A node's potentials minus the common one, ohm.
    pub fn row(&self, node: usize) -> &[f64] {
        &self.relative_ohm[node * self.width..][..self.width]
    }
}

/// A direction in which conductances and leads change.
#[derive(Debug, Default)]
pub struct Direction {
    /// Rows of potentials (or of differences of them), one for each conductance that changes.
    rows: Vec<f64>,
    /// Change of each conductance, S.
    conductances_s: Vec<f64>,
    /// Sum of the changes of conductances to the top, S; in `to_top_v`, each times its row.
    to_top_s: f64,
    to_top_v: Vec<f64>,
    lead_ohm: Vec<f64>,
    /// Sum of conductance times products of its row, row-major, above the diagonal and on it.
    products: Vec<f64>,
}

impl Direction {
    /// Resets to no change.
    pub fn clear(&mut self, potentials: &Potentials) {
        self.rows.clear();
        self.conductances_s.clear();
        self.to_top_s = 0.0;
        self.to_top_v.clear();
        self.to_top_v.resize(potentials.width, 0.0);
        self.lead_ohm.clear();
        self.lead_ohm.resize(potentials.electrodes, 0.0);
    }

    /// Adds a change of the conductance from a node to the top, S.
    pub fn to_top(&mut self, potentials: &Potentials, node: usize, change_s: f64) {
        let row = potentials.row(node);
        self.rows.extend_from_slice(row);
        self.conductances_s.push(change_s);
        self.to_top_s += change_s;
        for (sum, value) in self.to_top_v.iter_mut().zip(row) {
            *sum += change_s * value;
        }
    }

    /// Adds a change of the conductance between two nodes, S.
    pub fn between(&mut self, potentials: &Potentials, a: usize, b: usize, change_s: f64) {
        let ends = potentials.row(a).iter().zip(potentials.row(b));
        self.rows.extend(ends.map(|(a, b)| a - b));
        self.conductances_s.push(change_s);
    }

    /// Adds a change of an electrode's lead, ohm.
    pub fn lead(&mut self, electrode: usize, change_ohm: f64) {
        self.lead_ohm[electrode] += change_ohm;
    }

    /// Replaces the changes of the conductances to the top (S), in the order in which they were
    /// added.
    pub fn replace_to_top(&mut self, changes_s: impl Iterator<Item = f64>) {
        self.conductances_s.clear();
        self.conductances_s.extend(changes_s);
        self.to_top_s = self.conductances_s.iter().sum();
        self.to_top_v.fill(0.0);
        let rows = self.rows.chunks_exact(self.to_top_v.len());
        for (row, change_s) in rows.zip(&self.conductances_s) {
            for (sum, value) in self.to_top_v.iter_mut().zip(row) {
                *sum += change_s * value;
            }
        }
    }

    /// The frame's change along this direction, V after gain, into `out` (electrodes squared).
    pub fn frame(
        &mut self,
        potentials: &Potentials,
        readout: &ReadoutWork,
        circuit: &ReadoutCircuit,
        out: &mut [f64],
    ) {
        let (n, width, common) = (potentials.electrodes, potentials.width, potentials.common_ohm);
        weighted_products(&self.rows, &self.conductances_s, width, &mut self.products);
        let product = |j: usize, k: usize| self.products[width * j.min(k) + j.max(k)];
        let z = readout.impedance_ohm();
        for k in 0..n {
            let own = z[n * k + k] + circuit.electrodes[k].lead_ohm;
            // -dZ_kk, and the terms that change the sink's share.
            let fall = common * (common * self.to_top_s + 2.0 * self.to_top_v[k]) + product(k, k);
            let lead = self.lead_ohm[k];
            let volts = &mut out[n * k..][..n];
            for (j, volts) in volts.iter_mut().enumerate() {
                let seen = (own - z[n * j + k]) / own;
                // -d(Z_kk - Z_jk), without the common part.
                let apart = common * (self.to_top_v[k] - self.to_top_v[j])
                    + (product(k, k) - product(j, k));
                *volts = circuit.source_v / own * (seen * (fall - lead) + lead - apart);
            }
            volts[k] = 0.0;
            let first = volts[0];
            for j in 0..n {
                let next = if j + 1 < n { volts[j + 1] } else { first };
                volts[j] = circuit.gain * (volts[j] - next);
            }
        }
    }
}

/// `out[width * j + k] = sum_i weights_i rows_ij rows_ik` for whole tiles with j <= k. Bitwise
/// equal on every processor: vectors change neither a term nor the order of a sum.
fn weighted_products(rows: &[f64], weights: &[f64], width: usize, out: &mut Vec<f64>) {
    out.clear();
    out.resize(width * width, 0.0);
    let job = Products { rows, weights, width, out };
    #[cfg(target_arch = "x86_64")]
    if lane_x86::has_avx2() {
        return lane_x86::on_avx2(job);
    }
    job.run::<Portable>();
}

struct Products<'a> {
    rows: &'a [f64],
    weights: &'a [f64],
    width: usize,
    out: &'a mut [f64],
}

impl LaneJob for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lane32>(self) {
        let Self { rows, weights, width, out } = self;
        for (rows, weights) in rows.chunks(BLOCK_ROWS * width).zip(weights.chunks(BLOCK_ROWS)) {
            for j in (0..width).step_by(TILE) {
                for k in (j..width).step_by(TILE) {
                    let mut sums = [[0.0; TILE]; TILE];
                    for (row, &weight) in rows.chunks_exact(width).zip(weights) {
                        let (left, right) = (four(row, j), four(row, k));
                        for (sums, left) in sums.iter_mut().zip(left) {
                            let factor = weight * left;
                            for (sum, right) in sums.iter_mut().zip(right) {
                                *sum += factor * right;
                            }
                        }
                    }
                    for (r, sums) in sums.iter().enumerate() {
                        for (c, sum) in sums.iter().enumerate() {
                            out[width * (j + r) + k + c] += sum;
                        }
                    }
                }
            }
        }
    }
}
