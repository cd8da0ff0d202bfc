//! The resistor network compared with other dense and sparse solvers.

use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::circuit::{ElectrodeSite, ReadoutCircuit};
use sim_core::forward::Workspace;
use sim_core::network::kron::{KronReduction, KronWork};
use sim_core::network::readout::ReadoutWork;
use sim_core::network::{ElectrodeError, Resistor, SheetNetwork};
use sim_core::skin::LARGEST_ANISOTROPY_LN;

use super::{model, point_at, press};

/// A triangular patch of side x side nodes with random resistors and electrodes.
fn random_net(side: usize, electrodes: usize, seed: u64) -> (SheetNetwork, Vec<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let index = |x: usize, y: usize| (y * side + x) as u32;
    let mut places_mm = Vec::new();
    let mut resistors = Vec::new();
    for y in 0..side {
        for x in 0..side {
            places_mm.push([x as f64 + 0.5 * y as f64, y as f64]);
            let mut join = |a: u32, b: u32| {
                let conductance_s = 10f64.powf(rng.random_range(-5.0..-4.0));
                resistors.push(Resistor { a, b, conductance_s });
            };
            if x + 1 < side {
                join(index(x, y), index(x + 1, y));
            }
            if y + 1 < side {
                join(index(x, y), index(x, y + 1));
            }
            if x > 0 && y + 1 < side {
                join(index(x, y), index(x - 1, y + 1));
            }
        }
    }
    let step = side * side / electrodes;
    let electrodes = (0..electrodes).map(|k| (k * step + step / 2) as u32).collect();
    let to_top = (0..side * side).map(|_| 10f64.powf(rng.random_range(-11.0..-7.0))).collect();
    (SheetNetwork { places_mm, resistors, electrodes }, to_top)
}

fn circuit(electrodes: usize) -> ReadoutCircuit {
    let site = ElectrodeSite { x_mm: 0.0, y_mm: 0.0, contact_ohm: 0.0, lead_ohm: 0.0 };
    ReadoutCircuit { electrodes: vec![site; electrodes], source_v: 12.0, gain: 1.0 }
}

fn impedance(network: &SheetNetwork, to_top: &[f64]) -> Vec<f64> {
    let mut kron = KronWork::default();
    let mut readout = ReadoutWork::default();
    let reduced = KronReduction::new(network).reduce(to_top, &mut kron).to_vec();
    readout.evaluate(&reduced, &circuit(network.electrodes.len()));
    readout.impedance_ohm().to_vec()
}

fn dense_impedance(network: &SheetNetwork, to_top: &[f64]) -> Vec<f64> {
    let n = to_top.len();
    let mut a = Mat::<f64>::zeros(n, n);
    for (i, &g) in to_top.iter().enumerate() {
        a[(i, i)] += g;
    }
    for r in &network.resistors {
        let (i, j, g) = (r.a as usize, r.b as usize, r.conductance_s);
        a[(i, i)] += g;
        a[(j, j)] += g;
        a[(i, j)] -= g;
        a[(j, i)] -= g;
    }
    let kept = &network.electrodes;
    let mut rhs = Mat::<f64>::zeros(n, kept.len());
    for (k, &e) in kept.iter().enumerate() {
        rhs[(e as usize, k)] = 1.0;
    }
    let solution = a.partial_piv_lu().solve(&rhs);
    kept.iter()
        .flat_map(|&j| (0..kept.len()).map(move |k| (j as usize, k)))
        .map(|(j, k)| solution[(j, k)])
        .collect()
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn a_small_net_agrees_with_a_dense_inverse() {
    for (side, electrodes, seed) in [(3, 2, 1), (7, 5, 2), (14, 9, 3), (20, 28, 4)] {
        let (network, to_top) = random_net(side, electrodes, seed);
        let error = worst(&impedance(&network, &to_top), &dense_impedance(&network, &to_top));
        assert!(error < 1e-9, "side {side}: {error:e}");
    }
}

#[test]
fn twin_a_lost_resistor_is_seen() {
    let (mut network, to_top) = random_net(14, 9, 3);
    let whole = dense_impedance(&network, &to_top);
    network.resistors.remove(40);
    assert!(worst(&impedance(&network, &to_top), &whole) > 1e-6);
}

#[test]
fn the_order_of_removal_does_not_matter() {
    let m = model();
    let sheet = vec![[1e-4; 2]; m.mesh().triangles.len()];
    let network = SheetNetwork::new(m.mesh(), &sheet, m.circuit()).unwrap();
    // A barely touched skin: condition number 1e13, where a plain Cholesky loses its digits.
    let to_top = vec![6e-13; network.places_mm.len()];
    let mut turned = network.clone();
    for place in &mut turned.places_mm {
        *place = [0.8 * place[0] - 0.6 * place[1], 0.6 * place[0] + 0.8 * place[1]];
    }
    let error = worst(&impedance(&network, &to_top), &impedance(&turned, &to_top));
    assert!(error < 1e-12, "{error:e}");
}

#[test]
fn two_resistors_in_a_row_have_the_closed_form() {
    // e0 - 1 kohm - e1, e1 to the top over 2 kohm: Z = [[3, 2], [2, 2]] kohm.
    let network = SheetNetwork {
        places_mm: vec![[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
        resistors: vec![
            Resistor { a: 0, b: 1, conductance_s: 2e-3 },
            Resistor { a: 1, b: 2, conductance_s: 2e-3 },
        ],
        electrodes: vec![0, 2],
    };
    let z = impedance(&network, &[0.0, 0.0, 5e-4]);
    assert!(worst(&z, &[3e3, 2e3, 2e3, 2e3]) < 1e-14, "{z:?}");
}

/// The skin's Z by a sparse Cholesky factor with subtractions.
fn sparse_impedance(to_top: &[f64]) -> Vec<f64> {
    let m = model();
    let sheet = vec![[1e-4; 2]; m.mesh().triangles.len()];
    let network = SheetNetwork::new(m.mesh(), &sheet, m.circuit()).unwrap();
    let n = network.places_mm.len();
    let mut triplets: Vec<_> = (0..n).map(|i| Triplet::new(i, i, to_top[i])).collect();
    for r in &network.resistors {
        let (i, j, g) = (r.a as usize, r.b as usize, r.conductance_s);
        triplets.push(Triplet::new(i, i, g));
        triplets.push(Triplet::new(j, j, g));
        triplets.push(Triplet::new(i.max(j), i.min(j), -g));
    }
    let a = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &triplets).unwrap();
    let factor = a.sp_cholesky(Side::Lower).unwrap();
    let mut rhs = Mat::<f64>::zeros(n, 28);
    for (k, &e) in network.electrodes.iter().enumerate() {
        rhs[(e as usize, k)] = 1.0;
    }
    let solution = factor.solve(&rhs);
    network
        .electrodes
        .iter()
        .flat_map(|&j| (0..28).map(move |k| (j as usize, k)))
        .map(|(j, k)| solution[(j, k)])
        .collect()
}

#[test]
fn the_whole_skin_agrees_with_a_sparse_cholesky() {
    let mut work = Workspace::default();
    let places = [(270.0, 280.0), (120.0, 130.0), (420.0, 130.0), (300.0, 480.0)];
    let contacts: Vec<_> = places.iter().map(|&(x, y)| press(point_at(x, y), 30.0)).collect();
    model().voltages(&contacts, &mut work).unwrap();
    let other = sparse_impedance(work.to_top_s());
    let error = worst(work.readout().impedance_ohm(), &other);
    assert!(error < 1e-9, "{error:e}");
    // A broken twin: one foam resistor of 3503 forgotten, under a tip.
    let mut wrong = work.to_top_s().to_vec();
    wrong[model().mesh().points[point_at(270.0, 280.0)].centre as usize] = 0.0;
    assert!(worst(work.readout().impedance_ohm(), &sparse_impedance(&wrong)) > 1e-4);
}

#[test]
fn the_sheets_inner_resistors_have_the_equilateral_value() {
    let m = model();
    let sheet = vec![[1e-4; 2]; m.mesh().triangles.len()];
    let network = SheetNetwork::new(m.mesh(), &sheet, m.circuit()).unwrap();
    assert_eq!(network.places_mm.len(), 3503);
    let inner = 1e-4 / 3f64.sqrt(); // 2 x sigma cot(60) / 2 = 5.77e-5 S
    let (mut full, mut half) = (0, 0);
    for r in &network.resistors {
        full += usize::from((r.conductance_s / inner - 1.0).abs() < 1e-12);
        half += usize::from((r.conductance_s / inner - 0.5).abs() < 1e-12);
    }
    assert_eq!(full + half, network.resistors.len());
    assert!(half > 150 && full > 10_000);
}

/// Linear elements hold a linear potential exactly: its power is conductance x area.
#[test]
fn an_anisotropic_sheet_conducts_along_each_axis_as_stated() {
    let m = model();
    let sheet = vec![[1.3e-4, 1e-4]; m.mesh().triangles.len()];
    let network = SheetNetwork::new(m.mesh(), &sheet, m.circuit()).unwrap();
    let area_mm2: f64 = m.mesh().triangles.iter().map(|t| m.mesh().triangle_area_mm2(t)).sum();
    let power = |along: [f64; 2]| -> f64 {
        let volts = |node: u32| {
            let [x, y] = network.places_mm[node as usize];
            along[0] * x + along[1] * y
        };
        let of = |r: &Resistor| r.conductance_s * (volts(r.a) - volts(r.b)).powi(2);
        network.resistors.iter().map(of).sum::<f64>() / area_mm2
    };
    for (along, expected) in [([1.0, 0.0], 1.3e-4), ([0.0, 1.0], 1e-4), ([1.0, -2.0], 5.3e-4)] {
        let found = power(along);
        assert!((found / expected - 1.0).abs() < 1e-12, "{along:?}: {found:e}");
    }
    for ln in [-LARGEST_ANISOTROPY_LN, LARGEST_ANISOTROPY_LN] {
        let sheet = vec![[1e-4 * ln.exp(), 1e-4]; m.mesh().triangles.len()];
        let network = SheetNetwork::new(m.mesh(), &sheet, m.circuit()).unwrap();
        assert!(network.resistors.iter().all(|r| r.conductance_s > 0.0), "{ln}");
    }
}

#[test]
fn electrodes_off_the_nodes_need_a_contact_and_then_act_as_one_patch() {
    let m = model();
    let sheet = vec![[1e-4; 2]; m.mesh().triangles.len()];
    let mut circuit = m.circuit().clone();
    circuit.electrodes[3].x_mm += 3.0;
    assert_eq!(
        SheetNetwork::new(m.mesh(), &sheet, &circuit),
        Err(ElectrodeError::IdealOffNode { electrode: 3 })
    );
    circuit.electrodes[3].contact_ohm = 30.0;
    let network = SheetNetwork::new(m.mesh(), &sheet, &circuit).unwrap();
    assert_eq!(network.places_mm.len(), 3504);
    let own = network.electrodes[3];
    let parallel: f64 =
        network.resistors.iter().filter(|r| r.b == own).map(|r| r.conductance_s).sum();
    assert!((1.0 / parallel - 30.0).abs() < 1e-9);
}
