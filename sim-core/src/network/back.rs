//! Back-substitution: potentials everywhere from those of the electrodes and the top layer.
//! Uses: a stored factor of `kron`. Never: a subtraction.
//!
//! The potential of a removed node is the mean of those that remained at its removal, weighted by
//! `a_kj / d`; the fronts are processed in reverse order.

use super::TILE;
use super::kron::{KronFactor, KronReduction, four};

impl KronReduction {
    /// Computes the potentials at all nodes (row-major, indexed by the network's nodes, `width`
    /// columns) from those of the electrodes (`kept`, row-major in their order) and of the top
    /// layer (`top`, the same in every column), without current fed in elsewhere. Each is a
    /// weighted mean of the given ones, without a subtraction. `width` is a multiple of four.
    pub fn solve_columns(
        &self,
        factor: &mut KronFactor,
        kept: &[f64],
        top: f64,
        width: usize,
        potentials: &mut Vec<f64>,
    ) {
        let KronFactor { columns, front: local, ordered } = factor;
        ordered.clear();
        ordered.resize((self.order.len() - self.kept) * width, 0.0);
        ordered.extend_from_slice(kept);
        let mut end = columns.len();
        for front in self.fronts.iter().rev() {
            let lead = front.lead();
            let begin = end - front.pivots * lead;
            let block = &columns[begin..end];
            end = begin;
            // The last row comes first here, so that a pivot's sum runs over all known rows.
            local.clear();
            local.resize(width, top);
            for &place in front.remains.iter().rev() {
                local.extend_from_slice(&ordered[place as usize * width..][..width]);
            }
            let own = &mut ordered[front.first * width..][..front.pivots * width];
            let mut k = front.pivots;
            while k > 0 {
                if k >= TILE {
                    k -= TILE;
                    solve_pivots::<TILE>(block, lead, [front.rows, k], local, own, width);
                } else {
                    k -= 1;
                    solve_pivots::<1>(block, lead, [front.rows, k], local, own, width);
                }
            }
        }
        potentials.resize(ordered.len(), 0.0);
        for (&node, row) in self.order.iter().zip(ordered.chunks_exact(width)) {
            potentials[node as usize * width..][..width].copy_from_slice(row);
        }
    }
}

/// Potentials of the pivots `first..first + P` of a front, from those of all later rows in `local`
/// (the last one first), to which they are appended; also into `own`, by pivots.
fn solve_pivots<const P: usize>(
    block: &[f64],
    lead: usize,
    [rows, first]: [usize; 2],
    local: &mut Vec<f64>,
    own: &mut [f64],
    width: usize,
) {
    let columns: [&[f64]; P] = std::array::from_fn(|p| &block[(first + p) * lead..][..=rows]);
    for at in (0..width).step_by(TILE) {
        let mut sums = later_sums(&columns, local, [rows, first + P], [width, at]);
        for p in (0..P).rev() {
            for q in (p + 1..P).rev() {
                let (weight, later) = (columns[p][first + q], sums[q]);
                sums[p] = std::array::from_fn(|c| sums[p][c] + weight * later[c]);
            }
            sums[p] = sums[p].map(|value| value * columns[p][first + p]);
            own[(first + p) * width + at..][..TILE].copy_from_slice(&sums[p]);
        }
    }
    for pivot in own[first * width..][..P * width].chunks_exact(width).rev() {
        local.extend_from_slice(pivot);
    }
}

/// Part of [`solve_pivots`]; a separate function, so that the sums stay in registers.
#[inline(never)]
fn later_sums<const P: usize>(
    columns: &[&[f64]; P],
    local: &[f64],
    [rows, next]: [usize; 2],
    [width, at]: [usize; 2],
) -> [[f64; TILE]; P] {
    let mut sums = [[0.0; TILE]; P];
    for (later, row) in local.chunks_exact(width).zip((next..=rows).rev()) {
        let later = four(later, at);
        for (sums, column) in sums.iter_mut().zip(columns) {
            let weight = column[row];
            for (sum, value) in sums.iter_mut().zip(later) {
                *sum += weight * value;
            }
        }
    }
    sums
}
