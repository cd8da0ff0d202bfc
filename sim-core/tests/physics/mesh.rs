//! The mesh by counting (`docs/references.md`, "Skin geometry").

use std::collections::HashMap;

use sim_core::mesh::Mesh;

use super::sensor;

fn mesh() -> Mesh {
    Mesh::new(sensor()).unwrap()
}

#[test]
fn the_counts_of_the_paper_sized_skin() {
    let mesh = mesh();
    assert_eq!(mesh.plane_nodes(), 3503);
    assert_eq!(mesh.rhombi, 3306);
    assert_eq!(mesh.cells.len() - mesh.rhombi, 159);
    assert_eq!(mesh.triangles.len(), 2 * 3306 + 159);
    assert_eq!(mesh.sheets.len(), 5);
    assert_eq!(mesh.foam_levels, [1, 4]);
    assert_eq!(mesh.points.len(), 804);
    let used: std::collections::BTreeSet<u32> = mesh.cells.iter().flatten().copied().collect();
    assert_eq!(used.len(), 3503, "a node belongs to no brick");
}

#[test]
fn points_are_six_valent_and_no_other_inner_node_is() {
    let mesh = mesh();
    let mut valence: HashMap<u32, usize> = HashMap::new();
    for cell in &mesh.cells[..mesh.rhombi] {
        for &node in cell {
            *valence.entry(node).or_default() += 1;
        }
    }
    for point in &mesh.points {
        assert_eq!(valence[&point.centre], 6);
        let [cx, cy] = mesh.nodes_mm[point.centre as usize];
        for vertex in point.vertices {
            let [x, y] = mesh.nodes_mm[vertex as usize];
            assert!(((x - cx).hypot(y - cy) - 10.0).abs() < 1e-9);
            assert!(valence[&vertex] <= 3);
        }
    }
}

#[test]
fn cells_and_triangles_cover_the_same_area() {
    let mesh = mesh();
    let quad = |c: &[u32; 4]| {
        mesh.triangle_area_mm2(&[c[0], c[1], c[2]]) + mesh.triangle_area_mm2(&[c[0], c[2], c[3]])
    };
    let cells: f64 = mesh.cells.iter().map(quad).sum();
    let triangles: f64 = mesh.triangles.iter().map(|t| mesh.triangle_area_mm2(t)).sum();
    let nodes: f64 = mesh.node_areas_mm2().iter().sum();
    assert!((cells - triangles).abs() < 1e-6 && (nodes - triangles).abs() < 1e-6);
    assert!(mesh.triangles.iter().all(|t| mesh.triangle_area_mm2(t) > 43.0));
}

#[test]
fn electrodes_stand_on_nodes() {
    let mesh = mesh();
    for &[x, y] in sensor().electrodes_mm() {
        assert!(mesh.locate([x, y]).weights.contains(&1.0), "({x}, {y})");
    }
}

#[test]
fn a_place_is_the_weighted_mean_of_its_triangle() {
    let mesh = mesh();
    for (x, y) in [(270.0, 280.0), (101.3, 333.3), (49.2, 60.0)] {
        let place = mesh.locate([x, y]);
        let mean = |axis: usize| -> f64 {
            (0..3).map(|k| place.weights[k] * mesh.nodes_mm[place.nodes[k] as usize][axis]).sum()
        };
        assert!((mean(0) - x).abs() < 1e-9 && (mean(1) - y).abs() < 1e-9);
    }
    // Off the mesh: the rim.
    let place = mesh.locate([-50.0, 280.0]);
    assert!((place.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert!(place.nodes.iter().any(|&n| mesh.nodes_mm[n as usize][0] < 6.0));
}
