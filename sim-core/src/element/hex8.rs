//! Hex8: the 8-node isoparametric brick, 2x2x2 Gauss points, full integration, no B-bar.
//! Uses: nothing. Never: B-bar, incompatible modes: they change the calibration
//! (`docs/references.md`, "Materials").
//!
//! `x = sum N_i x_i`, `N_i = (1 + r r_i)(1 + s s_i)(1 + t t_i) / 8` on [-1, 1]^3; node order:
//! bottom face counter-clockwise, then the top face. `K = sum_g B' D B det J`. Repeated nodes make
//! a collapsed brick (a wedge), legal since det J stays positive at the Gauss points. Order
//! expected: displacement L2 2, energy 1. Locks in bending when thin.

/// Corners of the reference cube, in node order.
const CORNERS: [[f64; 3]; 8] = [
    [-1.0, -1.0, -1.0],
    [1.0, -1.0, -1.0],
    [1.0, 1.0, -1.0],
    [-1.0, 1.0, -1.0],
    [-1.0, -1.0, 1.0],
    [1.0, -1.0, 1.0],
    [1.0, 1.0, 1.0],
    [-1.0, 1.0, 1.0],
];

/// Stiffness matrix, 24 x 24, N/mm; degree of freedom `3 * node + axis`.
pub type Stiffness = [[f64; 24]; 24];

/// Shape functions at a position of the reference cube.
pub fn shape(place: [f64; 3]) -> [f64; 8] {
    CORNERS.map(|c| (0..3).map(|a| 1.0 + c[a] * place[a]).product::<f64>() / 8.0)
}

/// Derivatives of the shape functions along the reference axes.
pub fn shape_gradient(place: [f64; 3]) -> [[f64; 3]; 8] {
    CORNERS.map(|c| {
        let f: [f64; 3] = std::array::from_fn(|a| 1.0 + c[a] * place[a]);
        [c[0] * f[1] * f[2] / 8.0, c[1] * f[0] * f[2] / 8.0, c[2] * f[0] * f[1] / 8.0]
    })
}

/// Derivatives of the shape functions in space (1/mm) and det J (mm3), at a reference position.
pub fn spatial_gradient(nodes_mm: &[[f64; 3]; 8], place: [f64; 3]) -> ([[f64; 3]; 8], f64) {
    let reference = shape_gradient(place);
    let mut j = [[0.0; 3]; 3];
    for (gradient, node) in reference.iter().zip(nodes_mm) {
        for a in 0..3 {
            for b in 0..3 {
                j[a][b] += gradient[a] * node[b];
            }
        }
    }
    let cofactor = |a: usize, b: usize| {
        let (a1, a2, b1, b2) = ((a + 1) % 3, (a + 2) % 3, (b + 1) % 3, (b + 2) % 3);
        j[a1][b1] * j[a2][b2] - j[a1][b2] * j[a2][b1]
    };
    let det: f64 = (0..3).map(|b| j[0][b] * cofactor(0, b)).sum();
    let gradients = reference
        .map(|g| std::array::from_fn(|b| (0..3).map(|a| cofactor(a, b) * g[a]).sum::<f64>() / det));
    (gradients, det)
}

/// Strain-displacement matrix of one node: Voigt order xx, yy, zz, xy, yz, zx.
fn strain_columns(g: [f64; 3]) -> [[f64; 3]; 6] {
    [
        [g[0], 0.0, 0.0],
        [0.0, g[1], 0.0],
        [0.0, 0.0, g[2]],
        [g[1], g[0], 0.0],
        [0.0, g[2], g[1]],
        [g[2], 0.0, g[0]],
    ]
}

/// Stiffness of a brick: corner positions in mm, D in MPa.
pub fn stiffness(nodes_mm: &[[f64; 3]; 8], d_mpa: &[[f64; 6]; 6]) -> Stiffness {
    let mut k = [[0.0; 24]; 24];
    let gauss = 1.0 / 3f64.sqrt();
    for corner in CORNERS {
        let (gradients, det) = spatial_gradient(nodes_mm, corner.map(|c| c * gauss));
        let b = gradients.map(strain_columns);
        // D B, node by node: 6 x 3 each.
        let db = b.map(|node| {
            let mut out = [[0.0; 3]; 6];
            for (row, d) in out.iter_mut().zip(d_mpa) {
                for (strain, &weight) in node.iter().zip(d) {
                    for a in 0..3 {
                        row[a] += weight * strain[a] * det;
                    }
                }
            }
            out
        });
        for (i, bi) in b.iter().enumerate() {
            for (j, dbj) in db.iter().enumerate() {
                for a in 0..3 {
                    for c in 0..3 {
                        let products = bi.iter().zip(dbj).map(|(b, db)| b[a] * db[c]);
                        k[3 * i + a][3 * j + c] += products.sum::<f64>();
                    }
                }
            }
        }
    }
    k
}
