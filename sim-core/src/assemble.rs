//! The stiffness matrix of the whole skin.
//! Uses: `mesh`, `element::hex8`, `material`, `boundary`, faer's sparse matrix. Never: solving.

use std::collections::HashMap;

use faer::sparse::{SparseColMat, Triplet};

use crate::boundary::FixedBottom;
use crate::element::hex8::{self, Stiffness};
use crate::material::Isotropic;
use crate::mesh::{BrickSheet, Mesh};
use crate::solve::SolveError;

/// Grid on which outlines are compared: bricks with the same outline share one element matrix, mm.
const SAME_OUTLINE_MM: f64 = 1e-7;

/// Assembles the upper triangle of the stiffness matrix over the free displacements, N/mm.
///
/// # Errors
/// `SolveError::Assemble` if the sparse matrix cannot be built.
pub fn stiffness(
    mesh: &Mesh,
    boundary: &FixedBottom,
) -> Result<SparseColMat<usize, f64>, SolveError> {
    let mut triplets = Vec::with_capacity(mesh.cells.len() * mesh.sheets.len() * 300);
    for (level, sheet) in mesh.sheets.iter().enumerate() {
        let mut by_outline = HashMap::new();
        for cell in &mesh.cells {
            let (key, corners_mm) = outline(mesh, cell, sheet);
            let k = by_outline.entry(key).or_insert_with(|| brick(&corners_mm, sheet));
            let unknowns: [Option<usize>; 24] = std::array::from_fn(|i| {
                let corner = i / 3;
                boundary.unknown(level + corner / 4, cell[corner % 4] as usize, i % 3)
            });
            for (row, values) in unknowns.iter().zip(k.iter()) {
                let Some(row) = *row else { continue };
                for (column, &value) in unknowns.iter().zip(values) {
                    if let Some(column) = column.filter(|&column| row <= column) {
                        triplets.push(Triplet::new(row, column, value));
                    }
                }
            }
        }
    }
    let n = boundary.unknowns();
    SparseColMat::try_new_from_triplets(n, n, &triplets).map_err(SolveError::Assemble)
}

/// The corners of a brick relative to its first, mm, and a key that equal ones share.
fn outline(mesh: &Mesh, cell: &[u32; 4], sheet: &BrickSheet) -> ([i64; 8], [[f64; 3]; 8]) {
    let [x0, y0] = mesh.nodes_mm[cell[0] as usize];
    let corners = std::array::from_fn(|local| {
        let [x, y] = mesh.nodes_mm[cell[local % 4] as usize];
        [x - x0, y - y0, if local < 4 { 0.0 } else { sheet.height_mm }]
    });
    let key = std::array::from_fn(|i| (corners[i / 2][i % 2] / SAME_OUTLINE_MM).round() as i64);
    (key, corners)
}

fn brick(corners_mm: &[[f64; 3]; 8], sheet: &BrickSheet) -> Stiffness {
    let material = Isotropic { youngs_mpa: sheet.youngs_mpa, poisson: sheet.poisson };
    hex8::stiffness(corners_mm, &material.stiffness_mpa())
}
