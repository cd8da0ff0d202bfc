//! The brick: nodality, patch test, rigid motion; each check fails on a broken twin.

use sim_core::element::hex8::{self, Stiffness};
use sim_core::material::Isotropic;

/// A skew brick, and a rim wedge (a collapsed brick), corners in mm.
fn bricks() -> [[[f64; 3]; 8]; 2] {
    let skew = [
        [0.0, 0.0, 0.0],
        [8.6, 5.0, 0.3],
        [8.9, 15.0, 0.0],
        [-0.2, 10.0, 0.1],
        [0.1, 0.0, 1.3],
        [8.7, 5.2, 1.4],
        [8.6, 15.1, 1.2],
        [0.0, 10.3, 1.5],
    ];
    let wedge = |z: f64| [[0.0, 0.0, z], [8.66, -5.0, z], [8.66, 5.0, z], [0.0, 0.0, z]];
    let [bottom, top] = [wedge(0.0), wedge(1.3)];
    let wedge = std::array::from_fn(|i| if i < 4 { bottom[i] } else { top[i - 4] });
    [skew, wedge]
}

/// Largest nodal force of a linear displacement field, relative to the stiffness, beyond that of
/// its constant stress.
fn patch_error(nodes: &[[f64; 3]; 8], k: &Stiffness, d: &[[f64; 6]; 6]) -> f64 {
    // u = G x: with a constant strain, the nodal forces are V-weighted integrals of B' s.
    let gradient = [[1e-3, 2e-3, -5e-4], [3e-4, -1e-3, 7e-4], [-2e-4, 4e-4, 2e-3]];
    let u: Vec<f64> = nodes
        .iter()
        .flat_map(|x| gradient.map(|g| (0..3).map(|a| g[a] * x[a]).sum::<f64>()))
        .collect();
    let g = gradient;
    let strain =
        [g[0][0], g[1][1], g[2][2], g[0][1] + g[1][0], g[1][2] + g[2][1], g[2][0] + g[0][2]];
    let s: [f64; 6] = std::array::from_fn(|i| (0..6).map(|j| d[i][j] * strain[j]).sum());
    let stress = [[s[0], s[3], s[5]], [s[3], s[1], s[4]], [s[5], s[4], s[2]]];
    let mut expected = [0.0; 24];
    let at = 1.0 / 3f64.sqrt();
    for corner in 0..8 {
        let place = [0, 1, 2].map(|a| if corner >> a & 1 == 1 { at } else { -at });
        let (gradients, det) = hex8::spatial_gradient(nodes, place);
        for (node, gradient) in gradients.iter().enumerate() {
            for axis in 0..3 {
                expected[3 * node + axis] +=
                    det * (0..3).map(|b| stress[axis][b] * gradient[b]).sum::<f64>();
            }
        }
    }
    let scale = expected.iter().fold(0.0f64, |m, f| m.max(f.abs()));
    (0..24)
        .map(|i| ((0..24).map(|j| k[i][j] * u[j]).sum::<f64>() - expected[i]).abs() / scale)
        .fold(0.0, f64::max)
}

#[test]
fn shape_functions_sum_to_one_and_belong_to_their_node() {
    let mut corners = 0;
    for place in [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [0.3, -0.2, 0.9]] {
        let n = hex8::shape(place);
        assert!((n.iter().sum::<f64>() - 1.0).abs() < 1e-14);
        corners += usize::from(n.contains(&1.0));
    }
    assert_eq!(corners, 3);
}

#[test]
fn gradients_match_finite_differences() {
    let (place, h) = ([0.3, -0.2, 0.9], 1e-6);
    let gradient = hex8::shape_gradient(place);
    for axis in 0..3 {
        let mut moved = place;
        moved[axis] += h;
        let ahead = hex8::shape(moved);
        for (node, n) in hex8::shape(place).iter().enumerate() {
            assert!(((ahead[node] - n) / h - gradient[node][axis]).abs() < 1e-6);
        }
    }
}

#[test]
fn a_linear_field_is_reproduced_also_by_the_wedge() {
    let d = Isotropic { youngs_mpa: 0.07, poisson: 0.05 }.stiffness_mpa();
    for nodes in bricks() {
        let k = hex8::stiffness(&nodes, &d);
        assert!(patch_error(&nodes, &k, &d) < 1e-12);
    }
}

#[test]
fn twin_a_wrong_material_fails_the_patch_test() {
    let d = Isotropic { youngs_mpa: 0.07, poisson: 0.05 }.stiffness_mpa();
    let mut wrong = d;
    wrong[3][3] *= 2.0; // tensor instead of engineering shear strain
    for nodes in bricks() {
        let k = hex8::stiffness(&nodes, &wrong);
        assert!(patch_error(&nodes, &k, &d) > 1e-2);
    }
}

#[test]
fn rigid_motion_costs_nothing_and_the_matrix_is_symmetric() {
    let d = Isotropic { youngs_mpa: 20.0, poisson: 0.3 }.stiffness_mpa();
    for nodes in bricks() {
        let k = hex8::stiffness(&nodes, &d);
        let scale = k[0][0].abs();
        let rotation: Vec<f64> = nodes.iter().flat_map(|x| [-x[1], x[0], 0.0]).collect();
        for (i, row) in k.iter().enumerate() {
            let translated: f64 = (0..8).map(|n| row[3 * n + 2]).sum();
            let turned: f64 = row.iter().zip(&rotation).map(|(k, r)| k * r).sum();
            assert!(translated.abs() < 1e-10 * scale && turned.abs() < 1e-9 * scale);
            for (j, other) in k.iter().enumerate() {
                assert!((row[j] - other[i]).abs() < 1e-10 * scale);
            }
        }
    }
}
