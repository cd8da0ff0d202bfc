//! Tests of the fit: differences of its cost, skins of the family that it fits, invalid input.

use std::sync::OnceLock;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn sensor() -> &'static Sensor {
    static SENSOR: OnceLock<Sensor> = OnceLock::new();
    let text = include_str!("../../../../experiments/sensors/ert-28.toml");
    SENSOR.get_or_init(|| Sensor::from_toml(text).unwrap())
}

fn responses() -> Arc<UnitResponses> {
    static RESPONSES: OnceLock<Arc<UnitResponses>> = OnceLock::new();
    Arc::clone(RESPONSES.get_or_init(|| Arc::new(UnitResponses::solve(sensor()).unwrap())))
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0
}

/// Options for these trials, whose contacts are exactly as stated.
fn options(spacing_mm: f64, threads: usize) -> SkinFitOptions {
    let errors = TrialErrors {
        place_mm: 0.0,
        force_share: 0.0,
        gain_share: 0.0,
        model_error: 0.1,
        ..TrialErrors::default()
    };
    SkinFitOptions { spacing_mm, errors, ..SkinFitOptions::for_trials(0, threads) }
}

fn parameters(options: &SkinFitOptions) -> Parameters {
    Parameters::new(sensor(), responses(), options.prior, options.spacing_mm).unwrap()
}

/// ln of the sheet's conductance along x over that along y of [`some_skin`].
const ANISOTROPY: f64 = 0.25;

/// A skin drawn from the prior's family: smooth waves on every field, electrodes moved.
fn some_skin(parameters: &Parameters, seed: u64) -> ForwardModel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut vector = vec![0.0; parameters.len()];
    for (block, sd) in parameters.blocks.iter().zip([0.5, 0.08, 0.2, 0.06, 0.1]) {
        let wave: [f64; 3] = std::array::from_fn(|_| rng.random_range(-0.03..0.03));
        for corner in block.at.clone() {
            let [x, y] = block.place_mm(sensor(), corner - block.at.start);
            vector[corner] = 1.4 * sd * (wave[0] * x + wave[1] * y + 100.0 * wave[2]).sin();
        }
    }
    let anisotropy = parameters.anisotropy();
    vector[anisotropy] = ANISOTROPY;
    let electrodes = anisotropy + 1..parameters.len();
    let count = sensor().electrodes_mm().len();
    for (n, i) in electrodes.enumerate() {
        vector[i] = [2.5, 2.5, 0.1, 0.5][n / count] * normal(&mut rng);
    }
    parameters.model(&vector).unwrap()
}

/// Trials of one to three contacts on points, with white noise.
fn measured(skin: &ForwardModel, count: usize, seed: u64) -> Vec<MeasuredTrial> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut work = Workspace::default();
    (0..count)
        .map(|_| {
            let contacts: Vec<Contact> = (0..rng.random_range(1..=3))
                .map(|_| {
                    let p = sensor().points()[rng.random_range(0..804)];
                    let force_n = rng.random_range(7.0..45.0);
                    Contact { x_mm: p.x_mm, y_mm: p.y_mm, force_n }
                })
                .collect();
            let clean_v = skin.voltages(&contacts, &mut work).unwrap();
            let frame_v = clean_v.iter().map(|v| (v + 1.2e-3 * normal(&mut rng)) as f32).collect();
            MeasuredTrial { contacts, frame_v }
        })
        .collect()
}

fn median(model: &ForwardModel, trials: &[MeasuredTrial]) -> f64 {
    summary(&fvus(model, trials).unwrap()).unwrap().median
}

/// ln of the total conductance to the top under a tip on each of some points: the joint effect of
/// the fields of a, b, c and compliance, which are not separable.
fn conducts(model: &ForwardModel) -> Vec<f64> {
    let mut work = Workspace::default();
    let mut of = |point: usize| {
        let p = sensor().points()[point];
        let contact = Contact { x_mm: p.x_mm, y_mm: p.y_mm, force_n: 20.0 };
        model.voltages(&[contact], &mut work).unwrap();
        work.to_top_s().iter().sum::<f64>().ln()
    };
    (0..804).step_by(13).map(&mut of).collect()
}

/// Correlation of two lists.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let centred = |v: &[f64]| -> Vec<f64> {
        let mean = v.iter().sum::<f64>() / v.len() as f64;
        v.iter().map(|v| v - mean).collect()
    };
    let (a, b) = (centred(a), centred(b));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

/// Number of electrodes in the triangle of their true position.
fn in_their_triangles(places_mm: &[[f64; 2]], skin: &ForwardModel) -> usize {
    let triangle = |at_mm: [f64; 2]| {
        let mut nodes = skin.mesh().locate(at_mm).nodes;
        nodes.sort_unstable();
        nodes
    };
    let both = places_mm.iter().zip(&skin.circuit().electrodes);
    both.filter(|(at, site)| triangle(**at) == triangle([site.x_mm, site.y_mm])).count()
}

/// What a fit finds of [`some_skin`].
struct Recovered {
    /// Held-out medians of the FVU before and after the fit.
    medians: [f64; 2],
    /// Correlation of the fitted with the true conductances.
    alike: f64,
    /// Electrodes in their triangles before and after.
    placed: [usize; 2],
    anisotropy: f64,
}

/// A fit of `trials` trials.
fn recovered(trials: usize, spacing_mm: f64, model_error: f64) -> Recovered {
    let mut options = options(spacing_mm, 2);
    options.errors.model_error = model_error;
    let skin = some_skin(&parameters(&options), 3);
    let (fitted, held_out) = (measured(&skin, trials, 4), measured(&skin, 60, 5));
    let fit = fit(sensor(), responses(), &fitted, &options, &mut |_| {}).unwrap();
    let model = fit.model(sensor(), responses()).unwrap();
    let nominal = ForwardModel::new(sensor(), responses()).unwrap();
    let alike = correlation(&conducts(&model), &conducts(&skin));
    let medians = [median(&nominal, &held_out), median(&model, &held_out)];
    let sites = |model: &ForwardModel| {
        model.circuit().electrodes.iter().map(|site| [site.x_mm, site.y_mm]).collect::<Vec<_>>()
    };
    let placed = [&nominal, &model].map(|model| in_their_triangles(&sites(model), &skin));
    let anisotropy = fit.fields.ln_sheet_anisotropy;
    println!("{trials} trials: FVU {medians:.4?}, conductance {alike:.3}, electrodes {placed:?}");
    println!("anisotropy {anisotropy}, costs {:?}", fit.costs);
    Recovered { medians, alike, placed, anisotropy }
}

#[test]
fn the_step_goes_along_the_costs_gradient() {
    let options = options(90.0, 1);
    let parameters = parameters(&options);
    let trials = measured(&some_skin(&parameters, 1), 3, 2);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let point: Vec<f64> = (0..parameters.len()).map(|_| 0.05 * normal(&mut rng)).collect();
    let offsets_v: Vec<f64> = (0..784).map(|_| 1e-4 * normal(&mut rng)).collect();
    let mut ignore = |_: SkinProgress| {};
    let mut sweep = Sweep::new(&parameters, &trials, &options, &mut ignore);
    let model = parameters.model(&point).unwrap();
    let (_, pull) = sweep.normal(&model, &offsets_v, &[1.0; 3]).unwrap();
    let mut cost = |vector: &[f64]| {
        let model = parameters.model(vector).unwrap();
        sweep.misfits(&model, &offsets_v).unwrap().cost(f64::INFINITY)
    };
    let mut kinds: Vec<_> = parameters.blocks.iter().map(|block| block.at.clone()).collect();
    kinds.push(0..parameters.blocks[0].at.start);
    kinds.push(parameters.anisotropy()..parameters.anisotropy() + 1);
    kinds.push(parameters.places_at().end..parameters.len());
    for at in kinds {
        let direction: Vec<f64> = (0..parameters.len())
            .map(|i| if at.contains(&i) { normal(&mut rng) } else { 0.0 })
            .collect();
        let step = 1e-4;
        let moved = |by: f64| -> Vec<f64> {
            point.iter().zip(&direction).map(|(p, d)| p + by * d).collect()
        };
        let numbers = (cost(&moved(step)) - cost(&moved(-step))) / (2.0 * step);
        let slope: f64 = -2.0 * direction.iter().zip(&pull).map(|(d, p)| d * p).sum::<f64>();
        let error = ((numbers - slope) / numbers).abs();
        println!("{at:?}: {slope:.6e} against {numbers:.6e}");
        // Nodes that hardly conduct are skipped in the step, not in the cost.
        assert!(error < 1e-2, "{at:?}: {error:e}");
    }
}

#[test]
fn a_skin_of_the_family_is_found() {
    let Recovered { medians: [before, after], alike, placed, anisotropy } =
        recovered(120, 60.0, 0.02);
    assert!(after < 0.12 * before, "{before} -> {after}");
    assert!(alike > 0.95, "conductance: {alike}");
    assert!(placed[1] >= placed[0] + 6, "{placed:?} of 28 electrodes");
    assert!((anisotropy - ANISOTROPY).abs() < 0.03, "{anisotropy}");
}

#[test]
fn a_loose_electrode_is_found_and_is_no_open_end() {
    const LOOSE: usize = 25;
    let options = SkinFitOptions { steps: 8, ..options(90.0, 2) };
    let parameters = parameters(&options);
    let mut vector = vec![0.0; parameters.len()];
    // 20 kOhm of contact.
    let contact = parameters.places_at().end + LOOSE;
    vector[contact] = (2e4 / options.prior.contact_ohm).ln();
    let skin = parameters.model(&vector).unwrap();
    let (fitted, held_out) = (measured(&skin, 60, 14), measured(&skin, 40, 15));
    let fit = fit(sensor(), responses(), &fitted, &options, &mut |_| {}).unwrap();
    let model = fit.model(sensor(), responses()).unwrap();
    let nominal = ForwardModel::new(sensor(), responses()).unwrap();
    let [before, after] = [&nominal, &model].map(|model| median(model, &held_out));
    let found = fit.electrodes.contact_ohm[LOOSE] + fit.electrodes.lead_ohm[LOOSE];
    println!("FVU {before:.4} -> {after:.4}, {found:.0} Ohm, offsets {:?}", fit.offsets_mv[0]);
    assert!(after < 0.5 * before, "{before} -> {after}");
    assert!((5e3..1e5).contains(&found), "{found} Ohm");
}

#[test]
fn few_trials_help_and_do_not_overfit() {
    let [before, after] = recovered(15, 60.0, 0.1).medians;
    assert!(after < 0.8 * before, "{before} -> {after}");
}

#[test]
fn threads_change_no_bit_and_a_wild_frame_is_doubted() {
    let one = SkinFitOptions { steps: 6, ..options(90.0, 1) };
    let skin = some_skin(&parameters(&one), 7);
    let mut trials = measured(&skin, 24, 8);
    trials[5].frame_v.iter_mut().for_each(|v| *v = -*v);
    // An untouched skin with a readout offset.
    trials.push(MeasuredTrial { contacts: Vec::new(), frame_v: vec![2e-4; 784] });
    let three = SkinFitOptions { threads: 3, ..one };
    let [a, b] = [one, three].map(|o| {
        let mut counted = Vec::new();
        let fitted = fit(sensor(), responses(), &trials, &o, &mut |p| counted.push(p)).unwrap();
        // One count for the whole fit: the time to go does not begin again with each step.
        assert!(counted.is_sorted_by_key(|p| p.done));
        let [first, end] = [counted.first(), counted.last()].map(|p| p.unwrap());
        assert!(first.step == 1 && end.step > 1 && end.done <= end.total, "{end:?}");
        assert!(counted.iter().all(|p| p.total == 18 * trials.len()));
        fitted
    });
    assert_eq!(
        (&a.fields, &a.electrodes, &a.offsets_mv),
        (&b.fields, &b.electrodes, &b.offsets_mv)
    );
    assert_eq!(a.costs, b.costs);
    assert!(a.doubted.contains(&5), "{:?}", a.doubted);
    assert!(a.doubted.len() < 6, "{:?}", a.doubted);
}

#[test]
fn finer_fields_continue_a_coarser_skin() {
    let [coarse, fine] = [90.0, 60.0].map(|spacing_mm| parameters(&options(spacing_mm, 1)));
    let plane = |parameters: &Parameters| {
        let mut vector: Vec<f64> = (0..parameters.len()).map(|i| 1e-3 * i as f64).collect();
        for block in &parameters.blocks {
            for corner in block.at.clone() {
                let [x, y] = block.place_mm(sensor(), corner - block.at.start);
                vector[corner] = 1e-3 * x - 2e-3 * y;
            }
        }
        let own = parameters.anisotropy()..parameters.len();
        vector[own].iter_mut().enumerate().for_each(|(i, v)| *v = 0.1 * i as f64);
        vector
    };
    let refined = fine.refined(&coarse, &plane(&coarse));
    assert!(fine.len() > coarse.len());
    for (i, (found, wanted)) in refined.iter().zip(plane(&fine)).enumerate() {
        assert!((found - wanted).abs() < 1e-12, "{i}: {found} for {wanted}");
    }
}

#[test]
fn a_fit_of_many_trials_begins_with_a_quarter_of_them() {
    const MANY: usize = 60;
    let options = SkinFitOptions { steps: 1, many_trials: MANY, ..options(120.0, 2) };
    let parameters = parameters(&options);
    let trials = measured(&some_skin(&parameters, 11), MANY, 12);
    let mut counted = Vec::new();
    let fit = fit(sensor(), responses(), &trials, &options, &mut |p| counted.push(p)).unwrap();
    let alone = &mut |_: SkinProgress| {};
    let mut sweep = Sweep::new(&parameters, &trials, &options, alone);
    let (vector, offsets_v) = (vec![0.0; parameters.len()], vec![0.0; sensor().channels()]);
    let nominal = parameters.model(&vector).unwrap();
    let misfits = sweep.misfits(&nominal, &offsets_v).unwrap();
    let before = misfits.cost(misfits.edge());
    assert!(fit.costs[0] < 0.5 * before, "{before} -> {:?}", fit.costs);
    assert!(counted.is_sorted_by_key(|p| (p.step, p.done)));
    assert!(counted.iter().all(|p| p.steps == 2 && p.total == 3 * (MANY + MANY / 4)));
    assert!(counted.iter().any(|p| p.step == 2) && counted.iter().all(|p| p.done <= p.total));
    assert_eq!([999, 1000, 4000, 16000].map(|trials| strides(trials, 1000)[0]), [1, 4, 16, 64]);
}

#[test]
fn noise_is_seen_in_the_rings() {
    let skin = ForwardModel::new(sensor(), responses()).unwrap();
    let noise = noise_v(&measured(&skin, 12, 9)).unwrap();
    assert!((noise / 1.2e-3 - 1.0).abs() < 0.15, "{noise}");
    assert_eq!(noise_v(&[]), None);
}

#[test]
fn bad_input_is_named() {
    let options = options(90.0, 1);
    let of = |trials: &[MeasuredTrial], options: &SkinFitOptions| {
        fit(sensor(), responses(), trials, options, &mut |_| {}).unwrap_err().to_string()
    };
    assert_eq!(of(&[], &options), "fitting a skin: no trials with a contact");
    let mut trials = measured(&ForwardModel::new(sensor(), responses()).unwrap(), 2, 1);
    trials[1].frame_v[3] = f32::NAN;
    assert!(of(&trials, &options).contains("trial 1: 783 finite voltages, the sensor has 784"));
    trials[1].frame_v[3] = 0.0;
    trials[0].contacts[0].x_mm = -5.0;
    assert!(of(&trials, &options).contains("x_mm = -5"));
    let mut wrong = options;
    wrong.prior.ln_b.smooth_sd = f64::NAN;
    assert!(of(&trials, &wrong).contains("prior of LnB"));
}
