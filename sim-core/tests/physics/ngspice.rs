//! The voltages compared with ngspice, which solves the same network by another method.

use std::path::Path;
use std::process::Command;

use rand::seq::index::sample;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::forward::{Contact, Workspace};
use sim_core::network::SheetNetwork;
use sim_core::spice::{LoadedCircuit, netlist};
use tempfile::tempdir;

use super::tools::available;
use super::{model, point_at, press, sensor};

/// The largest relative difference that is allowed.
const AIM: f64 = 1e-9;

/// One to six different points, 0.1 to 80 N each, evenly in the logarithm.
fn random_load(rng: &mut ChaCha8Rng) -> Vec<Contact> {
    let count = rng.random_range(1..=6);
    let points = sample(rng, sensor().points().len(), count);
    points.iter().map(|p| press(p, 10f64.powf(rng.random_range(-1.0..80f64.log10())))).collect()
}

/// Electrode voltages that ngspice finds, V.
fn spice_voltages(folder: &Path, text: &str) -> Vec<f64> {
    let file = folder.join("skin.cir");
    std::fs::write(&file, text).unwrap();
    let run = Command::new("ngspice").arg("-b").arg(&file).output().unwrap();
    let answer = String::from_utf8_lossy(&run.stdout).into_owned();
    let voltages: Vec<f64> = (0..28)
        .filter_map(|j| {
            let (_, value) = answer.split_once(&format!("v(e{j}) = "))?;
            value.lines().next()?.trim().parse().ok()
        })
        .collect();
    assert_eq!(voltages.len(), 28, "{answer}\n{}", String::from_utf8_lossy(&run.stderr));
    voltages
}

/// Largest relative difference between ours and ngspice's over the electrodes except the sink.
fn difference(
    folder: &Path,
    network: &SheetNetwork,
    to_top_s: &[f64],
    work: &Workspace,
    sink: usize,
) -> f64 {
    let circuit = model().circuit();
    let skin = LoadedCircuit { title: "a test", network, circuit, to_top_s };
    let spice = spice_voltages(folder, &netlist(&skin, sink).unwrap());
    let ours = &work.readout().electrodes_v()[28 * sink..][..28];
    assert_eq!((ours[sink], spice[sink]), (0.0, 0.0), "the sink is at 0 V");
    (0..28).filter(|&j| j != sink).map(|j| (ours[j] / spice[j] - 1.0).abs()).fold(0.0, f64::max)
}

/// The largest difference over random trials; each with one random injection, or with all.
fn worst_of_trials(trials: usize, all_injections: bool) -> f64 {
    let folder = tempdir().unwrap();
    let network = model().network().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut work = Workspace::default();
    let mut worst = 0f64;
    for trial in 0..trials {
        let load = random_load(&mut rng);
        model().voltages(&load, &mut work).unwrap();
        let one = rng.random_range(0..28);
        for sink in if all_injections { 0..28 } else { one..one + 1 } {
            let found = difference(folder.path(), &network, work.to_top_s(), &work, sink);
            assert!(found < AIM, "trial {trial}, sink {sink}: {found:e} of {load:?}");
            worst = worst.max(found);
        }
    }
    worst
}

#[test]
fn fifty_random_trials_agree_with_ngspice() {
    if available("ngspice") {
        println!("50 trials, one injection each: {:.1e}", worst_of_trials(50, false));
    }
}

#[test]
#[ignore = "1,400 runs of ngspice take tens of minutes"]
fn fifty_random_trials_with_all_injections_agree_with_ngspice() {
    if available("ngspice") {
        println!("50 trials, 28 injections each: {:.1e}", worst_of_trials(50, true));
    }
}

#[test]
fn an_untouched_and_a_heavily_loaded_skin_agree_with_ngspice() {
    if !available("ngspice") {
        return;
    }
    let folder = tempdir().unwrap();
    let network = model().network().unwrap();
    let mut work = Workspace::default();
    let heavy: Vec<_> = [(150.0, 150.0), (270.0, 280.0), (400.0, 420.0)]
        .iter()
        .map(|&(x, y)| press(point_at(x, y), 80.0))
        .collect();
    for load in [vec![], heavy] {
        model().voltages(&load, &mut work).unwrap();
        let found = difference(folder.path(), &network, work.to_top_s(), &work, 13);
        println!("{} contacts: {found:.1e}", load.len());
        assert!(found < AIM, "{} contacts: {found:e}", load.len());
    }
}

#[test]
fn twin_one_resistor_off_by_a_millionth_is_seen_by_ngspice() {
    if !available("ngspice") {
        return;
    }
    let folder = tempdir().unwrap();
    let mut network = model().network().unwrap();
    let mut work = Workspace::default();
    let point = point_at(270.0, 280.0);
    model().voltages(&[press(point, 20.0)], &mut work).unwrap();
    let sink = 13;
    let mut foam = work.to_top_s().to_vec();
    foam[model().mesh().points[point].centre as usize] *= 1.0 + 1e-6;
    let found = difference(folder.path(), &network, &foam, &work, sink);
    println!("a foam resistor off by 1e-6: {found:.1e}");
    assert!(found > 10.0 * AIM, "{found:e}");
    let node = network.electrodes[sink];
    let at_the_sink = network.resistors.iter_mut().find(|r| r.a == node || r.b == node).unwrap();
    at_the_sink.conductance_s *= 1.0 + 1e-6;
    let found = difference(folder.path(), &network, work.to_top_s(), &work, sink);
    println!("a sheet resistor at the sink off by 1e-6: {found:.1e}");
    assert!(found > 10.0 * AIM, "{found:e}");
}
