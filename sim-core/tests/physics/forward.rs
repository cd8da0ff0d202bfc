//! The whole forward model: conventions, bounds, legal extremes, sizes of the signal.

use std::time::Instant;

use sim_core::circuit::ReadoutCircuit;
use sim_core::deformation::NodeForce;
use sim_core::fields::{DisplacementLut, LutError, LutGrid, NodeFields};
use sim_core::forward::{ForwardModel, Workspace};
use sim_core::piezo::resistance_ohm;
use sim_core::sensor::{ResistancePer, Sensor};

use super::{model, point_at, press, responses, sd, sensor};

fn frame(contacts: &[sim_core::forward::Contact]) -> Vec<f64> {
    model().voltages(contacts, &mut Workspace::default()).unwrap().to_vec()
}

#[test]
fn single_presses_have_the_studys_signal() {
    let point = point_at(270.0, 280.0);
    for (force_n, expected_mv) in [(5.0, 1.05), (10.0, 2.6), (20.0, 8.5), (40.0, 53.0)] {
        // `docs/references.md`, "Feasibility study". Mean over some points: their positions are
        // unknown.
        let places = [(150.0, 150.0), (400.0, 400.0), (200.0, 420.0), (350.0, 200.0)];
        let points = places.iter().map(|&(x, y)| point_at(x, y)).chain([point]);
        let all: Vec<f64> = points.map(|p| 1e3 * sd(&frame(&[press(p, force_n)]))).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        assert!((mean / expected_mv - 1.0).abs() < 0.25, "{force_n} N: {mean} mV ({all:.3?})");
    }
}

#[test]
fn frames_obey_the_convention() {
    let contacts = [press(100, 12.0), press(400, 25.0), press(700, 6.0)];
    let mut work = Workspace::default();
    let v = model().voltages(&contacts, &mut work).unwrap().to_vec();
    assert_eq!(v.len(), 784);
    let e = work.readout().electrodes_v();
    for k in 0..28 {
        assert_eq!(e[28 * k + k], 0.0, "the sink is at 0 V");
        let sum: f64 = v[28 * k..][..28].iter().sum();
        assert!(sum.abs() < 1e-14, "injection {k}: {sum:e}");
        for j in 0..28 {
            assert!((0.0..=12.0).contains(&e[28 * k + j]));
            let difference = e[28 * k + j] - e[28 * k + (j + 1) % 28];
            assert_eq!(v[28 * k + j], difference);
        }
    }
    let z = work.readout().impedance_ohm();
    for j in 0..28 {
        for k in 0..28 {
            assert_eq!(z[28 * j + k], z[28 * k + j]);
            assert!(z[28 * j + k] > 0.0 && z[28 * j + k] <= z[28 * k + k]);
        }
    }
}

#[test]
fn every_legal_load_is_finite() {
    let pitch = sensor().pitch_mm();
    let around = |force_n| -> Vec<_> {
        (0..6)
            .map(|arm| {
                let angle = f64::from(arm) * std::f64::consts::PI / 3.0;
                let (x, y) =
                    (257.01 + 2.0 * pitch * angle.cos(), 280.0 + 2.0 * pitch * angle.sin());
                press(point_at(x, y), force_n)
            })
            .collect()
    };
    for load in [around(1e-9), around(0.05), around(40.0), around(240.0), vec![press(0, 240.0)]] {
        let v = frame(&load);
        assert!(v.iter().all(|v| v.is_finite() && v.abs() <= 12.0));
    }
}

#[test]
fn an_untouched_skin_is_legal_and_right() {
    let mut work = Workspace::default();
    let v = model().voltages(&[], &mut work).unwrap().to_vec();
    assert!(v.iter().all(|v| v.is_finite()));
    // Every foam resistor is f(1e-4 mm), so the source drives 12 V through 3503 of them in
    // parallel: Z_kk is that resistance, except for the sheet's part of 1e-5.
    let rest_ohm = resistance_ohm(&sensor().file.piezo, 0.0);
    assert!((rest_ohm / 1.571e12 - 1.0).abs() < 1e-3, "{rest_ohm:e}");
    for k in 0..28 {
        let z = work.readout().impedance_ohm()[29 * k];
        assert!((z / (rest_ohm / 3503.0) - 1.0).abs() < 1e-4, "{z:e}");
    }
    // A millionth of a newton equals zero: x is below the clamp.
    assert_eq!(v, frame(&[press(400, 1e-6)]));
    assert!(1e6 * sd(&v) < 100.0 && sd(&v) > 0.0, "{} uV", 1e6 * sd(&v));
}

#[test]
fn more_force_draws_more_current_everywhere() {
    let mut work = Workspace::default();
    let mut before = vec![0.0; 28];
    for force_n in [0.0, 1.0, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 240.0] {
        model().voltages(&[press(333, force_n)], &mut work).unwrap();
        let current: Vec<f64> =
            (0..28).map(|k| 12.0 / work.readout().impedance_ohm()[29 * k]).collect();
        assert!(current.iter().zip(&before).all(|(now, before)| now > before), "{force_n} N");
        before = current;
    }
}

#[test]
fn loads_add_before_the_clamp() {
    // Around a press the foam rises a little; two presses must not clamp that to zero separately.
    let (a, b) = (point_at(270.0, 280.0), point_at(304.6, 280.0));
    let mut work = Workspace::default();
    model().voltages(&[press(a, 40.0), press(b, 40.0)], &mut work).unwrap();
    let both = work.compression_mm().to_vec();
    model().voltages(&[press(a, 40.0)], &mut work).unwrap();
    let first = work.compression_mm().to_vec();
    model().voltages(&[press(b, 40.0)], &mut work).unwrap();
    let clamped_early = first.iter().zip(work.compression_mm()).map(|(a, b)| a + b);
    assert!(both.iter().all(|&x| x >= 0.0));
    assert!(both.iter().zip(clamped_early).any(|(x, early)| early - x > 1e-3));
}

#[test]
fn the_area_reading_scales_the_foam_down() {
    let mut file = sensor().file.clone();
    file.piezo.resistance_per = ResistancePer::Area;
    let scaled = ForwardModel::new(Sensor::new(file).unwrap(), responses()).unwrap();
    let mut work = Workspace::default();
    let contact = [press(point_at(270.0, 280.0), 40.0)];
    let ratio = sd(&frame(&contact)) / sd(scaled.voltages(&contact, &mut work).unwrap());
    assert!((ratio / (400.0 / 86.6) - 1.0).abs() < 0.1, "{ratio}");
    assert_ne!(scaled.model_hash(), model().model_hash());
}

#[test]
fn vertex_forces_and_neutral_fields_give_the_same_frame() {
    let nominal = frame(&[press(222, 18.0)]);
    let fields = NodeFields::nominal(model().mesh());
    let circuit = ReadoutCircuit::nominal(sensor());
    let same = ForwardModel::with(sensor(), responses(), fields.clone(), circuit.clone()).unwrap();
    assert_eq!(same.model_hash(), model().model_hash());
    let vertices = same.mesh().points[222].vertices;
    let forces = vertices.map(|node| NodeForce { node, force_n: 3.0 });
    let mut work = Workspace::default();
    assert_eq!(same.voltages_of_node_forces(&forces, &mut work), nominal);

    // Each field changes the frame, and the hash; a wrong length is rejected.
    let mut other = fields.clone();
    other.ln_a.iter_mut().for_each(|v| *v = 0.1);
    let moved = ForwardModel::with(sensor(), responses(), other, circuit.clone()).unwrap();
    assert_ne!(moved.voltages_of_node_forces(&forces, &mut work), nominal);
    assert_ne!(moved.model_hash(), model().model_hash());
    let mut short = fields;
    short.ln_c.pop();
    assert!(ForwardModel::with(sensor(), responses(), short, circuit).is_err());
}

#[test]
fn contact_and_lead_resistances_reduce_the_seen_voltages_as_they_should() {
    let fields = NodeFields::nominal(model().mesh());
    let contact = [press(222, 30.0)];
    let mut work = Workspace::default();
    model().voltages(&contact, &mut work).unwrap();
    let (z, ideal) =
        (work.readout().impedance_ohm().to_vec(), work.readout().electrodes_v().to_vec());
    // A lead and a contact resistance on a node are equivalent: both add to Z_kk only.
    let ohm = 2e4;
    for lead in [true, false] {
        let mut circuit = ReadoutCircuit::nominal(sensor());
        let site = &mut circuit.electrodes[4];
        if lead {
            site.lead_ohm = ohm;
        } else {
            site.contact_ohm = ohm;
        }
        let model = ForwardModel::with(sensor(), responses(), fields.clone(), circuit).unwrap();
        model.voltages(&contact, &mut work).unwrap();
        let seen = work.readout().electrodes_v();
        let own = z[29 * 4] + ohm;
        for j in (0..28).filter(|&j| j != 4) {
            let expected = 12.0 * (own - z[28 * j + 4]) / own;
            assert!((seen[28 * 4 + j] / expected - 1.0).abs() < 1e-9);
        }
        let elsewhere = (seen[28 * 7 + 9] / ideal[28 * 7 + 9] - 1.0).abs();
        assert!(elsewhere < 1e-9, "{elsewhere:e}");
    }
}

#[test]
fn a_skin_with_other_electrodes_is_the_one_made_anew() {
    let mut circuit = ReadoutCircuit::nominal(sensor());
    circuit.electrodes.iter_mut().for_each(|site| site.contact_ohm = 30.0);
    let of = |circuit: &ReadoutCircuit| {
        let fields = NodeFields::nominal(model().mesh());
        ForwardModel::with(sensor(), responses(), fields, circuit.clone()).unwrap()
    };
    let before = of(&circuit);
    circuit.electrodes[3].x_mm += 17.0;
    circuit.electrodes[9].contact_ohm = 12.0;
    // The last one is a node itself, without a resistance.
    for contact_ohm in [30.0, 0.0] {
        circuit.electrodes[20].contact_ohm = contact_ohm;
        let (moved, built) = (before.with_circuit(circuit.clone()).unwrap(), of(&circuit));
        assert_eq!(moved.model_hash(), built.model_hash());
        let frame_of = |model: &ForwardModel| {
            model.voltages(&[press(222, 30.0)], &mut Workspace::default()).unwrap().to_vec()
        };
        let (moved_v, built_v) = (frame_of(&moved), frame_of(&built));
        assert_eq!(moved_v, built_v, "to the last bit");
        assert_ne!(frame_of(&before), moved_v);
    }
}

#[test]
fn a_displacement_table_is_linear_between_its_samples() {
    let lut = DisplacementLut::sample(LutGrid { step_mm: 0.5, end_mm: 4.0 }, |x| x * x).unwrap();
    assert_eq!(lut.apply(0.0), 0.0);
    assert_eq!(lut.apply(0.25), 0.125);
    assert_eq!(lut.apply(2.0), 4.0);
    assert!((lut.apply(5.0) - (16.0 + 7.5)).abs() < 1e-12, "is extrapolated with its last slope");
    assert_eq!(
        DisplacementLut::new(1.0, vec![0.0, 2.0, 1.0]),
        Err(LutError::NotRising { index: 2, value_mm: 1.0 })
    );
}

#[test]
fn a_frame_takes_about_a_millisecond() {
    let contacts: Vec<_> = (0..6).map(|i| press(60 + 120 * i, 20.0)).collect();
    let mut work = Workspace::default();
    model().voltages(&contacts, &mut work).unwrap();
    let best = (0..40)
        .map(|_| {
            let start = Instant::now();
            model().voltages(&contacts, &mut work).unwrap();
            start.elapsed()
        })
        .min()
        .unwrap();
    println!("one frame: {best:?}, {} multiply-adds", model().multiply_adds());
    // Generous, for a loaded machine; a dense or a 28-fold solve takes 100 ms and more.
    assert!(best.as_millis() < 10, "{best:?}");
}
