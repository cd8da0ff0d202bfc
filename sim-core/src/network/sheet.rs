//! The resistive fabric as a network: linear triangles, one resistor per edge.
//! Uses: `mesh`. Never: the foam.
//!
//! `g_edge = sum over its triangles of (sigma_y u_x v_x + sigma_x u_y v_y) / (4 area)`, u and v from the opposite corner to
//! its ends, sigma = conductance per square (S). It is the P1 finite element of the Laplacian, for an isotropic sheet
//! `sigma cot(angle opposite) / 2`; all g are positive on acute triangles unless sigma_x and sigma_y are far apart.

use std::collections::BTreeMap;

use super::Resistor;
use crate::mesh::Mesh;

/// Resistors of the sheet, ordered by their ends; `sheet_s` per triangle, S, along x and y.
pub fn resistors(mesh: &Mesh, sheet_s: &[[f64; 2]]) -> Vec<Resistor> {
    let mut edges: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for (triangle, &sigma) in mesh.triangles.iter().zip(sheet_s) {
        for Resistor { a, b, conductance_s } in of_triangle(mesh, triangle, sigma) {
            *edges.entry((a, b)).or_default() += conductance_s;
        }
    }
    edges.into_iter().map(|((a, b), conductance_s)| Resistor { a, b, conductance_s }).collect()
}

/// Resistors on the edges of a triangle of `sigma` S per square along x and y.
pub fn of_triangle(
    mesh: &Mesh,
    triangle: &[u32; 3],
    [along_x, along_y]: [f64; 2],
) -> [Resistor; 3] {
    let area = mesh.triangle_area_mm2(triangle);
    std::array::from_fn(|corner| {
        let [apex, a, b] = [0, 1, 2].map(|k| triangle[(corner + k) % 3]);
        let [p, q, r] = [apex, a, b].map(|n| mesh.nodes_mm[n as usize]);
        let [of_x, of_y] = [0, 1].map(|axis| (q[axis] - p[axis]) * (r[axis] - p[axis]));
        let conductance_s = (along_y * of_x + along_x * of_y) / (4.0 * area);
        Resistor { a: a.min(b), b: a.max(b), conductance_s }
    })
}
