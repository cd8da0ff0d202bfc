//! The displacement field compared with CalculiX, which has the same brick (C3D8) and another
//! solver.
//!
//! CalculiX prints 7 digits. The measure is the distance of a displacement from the interval that
//! its printed value represents (half a unit of the last digit), relative to the largest
//! displacement: over 21,018 values that shows differences far below a printed digit.

use std::path::Path;
use std::process::Command;

use sim_core::calculix::{deck, node_number};
use sim_core::deformation::{Deformation, NodeForce};
use sim_core::mesh::Mesh;
use sim_core::sensor::Sensor;
use tempfile::tempdir;

use super::tools::available;
use super::{model, point_at, press, sensor};

/// Beyond the printed digits, relative to the largest displacement.
const BEYOND_PRINT: f64 = 1e-9;

/// A displacement as CalculiX printed it.
struct Printed {
    node: usize,
    axis: usize,
    value_mm: f64,
    half_unit_mm: f64,
}

/// Four contacts: one at a corner, two that share nodes.
fn load() -> Vec<NodeForce> {
    let places =
        [(270.0, 280.0, 30.0), (287.4, 280.0, 12.0), (160.0, 420.0, 8.0), (60.0, 70.0, 55.0)];
    let contacts = places.map(|(x, y, force_n)| press(point_at(x, y), force_n));
    model().node_forces(&contacts).unwrap()
}

/// Everything that CalculiX prints for a load.
fn solve(folder: &Path, mesh: &Mesh, forces: &[NodeForce]) -> Vec<Printed> {
    std::fs::write(folder.join("skin.inp"), deck("a test", mesh, forces)).unwrap();
    let run = Command::new("ccx").arg("skin").current_dir(folder).output().unwrap();
    let told = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && told.contains("Job finished"), "{told}");
    let text = std::fs::read_to_string(folder.join("skin.dat")).unwrap();
    let printed: Vec<Printed> = text.lines().flat_map(printed_line).collect();
    assert_eq!(printed.len(), 2 * 3 * mesh.plane_nodes());
    printed
}

/// `node  ux  uy  uz`; other lines are skipped.
fn printed_line(line: &str) -> Vec<Printed> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let Some((node, values)) = words.split_first() else { return Vec::new() };
    let Ok(node) = node.parse() else { return Vec::new() };
    let number = |(axis, word): (usize, &&str)| {
        let exponent: i32 = word.split_once('E').unwrap().1.parse().unwrap();
        let value_mm = word.parse().unwrap();
        Printed { node, axis, value_mm, half_unit_mm: 0.5 * 10f64.powi(exponent - 6) }
    };
    values.iter().enumerate().map(number).collect()
}

/// Largest difference relative to the largest displacement: total, and beyond the printed digits.
fn differences(mesh: &Mesh, ours: &Deformation, printed: &[Printed]) -> [f64; 2] {
    let most = printed.iter().map(|p| p.value_mm.abs()).fold(0.0, f64::max);
    assert!(most > 0.5, "the load moves something: {most} mm");
    let mut worst = [0f64; 2];
    for p in printed {
        let (level, node) = ((p.node - 1) / mesh.plane_nodes(), (p.node - 1) % mesh.plane_nodes());
        assert_eq!(node_number(mesh, level, node), p.node);
        let found = (ours.at(level, node)[p.axis] - p.value_mm).abs();
        worst[0] = worst[0].max(found / most);
        worst[1] = worst[1].max((found - p.half_unit_mm) / most);
    }
    worst
}

#[test]
fn the_whole_skin_agrees_with_calculix_and_a_broken_twin_does_not() {
    if !available("ccx") {
        return;
    }
    let (folder, mesh, forces) = (tempdir().unwrap(), model().mesh(), load());
    let printed = solve(folder.path(), mesh, &forces);
    let ours = Deformation::solve(mesh, &forces).unwrap();
    let [plain, beyond] = differences(mesh, &ours, &printed);
    println!("largest difference {plain:.1e}; beyond the printed digits {beyond:.1e}");
    assert!(plain < 1e-6 && beyond < BEYOND_PRINT, "{plain:e} {beyond:e}");

    for off in [1e-5, 1e-7] {
        let mut file = sensor().file.clone();
        file.layers.foam.youngs_mpa *= 1.0 + off;
        let stiffer = Mesh::new(&Sensor::new(file).unwrap()).unwrap();
        let broken = Deformation::solve(&stiffer, &forces).unwrap();
        let [plain, beyond] = differences(mesh, &broken, &printed);
        println!(
            "a foam stiffer by {off:.0e}: {plain:.1e}; beyond the printed digits {beyond:.1e}"
        );
        assert!(plain > 0.1 * off && beyond > 10.0 * BEYOND_PRINT, "{plain:e} {beyond:e}");
    }
}

#[test]
fn the_foams_compression_is_the_superposed_one() {
    let (mesh, forces) = (model().mesh(), load());
    let ours = Deformation::solve(mesh, &forces).unwrap();
    let responses = model().responses();
    let mut worst = 0f64;
    for node in 0..mesh.plane_nodes() {
        let superposed: f64 = forces
            .iter()
            .map(|f| f.force_n * f64::from(responses.row(f.node as usize)[node]))
            .sum();
        worst = worst.max((ours.compression_mm(node) - superposed).abs());
    }
    // The table is in f32: 6e-8 of each of 24 shares of some millimetres.
    assert!(worst < 1e-6, "{worst:e} mm");
}
