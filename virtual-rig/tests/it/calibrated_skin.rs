//! A virtual skin with its whole reality gap, calibrated from noisy, tilted, drifting trials.
//! Uses: the virtual skin through its public interface, sim-core's fit.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::forward::{Contact, ForwardModel};
use sim_core::inverse::skin::{MeasuredTrial, SkinFitOptions, fit, fvus, noise_v, summary};
use sim_core::sensor::Sensor;
use virtual_rig::skin::mechanics::Stroke;
use virtual_rig::skin::{Gap, Readout, Skin, TipLoad};

/// Trials of one to three tips on points, as returned by the stream of the rig.
fn measured(skin: &Skin, gap: &Gap, count: usize, seed: u64) -> Vec<MeasuredTrial> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut readout = Readout::new(gap, seed);
    let points = skin.model().sensor().points();
    (0..count)
        .map(|trial| {
            let tips: Vec<TipLoad> = (0..rng.random_range(1..=3))
                .map(|arm| {
                    let p = points[rng.random_range(0..points.len())];
                    let force_n = rng.random_range(7.0..48.0);
                    TipLoad { arm, x_mm: p.x_mm, y_mm: p.y_mm, force_n, stroke: Stroke::Loading }
                })
                .collect();
            let mut frame_v = vec![0.0; 784];
            readout.frame(&skin.solve(&tips), 3.0 * trial as f64, &mut frame_v);
            let contact = |t: &TipLoad| Contact { x_mm: t.x_mm, y_mm: t.y_mm, force_n: t.force_n };
            MeasuredTrial { contacts: tips.iter().map(contact).collect(), frame_v }
        })
        .collect()
}

#[test]
fn a_hundred_trials_of_gap_a_halve_what_is_unexplained_of_others() {
    let sensor =
        Sensor::from_toml(include_str!("../../../experiments/sensors/ert-28.toml")).unwrap();
    let gap = Gap::from_toml(include_str!("../../../experiments/gaps/gap-a.toml")).unwrap();
    let cache = std::env::temp_dir().join("palpate-test-cache");
    let skin = Skin::new(sensor.clone(), gap.clone(), 3, Some(&cache)).unwrap();
    let responses = skin.model().responses();
    let (fitted, held_out) = (measured(&skin, &gap, 100, 1), measured(&skin, &gap, 60, 2));
    let mut options = SkinFitOptions::for_trials(fitted.len(), 2);
    options.steps = 4;
    options.errors.noise_v = noise_v(&fitted).unwrap();
    let fit = fit(&sensor, responses.clone(), &fitted, &options, &mut |_| {}).unwrap();
    let nominal = ForwardModel::new(&sensor, responses.clone()).unwrap();
    let model = fit.model(&sensor, responses.clone()).unwrap();
    let [before, after] =
        [&nominal, &model].map(|m| summary(&fvus(m, &held_out).unwrap()).unwrap().median);
    println!("held-out FVU, median: {before:.3} -> {after:.3}; costs {:?}", fit.costs);
    assert!(after < 0.5 * before, "{before} -> {after}");
}
