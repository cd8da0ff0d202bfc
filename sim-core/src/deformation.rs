//! The whole displacement field of one load: every level and axis, before any clamp.
//! Uses: `mesh`, `assemble`, `boundary`, `solve`. Never: the unit responses, the foam's resistance.
//!
//! For pictures and for comparison with other finite element codes; trials superpose `responses`,
//! which keep only the foam's compression.

use crate::assemble;
use crate::boundary::FixedBottom;
use crate::mesh::Mesh;
use crate::solve::{Factor, SolveError};

/// A force that presses a node of the skin's surface down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeForce {
    /// Node of the plane.
    pub node: u32,
    /// Force, N, > 0 is down.
    pub force_n: f64,
}

/// Displacement of every node, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct Deformation {
    plane_nodes: usize,
    foam_levels: [usize; 2],
    /// Level by level, x, y, z (up).
    displacement_mm: Vec<[f64; 3]>,
}

impl Deformation {
    /// Assembles the skin and solves for one load; takes about 1 s.
    ///
    /// # Errors
    /// `SolveError` if the stiffness matrix cannot be assembled, factorised or solved.
    pub fn solve(mesh: &Mesh, forces: &[NodeForce]) -> Result<Self, SolveError> {
        let boundary = FixedBottom::new(mesh);
        let factor = Factor::new(&assemble::stiffness(mesh, &boundary)?)?;
        let mut block = vec![0.0; boundary.unknowns()];
        let surface = mesh.levels() - 1;
        for force in forces {
            if let Some(unknown) = boundary.unknown(surface, force.node as usize, 2) {
                block[unknown] -= force.force_n;
            }
        }
        factor.solve(&mut block, 1)?;
        let displacement_mm = (0..mesh.levels())
            .flat_map(|level| (0..mesh.plane_nodes()).map(move |node| (level, node)))
            .map(|(level, node)| {
                [0, 1, 2].map(|axis| boundary.unknown(level, node, axis).map_or(0.0, |u| block[u]))
            })
            .collect();
        let (plane_nodes, foam_levels) = (mesh.plane_nodes(), mesh.foam_levels);
        Ok(Self { plane_nodes, foam_levels, displacement_mm })
    }

    /// Displacement of a node of the plane at a level (0 is the fixed bottom), mm: x, y, z up.
    pub fn at(&self, level: usize, node: usize) -> [f64; 3] {
        self.displacement_mm[level * self.plane_nodes + node]
    }

    /// Compression of the foam at a node of the plane, mm; < 0 where it is lifted.
    pub fn compression_mm(&self, node: usize) -> f64 {
        let [bottom, top] = self.foam_levels.map(|level| self.at(level, node)[2]);
        bottom - top
    }
}
