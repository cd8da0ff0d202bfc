//! The elastic skin: closed form, stiffness of a point, equality of points, the cache's bytes.

use sim_core::assemble;
use sim_core::boundary::FixedBottom;
use sim_core::mesh::Mesh;
use sim_core::responses::{ResponsesError, UnitResponses};
use sim_core::solve::Factor;

use super::{model, point_at, responses, sensor};

/// Foam compression under a tip on a point at one newton, at its centre and first vertex, mm.
fn compliance(point: usize) -> [f64; 2] {
    let nodes = model().mesh().points[point];
    let rows = nodes.vertices.map(|node| responses().row(node as usize).to_vec());
    [nodes.centre, nodes.vertices[0]]
        .map(|n| rows.iter().map(|r| f64::from(r[n as usize])).sum::<f64>() / 6.0)
}

#[test]
fn a_point_is_as_stiff_as_in_the_study() {
    let [centre, vertex] = compliance(point_at(270.0, 280.0));
    assert!((40.0 * centre - 3.22).abs() < 0.02, "centre {}", 40.0 * centre);
    assert!((40.0 * vertex - 2.75).abs() < 0.02, "vertex {}", 40.0 * vertex);
    assert!(centre >= 0.8 * vertex, "the dent must not be six pits");
}

#[test]
fn all_points_are_equal_to_four_digits() {
    let [centre, vertex] = compliance(point_at(270.0, 280.0));
    let mut worst = 0f64;
    for point in 0..sensor().points().len() {
        let [c, v] = compliance(point);
        worst = worst.max((c / centre - 1.0).abs()).max((v / vertex - 1.0).abs());
    }
    assert!(worst < 5e-5, "{worst:e}");
    // The measure distinguishes positions: a vertex is not a centre.
    assert!((vertex / centre - 1.0).abs() > 0.1);
}

/// Sinking of the top face per MPa under even pressure without lateral motion, mm.
fn confined_sinking(mesh: &Mesh) -> f64 {
    let boundary = FixedBottom::new(mesh);
    let full = assemble::stiffness(mesh, &boundary).unwrap();
    // Lateral motion is suppressed by removing those unknowns.
    let n = boundary.unknowns();
    let keep: Vec<usize> = (0..n).filter(|u| u % 3 == 2).collect();
    let mut triplets = Vec::new();
    for column in keep.iter().copied() {
        let values = full.val_of_col(column);
        for (row, &value) in full.row_idx_of_col(column).zip(values) {
            if row % 3 == 2 {
                triplets.push(faer::sparse::Triplet::new(row / 3, column / 3, value));
            }
        }
    }
    let vertical =
        faer::sparse::SparseColMat::try_new_from_triplets(n / 3, n / 3, &triplets).unwrap();
    let mut load = vec![0.0; n / 3];
    let surface = mesh.levels() - 1;
    // Consistent nodal forces of an even pressure on the bricks' top faces.
    for cell in &mesh.cells {
        let quarters = face_shares(mesh, cell);
        for (&node, share) in cell.iter().zip(quarters) {
            load[boundary.unknown(surface, node as usize, 2).unwrap() / 3] += share;
        }
    }
    Factor::new(&vertical).unwrap().solve(&mut load, 1).unwrap();
    let sinking: Vec<f64> = (0..mesh.plane_nodes())
        .map(|node| load[boundary.unknown(surface, node, 2).unwrap() / 3])
        .collect();
    let (low, high) = sinking.iter().fold((f64::MAX, f64::MIN), |(l, h), &s| (l.min(s), h.max(s)));
    assert!(high - low < 1e-9 * high, "even pressure sinks evenly: {low} to {high}");
    high
}

/// Integrals of the four bilinear shape functions over a quadrilateral, mm2.
fn face_shares(mesh: &Mesh, cell: &[u32; 4]) -> [f64; 4] {
    let at = 1.0 / 3f64.sqrt();
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let places = cell.map(|n| mesh.nodes_mm[n as usize]);
    let mut shares = [0.0; 4];
    for gauss in corners.map(|c| [c[0] * at, c[1] * at]) {
        let mut jacobian = [[0.0; 2]; 2];
        for (corner, place) in corners.iter().zip(&places) {
            for b in 0..2 {
                jacobian[0][b] += corner[0] * (1.0 + corner[1] * gauss[1]) / 4.0 * place[b];
                jacobian[1][b] += corner[1] * (1.0 + corner[0] * gauss[0]) / 4.0 * place[b];
            }
        }
        let det = jacobian[0][0] * jacobian[1][1] - jacobian[0][1] * jacobian[1][0];
        for (share, corner) in shares.iter_mut().zip(&corners) {
            *share += det * (1.0 + corner[0] * gauss[0]) * (1.0 + corner[1] * gauss[1]) / 4.0;
        }
    }
    shares
}

#[test]
fn confined_compression_follows_the_closed_form() {
    let mesh = model().mesh();
    let closed = |foam_scale: f64| -> f64 {
        let layers = &sensor().file.layers;
        [(&layers.bottom, 1.0), (&layers.foam, foam_scale), (&layers.top, 1.0)]
            .iter()
            .map(|(l, s)| {
                // The modulus without lateral motion.
                let (youngs_mpa, nu) = (l.youngs_mpa, l.poisson);
                let confined_mpa = youngs_mpa * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu));
                l.thickness_mm / (s * confined_mpa)
            })
            .sum()
    };
    let sinking = confined_sinking(mesh);
    assert!((sinking / closed(1.0) - 1.0).abs() < 1e-9, "{sinking} {}", closed(1.0));
    // A broken twin: a foam stiffer by a thousandth is detected.
    assert!((sinking / closed(1.001) - 1.0).abs() > 1e-4);
}

#[test]
fn the_cache_gives_back_the_same_table_and_refuses_others() {
    let table = responses();
    assert_eq!(table.nodes(), 3503);
    let bytes = table.to_bytes();
    assert_eq!(UnitResponses::from_bytes(&bytes, sensor()).unwrap(), *table);
    let mut flipped = bytes.clone();
    let middle = bytes.len() / 2;
    flipped[middle] ^= 1;
    assert!(matches!(
        UnitResponses::from_bytes(&flipped, sensor()),
        Err(ResponsesError::Damaged(_))
    ));
    assert!(matches!(
        UnitResponses::from_bytes(&bytes[..middle], sensor()),
        Err(ResponsesError::Damaged(_))
    ));
    let mut other = sensor().file.clone();
    other.layers.foam.youngs_mpa = 0.08;
    let other = sim_core::sensor::Sensor::new(other).unwrap();
    assert!(matches!(
        UnitResponses::from_bytes(&bytes, &other),
        Err(ResponsesError::OtherKey { .. })
    ));
}
