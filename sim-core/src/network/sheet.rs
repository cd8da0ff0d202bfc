//! The resistive fabric as a network: linear triangles, one resistor per edge.
//! Uses: `mesh`. Never: the foam.
//!
//! `g_edge = sum over its triangles of sigma cot(angle opposite) / 2`, sigma = conductance per
//! square (S). It is the P1 finite element of the Laplacian; all g are positive on acute triangles.

use std::collections::BTreeMap;

use super::Resistor;
use crate::mesh::Mesh;

/// Resistors of the sheet, ordered by their ends; `sheet_s` per triangle, S.
pub fn resistors(mesh: &Mesh, sheet_s: &[f64]) -> Vec<Resistor> {
    let mut edges: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for (triangle, &sigma) in mesh.triangles.iter().zip(sheet_s) {
        for Resistor { a, b, conductance_s } in of_triangle(mesh, triangle, sigma) {
            *edges.entry((a, b)).or_default() += conductance_s;
        }
    }
    edges.into_iter().map(|((a, b), conductance_s)| Resistor { a, b, conductance_s }).collect()
}

/// Resistors on the edges of a triangle of `sigma` S per square.
pub fn of_triangle(mesh: &Mesh, triangle: &[u32; 3], sigma: f64) -> [Resistor; 3] {
    let area = mesh.triangle_area_mm2(triangle);
    std::array::from_fn(|corner| {
        let [apex, a, b] = [0, 1, 2].map(|k| triangle[(corner + k) % 3]);
        let [p, q, r] = [apex, a, b].map(|n| mesh.nodes_mm[n as usize]);
        let dot = (q[0] - p[0]) * (r[0] - p[0]) + (q[1] - p[1]) * (r[1] - p[1]);
        let cot = dot / (2.0 * area);
        Resistor { a: a.min(b), b: a.max(b), conductance_s: 0.5 * sigma * cot }
    })
}
