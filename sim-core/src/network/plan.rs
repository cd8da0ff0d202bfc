//! The plan of the reduction: the order of the nodes, and the location of every number of a front.
//! Uses: `order`. Never: loads (one plan is valid for every load of a network, in every lane type).
//!
//! Multifrontal: each part of the dissection is a small dense front. Its rows are its own nodes
//! (`pivots`, removed here), one row for the sum over all the others, then those others (the
//! `boundary`, the top layer always last). The conductances that the removal of the pivots adds
//! between boundary nodes are the front's remainder, which is added to its parent.

use super::{SheetNetwork, TILE, row_of};
use crate::order::Part;

/// One dense front.
///
/// Its columns of pivots, padded to a multiple of four, are stored in tiles of four rows: entry
/// (row, k) is number `(row / 4 * columns + k) * 4 + row % 4`. Its remainder is stored by columns,
/// strictly below the diagonal, without padding.
#[derive(Debug)]
pub(super) struct Front {
    /// Number of nodes removed here.
    pub pivots: usize,
    /// Position of the first of them in the order.
    pub first: usize,
    /// Number of boundary nodes, the top included.
    pub boundary: usize,
    /// Resistors that end at a pivot: entry among the pivots' columns, conductance (S).
    pub resistors: Vec<(u32, f64)>,
    /// The parts whose remainders meet here, the last one first.
    pub children: Vec<Child>,
    /// Number of levels below the root, modulo 2: selects one of the two stacks for the remainder.
    pub parity: usize,
}

/// Target of a child's remainder, number by number: the columns of its nodes that are pivots here
/// come first.
#[derive(Debug)]
pub(super) struct Child {
    /// Target entries in the pivots' columns.
    pub pivots: Vec<u32>,
    /// Target numbers in the front's remainder.
    pub remainder: Vec<u32>,
}

impl Child {
    /// Length of the child's remainder.
    pub fn len(&self) -> usize {
        self.pivots.len() + self.remainder.len()
    }
}

impl Front {
    /// The first boundary row: pivots and the row of sums come before it, padded to a whole tile.
    pub fn boundary_row(&self) -> usize {
        (self.pivots + 1).next_multiple_of(TILE)
    }

    /// Number of columns of pivots, padded to whole tiles.
    pub fn columns(&self) -> usize {
        self.pivots.next_multiple_of(TILE)
    }

    /// Number of tiles of four rows.
    pub fn tiles(&self) -> usize {
        (self.boundary_row() + self.boundary).div_ceil(TILE)
    }

    /// Length of the remainder.
    pub fn remainder(&self) -> usize {
        packed(self.boundary)
    }

    fn entry(&self, row: usize, column: usize) -> usize {
        (row / TILE * self.columns() + column) * TILE + row % TILE
    }

    /// The row of a node in the front, given its position in the order; `boundary` is ascending.
    fn row(&self, place: u32, boundary: &[u32]) -> usize {
        match (place as usize).checked_sub(self.first) {
            Some(pivot) if pivot < self.pivots => pivot,
            _ => self.boundary_row() + row_of(boundary, place) as usize,
        }
    }
}

/// Number of entries strictly below the diagonal of a square block.
pub(super) fn packed(side: usize) -> usize {
    side * side.saturating_sub(1) / 2
}

/// Index of an entry below the diagonal of a block that is stored by columns.
pub(super) fn packed_entry(side: usize, row: usize, column: usize) -> usize {
    packed(side) - packed(side - column) + row - column - 1
}

/// Fronts of a network in the order of their elimination, and where each number of a load goes.
#[derive(Debug)]
pub struct ReductionPlan {
    pub(super) fronts: Vec<Front>,
    /// Largest length of each of the two stacks of remainders.
    pub(super) stacks: [usize; 2],
    /// Resistors between electrodes: index in the root's remainder, conductance (S).
    pub(super) between_kept: Vec<(u32, f64)>,
    order: Vec<u32>,
    kept: usize,
}

impl ReductionPlan {
    /// Plans the removal of all nodes of a network except its electrodes.
    pub fn new(network: &SheetNetwork) -> Self {
        let (nodes, kept) = (network.places_mm.len(), &network.electrodes);
        let neighbours = network.neighbours();
        let parts = network.parts(&neighbours);
        let order: Vec<u32> = parts.iter().flat_map(|p| &p.nodes).chain(kept).copied().collect();
        let mut place = vec![0u32; nodes];
        for (at, &node) in order.iter().enumerate() {
            place[node as usize] = at as u32;
        }
        let boundaries = boundaries(&parts, &place, &neighbours, kept.len());
        let mut fronts = lay_out(&parts, &boundaries);
        let mut between_kept = Vec::new();
        let owner: Vec<usize> = (0..parts.len())
            .flat_map(|part| std::iter::repeat_n(part, parts[part].nodes.len()))
            .collect();
        for r in &network.resistors {
            let (a, b) = (place[r.a as usize], place[r.b as usize]);
            let (low, high) = (a.min(b), a.max(b));
            if let Some(&part) = owner.get(low as usize) {
                let front = &mut fronts[part];
                let row = front.row(high, &boundaries[part]);
                let entry = front.entry(row, low as usize - front.first);
                front.resistors.push((entry as u32, r.conductance_s));
            } else {
                let first = owner.len() as u32;
                let entry =
                    packed_entry(kept.len() + 1, (high - first) as usize, (low - first) as usize);
                between_kept.push((entry as u32, r.conductance_s));
            }
        }
        let stacks = stack_sizes(&fronts);
        Self { fronts, stacks, order, between_kept, kept: kept.len() }
    }

    /// The network's nodes in the order of their removal, the electrodes last.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Number of electrodes.
    pub fn kept(&self) -> usize {
        self.kept
    }
}

/// Per part, the later nodes that are its neighbours once its nodes are removed: positions in the
/// order, ascending, without the top. Those of the last part are all kept nodes.
fn boundaries(
    parts: &[Part],
    place: &[u32],
    neighbours: &[Vec<u32>],
    kept: usize,
) -> Vec<Vec<u32>> {
    let mut boundaries: Vec<Vec<u32>> = Vec::with_capacity(parts.len());
    let mut end = 0;
    for part in parts {
        end += part.nodes.len() as u32;
        let of_nodes = part.nodes.iter().flat_map(|&n| &neighbours[n as usize]);
        let of_children = part.children.iter().flat_map(|&child| boundaries[child].iter().copied());
        let mut boundary: Vec<u32> = of_nodes
            .map(|&node| place[node as usize])
            .chain(of_children)
            .filter(|&place| place >= end)
            .collect();
        boundary.sort_unstable();
        boundary.dedup();
        boundaries.push(boundary);
    }
    if let Some(root) = boundaries.last_mut() {
        *root = (place.len() - kept..place.len()).map(|at| at as u32).collect();
    }
    boundaries
}

/// Lays out the fronts, without resistors.
fn lay_out(parts: &[Part], boundaries: &[Vec<u32>]) -> Vec<Front> {
    let mut fronts: Vec<Front> = Vec::with_capacity(parts.len());
    let mut first = 0;
    for (part, boundary) in parts.iter().zip(boundaries) {
        let mut front = Front {
            pivots: part.nodes.len(),
            first,
            boundary: boundary.len() + 1,
            resistors: Vec::new(),
            children: Vec::new(),
            parity: 0,
        };
        let children = part.children.iter().rev();
        front.children = children.map(|&c| child(&front, boundary, &boundaries[c])).collect();
        first += front.pivots;
        fronts.push(front);
    }
    for (index, part) in parts.iter().enumerate().rev() {
        for &child in &part.children {
            fronts[child].parity = 1 - fronts[index].parity;
        }
    }
    fronts
}

fn child(front: &Front, boundary: &[u32], of_child: &[u32]) -> Child {
    let top = front.boundary_row() + boundary.len();
    let rows: Vec<usize> =
        of_child.iter().map(|&place| front.row(place, boundary)).chain([top]).collect();
    let mut child = Child { pivots: Vec::new(), remainder: Vec::new() };
    for (at, &column) in rows.iter().enumerate() {
        for &row in &rows[at + 1..] {
            if column < front.pivots {
                child.pivots.push(front.entry(row, column) as u32);
            } else {
                let [row, column] = [row, column].map(|row| row - front.boundary_row());
                child.remainder.push(packed_entry(front.boundary, row, column) as u32);
            }
        }
    }
    child
}

/// The largest heights of the two stacks.
fn stack_sizes(fronts: &[Front]) -> [usize; 2] {
    let (mut heights, mut greatest) = ([0; 2], [0; 2]);
    for front in fronts {
        heights[front.parity] += front.remainder();
        greatest[front.parity] = greatest[front.parity].max(heights[front.parity]);
        let of_children: usize = front.children.iter().map(Child::len).sum();
        heights[1 - front.parity] -= of_children;
    }
    greatest
}
