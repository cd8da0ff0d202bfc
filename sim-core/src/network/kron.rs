//! Exact removal of all nodes except the electrodes and the top layer, without a subtraction.
//! Uses: `order`. Never: a diagonal entry (it would lose the digits).
//!
//! Star-mesh transform (Grassmann-Taksar-Heyman): the top layer is one further node, and a node k
//! is removed by `d = sum_j a_jk`, `a_ij += a_ik a_jk / d`, where the sum runs over all remaining
//! nodes. It is Cholesky with positive signs, and the pivot a sum: every entry keeps nearly full
//! relative precision, though the condition number reaches 1e13 on an untouched skin
//! (`docs/references.md`, "Resistor network").
//! Multifrontal: each part of the dissection is a small dense front (column-major, below the
//! diagonal only, last row = top); its remainder is added to its parent's front.
//! A stored factor also determines the potentials everywhere: `back`.

use std::sync::Arc;

use super::{Resistor, SheetNetwork, TILE, row_of};
use crate::order::Part;

/// Number of pivots that update the rest of a front together.
const PANEL: usize = 8;

/// One dense front.
#[derive(Debug, Clone)]
pub(super) struct Front {
    /// Number of nodes removed here.
    pub(super) pivots: usize,
    /// Position of the first of them in the order.
    pub(super) first: usize,
    /// Number of rows: pivots, then the nodes that remain; the top is one further row.
    pub(super) rows: usize,
    /// Resistors that start at a pivot: index in the front's block, conductance (S).
    resistors: Vec<(u32, f64)>,
    /// Per child, in the order of the stack from its top: row here of each of its rows, top last.
    children: Vec<Vec<u32>>,
    /// Positions in the order of the rows after the pivots.
    pub(super) remains: Vec<u32>,
}

impl Front {
    /// Height of a column: rows and top, padded to whole tiles.
    pub(super) fn lead(&self) -> usize {
        (self.rows + 1).next_multiple_of(TILE)
    }
}

/// The plan of the removal; valid for every load of the same network.
#[derive(Debug, Clone)]
pub struct KronReduction {
    /// Parts of all nodes except the kept ones, and the root that contains those.
    parts: Arc<[Part]>,
    pub(super) fronts: Vec<Front>,
    /// Node at each position of the order, the kept ones last.
    pub(super) order: Vec<u32>,
    pub(super) kept: usize,
}

/// Factor stored by [`KronReduction::factor`]: the pivots' columns of all fronts, one after the
/// other, each with `1 / sqrt(d)` on its diagonal.
#[derive(Debug, Default)]
pub struct KronFactor {
    pub(super) columns: Vec<f64>,
    /// Memory of `back`: potentials in one front, row-major.
    pub(super) front: Vec<f64>,
    /// Memory of `back`: potentials in the order of removal, row-major.
    pub(super) ordered: Vec<f64>,
}

/// Memory of a reduction; may be reused.
#[derive(Debug, Default)]
pub struct KronWork {
    front: Vec<f64>,
    stack: Vec<f64>,
    reduced: Vec<f64>,
}

impl KronReduction {
    /// Plans the removal of all nodes of a network except its electrodes.
    pub fn new(network: &SheetNetwork) -> Self {
        let neighbours = network.neighbours();
        Self::in_order(network.parts(&neighbours).into(), network, &neighbours)
    }

    /// Returns the plan of a network with other values, or other nodes at which the electrodes
    /// connect; the remaining nodes and their connections are the same. The order of the nodes,
    /// whose search takes most of the time, is reused.
    pub fn of_another(&self, network: &SheetNetwork) -> Self {
        let same = self.order.len() == network.places_mm.len()
            && self.order.ends_with(&network.electrodes);
        if !same {
            return Self::new(network);
        }
        Self::in_order(Arc::clone(&self.parts), network, &network.neighbours())
    }

    fn in_order(parts: Arc<[Part]>, network: &SheetNetwork, neighbours: &[Vec<u32>]) -> Self {
        let nodes = network.places_mm.len();
        let kept = &network.electrodes;
        let order: Vec<u32> = parts
            .iter()
            .flat_map(|p| p.nodes.iter().copied())
            .chain(kept.iter().copied())
            .collect();
        let mut place = vec![0u32; nodes];
        for (at, &node) in order.iter().enumerate() {
            place[node as usize] = at as u32;
        }
        let fronts = fronts(&parts, &place, neighbours, &network.resistors, kept.len());
        Self { parts, fronts, order, kept: kept.len() }
    }

    /// Number of multiply-adds of one reduction, counted on the plan.
    pub fn multiply_adds(&self) -> usize {
        let of = |f: &Front| -> usize {
            (0..f.pivots).map(|k| (f.rows - k) * (f.rows - k + 1) / 2).sum()
        };
        self.fronts.iter().map(of).sum()
    }

    /// Removes the nodes. `to_top_s`: conductance of each node to the top layer, S, >= 0, indexed
    /// by the network's nodes. The result is a (kept + 1) x kept block, column-major: below the
    /// diagonal the conductances between electrodes, in the last row those to the top.
    pub fn reduce<'w>(&self, to_top_s: &[f64], work: &'w mut KronWork) -> &'w [f64] {
        self.eliminate(to_top_s, work, |_| ())
    }

    /// As [`Self::reduce`], and stores the factor: the block is bitwise equal.
    pub fn factor<'w>(
        &self,
        to_top_s: &[f64],
        work: &'w mut KronWork,
        factor: &mut KronFactor,
    ) -> &'w [f64] {
        factor.columns.clear();
        self.eliminate(to_top_s, work, |pivots| factor.columns.extend_from_slice(pivots))
    }

    /// `keep` is called with each front's pivot columns after their removal.
    fn eliminate<'w>(
        &self,
        to_top_s: &[f64],
        work: &'w mut KronWork,
        mut keep: impl FnMut(&[f64]),
    ) -> &'w [f64] {
        let KronWork { front: buffer, stack, reduced } = work;
        stack.clear();
        for front in &self.fronts {
            let lead = front.lead();
            if buffer.len() < lead * lead {
                buffer.resize(lead * lead, 0.0);
            }
            let block = &mut buffer[..lead * lead];
            block.fill(0.0);
            for &(at, conductance) in &front.resistors {
                block[at as usize] += conductance;
            }
            for k in 0..front.pivots {
                block[k * lead + front.rows] += to_top_s[self.order[front.first + k] as usize];
            }
            for rows in &front.children {
                let size = rows.len() * (rows.len() - 1) / 2;
                let update = &stack[stack.len() - size..];
                extend_add(block, lead, rows, update);
                stack.truncate(stack.len() - size);
            }
            remove_pivots(block, lead, front.rows, front.pivots);
            keep(&block[..front.pivots * lead]);
            for j in front.pivots..front.rows {
                stack.extend_from_slice(&block[j * lead + j + 1..=j * lead + front.rows]);
            }
        }
        let lead = self.kept + 1;
        reduced.clear();
        reduced.resize(lead * self.kept, 0.0);
        let mut packed = stack.as_slice();
        for j in 0..self.kept {
            let (column, rest) = packed.split_at(self.kept - j);
            reduced[j * lead + j + 1..(j + 1) * lead].copy_from_slice(column);
            reduced[j * lead + self.kept] +=
                to_top_s[self.order[self.order.len() - self.kept + j] as usize];
            packed = rest;
        }
        reduced
    }
}

/// Adds a child's remainder (columns packed below the diagonal, top last) to a front.
fn extend_add(block: &mut [f64], lead: usize, rows: &[u32], update: &[f64]) {
    let mut packed = update;
    for (j, &column) in rows[..rows.len() - 1].iter().enumerate() {
        let (values, rest) = packed.split_at(rows.len() - 1 - j);
        let target = &mut block[column as usize * lead..][..lead];
        for (&row, &value) in rows[j + 1..].iter().zip(values) {
            target[row as usize] += value;
        }
        packed = rest;
    }
}

/// Removes the first `pivots` nodes of a front of `rows` nodes and the top, and stores their
/// `1 / sqrt(d)` on the diagonal. Other entries on and above it, and in the padding columns, are
/// scratch and never read.
fn remove_pivots(block: &mut [f64], lead: usize, rows: usize, pivots: usize) {
    let mut start = 0;
    while start < pivots {
        let width = PANEL.min(pivots - start);
        let (panel, rest) = block[start * lead..].split_at_mut(width * lead);
        factor_panel(panel, lead, start);
        let first = start + width;
        // Up to three single columns, then tiles at multiples of four.
        let aligned = first.next_multiple_of(TILE).min(rows);
        let (single, tiled) = rest.split_at_mut((aligned - first) * lead);
        for (j, target) in (first..aligned).zip(single.chunks_exact_mut(lead)) {
            for source in panel.chunks_exact(lead) {
                add_scaled(&mut target[j + 1..], source[j], &source[j + 1..]);
            }
        }
        for (tile, columns) in tiled.chunks_exact_mut(TILE * lead).enumerate() {
            update_tiles(panel, columns, lead, aligned + TILE * tile);
        }
        start = first;
    }
}

/// Updates four columns from `from` on, in tiles of four by four.
fn update_tiles(panel: &[f64], columns: &mut [f64], lead: usize, from: usize) {
    for row in (from..lead).step_by(TILE) {
        let mut sums = [[0.0; TILE]; TILE];
        for source in panel.chunks_exact(lead) {
            let (left, down) = (four(source, from), four(source, row));
            for (sums, factor) in sums.iter_mut().zip(left) {
                for (sum, value) in sums.iter_mut().zip(down) {
                    *sum += factor * value;
                }
            }
        }
        for (target, sums) in columns.chunks_exact_mut(lead).zip(&sums) {
            for (value, sum) in target[row..row + TILE].iter_mut().zip(sums) {
                *value += sum;
            }
        }
    }
}

/// The numbers of a tile in a row or column, from `at`.
#[inline(always)]
pub(super) fn four(values: &[f64], at: usize) -> &[f64; TILE] {
    values[at..].first_chunk().expect("rows and columns are padded to whole tiles")
}

/// Scales a panel's columns by `1 / sqrt(d)`, each updated by those before it.
fn factor_panel(panel: &mut [f64], lead: usize, start: usize) {
    let width = panel.len() / lead;
    for k in 0..width {
        let (before, column) = panel.split_at_mut(k * lead);
        let row = start + k;
        let (diagonal, column) = column[row..lead].split_at_mut(1);
        for source in before.chunks_exact(lead) {
            add_scaled(column, source[row], &source[row + 1..]);
        }
        let d = sum(column);
        let scale = if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 };
        column.iter_mut().for_each(|value| *value *= scale);
        diagonal[0] = scale;
    }
}

/// Sum as eight independent sums, which a processor adds in parallel.
fn sum(values: &[f64]) -> f64 {
    let (strands, tail) = values.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for strand in strands {
        for (sum, value) in sums.iter_mut().zip(strand) {
            *sum += value;
        }
    }
    sums.iter().sum::<f64>() + tail.iter().sum::<f64>()
}

#[inline]
fn add_scaled(target: &mut [f64], factor: f64, source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += factor * s;
    }
}

/// Lays out the fronts: rows, resistors, and the target of each child's remainder.
fn fronts(
    parts: &[Part],
    place: &[u32],
    neighbours: &[Vec<u32>],
    resistors: &[Resistor],
    kept: usize,
) -> Vec<Front> {
    let removed = (place.len() - kept) as u32;
    let mut fronts: Vec<Front> = Vec::with_capacity(parts.len());
    let mut front_of = Vec::with_capacity(place.len());
    let mut first = 0;
    for (index, part) in parts.iter().enumerate() {
        let pivots = part.nodes.len();
        let end = (first + pivots) as u32;
        let is_root = index + 1 == parts.len();
        let mut boundary: Vec<u32> = part
            .nodes
            .iter()
            .flat_map(|&n| neighbours[n as usize].iter().map(|&m| place[m as usize]))
            .chain(part.children.iter().flat_map(|&c| fronts[c].remains.iter().copied()))
            .chain(if is_root { removed..place.len() as u32 } else { 0..0 })
            .filter(|&at| at >= end)
            .collect();
        boundary.sort_unstable();
        boundary.dedup();
        let rows: Vec<u32> = (first as u32..end).chain(boundary.iter().copied()).collect();
        let children = part
            .children
            .iter()
            .rev()
            .map(|&child| {
                let mapped = fronts[child].remains.iter().map(|at| row_of(&rows, *at));
                mapped.chain([rows.len() as u32]).collect()
            })
            .collect();
        front_of.extend(std::iter::repeat_n(index, pivots));
        let rows = rows.len();
        let resistors = Vec::new();
        fronts.push(Front { pivots, first, rows, resistors, children, remains: boundary });
        first += pivots;
    }
    front_of.extend(std::iter::repeat_n(parts.len() - 1, kept));
    for r in resistors {
        let (a, b) = (place[r.a as usize], place[r.b as usize]);
        let (low, high) = (a.min(b), a.max(b));
        let index = front_of[low as usize];
        let front = &mut fronts[index];
        let (base, end) = (front.first as u32, (front.first + front.pivots) as u32);
        let row = |at: u32| {
            if at < end && at >= base {
                at - base
            } else {
                front.pivots as u32 + row_of(&front.remains, at)
            }
        };
        let at = row(low) * front.lead() as u32 + row(high);
        front.resistors.push((at, r.conductance_s));
    }
    fronts
}
