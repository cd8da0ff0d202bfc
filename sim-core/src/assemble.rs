//! The stiffness matrix of the whole skin.
//! Uses: `mesh`, `element::hex8`, `material`, `boundary`, faer's sparse matrix. Never: solving.

use faer::sparse::{SparseColMat, Triplet};

use crate::boundary::FixedBottom;
use crate::element::hex8;
use crate::material::isotropic_mpa;
use crate::mesh::Mesh;
use crate::solve::SolveError;

/// Assembles the lower triangle of the stiffness matrix over the free displacements, N/mm.
pub fn stiffness(
    mesh: &Mesh,
    boundary: &FixedBottom,
) -> Result<SparseColMat<usize, f64>, SolveError> {
    let heights = mesh.level_heights_mm();
    let mut triplets = Vec::with_capacity(mesh.cells.len() * mesh.sheets.len() * 300);
    for (sheet_index, sheet) in mesh.sheets.iter().enumerate() {
        let d = isotropic_mpa(sheet.youngs_mpa, sheet.poisson);
        for cell in &mesh.cells {
            let corner = |local: usize| (sheet_index + local / 4, cell[local % 4] as usize);
            let nodes_mm: [[f64; 3]; 8] = std::array::from_fn(|local| {
                let (level, node) = corner(local);
                [mesh.nodes_mm[node][0], mesh.nodes_mm[node][1], heights[level]]
            });
            let unknowns: [Option<usize>; 24] = std::array::from_fn(|i| {
                let (level, node) = corner(i / 3);
                boundary.unknown(level, node, i % 3)
            });
            let k = hex8::stiffness(&nodes_mm, &d);
            for (i, row) in unknowns.iter().enumerate() {
                for (j, column) in unknowns.iter().enumerate() {
                    if let (Some(row), Some(column)) = (*row, *column)
                        && row >= column
                    {
                        triplets.push(Triplet::new(row, column, k[i][j]));
                    }
                }
            }
        }
    }
    let n = boundary.unknowns();
    SparseColMat::try_new_from_triplets(n, n, &triplets).map_err(SolveError::Assemble)
}
