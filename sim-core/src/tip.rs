//! Distribution of a tip's force among the nodes, for a tip anywhere on the skin.
//! Uses: `sensor`, `mesh`. Never: the size of the force.
//!
//! A tip is six equal forces at the corners of its hexagon (paper III-A), in the lattice's
//! orientation. A force between nodes is shared by the linear shape functions of its lattice
//! triangle: force and moment are preserved, the shares are continuous in the tip's position, and
//! on a node one share is exactly 1. Their slopes jump at the triangles' edges; on an edge the
//! slope is that of one of the two triangles.
//!
//! Linear shares blur the dent, and the foam's law is steep: in a triangle's middle a 40 N tip
//! would draw a quarter less current than on a node (`tests/physics/tip.rs`). The blur is the
//! shares' second moment, `h2 q` with `q = w1 w2 + w2 w3 + w3 w1` and h the lattice's side.
//! [`Spreading::Sharp`] removes it: every node's share `w` becomes `w (1 + q)` on itself and
//! `-w q / 6` on each of its six neighbours, the lattice's Laplacian. Force and moment are
//! preserved, on a node nothing changes, and the result stays linear in the force.
//!
//! The mesh ends up to 5.9 mm before the skin's left and right edge. A corner of the hexagon beyond
//! the outermost column of nodes loads that column at the same height; the notches of the lattice
//! at the upper and lower edge are closed by a triangle of the three nodes around them. Nodes
//! without six neighbours are not sharpened.

use crate::mesh::Mesh;
use crate::sensor::Sensor;

/// Lattice steps (in half pitches and half sides) from a tip's centre to its hexagon's corners,
/// counter-clockwise from +y.
const HEXAGON: [[i32; 2]; 6] = [[0, 2], [-1, 1], [-1, -1], [0, -2], [1, -1], [1, 1]];

/// A tip closer than this to a node counts as on it, in lattice steps.
const ON_NODE: f64 = 1e-7;

/// Distribution of a force between nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spreading {
    /// By linear shape functions: up to twelve nodes carry a tip, no share is negative, the dent is
    /// blurred.
    Linear,
    /// By linear shape functions without their second moment: up to 27 nodes, some shares are
    /// slightly negative.
    Sharp,
}

/// Share of a tip's force on one node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// Node of the mesh.
    pub node: u32,
    /// Share of one sixth of the tip's force: those of a tip add up to 6.
    pub sixths: f64,
    /// Slope of `sixths` in the tip's x and y, 1/mm: those of a tip add up to 0.
    pub slope_per_mm: [f64; 2],
}

/// The mesh's lattice as a grid, so that the triangle of a position is found without a search.
#[derive(Debug, Clone)]
pub struct TipLattice {
    origin_mm: [f64; 2],
    step_mm: [f64; 2],
    /// Lattice coordinates of the outermost nodes.
    low: [i32; 2],
    high: [i32; 2],
    /// Node at `rows * (m - low m) + (q - low q)`; `u32::MAX` if there is none.
    grid: Vec<u32>,
}

/// A lattice position with its weight and the weight's slopes per lattice step.
type Corner = ([i32; 2], f64, [f64; 2]);

impl TipLattice {
    /// Builds the lattice of a sensor and its mesh.
    pub fn new(sensor: &Sensor, mesh: &Mesh) -> Self {
        let origin_mm = [sensor.first_column_x_mm(), sensor.file.points.first_row_y_mm];
        let step_mm = [sensor.pitch_mm() / 2.0, sensor.side_mm() / 2.0];
        let lattice = |place: &[f64; 2]| -> [i32; 2] {
            std::array::from_fn(|i| ((place[i] - origin_mm[i]) / step_mm[i]).round() as i32)
        };
        let places: Vec<[i32; 2]> = mesh.nodes_mm.iter().map(lattice).collect();
        let bound = |axis: usize, pick: fn(i32, i32) -> i32| {
            places.iter().map(|p| p[axis]).reduce(pick).unwrap_or(0)
        };
        let low = [bound(0, i32::min), bound(1, i32::min)];
        let high = [bound(0, i32::max), bound(1, i32::max)];
        let cells = (high[0] - low[0] + 1) * (high[1] - low[1] + 1);
        let grid = vec![u32::MAX; cells as usize];
        let mut lattice = Self { origin_mm, step_mm, low, high, grid };
        for (node, &place) in places.iter().enumerate() {
            if let Some(at) = lattice.index(place) {
                lattice.grid[at] = node as u32;
            }
        }
        lattice
    }

    /// Shares of the force of a tip at a position, mm, appended to `shares`, each node once; on a node its six neighbours
    /// come in the order of the hexagon's corners.
    pub fn spread(&self, spreading: Spreading, at_mm: [f64; 2], shares: &mut Vec<Share>) {
        let first = shares.len();
        let mut centre = self.steps(at_mm);
        let node = centre.map(f64::round);
        let near = |i: usize| (centre[i] - node[i]).abs() < ON_NODE;
        if near(0) && near(1) && (node[0] + node[1]) % 2.0 == 0.0 {
            centre = node;
        }
        let corners = HEXAGON
            .map(|[m, q]| self.corners([centre[0] + f64::from(m), centre[1] + f64::from(q)]));
        for corner in corners.iter().flatten() {
            self.add(*corner, first, shares);
        }
        if spreading == Spreading::Sharp {
            for triangle in &corners {
                self.sharpen(triangle, first, shares);
            }
        }
        shares.retain(|s| s.sixths != 0.0 || s.slope_per_mm != [0.0; 2]);
    }

    /// The three nodes around a position, mm, each with its linear weight (sum 1) and the weight's
    /// slope in x and y, 1/mm. `None` if the lattice lacks a corner.
    pub fn around(&self, at_mm: [f64; 2]) -> [Option<Share>; 3] {
        self.corners(self.steps(at_mm)).map(|(place, sixths, slope)| {
            let slope_per_mm = [slope[0] / self.step_mm[0], slope[1] / self.step_mm[1]];
            self.node(place).map(|node| Share { node, sixths, slope_per_mm })
        })
    }

    /// Position in lattice steps.
    fn steps(&self, at_mm: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (at_mm[axis] - self.origin_mm[axis]) / self.step_mm[axis])
    }

    /// Removes the second moment of a triangle's shares.
    fn sharpen(&self, triangle: &[Corner; 3], first: usize, shares: &mut Vec<Share>) {
        let pairs = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (triangle[a], triangle[b]));
        let q: f64 = pairs.iter().map(|(a, b)| a.1 * b.1).sum();
        let dq =
            [0, 1].map(|i| pairs.iter().map(|(a, b)| a.2[i] * b.1 + a.1 * b.2[i]).sum::<f64>());
        for &(node, weight, slope) in triangle {
            let around = HEXAGON.map(|[m, q]| [node[0] + m, node[1] + q]);
            if around.iter().any(|&place| self.node(place).is_none()) {
                continue;
            }
            let back = weight * q;
            let back_slope = [0, 1].map(|i| slope[i] * q + weight * dq[i]);
            self.add((node, back, back_slope), first, shares);
            for place in around {
                self.add((place, -back / 6.0, back_slope.map(|s| -s / 6.0)), first, shares);
            }
        }
    }

    /// The three nodes that share a force at a position (in lattice steps). Beyond the outermost
    /// nodes the position is moved just inside them, and the share no longer depends on that
    /// coordinate.
    fn corners(&self, place: [f64; 2]) -> [Corner; 3] {
        let mut free = [1.0; 2];
        let inside: [f64; 2] = std::array::from_fn(|i| {
            let (low, high) = (f64::from(self.low[i]), f64::from(self.high[i]));
            if place[i] < low || place[i] > high {
                free[i] = 0.0;
            }
            place[i].clamp(low + ON_NODE, high - ON_NODE)
        });
        let mut corners = triangle(inside);
        for (_, _, slope) in &mut corners {
            *slope = [slope[0] * free[0], slope[1] * free[1]];
        }
        match corners.iter().position(|&(place, ..)| self.node(place).is_none()) {
            Some(missing) => self.close_notch(corners, missing),
            None => corners,
        }
    }

    /// Replaces the corner that is one step beyond the upper or lower edge: linear in the triangle
    /// of the node towards the skin and the two next to it. In the skin's corners one of those two
    /// is missing as well, and the node towards the skin carries its weight.
    fn close_notch(&self, mut corners: [Corner; 3], missing: usize) -> [Corner; 3] {
        let ([m, q], weight, slope) = corners[missing];
        let inward = if q < self.low[1] { 1 } else { -1 };
        let inner = [m, q + 2 * inward];
        let far_side = [m - 1, m + 1].map(|m| [m, q + inward]).into_iter().find(|&side| {
            self.node(side).is_some() && corners.iter().all(|corner| corner.0 != side)
        });
        let Some(far_side) = far_side else {
            corners[missing].0 = inner;
            return corners;
        };
        for (place, corner_weight, corner_slope) in &mut corners {
            let sign = if *place == inner { -1.0 } else { 1.0 };
            *corner_weight += sign * weight;
            corner_slope.iter_mut().zip(slope).for_each(|(s, of)| *s += sign * of);
        }
        corners[missing] = (far_side, weight, slope);
        corners
    }

    fn add(&self, (place, weight, slope): Corner, first: usize, shares: &mut Vec<Share>) {
        let Some(node) = self.node(place) else { return };
        let slope = [slope[0] / self.step_mm[0], slope[1] / self.step_mm[1]];
        match shares[first..].iter_mut().find(|s| s.node == node) {
            Some(share) => {
                share.sixths += weight;
                share.slope_per_mm.iter_mut().zip(slope).for_each(|(s, of)| *s += of);
            }
            None => shares.push(Share { node, sixths: weight, slope_per_mm: slope }),
        }
    }

    fn node(&self, place: [i32; 2]) -> Option<u32> {
        self.index(place).map(|at| self.grid[at]).filter(|&node| node != u32::MAX)
    }

    fn index(&self, [m, q]: [i32; 2]) -> Option<usize> {
        let inside =
            (self.low[0]..=self.high[0]).contains(&m) && (self.low[1]..=self.high[1]).contains(&q);
        let rows = self.high[1] - self.low[1] + 1;
        inside.then(|| (rows * (m - self.low[0]) + (q - self.low[1])) as usize)
    }
}

/// The lattice triangle of a position, with barycentric weights. The steps (1, 1) and (0, 2) span
/// the lattice; their rhombus is cut along its short diagonal.
fn triangle([u, v]: [f64; 2]) -> [Corner; 3] {
    let (along, up) = (u, (v - u) / 2.0);
    let (i, j) = (along.floor(), up.floor());
    let (a, b) = (along - i, up - j);
    // Slopes of a and b in u and v.
    let (da, db) = ([1.0, 0.0], [-0.5, 0.5]);
    let minus = |s: [f64; 2]| [-s[0], -s[1]];
    let both = [da[0] + db[0], da[1] + db[1]];
    let node = |di: i32, dj: i32| {
        let (i, j) = (i as i32 + di, j as i32 + dj);
        [i, i + 2 * j]
    };
    if a + b <= 1.0 {
        [(node(0, 0), 1.0 - a - b, minus(both)), (node(1, 0), a, da), (node(0, 1), b, db)]
    } else {
        [
            (node(1, 1), a + b - 1.0, both),
            (node(1, 0), 1.0 - b, minus(db)),
            (node(0, 1), 1.0 - a, minus(da)),
        ]
    }
}
