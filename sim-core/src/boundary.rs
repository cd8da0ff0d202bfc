//! The fixed bottom: which displacements are free, and their numbers.
//! Uses: `mesh`, `order`. Never: values other than zero.
//!
//! The support under the skin is rigid and the bottom nodes are fixed (paper III-A). Free
//! displacements are numbered in the order of elimination: nested dissection of the plane, with the
//! displacements of a node together.

use crate::mesh::Mesh;
use crate::order::dissect;

/// Numbers the free displacements: every axis of every node above level 0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FixedBottom {
    free_levels: usize,
    /// Position of each node of the plane in the order.
    place: Vec<usize>,
}

impl FixedBottom {
    /// Numbers the free displacements of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let mut neighbours = vec![Vec::new(); mesh.plane_nodes()];
        for cell in &mesh.cells {
            for &a in cell {
                neighbours[a as usize].extend(cell.iter().copied().filter(|&b| b != a));
            }
        }
        let mut place = vec![0; mesh.plane_nodes()];
        let parts = dissect(&mesh.nodes_mm, &neighbours, &[]);
        for (at, &node) in parts.iter().flat_map(|part| &part.nodes).enumerate() {
            place[node as usize] = at;
        }
        Self { free_levels: mesh.levels() - 1, place }
    }

    /// Number of free displacements.
    pub fn unknowns(&self) -> usize {
        3 * self.free_levels * self.place.len()
    }

    /// Number of a displacement: level, node of the plane, axis (0 x, 1 y, 2 z up); `None` if
    /// fixed.
    pub fn unknown(&self, level: usize, node: usize, axis: usize) -> Option<usize> {
        let above = level.checked_sub(1)?;
        Some(3 * (self.place[node] * self.free_levels + above) + axis)
    }
}
