//! The fixed bottom: which displacements are free, and their numbers.
//! Uses: `mesh`. Never: values other than zero.
//!
//! The bench under the skin is rigid and the bottom nodes are fixed (paper III-A).

use crate::mesh::Mesh;

/// Numbers the free displacements: every axis of every node above level 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FixedBottom {
    free_levels: usize,
    plane_nodes: usize,
}

impl FixedBottom {
    /// The numbering of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        Self { free_levels: mesh.levels() - 1, plane_nodes: mesh.plane_nodes() }
    }

    /// Free displacements in all.
    pub fn unknowns(&self) -> usize {
        3 * self.free_levels * self.plane_nodes
    }

    /// Number of a displacement: level, node of the plane, axis (0 x, 1 y, 2 z up); `None` if fixed.
    pub fn unknown(&self, level: usize, node: usize, axis: usize) -> Option<usize> {
        level.checked_sub(1).map(|above| 3 * (node * self.free_levels + above) + axis)
    }
}
