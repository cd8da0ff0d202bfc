//! Convergence of the elastic solve to a known smooth solution: mesh, element, material, assembly,
//! boundary and solve together.
//!
//! The load is the one of the known field (`F_i = integral of B_i' D e(u)`), so that body forces
//! and tractions are not needed. Halving the bricks must divide the error of the displacement by 4
//! (order 2) and that of the strain by 2 (order 1).

use sim_core::assemble;
use sim_core::boundary::FixedBottom;
use sim_core::element::hex8;
use sim_core::material::Isotropic;
use sim_core::mesh::{BrickSheet, Mesh};
use sim_core::solve::Factor;

const POISSON: f64 = 0.3;

/// Rhombi as in the skin's middle, or collapsed bricks as at its rim.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Bricks {
    Rhombi,
    Collapsed,
}

/// A sheared cube of side 1 mm, `n` bricks along each edge.
fn mesh(n: u32, bricks: Bricks) -> Mesh {
    let h = 1.0 / f64::from(n);
    let mut nodes_mm = Vec::new();
    let mut cells = Vec::new();
    for j in 0..=n {
        for i in 0..=n {
            let (along, up) = (f64::from(i) * h, f64::from(j) * h);
            nodes_mm.push([along + 0.5 * up, 0.75f64.sqrt() * up]);
            if i < n && j < n {
                let [a, d] = [j, j + 1].map(|row| row * (n + 1) + i);
                match bricks {
                    Bricks::Rhombi => cells.push([a, a + 1, d + 1, d]),
                    Bricks::Collapsed => cells.extend([[a, a + 1, d, a], [d + 1, d, a + 1, d + 1]]),
                }
            }
        }
    }
    let sheet = BrickSheet { height_mm: h, youngs_mpa: 1.0, poisson: POISSON };
    Mesh {
        nodes_mm,
        triangles: Vec::new(),
        rhombi: if bricks == Bricks::Rhombi { cells.len() } else { 0 },
        cells,
        sheets: vec![sheet; n as usize],
        foam_levels: [0, n as usize],
        points: Vec::new(),
    }
}

/// The known displacement, zero at the bottom, mm.
fn known([x, y, z]: [f64; 3]) -> [f64; 3] {
    [z * (x + 0.5 * y).sin(), z * z * (x - y).cos(), x * y * z]
}

/// Its strain: xx, yy, zz, xy, yz, zx, shears doubled.
fn known_strain([x, y, z]: [f64; 3]) -> [f64; 6] {
    let ((sin, cos), (s, c)) = ((x + 0.5 * y).sin_cos(), (x - y).sin_cos());
    let (xy, yz, zx) = (0.5 * z * cos - z * z * s, 2.0 * z * c + x * z, y * z + sin);
    [z * cos, z * z * s, x * y, xy, yz, zx]
}

/// Weights and positions of the 3 x 3 x 3 Gauss rule.
fn gauss() -> Vec<(f64, [f64; 3])> {
    let points = [(5.0 / 9.0, -0.6f64.sqrt()), (8.0 / 9.0, 0.0), (5.0 / 9.0, 0.6f64.sqrt())];
    let mut rule = Vec::new();
    for (u, r) in points {
        for (v, s) in points {
            rule.extend(points.map(|(w, t)| (u * v * w, [r, s, t])));
        }
    }
    rule
}

/// Nodes (level, plane) and corners of a brick.
type Brick = ([(usize, usize); 8], [[f64; 3]; 8]);

fn all_bricks(mesh: &Mesh) -> Vec<Brick> {
    let heights = mesh.level_heights_mm();
    let brick = |level: usize, cell: &[u32; 4]| {
        let nodes = std::array::from_fn(|i| (level + i / 4, cell[i % 4] as usize));
        let corners = nodes.map(|(level, node): (usize, usize)| {
            [mesh.nodes_mm[node][0], mesh.nodes_mm[node][1], heights[level]]
        });
        (nodes, corners)
    };
    (0..mesh.sheets.len()).flat_map(|l| mesh.cells.iter().map(move |c| brick(l, c))).collect()
}

/// Root mean square errors of displacement and strain. `load_poisson` is that of the load.
fn errors(mesh: &Mesh, load_poisson: f64) -> [f64; 2] {
    let boundary = FixedBottom::new(mesh);
    let d = Isotropic { youngs_mpa: 1.0, poisson: load_poisson }.stiffness_mpa();
    let mut u = vec![0.0; boundary.unknowns()];
    let bricks = all_bricks(mesh);
    for (nodes, corners) in &bricks {
        for (weight, at) in gauss() {
            let (gradients, det) = hex8::spatial_gradient(corners, at);
            let e = known_strain(place(corners, at));
            let s: [f64; 6] = std::array::from_fn(|i| (0..6).map(|j| d[i][j] * e[j]).sum());
            let stress = [[s[0], s[3], s[5]], [s[3], s[1], s[4]], [s[5], s[4], s[2]]];
            for (&(level, node), gradient) in nodes.iter().zip(&gradients) {
                for (axis, row) in stress.iter().enumerate() {
                    if let Some(unknown) = boundary.unknown(level, node, axis) {
                        let force: f64 = row.iter().zip(gradient).map(|(s, g)| s * g).sum();
                        u[unknown] += weight * det * force;
                    }
                }
            }
        }
    }
    let stiffness = assemble::stiffness(mesh, &boundary).unwrap();
    Factor::new(&stiffness).unwrap().solve(&mut u, 1).unwrap();
    let [mut displacement, mut strain, mut volume] = [0.0; 3];
    for (nodes, corners) in &bricks {
        let moved = nodes.map(|(level, node)| {
            [0, 1, 2].map(|axis| boundary.unknown(level, node, axis).map_or(0.0, |i| u[i]))
        });
        for (weight, at) in gauss() {
            let (gradients, det) = hex8::spatial_gradient(corners, at);
            let here = place(corners, at);
            let found = place(&moved, at);
            let off = found.iter().zip(known(here)).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let sum = |axis: usize, along: usize| -> f64 {
                moved.iter().zip(&gradients).map(|(u, g)| u[axis] * g[along]).sum()
            };
            let shear = |a, b| sum(a, b) + sum(b, a);
            let e = [sum(0, 0), sum(1, 1), sum(2, 2), shear(0, 1), shear(1, 2), shear(2, 0)];
            let e_off = e.iter().zip(known_strain(here)).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            displacement += weight * det * off;
            strain += weight * det * e_off;
            volume += weight * det;
        }
    }
    [(displacement / volume).sqrt(), (strain / volume).sqrt()]
}

/// Values at the corners, interpolated to a position of the reference cube.
fn place(corners: &[[f64; 3]; 8], at: [f64; 3]) -> [f64; 3] {
    let n = hex8::shape(at);
    std::array::from_fn(|axis| n.iter().zip(corners).map(|(n, c)| n * c[axis]).sum())
}

/// Observed orders of displacement and strain between `n` and `2 n` bricks.
fn orders(n: u32, bricks: Bricks, load_poisson: f64) -> [f64; 2] {
    let [coarse, fine] = [n, 2 * n].map(|n| errors(&mesh(n, bricks), load_poisson));
    [0, 1].map(|i| (coarse[i] / fine[i]).log2())
}

#[test]
fn displacement_converges_with_order_2_and_strain_with_order_1() {
    for bricks in [Bricks::Rhombi, Bricks::Collapsed] {
        let [displacement, strain] = orders(6, bricks, POISSON);
        println!("{bricks:?}: displacement {displacement:.3}, strain {strain:.3}");
        assert!((displacement - 2.0).abs() < 0.15, "{bricks:?}: displacement {displacement}");
        assert!((strain - 1.0).abs() < 0.1, "{bricks:?}: strain {strain}");
    }
}

#[test]
fn twin_a_load_of_another_material_does_not_converge() {
    for bricks in [Bricks::Rhombi, Bricks::Collapsed] {
        let [displacement, _] = orders(6, bricks, POISSON + 0.02);
        assert!(displacement < 1.0, "{bricks:?}: displacement {displacement}");
    }
}
